#!/bin/sh
# Runs the detector on an emulated Cortex-M4F with a whole simulated recording and calibrates from its circle stream on this
# machine. The result must be close to the truth: focal lengths within 0.3 %, principal point within 1 px.
# Run tools/embedded/test.sh first, which builds the programs, and build evcal.
set -eu
cd "$(dirname "$0")/../.."
target=${CARGO_TARGET_DIR:-$PWD/target}
out=$target/embedded
evcal=$target/release/evcal
recording=$out/recording
board=acircles:9x4:55mm:r17.5mm

echo "== the detector on a Cortex-M4F reads a recording of 4 s"
rm -rf "$recording" "$out/calibration"
"$evcal" simulate --duration 4s --motion fast --seed 7 --board "$board" --format csv -o "$recording"
"$out/firmware/release/encode-events" "$recording/events.csv" "$recording/events.evt2" evt2
timeout 1800 qemu-system-arm -M mps2-an386 -nographic -monitor none -serial none -icount shift=6 \
    -semihosting-config "enable=on,target=native,arg=detector,arg=$recording/events.evt2,arg=$out/circles.stream,arg=evt2" \
    -kernel "$out/firmware/thumbv7em-none-eabihf/release/detector"

echo "== calibration from its circle stream"
"$evcal" calibrate "$out/circles.stream" --board "$board" -o "$out/calibration"
"$evcal" evaluate "$out/calibration" --truth "$recording" > "$out/evaluation.txt"
sed -n 1,/^projection/p "$out/evaluation.txt"
awk '
    function size(value) { return value < 0 ? -value : value }
    $1 == "fx" || $1 == "fy" { seen++; if (size($4) > 0.003 * $2) bad = bad " " $1 }
    $1 == "cx" || $1 == "cy" { seen++; if (size($4) > 1) bad = bad " " $1 }
    END {
        if (seen != 4) { print "test-embedded-calibration: no comparison with the truth"; exit 1 }
        if (bad != "") { print "test-embedded-calibration: too far from the truth:" bad; exit 1 }
    }' "$out/evaluation.txt"
echo "test-embedded-calibration: within 0.3 % and 1 px"
