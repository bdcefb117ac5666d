#!/bin/sh
# Checks that two builds of evcal calibrate recordings to the same bytes: camera, trajectory and circles.
#   sh tools/measure/same-results.sh OLD NEW [RECORDING MODEL]...
# The default recording is the one in fixtures. The board is the one of all simulated recordings of the project.
set -eu
cd "$(dirname "$0")/../.."
[ $# -ge 2 ] || { echo "same-results: give two programs" >&2; exit 2; }
old=$1
new=$2
shift 2
[ $# -gt 0 ] || set -- fixtures/board/events.dvraw radtan
board=acircles:9x4:55mm:r17.5mm
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
different=0
while [ $# -gt 0 ]; do
    for program in old new; do
        eval "path=\$$program"
        mkdir -p "$work/$program"
        "$path" calibrate "$1" --board $board --model "$2" --accept-any --force -o "$work/$program/calibration" >/dev/null 2>&1 ||
            { echo "same-results: $path cannot calibrate $1" >&2; exit 1; }
    done
    for file in camera.yaml trajectory.txt circles.csv; do
        if cmp -s "$work/old/calibration/$file" "$work/new/calibration/$file"; then
            echo "$1: $file is the same"
        else
            echo "$1: $file DIFFERS"
            different=1
        fi
    done
    shift 2
done
exit $different
