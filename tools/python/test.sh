#!/bin/sh
# Installs the Python package's wheel (wheel.sh) in an environment of its own below the target folder, and tests it there: pytest, the stubs against the module (stubtest), how fast it moves events.
set -eu
cd "$(dirname "$0")/../.."

target="${CARGO_TARGET_DIR:-$PWD/target}/python"
PATH="$target/environment/bin:$PATH"
export PATH

cargo fmt --manifest-path python/Cargo.toml --check
LIBUDEV_NO_PKG_CONFIG=1 CARGO_TARGET_DIR="$target" cargo clippy --quiet --release --locked --manifest-path python/Cargo.toml -- -D warnings

pip install --quiet --disable-pip-version-check --force-reinstall --no-deps "$target"/wheels/*.whl
ls -l "$target"/wheels/*.whl | awk '{ print "test-python: " $9 ": " $5 " bytes" }'

# Not next to the sources, which would be imported instead of the installed package.
root=$PWD
cd "$target"
python -m mypy.stubtest evcal
python -m pytest -q -p no:cacheprovider "$root/python/tests"
python "$root/python/benchmarks/undistort_events.py"
