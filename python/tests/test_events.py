"""Arrays of events: whatever their fields are called."""

import cv2
import numpy as np
import pytest

import evcal

OWN = np.dtype({"names": ["t", "x", "y", "p"], "formats": ["<i8", "<u2", "<u2", "u1"], "offsets": [0, 8, 10, 12], "itemsize": 16})
LAYOUTS = {
    "evcal": OWN,
    "dv-processing": np.dtype([("timestamp", "<i8"), ("x", "<i2"), ("y", "<i2"), ("polarity", "i1")], align=True),
    "Metavision": np.dtype({"names": ["x", "y", "p", "t"], "formats": ["<u2", "<u2", "<i2", "<i8"], "offsets": [0, 2, 4, 8], "itemsize": 16}),
    "tonic": np.dtype([("x", "<i2"), ("y", "<i2"), ("t", "<i8"), ("p", "?")]),
    "faery": np.dtype([("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")]),
}
NAMES = {"timestamp": "t", "polarity": "p", "on": "p"}


def make(count, dtype=OWN, seed=1):
    random = np.random.default_rng(seed)
    values = {
        "t": np.sort(random.integers(0, 1_000_000, count)) + 1_643_243_628_737_093,
        "x": random.integers(0, 346, count),
        "y": random.integers(0, 260, count),
        "p": random.integers(0, 2, count),
    }
    events = np.empty(count, dtype)
    for name in dtype.names:
        events[name] = values[NAMES.get(name, name)]
    return events


def camera():
    return evcal.Camera("radtan", [330.0, 331.0, 170.0, 131.0, -0.35, 0.15, 0.001, -0.0005, -0.02], (346, 260))


def expected(events):
    one = camera()
    pixels = np.column_stack([events["x"], events["y"]]).astype(np.float64)
    until = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    places = cv2.undistortPoints(
        pixels, one.matrix, one.distortion, R=np.eye(3), P=one.matrix, criteria=until
    ).reshape(-1, 2)
    rounded = np.floor(places + 0.5)
    kept = ((rounded >= 0) & (rounded < [346, 260])).all(axis=1)
    return kept, rounded[kept]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_events_of_every_library_are_undistorted_in_their_own_type(layout):
    events = make(20_000, LAYOUTS[layout])
    before = events.copy()
    undistorted = camera().undistort_events(events)
    kept, places = expected(events)
    assert undistorted.dtype == events.dtype
    assert 0 < kept.sum() < len(events)
    assert (undistorted["x"] == places[:, 0]).all() and (undistorted["y"] == places[:, 1]).all()
    for name in set(events.dtype.names) - {"x", "y"}:
        assert (undistorted[name] == events[name][kept]).all()
    assert (events == before).all()


def test_views_with_gaps_are_taken_too():
    events = make(1000)
    every_third = camera().undistort_events(events[::3])
    assert (every_third == camera().undistort_events(events[::3].copy())).all()


def test_real_events_of_dv_processing_are_taken():
    dv = pytest.importorskip("dv_processing")
    store = dv.EventStore()
    events = make(500)
    for event in events:
        store.push_back(int(event["t"]), int(event["x"]), int(event["y"]), bool(event["p"]))
    theirs = camera().undistort_events(store.numpy())
    ours = camera().undistort_events(events)
    assert (theirs["timestamp"] == ours["t"]).all() and (theirs["x"] == ours["x"]).all()
    assert (theirs["polarity"] == ours["p"]).all()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_detection_does_not_depend_on_the_type(layout):
    events, _ = evcal.simulate(duration=0.3)
    other = np.empty(len(events), LAYOUTS[layout])
    for name in other.dtype.names:
        other[name] = events[NAMES.get(name, name)]
    board = "acircles:9x4:55mm:r17.5mm"
    found = evcal.detect(other, board=board, sensor=(346, 260))
    assert len(found) > 0 and (found == evcal.detect(events, board=board, sensor=(346, 260))).all()


def test_mistakes_are_named():
    one = camera()
    with pytest.raises(TypeError, match="fields t .* has none"):
        one.undistort_events(np.zeros((5, 4)))
    with pytest.raises(TypeError, match="has t, x, y$"):
        one.undistort_events(np.zeros(5, [("t", "<i8"), ("x", "<u2"), ("y", "<u2")]))
    with pytest.raises(TypeError, match="microseconds"):
        one.undistort_events(np.zeros(5, [("t", "<f8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")]))
    with pytest.raises(TypeError, match="big-endian"):
        one.undistort_events(np.zeros(5, [("t", ">i8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")]))
    with pytest.raises(ValueError, match="too narrow"):
        one.undistort_events(np.zeros(5, [("t", "<i8"), ("x", "u1"), ("y", "u1"), ("p", "u1")]))
    negative = make(5, LAYOUTS["tonic"])
    negative["x"][3] = -2
    with pytest.raises(ValueError, match="event 3: x = -2"):
        evcal.detect(negative, board="acircles:9x4:55mm:r17.5mm", sensor=(346, 260))
    with pytest.raises(evcal.Error, match=r"how many pixels.*give sensor=\(\d+, \d+\)"):
        evcal.detect(make(5), board="acircles:9x4:55mm:r17.5mm")


def test_no_events_are_no_error():
    assert len(camera().undistort_events(make(0))) == 0
