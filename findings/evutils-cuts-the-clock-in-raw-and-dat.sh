#!/bin/sh
# One would expect that events written to a file are read with the times that they were written with.
# The writers of evutils keep 24 bits of the time in EVT 3 (16.8 s) and 32 bits in DAT (71.6 min) and drop the rest, without a word,
# also if the recording begins later than that. Cameras that stamp with the time of day, such as a DAVIS through dv-processing, lose
# their clock, so frames and IMU samples of the same recording no longer fit. CSV, npz and AEDAT4 of the same program keep it.
# Seen with evutils 0.3.18.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check evutils==0.3.18 numpy==2.2.6
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import importlib.metadata
import pathlib
import sys

import numpy
from evutils.io import EventReader, EventWriter
from evutils.types import Event_dtype

print("evutils", importlib.metadata.version("evutils"))
start = 1_643_243_627_000_000
events = numpy.zeros(1000, Event_dtype)
events["t"] = start + numpy.arange(1000) * 37
events["x"], events["y"], events["p"] = numpy.arange(1000) % 346, numpy.arange(1000) % 260, numpy.arange(1000) % 2
first = {}
for kind in ("raw", "dat", "csv", "npz", "aedat4"):
    path = str(pathlib.Path(sys.argv[1], f"events.{kind}"))
    writer = EventWriter(path, width=346, height=260)
    writer.write(events)
    writer.close()
    batches = [getattr(batch, "events", batch) for batch in EventReader(path)]
    first[kind] = int(next(batch["t"][0] for batch in batches if len(batch)))
    print(f"{kind}: {sum(len(batch) for batch in batches)} events, first at {first[kind]}, expected {start}")
expected = {"raw": start % 2**24, "dat": start % 2**32, "csv": start, "npz": start, "aedat4": start}
sys.exit(0 if first == expected else "the behaviour has changed")
PYTHON
