#!/bin/sh
# Installs the missing requirements of a build on Debian: OpenCV, clang and a C++ compiler (the crate `opencv` reads OpenCV's headers
# with libclang and compiles functions in C++), libusb, umockdev (shows tests an emulated camera), and a Rust compiler if there is none
# that is new enough. OPENCV=0: without OpenCV and what it needs.
set -eu

cd "$(dirname "$0")/../.."
script=setup
. tools/setup/packages.sh
needed_rust=1.89

new_enough() {
    found=$(cargo --version 2>/dev/null | sed -n 's/^cargo \([0-9]*\.[0-9]*\).*/\1/p')
    [ -n "$found" ] && [ "$(printf '%s\n%s\n' "$needed_rust" "$found" | sort -V | head -n 1)" = "$needed_rust" ]
}

if ! is_debian; then
    echo "setup: this is not Debian or a relative; install OpenCV 4 or 5, clang with libclang, a C++ compiler, libusb 1.0, pkg-config and Rust $needed_rust yourself" >&2
    exit 0
fi

opencv="libopencv-dev clang g++"
[ "${OPENCV:-1}" != 0 ] || opencv=
# shellcheck disable=SC2086 # three packages
install_packages gcc libc6-dev pkg-config $opencv libusb-1.0-0-dev libudev-dev umockdev
if ! new_enough; then
    # Debian's own current Rust, built for its web browsers.
    install_packages cargo-web rustc-web rust-web-clippy rustfmt-web
fi
if ! new_enough; then
    echo "setup: Rust $needed_rust or newer is needed, found: $(cargo --version 2>/dev/null || echo none)" >&2
    exit 1
fi
