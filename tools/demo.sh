#!/bin/sh
# Simulates a DAVIS346 in front of a moving board, calibrates it from the events alone and compares
# the result with the truth.
set -eu
cd "$(dirname "$0")/.."
evcal="${CARGO_TARGET_DIR:-target}/release/evcal"
out=demo
board=acircles:9x4:55mm:r17.5mm
rm -rf "$out"
echo "== 1. a simulated recording: 4 s of a hand-moved board"
"$evcal" simulate --duration 4s --motion fast --seed 7 --board "$board" -o "$out/recording"
echo
echo "== 2. calibration from the events"
"$evcal" calibrate "$out/recording/events.aedat4" --board "$board" -o "$out/calibration" --verbose
echo
echo "== 3. against the truth"
"$evcal" evaluate "$out/calibration" --truth "$out/recording"
echo
echo "Look at $out/calibration/good-frame.png: events red and blue, the board where the model puts it green."
