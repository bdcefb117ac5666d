#!/bin/sh
# One would expect that frames made of a recording contain all of its events.
# tonic.transforms.ToFrame with time_window or event_count drops the events after the last whole frame; with n_time_bins, which
# divides the recording evenly, it drops the last event. ToVoxelGrid, whose weights of ON and OFF events cancel, does not sum to
# zero for as many ON as OFF events. No warning in any of the cases.
# Seen with tonic 1.7.0 on 100 events, 50 of each polarity.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check tonic==1.7.0 numpy==2.2.6
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys

import numpy
import tonic

print("tonic", tonic.__version__)
events = numpy.zeros(100, dtype=[("t", int), ("x", int), ("y", int), ("p", int)])
events["t"], events["x"], events["p"] = numpy.arange(100) * 1000, 3, numpy.arange(100) % 2
size = (10, 10, 2)
counts = {
    name: int(tonic.transforms.ToFrame(sensor_size=size, **options)(events).sum())
    for name, options in (("time_window", {"time_window": 30_000}), ("event_count", {"event_count": 30}), ("n_time_bins", {"n_time_bins": 7}))
}
grid = float(tonic.transforms.ToVoxelGrid(sensor_size=size, n_time_bins=5)(events).sum())
print("expected 100 events in the frames:", counts)
print("expected a sum of 0 in the voxel grid:", round(grid, 3))
as_described = counts == {"time_window": 90, "event_count": 90, "n_time_bins": 99} and abs(grid) > 0.1
sys.exit(0 if as_described else "the behaviour has changed")
PYTHON
