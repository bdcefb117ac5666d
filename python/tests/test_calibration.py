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


def test_reads_what_info_counts(events):
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
    # An array does not tell which camera it is from.
    assert theirs.pop("camera_name") == "DAVIS346_evcalsim"
    for one in (mine, theirs):
        # What the reader says of the camera's stream.
        one["stages"].pop("recordings")
    assert mine == theirs


def test_the_camera_is_the_true_one(calibration):
    difference = evcal.evaluate(calibration, FIXTURE)
    assert difference["rms"] < 0.05
    assert evcal.evaluate(calibration.camera, evcal.Camera.load(FIXTURE)) == difference
    assert set(calibration.sigma) == set(calibration.camera.parameters)
    assert all(sigma > 0 for sigma in calibration.sigma.values())


def test_progress_names_each_stage_once(calibration, stages):
    assert stages[0].startswith("looking for the board in") and stages[-1] == "examination"
    assert all(before != after for before, after in zip(stages, stages[1:], strict=False))


def test_the_folder_is_that_of_the_program(calibration, tmp_path):
    report = calibration.write(tmp_path / "calibration")
    # Only the one in the folder has files beside it.
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


def test_words(calibration):
    assert calibration.grade in ("good", "usable", "not-good")
    assert calibration.verdict.splitlines()[0] in repr(calibration)


def test_what_progress_raises_comes_out(events):
    class Enough(Exception):
        pass

    def progress(text):
        raise Enough(text)

    with pytest.raises(Enough, match="looking for the board"):
        evcal.calibrate(events, board=BOARD, sensor=(346, 260), progress=progress)


def test_control_c_ends_a_calibration_and_others_run_meanwhile(events):
    begun = threading.Event()
    turns = []

    def interrupt():
        begun.wait()
        # The interpreter is free while evcal works.
        for _ in range(5):
            turns.append(time.monotonic())
            time.sleep(0.02)
        _thread.interrupt_main()

    # A shell's background job is started without it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    thread = threading.Thread(target=interrupt)
    thread.start()
    # The same recording twice would be refused.
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


def test_mistakes_are_named(events):
    with pytest.raises(ValueError, match="checkerboard"):
        evcal.calibrate(RECORDING, board="checkerboard:9x6")
    with pytest.raises(ValueError, match="auto"):
        evcal.calibrate(RECORDING, board=BOARD, model="pinhole")
    with pytest.raises(evcal.Error, match="nowhere.dvraw"):
        evcal.calibrate("nowhere.dvraw", board=BOARD)
    with pytest.raises(evcal.Error, match=r"how many pixels.*give sensor=\(346, 260\)"):
        evcal.calibrate(events, board=BOARD)
    with pytest.raises(evcal.Error, match="contains no events"):
        evcal.calibrate(events[:0], board=BOARD, sensor=(346, 260))
