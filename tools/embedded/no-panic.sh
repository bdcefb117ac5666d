#!/bin/sh
# Links a program that calls every function of core, link and detector and cannot be linked if a panic is reachable,
# and tests that a deliberate panic is found.
#
#   tools/embedded/no-panic.sh DIRECTORY TARGET     where to build, and for what; after tools/embedded/target.sh
set -eu
cd "$(dirname "$0")/../../firmware"
out=$1
target=$2
link() {
    cargo build -q --release --locked --target "$target" --target-dir "$out" -p no-panic "$@"
}

echo "== no panic is reachable"
link || {
    echo "no-panic: a panic can be reached; these functions call one:" >&2
    cargo rustc -q --release --locked --target "$target" --target-dir "$out" -p no-panic -- \
        --emit asm -C link-arg=--unresolved-symbols=ignore-all
    awk '/^[_A-Za-z][^ ]*:/ { in_function = $1 } $1 ~ /^bl?(\.w)?$/ && $2 ~ /panic|slice_index_fail|unwrap_failed/ { print "  " in_function " " $2 }' \
        "$(ls -t "$out/$target/release/deps"/no_panic*.s | head -n 1)" | sort -u >&2
    exit 1
}
if link --features deliberate-panic > "$out/deliberate.log" 2>&1; then
    echo "no-panic: a deliberate panic is not found, so the test proves nothing" >&2
    exit 1
fi
if ! grep -q "a_panic_can_be_reached" "$out/deliberate.log"; then
    echo "no-panic: the deliberate panic fails for another reason:" >&2
    cat "$out/deliberate.log" >&2
    exit 1
fi
echo "a deliberate panic fails to link, as it should"
