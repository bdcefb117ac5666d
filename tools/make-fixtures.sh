#!/bin/sh
# Makes the recordings in fixtures/ again, byte for byte (see fixtures/README.md).
#
#   tools/make-fixtures.sh                        the simulated session
#   tools/make-fixtures.sh newtons-cradle.aedat4  the real recording too, from its original
#
# EVCAL is the program to use, FIXTURES the folder to write to.
set -eu
original_sha256=97ea11518d8b19581774c4a41ac8b87ca78bc66cdfd13d16a312c78891cc1b6c
repository=$(cd "$(dirname "$0")/.." && pwd)
evcal=${EVCAL:-${CARGO_TARGET_DIR:-$repository/target}/release/evcal}
fixtures=${FIXTURES:-$repository/fixtures}

"$evcal" simulate --board acircles:9x4:55mm:r17.5mm --motion slow --seed 2 --duration 3s \
    --format dvraw --frames 20 --imu -o "$fixtures/board"

if [ $# -ge 1 ]; then
    echo "$original_sha256  $1" | sha256sum --check --quiet || {
        echo "make-fixtures: $1 is not the original recording; fixtures/README.md says where it is" >&2
        exit 1
    }
    rm -f "$fixtures/newtons-cradle.dvraw"
    "$evcal" convert "$1" "$fixtures/newtons-cradle.dvraw"
fi
