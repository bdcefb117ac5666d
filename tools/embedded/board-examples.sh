#!/bin/sh
# Checks that the example for a real board compiles; tools/embedded/test-slow.sh builds it completely.
#
#   tools/embedded/board-examples.sh DIRECTORY     where to build; after tools/embedded/target.sh thumbv7em-none-eabihf
set -eu
cd "$(dirname "$0")/../../firmware"
echo "== board example: NUCLEO-H743ZI compiles"
cargo check -q --release --locked --target thumbv7em-none-eabihf --target-dir "$1" -p nucleo-h743zi
