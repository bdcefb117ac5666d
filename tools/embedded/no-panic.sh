#!/bin/sh
# Links a program that calls everything in core, link and detector, and that cannot be linked if a panic can be
# reached; and tests that a deliberate panic is found.
#
#   tools/embedded/no-panic.sh DIRECTORY TARGET     where to build, and for what; after tools/embedded/target.sh
set -eu
cd "$(dirname "$0")/../../firmware"
out=$1
target=$2
link() {
    cargo build -q --release --locked --target "$target" --target-dir "$out" -p no-panic "$@"
}

echo "== no panic can be reached"
link || {
    echo "no-panic: a panic can be reached; these functions call one:" >&2
    cargo rustc -q --release --locked --target "$target" --target-dir "$out" -p no-panic -- \
        --emit asm -C link-arg=--unresolved-symbols=ignore-all
    awk '/^[_A-Za-z][^ ]*:/ { in_function = $1 } $1 ~ /^bl?(\.w)?$/ && $2 ~ /panic|slice_index_fail|unwrap_failed/ { print "  " in_function " " $2 }' \
        "$(ls -t "$out/$target/release/deps"/no_panic*.s | head -n 1)" | sort -u >&2
    exit 1
}
if link --features deliberate-panic > "$out/deliberate.log" 2>&1; then
    echo "no-panic: a deliberate panic is not found: the test tests nothing" >&2
    exit 1
fi
if ! grep -q "a_panic_can_be_reached" "$out/deliberate.log"; then
    echo "no-panic: the deliberate panic fails for another reason:" >&2
    cat "$out/deliberate.log" >&2
    exit 1
fi
echo "a deliberate panic fails to link, as it should"
