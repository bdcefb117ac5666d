#!/bin/sh
# Builds the program and prints how long that took and how to call it. OPENCV=0: without OpenCV.
set -eu
cd "$(dirname "$0")/../.."
start=$(date +%s)
if [ "${OPENCV:-1}" = 0 ]; then
    echo "evcal is being built without OpenCV: about 4 minutes on two cores the first time"
    cargo build --release --locked -p evcal --no-default-features --features cli
else
    echo "evcal is being built: about 4 minutes on two cores the first time"
    cargo build --release --locked -p evcal
fi
program="${CARGO_TARGET_DIR:-target}/release"
echo "evcal was built in $(($(date +%s) - start)) s: $program/evcal"
echo "To call it by its name in this terminal: export PATH=\"$(cd "$program" && pwd):\$PATH\""
