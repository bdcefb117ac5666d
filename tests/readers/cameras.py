"""Writes camera files with other programs, and projects points with their cameras.

Standard input is a JSON object {"program": "opencv" or "mrcal", "folder": the folder for the files}. Standard output is a JSON list
of {"file", "points", "pixels"}: a file in the folder, points in camera coordinates and the pixels of the program.
"""

import json
import sys

import numpy as np

SIZE = (346, 260)
POINTS = [[x, y, 1.0] for x in np.linspace(-0.5, 0.5, 11) for y in np.linspace(-0.38, 0.38, 9)]


def opencv(folder):
    import cv2

    points, none = np.array(POINTS).reshape(-1, 1, 3), np.zeros(3)
    matrix = np.array([[330.25, 0, 171.5], [0, 331.5, 130.75], [0, 0, 1]])
    five = np.array([[-0.3], [0.1], [0.001], [-0.002], [0.04]])
    four = np.array([[-0.02], [0.01], [-0.003], [0.0005]])
    # Views of the calibration sample: 60 × 54 points, some 90 kB.
    views = np.random.default_rng(1).uniform(0, 346, (60, 54, 2)).astype(np.float32)
    # The rational model: 14 numbers, six of them 0.
    board = np.array([[x * 0.03, y * 0.03, 0] for y in range(6) for x in range(9)], dtype=np.float32)
    poses = np.random.default_rng(2).normal([0, 0, 0, -0.12, -0.07, 0.4], [0.3, 0.3, 0.1, 0.03, 0.03, 0.03], (12, 6))
    pictures = [cv2.projectPoints(board, pose[:3], pose[3:], matrix, five)[0].astype(np.float32) for pose in poses]
    flags = cv2.CALIB_RATIONAL_MODEL
    _, rational_matrix, rational, _, _ = cv2.calibrateCamera([board] * 12, pictures, SIZE, None, None, flags=flags)
    assert rational.size == 14 and (rational.ravel()[8:] == 0).all(), rational
    sample = {"nr_of_frames": 60, "board_width": 9, "board_height": 6, "square_size": 0.03, "flags": 0}
    cases = {
        "sample": (matrix, five, sample | {"fisheye_model": 0, "image_points": views}, cv2.projectPoints),
        "fisheye": (matrix, four, sample | {"fisheye_model": 1}, cv2.fisheye.projectPoints),
        "rational": (rational_matrix, rational, {}, cv2.projectPoints),
        # OpenCV 5 writes an array with one axis as "opencv-nd-matrix".
        "one-axis": (matrix, five.ravel(), {}, cv2.projectPoints),
    }
    for extension in ("yml", "xml", "json"):
        for name, (camera_matrix, distortion, more, project) in cases.items():
            pixels = project(points, none, none, camera_matrix, distortion.reshape(1, -1))[0]
            entries = {"camera_matrix": camera_matrix, "distortion_coefficients": distortion} | more
            yield written(f"{folder}/{name}.{extension}", entries), pixels
        # The keys of OpenCV's sample of omnidir.
        pixels = cv2.omnidir.projectPoints(points, none, none, matrix, 0.85, four.T)[0]
        entries = {"flags": 0, "camera_matrix": matrix, "distortion_coefficients": four.T, "xi": 0.85, "rms": 0.2}
        yield written(f"{folder}/omni.{extension}", entries), pixels


def written(path, entries):
    import cv2

    storage = cv2.FileStorage(path, cv2.FILE_STORAGE_WRITE)
    for name, value in ({"image_width": SIZE[0], "image_height": SIZE[1]} | entries).items():
        storage.write(name, value)
    storage.release()
    return path


def mrcal(folder):
    """A file with the observations that mrcal computed the camera from, and files without distortion and with zeros."""
    import mrcal

    lens = "LENSMODEL_OPENCV5"
    values = np.array([332.0, 333.0, 172.0, 129.0, -0.3, 0.1, 1e-3, -2e-3, 0.02])
    board = mrcal.ref_calibration_object(9, 6, 0.03)
    random = np.random.default_rng(1)
    poses = random.normal([0, 0, 0, -0.12, -0.07, 0.45], [0.3, 0.3, 0.3, 0.03, 0.03, 0.03], (12, 6))
    pictures = [mrcal.project(mrcal.transform_point_rt(pose, board), lens, values) for pose in poses]
    weighted = [np.concatenate([picture, np.ones(picture.shape[:2] + (1,))], axis=-1) for picture in pictures]
    inputs = {
        "lensmodel": lens,
        "intrinsics": values[None] * 1.0,
        "extrinsics_rt_fromref": np.zeros((0, 6)),
        "frames_rt_toref": poses,
        "points": None,
        "observations_board": np.array(weighted),
        "indices_frame_camintrinsics_camextrinsics": np.array([[i, 0, -1] for i in range(12)], dtype=np.int32),
        "observations_point": None,
        "indices_point_camintrinsics_camextrinsics": None,
        "imagersizes": np.array([SIZE], dtype=np.int32),
        "calobject_warp": None,
        "do_optimize_calobject_warp": False,
        "calibration_object_spacing": 0.03,
        "do_apply_outlier_rejection": False,
        "verbose": False,
    }
    mrcal.optimize(**inputs)
    rational = [332.0, 333.0, 172.0, 129.0, 0.5, 0.1, 1e-3, -2e-3, 0.02, 0.8, 0.3, 0.05, 0, 0, 0, 0]
    models = {
        "calibrated": mrcal.cameramodel(optimization_inputs=inputs, icam_intrinsics=0),
        "pinhole": mrcal.cameramodel(intrinsics=("LENSMODEL_PINHOLE", values[:4]), imagersize=SIZE),
        "rational": mrcal.cameramodel(intrinsics=("LENSMODEL_OPENCV12", np.array(rational)), imagersize=SIZE),
    }
    for name, model in models.items():
        path = f"{folder}/{name}.cameramodel"
        model.write(path)
        # The file has ten digits.
        yield path, mrcal.project(np.array(POINTS), *mrcal.cameramodel(path).intrinsics())


def main():
    question = json.load(sys.stdin)
    files = {"opencv": opencv, "mrcal": mrcal}[question["program"]](question["folder"])
    answers = [{"file": path, "points": POINTS, "pixels": pixels.reshape(-1, 2).tolist()} for path, pixels in files]
    json.dump(answers, sys.stdout)


main()
