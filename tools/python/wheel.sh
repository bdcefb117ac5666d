#!/bin/sh
# Builds the Python package's wheel, in target/python/wheels, with its requirements in an environment below the target folder.
set -eu
cd "$(dirname "$0")/../.."

script=wheel
. tools/setup/packages.sh

if is_debian; then
    install_packages python3-venv
else
    echo "wheel: this is not Debian or a relative; install python3 with venv yourself" >&2
fi

target="${CARGO_TARGET_DIR:-$PWD/target}/python"
environment="$target/environment"
install_python_packages "$environment" python/tests/requirements.txt
PATH="$environment/bin:$PATH"
export PATH

# The wheel contains libusb, which uses the kernel directly instead of udev.
rm -rf "$target/wheels"
LIBUDEV_NO_PKG_CONFIG=1 CARGO_TARGET_DIR="$target" \
    maturin build --quiet --release --locked --manifest-path python/Cargo.toml --out "$target/wheels"
