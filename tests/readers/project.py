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
    if kind == "pinhole-radtan8":
        # basalt uses the model within the radius rpmax at depth 1; 0 is no limit.
        assert ((across / z < p["rpmax"]) | (p["rpmax"] == 0)).all()
        matrix = np.array([[p["fx"], 0, p["cx"]], [0, p["fy"], p["cy"]], [0, 0, 1]])
        distortion = np.array([p[name] for name in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")])
        return with_opencv("radtan", points, matrix, distortion)
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


def colmap(path, points):
    """Loads cameras.txt as a part of a reconstruction without images. The centre of the first pixel is (0.5, 0.5)."""
    import shutil
    import tempfile

    import pycolmap

    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(path, folder + "/cameras.txt")
        for name in ("images.txt", "points3D.txt"):
            open(f"{folder}/{name}", "w").close()
        (camera,) = pycolmap.Reconstruction(folder).cameras.values()
    assert (camera.width, camera.height) == (346, 260)
    return camera.img_from_cam(np.array(points)) - 0.5


def nerfstudio(path, points):
    """Projects as nerfstudio's camera_utils does; its pixels have their corner at 0."""
    with open(path) as file:
        camera = json.load(file)
    assert (camera["w"], camera["h"]) == (346, 260)
    x, y, z = np.array(points).T
    x, y = x / z, y / z
    if camera["camera_model"] == "OPENCV_FISHEYE":
        radius = np.hypot(x, y)
        scale = equidistant(np.arctan(radius), [camera[f"k{n}"] for n in (1, 2, 3, 4)]) / radius
        u, v = x * scale, y * scale
    else:
        assert camera["camera_model"] == "OPENCV"
        square = x * x + y * y
        d = 1 + square * (camera["k1"] + square * (camera["k2"] + square * (camera["k3"] + square * camera["k4"])))
        p1, p2 = camera["p1"], camera["p2"]
        u = d * x + 2 * p1 * x * y + p2 * (square + 2 * x * x)
        v = d * y + 2 * p2 * x * y + p1 * (square + 2 * y * y)
    return np.stack([camera["fl_x"] * u + camera["cx"], camera["fl_y"] * v + camera["cy"]], axis=1) - 0.5


def storage_of(path):
    import cv2

    storage = cv2.FileStorage(path, cv2.FILE_STORAGE_READ)
    assert storage.isOpened()

    def number(node, name):
        node = node.getNode(name)
        assert node.isReal() or node.isInt(), name
        return node.real()

    return storage, number


def vins_fusion(path, points):
    """Reads the keys of camodocal's Parameters::readFromYamlFile and projects as its cameras do."""
    storage, number = storage_of(path)
    assert (number(storage, "image_width"), number(storage, "image_height")) == (346, 260)
    assert storage.getNode("camera_name").string() == "DAVIS346_00000001"
    kind = storage.getNode("model_type").string()
    projection = storage.getNode("projection_parameters")
    x, y, z = np.array(points).T
    length = np.sqrt(x * x + y * y + z * z)
    if kind == "KANNALA_BRANDT":
        fu, fv, cu, cv = (number(projection, name) for name in ("mu", "mv", "u0", "v0"))
        radius = equidistant(np.arccos(z / length), [number(projection, f"k{n}") for n in (2, 3, 4, 5)])
        direction = np.arctan2(y, x)
        u, v = radius * np.cos(direction), radius * np.sin(direction)
        return np.stack([fu * u + cu, fv * v + cv], axis=1)
    if kind == "MEI":
        fu, fv, cu, cv = (number(projection, name) for name in ("gamma1", "gamma2", "u0", "v0"))
        depth = z + number(storage.getNode("mirror_parameters"), "xi") * length
    else:
        assert kind == "PINHOLE"
        fu, fv, cu, cv = (number(projection, name) for name in ("fx", "fy", "cx", "cy"))
        depth = z
    k1, k2, p1, p2 = (number(storage.getNode("distortion_parameters"), name) for name in ("k1", "k2", "p1", "p2"))
    flat = np.stack([x / depth, y / depth, np.ones_like(x)], axis=1)
    return with_opencv("radtan", flat, np.array([[fu, 0, cu], [0, fv, cv], [0, 0, 1]]), np.array([k1, k2, p1, p2]))


def orb_slam3(path, points):
    """Reads the keys that Settings requires, with their types, and projects as it does."""
    storage, number = storage_of(path)
    assert storage.getNode("File.version").string() == "1.0"
    for name in ("Camera.width", "Camera.height", "Camera.fps", "Camera.RGB"):
        assert storage.getNode(name).isInt(), name
    assert (number(storage, "Camera.width"), number(storage, "Camera.height")) == (346, 260)
    fx, fy, cx, cy = (number(storage, f"Camera1.{name}") for name in ("fx", "fy", "cx", "cy"))
    kind = storage.getNode("Camera.type").string()
    names = {"PinHole": ("k1", "k2", "p1", "p2"), "KannalaBrandt8": ("k1", "k2", "k3", "k4")}[kind]
    if kind == "PinHole" and not storage.getNode("Camera1.k3").empty():
        names += ("k3",)
    distortion = np.array([number(storage, f"Camera1.{name}") for name in names])
    model = "radtan" if kind == "PinHole" else "fisheye"
    return with_opencv(model, points, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), distortion)


def svo(path, points):
    """Reads the keys that vikit's NCamera requires."""
    import yaml

    with open(path) as file:
        root = yaml.safe_load(file)
    assert root["label"] == "DAVIS346_00000001"
    (entry,) = root["cameras"]
    camera = entry["camera"]

    def matrix(node, rows, columns):
        assert (node["rows"], node["cols"]) == (rows, columns) and len(node["data"]) == rows * columns
        return np.array(node["data"]).reshape(rows, columns)

    assert (matrix(entry["T_B_C"], 4, 4) == np.eye(4)).all()
    assert camera["type"] == "pinhole" and (camera["image_width"], camera["image_height"]) == (346, 260)
    fx, fy, cx, cy = matrix(camera["intrinsics"], 4, 1)[:, 0]
    distortion = matrix(camera["distortion"]["parameters"], 4, 1)[:, 0]
    model = {"radial-tangential": "radtan", "equidistant": "fisheye"}[camera["distortion"]["type"]]
    return with_opencv(model, points, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), distortion)


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
    "colmap": colmap,
    "nerfstudio": nerfstudio,
    "vins-fusion": vins_fusion,
    "orb-slam3": orb_slam3,
    "svo": svo,
}


def main():
    answers = [READERS[task["format"]](task["file"], task["points"]).tolist() for task in json.load(sys.stdin)]
    json.dump(answers, sys.stdout)


main()
