#!/bin/sh
# Calibrates a DAVIS346 from a raw dump of its USB stream (simulated, so that the truth is known) and
# compares the result with the truth.
set -eu
cd "$(dirname "$0")/.."
evcal="${CARGO_TARGET_DIR:-target}/release/evcal"
session=fixtures/board
out=demo
board=acircles:9x4:55mm:r17.5mm
rm -rf "$out/calibration"
echo "== 1. the recording: 3 s of a hand-moved board"
"$evcal" info "$session/events.dvraw"
echo
echo "== 2. calibration from the events"
start=$(date +%s)
"$evcal" calibrate "$session/events.dvraw" --board "$board" -o "$out/calibration" --verbose
echo "(the calibration took $(($(date +%s) - start)) s)"
echo
echo "== 3. comparison with the truth"
"$evcal" evaluate "$out/calibration" --truth "$session"
echo
echo "The page that guides a person at a camera, on the same recording:"
echo "  $evcal live --replay $session/events.dvraw --speed 0.2 --board $board -o $out/live"
echo
echo "Open $out/calibration/report.html: whether the result is good and why, with maps and pictures. In"
echo "$out/calibration/good-frame.png ON events are blue and OFF events orange; the board, projected by the calibration, is green."
