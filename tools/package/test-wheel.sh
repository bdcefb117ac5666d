#!/bin/sh
# Tests the Python package in a bare Debian root with Debian's Python and NumPy: the wheel is installed without a network and
# calibrates the fixture. The camera must equal the calibration by the program from the .deb, in CALIBRATION.
#
#   sh tools/package/test-wheel.sh CALIBRATION
set -eu
cd "$(dirname "$0")/../.."
script=packages
. tools/setup/packages.sh
. tools/package/names.sh
calibration=$1

wheel=$(ls "$target_folder"/python/wheels/evcal-*.whl)
root=$(cd "$target_folder" && pwd)/wheel-root
bare_root "$root" python3-numpy,python3-venv
run_as_root rm -rf "$root/tmp/environment"
run_as_root cp "$wheel" "$session/events.dvraw" "$session/truth.json" tools/package/use_wheel.py "$root/tmp/"
run_as_root cp "$calibration/calibration.json" "$root/tmp/program.json"
run_as_root chroot "$root" sh -c "python3 -m venv --system-site-packages /tmp/environment &&
    /tmp/environment/bin/pip install --quiet --disable-pip-version-check --no-index /tmp/${wheel##*/}"
run_as_root chroot "$root" timeout 600 /tmp/environment/bin/python /tmp/use_wheel.py "$board" ||
    fail "the wheel does not calibrate in the bare root as the program does"
run_as_root rm -rf "$root/tmp/environment"
echo "packages: the wheel ($(stat -c %s "$wheel") bytes) was installed in a bare Debian root and used for a calibration"
