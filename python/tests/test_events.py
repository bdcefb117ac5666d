"""Arrays of events with the field names and types of several libraries."""

import subprocess
import sys

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


def test_array_views_with_gaps_are_accepted():
    events = make(1000)
    every_third = camera().undistort_events(events[::3])
    assert (every_third == camera().undistort_events(events[::3].copy())).all()


def test_real_events_of_dv_processing_are_accepted():
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


@pytest.mark.parametrize("kind, off, on", [("u1", 0, 255), ("u1", 255, 1), ("u1", 1, 2), ("i2", -1, 1)])
def test_the_larger_of_two_polarities_is_on(kind, off, on):
    events = make(1000)
    theirs = events.astype([("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", kind)])
    theirs["p"] = np.where(events["p"] == 1, on, off)
    expected = camera().undistort_events(events, subpixel=True)["p"]
    assert (camera().undistort_events(theirs, subpixel=True)["p"] == expected).all()


FORMS = {
    "N x 4": lambda events: table(events),
    "4 x N": lambda events: table(events).T,
    "x, y, t, p in seconds": lambda events: table(events)[:, [1, 2, 0, 3]] * [1, 1, 1e-6, 1],
    "x, y, p, t with polarities of -1": lambda events: table(events)[:, [1, 2, 3, 0]] * [1, 1, 2, 1] - [0, 0, 1, 0],
    "dict of lists": lambda events: {name: events[name].tolist() for name in "txyp"},
    "dict in nanoseconds": lambda events: {"timestamp_ns": events["t"] * 1000, **{name: events[name] for name in "xyp"}},
    "float seconds": lambda events: {"t": events["t"] * 1e-6, **{name: events[name] for name in "xyp"}},
    "big-endian": lambda events: events.astype([("t", ">i8"), ("x", ">u2"), ("y", ">u2"), ("p", "u1")]),
    "pandas": lambda events: pytest.importorskip("pandas").DataFrame({name: events[name] for name in "ptxy"}),
    "pandas with timedeltas": lambda events: pytest.importorskip("pandas").DataFrame(
        {"t": events["t"].astype("timedelta64[us]"), **{name: events[name] for name in "xyp"}}
    ),
    "polars": lambda events: pytest.importorskip("polars").DataFrame({name: events[name] for name in "ptxy"}),
    "torch": lambda events: pytest.importorskip("torch").from_numpy(table(events)),
    "DLPack": lambda events: OnlyDlpack(table(events)),
    "__array__": lambda events: OnlyArray(table(events)),
}


class OnlyDlpack:
    def __init__(self, array):
        self.array = array

    def __dlpack__(self, **options):
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self.array.__dlpack_device__()


class OnlyArray:
    def __init__(self, array):
        self.array = array

    def __array__(self, dtype=None, copy=None):
        return self.array


def table(events):
    return np.column_stack([events[name].astype(np.int64) for name in "txyp"])


@pytest.mark.parametrize("form", FORMS)
def test_events_are_accepted_in_every_form(form):
    events = make(5000)
    events["t"] -= events["t"][0]
    undistorted = camera().undistort_events(FORMS[form](events))
    expected = camera().undistort_events(events)
    for name in "txyp":
        assert (undistorted[name] == expected[name]).all(), name


def test_given_columns_and_unit_take_precedence():
    events = make(500)
    milliseconds = np.column_stack([events["y"], events["x"], events["p"], events["t"] // 1000])
    undistorted = camera().undistort_events(milliseconds, columns="y,x,p,t", time_unit="ms")
    events["t"] = events["t"] // 1000 * 1000
    assert (undistorted == camera().undistort_events(events)).all()


def test_fractions_of_pixels_are_kept():
    events = make(5000)
    exact = camera().undistort_events(events, subpixel=True)
    one = camera()
    until = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    pixels = np.column_stack([events["x"], events["y"]]).astype(np.float64)
    places = cv2.undistortPoints(pixels, one.matrix, one.distortion, R=np.eye(3), P=one.matrix, criteria=until)[:, 0]
    kept = ((places >= -0.5) & (places < np.array([345.5, 259.5]))).all(axis=1)
    assert len(exact) == kept.sum() and (exact["t"] == events["t"][kept]).all() and (exact["p"] == events["p"][kept]).all()
    assert np.abs(np.column_stack([exact["x"], exact["y"]]) - places[kept]).max() < 1e-6


def test_events_are_converted(tmp_path):
    events = make(500)
    result = evcal.convert(table(events), tmp_path / "events.h5", sensor=(346, 260))
    assert result["events"] == 500 and result["lost"] == []
    assert (evcal.read(tmp_path / "events.h5") == events).all()
    with pytest.raises(evcal.Error, match="force=True"):
        evcal.convert(events, tmp_path / "events.h5", sensor=(346, 260))
    with pytest.raises(evcal.Error, match=r"add sensor=\(\d+, \d+\)"):
        evcal.convert(events, tmp_path / "other.h5")
    with pytest.raises(evcal.Error, match="to="):
        evcal.convert(events, tmp_path / "events.unknown", sensor=(346, 260))
    with pytest.raises(ValueError, match="aedat4"):
        evcal.convert(events, tmp_path / "events.xyz", to="xyz", sensor=(346, 260))


def test_mistakes_are_named():
    one = camera()
    with pytest.raises(TypeError, match=r"N x 4 numbers.* shape \(5, 3\)"):
        one.undistort_events(np.zeros((5, 3)))
    with pytest.raises(ValueError, match=r"not clear .*columns="):
        one.undistort_events(np.full((5, 4), 7))
    with pytest.raises(ValueError, match="does not name all 4 columns"):
        one.undistort_events(np.zeros((5, 4)), columns="t,x,y,p,-")
    with pytest.raises(ValueError, match="time_unit|write s"):
        evcal.detect(np.zeros((5, 4)), board="acircles:9x4:55mm:r17.5mm", time_unit="days")
    with pytest.raises(ValueError, match="event 1: x = 3.5 is not a whole pixel"):
        one.undistort_events({"t": [1, 2], "x": [3.0, 3.5], "y": [1, 2], "p": [0, 1]})
    with pytest.raises(ValueError, match="event 1: t = nan"):
        one.undistort_events({"t": [1.0, np.nan], "x": [3, 3], "y": [1, 2], "p": [0, 1]})
    with pytest.raises(ValueError, match="differ in length"):
        one.undistort_events({"t": [1], "x": [3, 3], "y": [1, 2], "p": [0, 1]})
    with pytest.raises(TypeError, match="named t, x, y; t, x, y and p were expected"):
        one.undistort_events({"t": [1], "x": [3], "y": [1]})
    with pytest.raises(TypeError, match="has t, x, y$"):
        one.undistort_events(np.zeros(5, [("t", "<i8"), ("x", "<u2"), ("y", "<u2")]))
    with pytest.raises(ValueError, match="too narrow"):
        one.undistort_events(np.zeros(5, [("t", "<i8"), ("x", "u1"), ("y", "u1"), ("p", "u1")]))
    negative = make(5, LAYOUTS["tonic"])
    negative["x"][3] = -2
    with pytest.raises(ValueError, match="event 3: x = -2"):
        evcal.detect(negative, board="acircles:9x4:55mm:r17.5mm", sensor=(346, 260))
    with pytest.raises(evcal.Error, match=r"how many pixels.*add sensor=\(\d+, \d+\)"):
        evcal.detect(make(5), board="acircles:9x4:55mm:r17.5mm")


def test_an_empty_array_is_not_an_error():
    assert len(camera().undistort_events(make(0))) == 0


def test_events_that_do_not_fit_are_refused_with_the_limit(tmp_path):
    events = np.tile(make(8_000), 1000)
    events["t"] = np.arange(len(events))
    np.save(tmp_path / "events.npy", events)
    limited = f"""
import re, resource
import numpy as np
import evcal
file = {str(tmp_path / "events.npy")!r}
events = np.load(file)
used = 1024 * int(re.search(r"VmSize:\\s+(\\d+)", open("/proc/self/status").read())[1])
for call in [lambda: evcal.read(file, sensor=(346, 260)), lambda: evcal.check(events, sensor=(346, 260))]:
    resource.setrlimit(resource.RLIMIT_AS, (used + 100_000_000, resource.RLIM_INFINITY))
    try:
        call()
    except MemoryError as error:
        print(error)
    resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    print(len(evcal.read(file, sensor=(346, 260))))
"""
    ended = subprocess.run([sys.executable, "-c", limited], capture_output=True, text=True, check=True)
    first, count, second, again = ended.stdout.splitlines()
    assert all("ulimit -v" in line and "need 0.13 GB" in line and "path" in line for line in [first, second])
    assert count == again == "8000000"
