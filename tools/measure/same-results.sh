#!/bin/sh
# Compares what two builds of evcal make of twelve recordings: nine of events alone, whose files must be the same to the byte
# (camera, trajectory, circles, calibration.json without the command that made it, exports), and three with an IMU or a second
# camera, whose differences are printed in σ.
#   sh tools/measure/same-results.sh OLD NEW [FOLDER [CASE...]]
# FOLDER keeps the simulated recordings (made by OLD) and the results of OLD; without it both are made again. Needs python3.
set -eu
cd "$(dirname "$0")/../.."
[ $# -ge 2 ] || { echo "same-results: give two programs" >&2; exit 2; }
old=$1
new=$2
temporary=$(mktemp -d)
trap 'rm -rf "$temporary"' EXIT
folder=${3:-$temporary}
[ $# -lt 3 ] && shift 2 || shift 3
mkdir -p "$folder"
dots=acircles:9x4:55mm:r17.5mm
fixture=fixtures/board/events.dvraw
different=0

# result PROGRAM FOLDER ARGUMENTS...: calibrates and exports.
result() {
    program=$1
    to=$2
    shift 2
    "$program" calibrate "$@" --accept-any --force --threads 2 -o "$to" >"$to.log" 2>&1 ||
        { cat "$to.log" >&2; echo "same-results: $program cannot calibrate $*" >&2; exit 1; }
    "$program" export "$to" --format all --force -o "$to/exports" >/dev/null 2>&1 || true
}

# compare KIND NAME RECORDING SIMULATION ARGUMENTS...: SIMULATION has the options that make the folder RECORDING, which is {} in ARGUMENTS.
compare() {
    kind=$1
    name=$2
    recording=$folder/recordings/$3
    simulation=$4
    shift 4
    case " $wanted " in *" $name "*|"  ") ;; *) return 0 ;; esac
    if [ -n "$simulation" ] && [ ! -e "$recording/truth.json" ]; then
        # shellcheck disable=SC2086
        "$old" simulate $simulation --force -o "$recording" >/dev/null 2>&1
    fi
    count=$#
    while [ "$count" -gt 0 ]; do
        argument=$1
        shift
        case $argument in '{}'*) argument=$recording${argument#??} ;; esac
        set -- "$@" "$argument"
        count=$((count - 1))
    done
    [ -e "$folder/$name.old/calibration.json" ] || result "$old" "$folder/$name.old" "$@"
    result "$new" "$temporary/$name.new" "$@"
    python3 tools/measure/same_results.py "$kind" "$name" "$folder/$name.old" "$temporary/$name.new" || different=1
}

wanted="$*"
compare events fixture - "" $fixture --board $dots
compare events so3 - "" $fixture --board $dots --model kannala-brandt --rotation so3
compare events joint-frames - "" $fixture --board $dots --joint-frames
compare events squares squares "--board checkerboard:6x9:25mm --duration 3s --seed 31 --motion fast" '{}/events.aedat4' --board checkerboard:6x9:25mm
compare events bent bent "--bend 4mm,-3mm --duration 3s --seed 32 --motion fast" '{}/events.aedat4' --board $dots
compare events fisheye fisheye "--duration 3s --seed 33 --motion fast --model kannala-brandt --parameters 180,180,172.5,129.5,-0.02,0.01,-0.003,0.0005" \
    '{}/events.aedat4' --board $dots --model kannala-brandt
compare events partial partial "--duration 4s --seed 34 --motion interrupted" '{}/events.aedat4' --board $dots
compare events two-files two-files "--duration 3s --seed 35 --motion far" '{}/events.aedat4' $fixture --board $dots
compare events long long "--duration 8s --seed 36 --motion slow" '{}/events.aedat4' --board $dots
compare rig imu rig "--duration 4s --seed 41 --motion fast --imu davis346 --second-camera" '{}/events.aedat4' --board $dots --imu
compare rig second-events rig "--duration 4s --seed 41 --motion fast --imu davis346 --second-camera" '{}/events.aedat4' --board $dots --with '{}/second.aedat4'
compare rig second-frames frames "--duration 4s --seed 42 --motion fast --imu --second-frames" '{}/events.aedat4' --board $dots --with '{}/second'
exit $different
