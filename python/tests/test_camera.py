"""The camera against OpenCV."""

import copy
import pickle

import cv2
import numpy as np
import pytest

import evcal

SENSOR = (346, 260)
MATRIX = (330.0, 331.0, 170.0, 131.0)
COEFFICIENTS = {
    "radtan4": (-0.35, 0.15, 0.001, -0.0005),
    "radtan": (-0.35, 0.15, 0.001, -0.0005, -0.02),
    "radtan8": (-0.35, 0.15, 0.001, -0.0005, -0.02, 0.01, 0.02, -0.003),
    "kannala-brandt": (-0.03, 0.004, -0.002, 0.0005),
}


def camera(model):
    return evcal.Camera(model, [*MATRIX, *COEFFICIENTS[model]], SENSOR)


def points(count=5000):
    random = np.random.default_rng(1)
    return np.column_stack([random.uniform(-0.45, 0.45, (count, 2)), np.ones(count)]) * random.uniform(
        0.2, 5.0, (count, 1)
    )


def opencv_pixels(model, points):
    matrix = np.array([[MATRIX[0], 0, MATRIX[2]], [0, MATRIX[1], MATRIX[3]], [0, 0, 1]])
    project = cv2.fisheye.projectPoints if model == "kannala-brandt" else None
    if project is not None:
        pixels, _ = project(points[:, None], np.zeros(3), np.zeros(3), matrix, np.array(COEFFICIENTS[model]))
    else:
        pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(COEFFICIENTS[model]))
    return pixels.reshape(-1, 2)


@pytest.mark.parametrize("model", COEFFICIENTS)
def test_projects_as_opencv_does(model):
    difference = camera(model).project(points()) - opencv_pixels(model, points())
    assert np.abs(difference).max() < 1e-9


@pytest.mark.parametrize("model", COEFFICIENTS)
def test_unproject_undoes_project(model):
    one = camera(model)
    bearings = one.unproject(one.project(points()))
    expected = points() / np.linalg.norm(points(), axis=1, keepdims=True)
    assert np.abs(bearings - expected).max() < 1e-9


def test_matrix_and_distortion_are_in_the_form_of_opencv():
    one = camera("radtan")
    pixels, _ = cv2.projectPoints(points(), np.zeros(3), np.zeros(3), one.matrix, one.distortion)
    assert np.abs(one.project(points()) - pixels.reshape(-1, 2)).max() < 1e-9


def test_points_that_a_lens_does_not_see_are_nan():
    pixels = camera("radtan").project([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    assert np.isnan(pixels[0]).all()
    assert pixels[1].tolist() == [MATRIX[2], MATRIX[3]]


def test_undistort_map_equals_opencv():
    one = camera("radtan")
    matrix = one.matrix
    expected = cv2.initUndistortRectifyMap(matrix, one.distortion, None, matrix, SENSOR, cv2.CV_32FC1)
    for mine, theirs in zip(one.undistort_map(), expected, strict=True):
        assert mine.dtype == np.float32 and mine.shape == theirs.shape
        assert np.abs(mine - theirs).max() < 1e-4


@pytest.mark.parametrize("alpha", [0.0, 0.5, 1.0])
def test_the_new_camera_equals_opencv(alpha):
    # The distortion is weak, because OpenCV inverts the lens in only five iterations.
    one = evcal.Camera("radtan", [*MATRIX, -0.05, 0.01, 0.0002, -0.0001, 0.0], SENSOR)
    expected, _ = cv2.getOptimalNewCameraMatrix(one.matrix, one.distortion, SENSOR, alpha)
    assert np.abs(one.undistorted(alpha).matrix - expected).max() < 1e-3


def test_a_camera_survives_a_file(tmp_path):
    one = camera("kannala-brandt")
    one.save(tmp_path / "one.camera.json")
    again = evcal.Camera.load(tmp_path / "one.camera.json")
    assert again == one and again.parameters == one.parameters and again.sensor == SENSOR
    assert again.sigma is None
    assert eval(repr(one), {"Camera": evcal.Camera}) == one


@pytest.mark.parametrize("form", ["yaml", "json", "xml"])
def test_files_of_opencv_are_cameras(tmp_path, form):
    matrix = np.array([[330.0, 0.0, 172.0], [0.0, 331.0, 130.0], [0.0, 0.0, 1.0]])
    distortion = np.array([[-0.35, 0.12, 0.001, -0.002, 0.04]])
    storage = cv2.FileStorage(str(tmp_path / f"camera.{form}"), cv2.FILE_STORAGE_WRITE)
    for name, value in [("image_width", 346), ("image_height", 260), ("camera_matrix", matrix)]:
        storage.write(name, value)
    storage.write("distortion_coefficients", distortion)
    storage.release()
    loaded = evcal.Camera.load(tmp_path / f"camera.{form}")
    assert loaded.model == "radtan" and loaded.sensor == (346, 260)
    np.testing.assert_array_equal(loaded.matrix, matrix)
    points = np.array([[0.1, -0.2, 1.0], [-0.3, 0.15, 0.9]])
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, distortion)
    np.testing.assert_allclose(loaded.project(points), theirs[:, 0], atol=1e-9)


def test_files_of_basalt_dv_and_mrcal_are_cameras(tmp_path):
    def load(name, text):
        (tmp_path / name).write_text(text)
        return evcal.Camera.load(tmp_path / name)

    basalt = load(
        "basalt.json",
        '{"value0": {"T_imu_cam": [], "intrinsics": [{"camera_type": "ds", "intrinsics": {"fx": 157.0, "fy": 158.0, "cx": 172.0,'
        ' "cy": 129.0, "xi": -0.2, "alpha": 0.6}}], "resolution": [[346, 260]]}}',
    )
    assert basalt == evcal.Camera("double-sphere", [157.0, 158.0, 172.0, 129.0, -0.2, 0.6], SENSOR)
    dv = load(
        "dv.xml",
        '<?xml version="1.0"?><opencv_storage><DVXplorer_1><camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols>'
        "<dt>d</dt><data>330. 0. 170. 0. 331. 131. 0. 0. 1.</data></camera_matrix>"
        '<distortion_coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt>'
        "<data>-0.35 0.15 1e-3 -5e-4 -0.02</data></distortion_coefficients><image_width>346</image_width>"
        "<image_height>260</image_height></DVXplorer_1><use_fisheye_model>0</use_fisheye_model></opencv_storage>",
    )
    assert dv == camera("radtan")
    mrcal = load(
        "camera.cameramodel",
        "# generated\n{\n    'lensmodel':  'LENSMODEL_OPENCV4',\n\n    # intrinsics are fx,fy,cx,cy,distortion0,....\n"
        "    'intrinsics': [ 330, 331, 170, 131, -0.35, 0.15, 0.001, -0.0005,],\n\n    'extrinsics': [ 0, 0, 0, 0, 0, 0,],\n\n"
        "    'imagersize': [ 346, 260,],\n}\n",
    )
    assert mrcal == camera("radtan4")


def test_one_point_and_many_points_have_the_same_projection():
    one = camera("radtan")
    point = [0.1, -0.2, 1.0]
    assert one.project(point).shape == (2,)
    assert (one.project(point) == one.project([point])[0]).all()
    bearing = one.unproject(one.project(point))
    assert bearing == pytest.approx(np.array(point) / np.linalg.norm(point), abs=1e-9)
    assert one.project(np.zeros((0, 3))).shape == (0, 2)


def test_a_camera_is_pickled_and_copied():
    sigma = [0.1] * 9
    one = evcal.Camera("radtan", camera("radtan").parameters, SENSOR, sigma)
    for again in (pickle.loads(pickle.dumps(one)), copy.deepcopy(one)):
        assert again == one and again.sigma == one.sigma == {name: 0.1 for name in one.parameters}
    assert pickle.loads(pickle.dumps(camera("kannala-brandt"))).sigma is None
    with pytest.raises(ValueError, match="sigma"):
        evcal.Camera("radtan", one.parameters, SENSOR, [1.0])


def test_a_camera_is_exported(tmp_path):
    one = camera("radtan")
    text = evcal.export(one, "opencv-yaml")
    [path] = evcal.export(one, "opencv-yaml", tmp_path / "camera.yaml", camera_name="left")
    assert "left" in path.read_text() and "camera_matrix" in text
    assert evcal.Camera.load(path) == one
    with pytest.raises(evcal.Error, match="force=True"):
        evcal.export(one, "opencv-yaml", path)
    written = evcal.export(one, "all", tmp_path / "all")
    assert {path.suffix for path in written} >= {".yaml", ".xml", ".json"} and all(path.exists() for path in written)
    with pytest.raises(ValueError, match='opencv-yaml, .*, all, not "matlab"'):
        evcal.export(one, "matlab")
    with pytest.raises(ValueError, match="output="):
        evcal.export(one, "all")
    # Kalibr has no k3, so a radtan4 camera is fitted, with a warning.
    with pytest.warns(UserWarning, match="radtan4"):
        evcal.export(one, "kalibr")


def test_cameras_are_compared():
    one = camera("radtan")
    moved = evcal.Camera("radtan", {**one.parameters, "fx": 350.0}, SENSOR)
    assert evcal.compare(one, one)["sameness"] == "same"
    result = evcal.compare(one, moved)
    assert result["sameness"] == "unknown" and result["difference_rms"] > 1.0 and result["sentence"]


def test_mistakes_are_named():
    with pytest.raises(ValueError, match="supported models are: radtan4 radtan"):
        evcal.Camera("pinhole", [1.0] * 9, SENSOR)
    with pytest.raises(ValueError, match="fx, fy, cx, cy"):
        evcal.Camera("radtan", [330.0, 331.0], SENSOR)
    with pytest.raises(KeyError, match="k3"):
        evcal.Camera("radtan", {name: 1.0 for name in ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")}, SENSOR)
    with pytest.raises(ValueError, match="N x 3"):
        camera("radtan").project([[1.0, 2.0]])
    with pytest.raises(evcal.Error, match="nowhere.json"):
        evcal.Camera.load("nowhere.json")


def test_evaluate_removes_the_rotation():
    one = camera("radtan")
    moved = evcal.Camera("radtan", {**one.parameters, "cx": one.parameters["cx"] + 0.5}, SENSOR)
    difference = evcal.evaluate(moved, one)
    assert evcal.evaluate(one, one)["rms"] < 1e-9
    assert 0.0 < difference["rms"] < 0.2 < 0.5
