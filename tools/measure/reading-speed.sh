#!/bin/sh
# Measures the reading speed of each format on one core with a simulated recording of 5 million events.
#
#   sh tools/measure/reading-speed.sh [FOLDER]
set -eu
cd "$(dirname "$0")/../.."

folder="${1:-${CARGO_TARGET_DIR:-target}/reading-speed}"
program="${CARGO_TARGET_DIR:-target}/release"
cargo build --release --quiet --locked -p evcal --bin evcal -p event-recordings --example reading_speed
mkdir -p "$folder"
"$program/evcal" simulate --force --motion fast --duration 4s -o "$folder/simulation" >/dev/null
rm -f "$folder"/*.*
for kind in dvraw bag mcap raw npz csv bin; do
    "$program/evcal" convert "$folder/simulation/events.aedat4" "$folder/source.$kind" >/dev/null
done
"${CARGO_TARGET_DIR:-target}/readers/bin/python" tests/readers/speed.py "$folder"
"$program/examples/reading_speed" "$folder/simulation/events.aedat4" "$folder"/*.*
