#!/bin/sh
# evlib 0.13.2 writes text with times in seconds and six decimals, and reads it with times in microseconds. One would expect to
# get the times back that were written. Some hundredths of the events come back 1 us earlier: the decimals are right in the
# file, but the reader multiplies by a million and cuts instead of rounding (1.001271 * 1e6 is 1001270.9999999999).
# Consequence: a text file of whole microseconds, from any program, changes when evlib reads it; equal times of two events may
# stay equal, but steps of the clock become uneven and events do not match those of other readers.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps evlib==0.13.2 polars==2.1.0 polars-runtime-32==2.1.0 numpy==2.4.6 h5py==3.16.0 tqdm==4.70.1 typing_extensions==4.16.0
cat >"$folder/show.py" <<'PYTHON'
import sys
from importlib.metadata import version

import evlib
import numpy as np

t = 1_000_000 + 37 * np.arange(20_000)
x, y, p = (np.arange(len(t)) * step % side for step, side in ((7, 346), (11, 260), (1, 2)))
path = f"{sys.argv[1]}/events.txt"
evlib.save_events_to_text(x.astype(np.int64), y.astype(np.int64), t / 1e6, p.astype(np.int64), path)
in_file = np.array([round(float(line.split()[0]) * 1e6) for line in open(path) if line[0].isdigit()])
read = evlib.load_events(path).collect()["t"].dt.total_microseconds().to_numpy()
early = int(np.count_nonzero(read == t - 1))
print("evlib", version("evlib"))
print("the file contains the right times:", bool((in_file == t).all()))
print(f"expected: 0 of {len(t)} events differ")
print(f"seen: {early} events are 1 us early, {int(np.count_nonzero(read == t))} are right")
assert (in_file == t).all() and early > 100 and early + np.count_nonzero(read == t) == len(t)
PYTHON
"$folder/venv/bin/python" "$folder/show.py" "$folder"
