#!/bin/sh
# eventcv 1.0.8 reads text, CSV and HDF5 whose times are whole microseconds, and finds the unit from the length of the recording.
# One would expect that a cut of a recording keeps the times that the whole one has. If all its events are within one second,
# the unit is taken for milliseconds instead: times are 1000 times too large, without a warning, even in the layout of DSEC,
# which has microseconds only.
# Consequence: short cuts (a test file, a window around an event) get rates and speeds that are 1000 times too small. Pass
# time_unit="us".
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps eventcv==1.0.8 numpy==2.4.6 h5py==3.16.0
cat >"$folder/show.py" <<'PYTHON'
import sys
from importlib.metadata import version

import eventcv
import h5py
import numpy as np

print("eventcv", version("eventcv"))
seen = []
for seconds in (4, 0.5):
    count = int(seconds * 10_000)
    t = 100 * np.arange(count)
    columns = {"t": t, "x": np.arange(count) % 346, "y": np.arange(count) % 260, "p": np.arange(count) % 2}
    path = f"{sys.argv[1]}/{count}"
    np.savetxt(f"{path}.csv", np.stack(list(columns.values()), 1), fmt="%d", delimiter=",", header="t,x,y,p", comments="")
    with h5py.File(f"{path}.h5", "w") as file:
        for (name, column), kind in zip(columns.items(), ("u4", "u2", "u2", "u1")):
            file[f"events/{name}"] = column.astype(kind)
    for ending in ("csv", "h5"):
        last = int(eventcv.load(f"{path}.{ending}").numpy()[-1, 2])
        seen.append(last / t[-1])
        print(f"{ending}, {seconds} s of microseconds: expected a last time of {t[-1]} us, seen {last} us")
assert seen == [1, 1, 1000, 1000]
PYTHON
"$folder/venv/bin/python" "$folder/show.py" "$folder"
