#!/bin/sh
# Builds the Python package's wheel, installs it in an environment of its own below the target folder, and tests it
# there: pytest, the stubs against the module (stubtest), how fast it moves events.
set -eu
cd "$(dirname "$0")/../.."

script=test-python
. tools/setup/packages.sh

if is_debian; then
    install_packages python3-venv
else
    echo "test-python: this is not Debian or a relative; install python3 with venv yourself" >&2
fi

target="${CARGO_TARGET_DIR:-$PWD/target}/python"
environment="$target/environment"
install_python_packages "$environment" python/tests/requirements.txt
PATH="$environment/bin:$PATH"
export PATH

cargo fmt --manifest-path python/Cargo.toml --check
LIBUDEV_NO_PKG_CONFIG=1 CARGO_TARGET_DIR="$target" cargo clippy --quiet --release --locked --manifest-path python/Cargo.toml -- -D warnings

# libusb comes with the wheel, and speaks to the kernel itself.
rm -rf "$target/wheels"
LIBUDEV_NO_PKG_CONFIG=1 CARGO_TARGET_DIR="$target" \
    maturin build --quiet --release --locked --manifest-path python/Cargo.toml --out "$target/wheels"
pip install --quiet --disable-pip-version-check --force-reinstall --no-deps "$target"/wheels/*.whl
ls -l "$target"/wheels/*.whl | awk '{ print "test-python: " $9 ": " $5 " bytes" }'

# Not beside the sources, which would be imported in place of what is installed.
root=$PWD
cd "$target"
python -m mypy.stubtest evcal
python -m pytest -q -p no:cacheprovider "$root/python/tests"
python "$root/python/benchmarks/undistort_events.py"
