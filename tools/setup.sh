#!/bin/sh
# Installs what evcal needs to build on Debian and is not there yet: OpenCV, libclang (its bindings
# are generated), libusb, umockdev (shows tests an emulated camera), and a Rust compiler where there is
# none that is new enough.
set -eu

needed_rust=1.89

run_as_root() {
    if [ "$(id -u)" -eq 0 ]; then
        "$@"
    elif command -v sudo >/dev/null 2>&1; then
        sudo "$@"
    else
        echo "setup: please run as root: $*" >&2
        exit 1
    fi
}

missing=""
need_package() {
    dpkg-query -W -f='${Status}' "$1" 2>/dev/null | grep -q 'install ok installed' || missing="$missing $1"
}

new_enough() {
    found=$(cargo --version 2>/dev/null | sed -n 's/^cargo \([0-9]*\.[0-9]*\).*/\1/p')
    [ -n "$found" ] && [ "$(printf '%s\n%s\n' "$needed_rust" "$found" | sort -V | head -n 1)" = "$needed_rust" ]
}

if ! command -v dpkg-query >/dev/null 2>&1; then
    echo "setup: this is not Debian or a relative; install OpenCV 4, clang, libclang, libusb 1.0, pkg-config and Rust $needed_rust yourself" >&2
    exit 0
fi

for package in gcc libc6-dev pkg-config libopencv-dev clang libclang-dev libusb-1.0-0-dev libudev-dev umockdev; do
    need_package "$package"
done
if ! new_enough; then
    # Debian's own current Rust, built for its web browsers.
    need_package cargo-web
    need_package rustc-web
    need_package rust-web-clippy
    need_package rustfmt-web
fi
if [ -n "$missing" ]; then
    echo "setup: installing$missing"
    run_as_root apt-get -o DPkg::Lock::Timeout=900 update -q
    # shellcheck disable=SC2086 # one word a package
    run_as_root env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=900 install -q -y --no-install-recommends $missing
fi
if ! new_enough; then
    echo "setup: Rust $needed_rust or newer is needed, found: $(cargo --version 2>/dev/null || echo none)" >&2
    exit 1
fi
