"""Prints how many events per second Camera.undistort_events moves: python benchmarks/undistort_events.py"""

import time

import numpy as np

import evcal

COUNT = 20_000_000
LAYOUTS = {
    "16 bytes (evcal, Metavision)": {"names": ["t", "x", "y", "p"], "formats": ["<i8", "<u2", "<u2", "u1"], "itemsize": 16},
    "13 bytes (tonic, faery)": [("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")],
}

camera = evcal.Camera("radtan", [330.0, 331.0, 170.0, 131.0, -0.35, 0.15, 0.001, -0.0005, -0.02], (346, 260))
random = np.random.default_rng(1)
for name, layout in LAYOUTS.items():
    events = np.zeros(COUNT, np.dtype(layout))
    events["x"] = random.integers(0, 346, COUNT)
    events["y"] = random.integers(0, 260, COUNT)
    camera.undistort_events(events[:1])
    times = []
    for _ in range(5):
        start = time.perf_counter()
        camera.undistort_events(events)
        times.append(time.perf_counter() - start)
    print(f"{name}: {COUNT / 1e6 / sorted(times)[2]:.0f} Mev/s")
