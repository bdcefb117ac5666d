#!/bin/sh
# Slow tests: the core's ordinary tests as 32-bit Arm programs under QEMU, where `usize` has 32 bits and the compiler
# differs, and the complete build of the example for a real board.
set -eu
cd "$(dirname "$0")/../.."
script=test-embedded-slow
. tools/setup/packages.sh
out=${CARGO_TARGET_DIR:-$PWD/target}/embedded
mkdir -p "$out"
target=armv7-unknown-linux-gnueabihf

echo "== the core's tests on 32-bit Arm"
install_packages gcc-arm-linux-gnueabihf libc6-dev-armhf-cross qemu-user rustc-web rust-web-src
# The compiler and the sources of std have the same version because they are in one Debian package.
RUSTC=/usr/bin/rustc RUSTC_BOOTSTRAP=1 \
    CARGO_TARGET_ARMV7_UNKNOWN_LINUX_GNUEABIHF_LINKER=arm-linux-gnueabihf-gcc \
    CARGO_TARGET_ARMV7_UNKNOWN_LINUX_GNUEABIHF_RUNNER="qemu-arm -L /usr/arm-linux-gnueabihf" \
    cargo test --release --locked -Zbuild-std --target "$target" --target-dir "$out/arm-linux" -p evcal-core --lib --tests

settings=$(tools/embedded/target.sh thumbv7em-none-eabihf)
eval "$settings"
echo "== board example: NUCLEO-H743ZI"
(
    cd firmware
    cargo build -q --release --locked --target thumbv7em-none-eabihf --target-dir "$out/firmware" -p nucleo-h743zi
)
size "$out/firmware/thumbv7em-none-eabihf/release/nucleo-h743zi"
