"""Projects points with the camera in a file, which is read by the program that the format is meant for.

Standard input is a JSON list of {"format", "file", "points"}: the format's name, the file, and points in camera
coordinates. Standard output is a JSON list of lists of pixels. Where no Python package of a program exists, its
loader's rules and its projection are written out here from its documentation.
"""

import json
import sys

import numpy as np


def opencv(path, points):
    import cv2

    storage = cv2.FileStorage(path, cv2.FILE_STORAGE_READ)
    assert storage.isOpened()
    matrix = storage.getNode("camera_matrix").mat()
    distortion = storage.getNode("distortion_coefficients").mat()
    assert storage.getNode("image_width").real() == 346 and storage.getNode("image_height").real() == 260
    model = storage.getNode("distortion_model").string()
    if model == "omnidir":
        points, none = np.array(points).reshape(-1, 1, 3), np.zeros(3)
        xi = storage.getNode("xi").real()
        return cv2.omnidir.projectPoints(points, none, none, matrix, xi, distortion)[0].reshape(-1, 2)
    return with_opencv(model, points, matrix, distortion)


def with_opencv(model, points, matrix, distortion):
    import cv2

    points, none = np.array(points).reshape(-1, 1, 3), np.zeros(3)
    if model == "fisheye":
        return cv2.fisheye.projectPoints(points, none, none, matrix, distortion)[0].reshape(-1, 2)
    assert model == "radtan"
    return cv2.projectPoints(points, none, none, matrix, distortion)[0].reshape(-1, 2)


def ros(path, points):
    """Reads the keys that camera_calibration_parsers requires and projects with OpenCV, as image_geometry does."""
    import yaml

    with open(path) as file:
        camera = yaml.safe_load(file)
    assert (camera["image_width"], camera["image_height"]) == (346, 260)
    assert isinstance(camera["camera_name"], str)

    def matrix(name, rows, columns):
        node = camera[name]
        assert (node["rows"], node["cols"]) == (rows, columns) and len(node["data"]) == rows * columns
        assert all(type(value) is float for value in node["data"]), node["data"]
        return np.array(node["data"]).reshape(rows, columns)

    count = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}[camera["distortion_model"]]
    distortion = matrix("distortion_coefficients", 1, count)
    assert (matrix("rectification_matrix", 3, 3) == np.eye(3)).all()
    camera_matrix = matrix("camera_matrix", 3, 3)
    assert (matrix("projection_matrix", 3, 4) == np.hstack([camera_matrix, np.zeros((3, 1))])).all()
    model = "fisheye" if camera["distortion_model"] == "equidistant" else "radtan"
    return with_opencv(model, points, camera_matrix, distortion)


def kalibr(path, points):
    """Applies the checks of kalibr_common's CameraParameters and the projections of aslam_cv."""
    import yaml

    with open(path) as file:
        camera = yaml.safe_load(file)["cam0"]
    intrinsics, distortion = camera["intrinsics"], camera["distortion_coeffs"]
    lengths = {"pinhole": 4, "omni": 5, "eucm": 6, "ds": 6}
    assert len(intrinsics) == lengths[camera["camera_model"]]
    assert all(type(value) is float for value in intrinsics)
    assert len(distortion) == {"radtan": 4, "equidistant": 4, "fov": 1, "none": 0}[camera["distortion_model"]]
    assert all(type(value) is float for value in distortion)
    assert all(type(value) is int for value in camera["resolution"]) and camera["resolution"] == [346, 260]
    assert isinstance(camera["rostopic"], str) and camera["cam_overlaps"] == []
    *shape, fu, fv, pu, pv = intrinsics
    x, y, z = np.array(points).T
    length = np.sqrt(x * x + y * y + z * z)
    if camera["camera_model"] == "pinhole":
        u, v = x / z, y / z
    elif camera["camera_model"] == "omni":
        u, v = x / (z + shape[0] * length), y / (z + shape[0] * length)
    elif camera["camera_model"] == "eucm":
        alpha, beta = shape
        depth = alpha * np.sqrt(beta * (x * x + y * y) + z * z) + (1 - alpha) * z
        u, v = x / depth, y / depth
    else:
        u, v = double_sphere(*shape, x, y, z)
    if camera["distortion_model"] == "radtan":
        k1, k2, p1, p2 = distortion
        square = u * u + v * v
        radial = 1 + k1 * square + k2 * square * square
        u, v = (
            u * radial + 2 * p1 * u * v + p2 * (square + 2 * u * u),
            v * radial + p1 * (square + 2 * v * v) + 2 * p2 * u * v,
        )
    elif camera["distortion_model"] == "equidistant":
        radius = np.hypot(u, v)
        scale = equidistant(np.arctan(radius), distortion) / radius
        u, v = u * scale, v * scale
    elif camera["distortion_model"] == "fov":
        radius, (w,) = np.hypot(u, v), distortion
        scale = np.arctan(2 * radius * np.tan(w / 2)) / w / radius
        u, v = u * scale, v * scale
    return np.stack([fu * u + pu, fv * v + pv], axis=1)


def equidistant(angle, coefficients):
    square = angle * angle
    return angle * (1 + sum(k * square ** (n + 1) for n, k in enumerate(coefficients)))


def double_sphere(xi, alpha, x, y, z):
    first = np.sqrt(x * x + y * y + z * z)
    shifted = xi * first + z
    depth = alpha * np.sqrt(x * x + y * y + shifted * shifted) + (1 - alpha) * shifted
    return x / depth, y / depth


def basalt(path, points):
    """Reads the keys of basalt-headers' serialiser and projects with its camera models."""
    with open(path) as file:
        root = json.load(file)
    name, value = next(iter(root.items()))
    assert name == "value0", "cereal takes the first value"
    for key, length in [("calib_accel_bias", 9), ("calib_gyro_bias", 12), ("accel_noise_std", 3), ("gyro_noise_std", 3)]:
        assert len(value[key]) == length
    assert set(value["T_imu_cam"][0]) == {"px", "py", "pz", "qx", "qy", "qz", "qw"}
    assert value["resolution"] == [[346, 260]] and value["vignette"] == []
    assert isinstance(value["cam_time_offset_ns"], int) and value["imu_update_rate"] > 0
    (camera,) = value["intrinsics"]
    p = camera["intrinsics"]
    x, y, z = np.array(points).T
    across = np.hypot(x, y)
    kind = camera["camera_type"]
    if kind == "kb4":
        scale = equidistant(np.arctan2(across, z), [p["k1"], p["k2"], p["k3"], p["k4"]]) / across
        u, v = x * scale, y * scale
    elif kind == "ds":
        u, v = double_sphere(p["xi"], p["alpha"], x, y, z)
    elif kind in ("ucm", "eucm"):
        depth = p["alpha"] * np.sqrt(p.get("beta", 1.0) * across * across + z * z) + (1 - p["alpha"]) * z
        u, v = x / depth, y / depth
    else:
        assert kind == "fov"
        scale = np.arctan2(2 * across * np.tan(p["w"] / 2), z) / (p["w"] * across)
        u, v = x * scale, y * scale
    return np.stack([p["fx"] * u + p["cx"], p["fy"] * v + p["cy"]], axis=1)


def dv_processing(path, points):
    import dv_processing

    (camera,) = dv_processing.camera.CalibrationSet.LoadFromFile(path).getCameraCalibrations().values()
    assert tuple(camera.resolution) == (346, 260) and camera.name == "DAVIS346_00000001", (camera.resolution, camera.name)
    geometry = camera.getCameraGeometry()
    # The distortion function expects points at depth 1.
    flat = [np.array([x / z, y / z, 1.0]) for x, y, z in points]
    return np.array([geometry.project(geometry.distort(point)) for point in flat])


def mrcal(path, points):
    import mrcal

    model = mrcal.cameramodel(path)
    assert tuple(model.imagersize()) == (346, 260)
    region = model.valid_intrinsics_region()
    assert len(region) > 3 and (region[0] == region[-1]).all()
    return mrcal.project(np.array(points), *model.intrinsics())


READERS = {
    "opencv-yaml": opencv,
    "opencv-xml": opencv,
    "opencv-json": opencv,
    "ros": ros,
    "kalibr": kalibr,
    "basalt": basalt,
    "dv-xml": dv_processing,
    "dv-processing": dv_processing,
    "mrcal": mrcal,
}


def main():
    answers = [READERS[task["format"]](task["file"], task["points"]).tolist() for task in json.load(sys.stdin)]
    json.dump(answers, sys.stdout)


main()
