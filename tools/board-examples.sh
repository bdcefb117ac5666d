#!/bin/sh
# Compiles the example for a real board, and prints what it takes.
#
#   tools/board-examples.sh DIRECTORY     where to build; after tools/embedded-target.sh thumbv7em-none-eabihf
set -eu
cd "$(dirname "$0")/../firmware"
out=$1
echo "== board example: NUCLEO-H743ZI"
cargo build -q --release --locked --target thumbv7em-none-eabihf --target-dir "$out" -p nucleo-h743zi
size "$out/thumbv7em-none-eabihf/release/nucleo-h743zi"
