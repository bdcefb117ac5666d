"""Calibrations, from files and from arrays."""

import _thread
import re
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import evcal

FIXTURE = Path(__file__).resolve().parents[2] / "fixtures" / "board"
RECORDING = FIXTURE / "events.dvraw"
BOARD = "acircles:9x4:55mm:r17.5mm"


@pytest.fixture(scope="module")
def events():
    return evcal.read(RECORDING)


@pytest.fixture(scope="module")
def stages():
    return []


@pytest.fixture(scope="module")
def calibration(stages):
    return evcal.calibrate(RECORDING, board=BOARD, frames="ignore", progress=stages.append)


def test_read_returns_the_events_that_info_counts(events):
    information = evcal.info(RECORDING)
    assert len(events) == information["events"]
    assert information["sensor"] == {"width": 346, "height": 260}
    assert [int(events["t"][0]), int(events["t"][-1])] == information["times_us"]
    assert (np.diff(events["t"]) >= 0).all() and events["x"].max() < 346 and events["y"].max() < 260
    assert np.mean(events["p"]) == pytest.approx(information["on_share"])


def test_an_array_gives_the_calibration_of_its_file_to_the_bit(calibration, events):
    from_array = evcal.calibrate(events, board=BOARD, sensor=(346, 260))
    assert from_array.camera == calibration.camera
    assert from_array.sigma == calibration.sigma
    mine, theirs = from_array.to_dict(), calibration.to_dict()
    # An array does not contain the name of the camera.
    assert theirs.pop("camera_name") == "DAVIS346_evcalsim"
    for one in (mine, theirs):
        # The notes of the reader about the camera's stream differ.
        one["stages"].pop("recordings")
    assert mine == theirs


def test_the_camera_is_near_the_truth(calibration):
    difference = evcal.evaluate(calibration, FIXTURE)
    assert difference["rms"] < 0.05
    assert evcal.evaluate(calibration.camera, evcal.Camera.load(FIXTURE)) == difference
    assert set(calibration.sigma) == set(calibration.camera.parameters)
    assert all(sigma > 0 for sigma in calibration.sigma.values())


def test_progress_names_each_stage_once(calibration, stages):
    assert stages[0].startswith("looking for the board in") and stages[-1] == "examination"
    assert all(before != after for before, after in zip(stages, stages[1:], strict=False))


def test_the_folder_equals_the_folder_of_the_program(calibration, tmp_path):
    report = calibration.write(tmp_path / "calibration")
    # Only the report in the folder lists the files next to it.
    files = re.compile("<h3>Files</h3>.*?</table></div>", re.DOTALL)
    written = Path(report).read_text()
    assert "camera.yaml" in files.search(written)[0]
    assert files.sub("", written) == files.sub("", calibration.report)
    assert (tmp_path / "calibration" / "camera.yaml").exists()
    again = evcal.Camera.load(tmp_path / "calibration")
    assert again == calibration.camera and again.sigma == calibration.sigma
    with pytest.raises(evcal.Error, match="is there already; .*force=True"):
        calibration.write(tmp_path / "calibration")
    calibration.write(tmp_path / "calibration", force=True)


def test_grade_and_verdict_are_shown(calibration):
    assert calibration.grade in ("good", "usable", "not-good")
    assert calibration.verdict.splitlines()[0] in repr(calibration)


def test_exceptions_of_progress_are_raised(events):
    class Enough(Exception):
        pass

    def progress(text):
        raise Enough(text)

    with pytest.raises(Enough, match="looking for the board"):
        evcal.calibrate(events, board=BOARD, sensor=(346, 260), progress=progress)


def test_control_c_ends_a_calibration_and_other_threads_run(events):
    begun = threading.Event()
    turns = []

    def interrupt():
        begun.wait()
        # The interpreter is free while evcal works.
        for _ in range(5):
            turns.append(time.monotonic())
            time.sleep(0.02)
        _thread.interrupt_main()

    # A shell starts background jobs without Python's handler of Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    thread = threading.Thread(target=interrupt)
    thread.start()
    # The copies differ, because duplicate recordings are rejected.
    recordings = [events.copy() for _ in range(20)]
    for index, recording in enumerate(recordings):
        recording["x"] = (recording["x"] + index) % 346
    with pytest.raises(KeyboardInterrupt):
        evcal.calibrate(recordings, board=BOARD, sensor=(346, 260), progress=lambda _: begun.set())
    thread.join()
    assert len(turns) == 5


def test_simulated_events_find_their_camera():
    events, truth = evcal.simulate(duration=3.0, seed=5)
    again, _ = evcal.simulate(duration=3.0, seed=5)
    assert (events == again).all()
    calibration = evcal.calibrate(events, board=BOARD, sensor=truth.sensor)
    assert evcal.evaluate(calibration, truth)["rms"] < 0.1
    circles = evcal.detect(events, board=BOARD, sensor=truth.sensor)
    assert circles["index"].max() < 36 and (np.diff(circles["frame"].astype(int)) >= 0).all()


def test_trajectory_and_covariance_are_arrays(calibration, tmp_path):
    sigma = np.array(list(calibration.sigma.values()))
    assert np.sqrt(np.diag(calibration.covariance)) == pytest.approx(sigma, rel=1e-12)
    assert calibration.covariance == pytest.approx(calibration.covariance.T, rel=1e-6, abs=1e-15)
    calibration.write(tmp_path / "calibration")
    written = np.loadtxt(tmp_path / "calibration" / "trajectory.txt")
    poses = calibration.trajectory
    sure = poses[poses["sure"]]
    assert len(written) == len(sure) <= len(poses) and (poses["recording"] == 0).all()
    mine = np.column_stack([sure["t"], sure["position"], sure["rotation"]])
    assert np.abs(mine - written).max() < 1e-5
    assert (sure["position_sigma"] > 0).all() and (sure["rotation_sigma"] < 0.02).all()


@pytest.fixture(scope="module")
def simulated():
    events, truth = evcal.simulate(duration=5.0, motion="fast", seed=3)
    return events, truth, evcal.calibrate(events, board=BOARD, sensor=truth.sensor)


def samples_of(trajectory, path, rate=200.0):
    """Writes the readings of an IMU at the camera, computed from differences of the camera's poses."""
    t, position = trajectory["t"], trajectory["position"]
    x, y, z, w = trajectory["rotation"].T
    rotation = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]).transpose(2, 0, 1)  # fmt: skip
    step = 1 / rate
    keep = np.flatnonzero((np.diff(t)[:-1] < 1.5 * step) & (np.diff(t)[1:] < 1.5 * step)) + 1
    acceleration = (position[keep + 1] - 2 * position[keep] + position[keep - 1]) / step**2
    turned = np.einsum("nji,njk->nik", rotation[keep - 1], rotation[keep + 1])
    rates = np.stack([turned[:, 2, 1] - turned[:, 1, 2], turned[:, 0, 2] - turned[:, 2, 0], turned[:, 1, 0] - turned[:, 0, 1]], 1) / (4 * step)
    # The board is upright, so gravity points along +y. An IMU at rest measures the force against gravity.
    force = np.einsum("nji,nj->ni", rotation[keep], acceleration - [0.0, 9.80665, 0.0])
    rows = np.column_stack([t[keep] * 1e6, force, rates])
    np.savetxt(path, rows, delimiter=",", header="t_us,ax_m_s2,ay_m_s2,az_m_s2,gx_rad_s,gy_rad_s,gz_rad_s", comments="", fmt="%.9g")


def test_the_imu_is_calibrated(simulated, tmp_path):
    events, truth, alone = simulated
    samples_of(alone.trajectory, tmp_path / "imu.csv")
    calibration = evcal.calibrate(events, board=BOARD, sensor=truth.sensor, imu=tmp_path / "imu.csv")
    result = calibration.to_dict()["inertial"]
    turn = np.array(result["T_imu_camera"])[:3, :3]
    assert np.abs(turn - np.eye(3)).max() < 0.05 and result["used"] > 500
    assert "\nIMU: " in calibration.verdict
    written = [path.name for path in evcal.export(calibration, "all", tmp_path / "all")]
    assert len(written) > len(evcal.export(alone, "all", tmp_path / "alone"))


def test_the_camera_is_calibrated_without_a_usable_imu(simulated, tmp_path):
    events, truth, alone = simulated
    # Readings of an IMU that lies on a table.
    rows = "".join(f"{5000 * index},0,-9.8,0,0,0,0\n" for index in range(1000))
    (tmp_path / "imu.csv").write_text("t_us,ax_m_s2,ay_m_s2,az_m_s2,gx_rad_s,gy_rad_s,gz_rad_s\n" + rows)
    with pytest.warns(UserWarning, match="the IMU was not calibrated: "):
        calibration = evcal.calibrate(events, board=BOARD, sensor=truth.sensor, imu=tmp_path / "imu.csv")
    assert calibration.camera.parameters == alone.camera.parameters
    [(what, reason)] = calibration.not_calibrated
    assert what == "the IMU" and reason in calibration.verdict and alone.not_calibrated == []


def test_mistakes_about_the_imu_are_named():
    # The camera is calibrated nevertheless.
    with pytest.warns(UserWarning, match="3 s are needed"):
        assert len(evcal.calibrate(RECORDING, board=BOARD, imu=True).not_calibrated) == 1
    with pytest.raises(TypeError, match="imu is True"):
        evcal.calibrate(RECORDING, board=BOARD, imu=3.5)
    with pytest.raises(ValueError, match="gravity"):
        evcal.calibrate(RECORDING, board=BOARD, imu=True, gravity=1.0)


def test_the_pose_of_a_second_camera_is_estimated(simulated):
    events, truth, _ = simulated
    # The second camera has the same lens, but its sensor is 9 px further to the left.
    second = events[events["x"] < 337].copy()
    second["x"] += 9
    calibration = evcal.calibrate(events, board=BOARD, sensor=truth.sensor, with_=[second])
    [other] = calibration.to_dict()["second_cameras"]
    assert np.abs(np.array(other["T_second_first"]) - np.eye(4)).max() < 2e-3
    assert other["solved_together"][1]["camera"]["parameters"]["cx"] - calibration.camera.parameters["cx"] == pytest.approx(9.0, abs=0.3)
    assert "\nPosition of array: " in calibration.verdict
    with pytest.warns(UserWarning, match="with_="):
        alone = evcal.calibrate(events, board=BOARD, sensor=truth.sensor, with_=events)
    assert len(alone.not_calibrated) == 1 and alone.camera.parameters == simulated[2].camera.parameters


def test_a_recording_is_checked(events):
    result = evcal.check(events, board=BOARD, sensor=(346, 260))
    assert result["ready"] and result["next"] == f'calibrate from it with board="{BOARD}"'
    assert result["events"] == len(events) and result["seen"]["found"] > 0
    unknown = evcal.check(events, board=BOARD)
    assert not unknown["ready"] and "sensor=(346, 260)" in unknown["next"]
    recognised = evcal.check(RECORDING)
    assert 'for example board="acircles:9x4:' in recognised["next"]


def test_the_stated_board_is_compared_with_the_recording():
    board = "charuco:4x5:55mm:41mm:DICT_4X4_50"
    events, truth = evcal.simulate(board=board, duration=3.0, seed=706)
    with pytest.warns(UserWarning, match=f"calibrated with {board}$"):
        evcal.check(events, board=f"{board}:legacy", sensor=truth.sensor)


def test_parts_of_a_recording_are_compared(events):
    result = evcal.repeat(events, board=BOARD, sensor=(346, 260), runs=2, seconds=2.0)
    assert len(result["runs"]) == 2 and result["parameters"][0]["name"] == "fx" and result["projection"] > 0
    with pytest.raises(evcal.Error, match="seconds="):
        evcal.repeat(events, board=BOARD, sensor=(346, 260), seconds=1000.0)
    with pytest.raises(ValueError, match="runs"):
        evcal.repeat(events, board=BOARD, runs=1)


def test_calibrations_are_compared(calibration):
    assert evcal.compare(calibration, calibration)["sameness"] == "same"
    parameters = calibration.camera.parameters
    moved = evcal.Camera("radtan", {**parameters, "fx": parameters["fx"] * 1.05}, (346, 260))
    assert evcal.compare(calibration, moved)["sameness"] == "different"


def test_messages_name_no_option_of_the_command_line(calibration):
    assert "--" not in calibration.verdict
    with pytest.raises(evcal.Error) as refused:
        evcal.calibrate(RECORDING, board="acircles:7x6:55mm:r17.5mm")
    assert "--" not in str(refused.value)


def test_mistakes_are_named(events):
    with pytest.raises(ValueError, match="checkerboard"):
        evcal.calibrate(RECORDING, board="checkerboard:9x6")
    with pytest.raises(ValueError, match="auto"):
        evcal.calibrate(RECORDING, board=BOARD, model="pinhole")
    with pytest.raises(evcal.Error, match="nowhere.dvraw"):
        evcal.calibrate("nowhere.dvraw", board=BOARD)
    with pytest.raises(evcal.Error, match=r"how many pixels.*add sensor=\(346, 260\)"):
        evcal.calibrate(events, board=BOARD)
    with pytest.raises(evcal.Error, match="contains no events"):
        evcal.calibrate(events[:0], board=BOARD, sensor=(346, 260))
