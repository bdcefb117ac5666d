#!/bin/sh
# Text with one event per line and spaces between its fields, "t x y p", is how the Event Camera Dataset and many converters
# write events. evutils 0.3.18 reads such a file without an error or a warning, but every event gets the pixel (0, 0) and the
# polarity 0; only the times are right (if they are whole numbers). Its reader knows commas only.
# Consequence: a recording looks as if one pixel had sent everything. Replace the spaces by commas before reading.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps evutils==0.3.18 numpy==2.4.6
cat >"$folder/show.py" <<'PYTHON'
import sys
from importlib.metadata import version

from evutils import io

events = [(1_000_000 + 50 * i, i * 7 % 346, i * 11 % 260, i % 2) for i in range(1000)]
read = {}
for name, separator in (("commas", ","), ("spaces", " ")):
    path = f"{sys.argv[1]}/{name}.txt"
    with open(path, "w") as file:
        file.writelines(separator.join(map(str, event)) + "\n" for event in events)
    with io.EventReader(path) as reader:
        got = reader.read_all()
    read[name] = [tuple(int(value) for value in event) for event in zip(got.t, got.x, got.y, got.p)]
print("evutils", version("evutils"))
print("expected: the same events from both files, the 4th is", events[3])
for name, got in read.items():
    print(f"seen with {name}: {len(got)} events, the 4th is {got[3]}")
assert read["commas"] == events
assert read["spaces"] == [(t, 0, 0, 0) for t, *_ in events]
PYTHON
"$folder/venv/bin/python" "$folder/show.py" "$folder"
