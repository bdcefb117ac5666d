#!/bin/sh
# evutils 0.3.18 writes files named .aedat4, and it reads them. One would expect that the programs of the format read them too.
# dv-processing 2.0.4, aedat 2.3.0 and faery 0.7.1 refuse every such file: the header lacks the identifier of the format, and
# the XML in it has other nodes than those that DV writes.
# Consequence: a recording converted with evutils cannot be opened with the software of the cameras. Write RAW or npz with
# evutils, and AEDAT4 with dv-processing or faery.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps evutils==0.3.18 dv-processing==2.0.4 aedat==2.3.0 faery==0.7.1 numpy==2.4.6
cat >"$folder/show.py" <<'PYTHON'
import sys
from importlib.metadata import version

import aedat
import dv_processing
import faery
import numpy as np
from evutils import io
from evutils.types import EventArray

i = np.arange(1000)
columns = {"t": 1_000_000 + 50 * i, "x": (i % 346).astype("u2"), "y": (i % 260).astype("u2"), "p": (i % 2).astype("u1")}
path = f"{sys.argv[1]}/evutils.aedat4"
with io.EventWriter(path, width=346, height=260) as writer:
    writer.write(EventArray(**columns))
with io.EventReader(path) as reader:
    print(f"evutils {version('evutils')}: writes the file and reads {len(reader.read_all().t)} events from it")
print("expected: the other programs read 1000 events")
readers = {
    "dv-processing": lambda: dv_processing.io.MonoCameraRecording(path),
    "aedat": lambda: list(aedat.Decoder(path)),
    "faery": lambda: faery.events_stream_from_file(path).to_array(),
}
refused = 0
for name, read in readers.items():
    try:
        read()
        print(f"seen: {name} {version(name)} reads it")
    except Exception as error:
        refused += 1
        print(f"seen: {name} {version(name)} refuses it: {error}")
assert refused == 3
PYTHON
"$folder/venv/bin/python" "$folder/show.py" "$folder"
