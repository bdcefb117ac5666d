#!/bin/sh
# Compiles the core, the link and the detector against a sysroot that contains only `core`, and tests that
# code that uses `std` or `alloc` does not compile. Needs only this machine's target.
#
#   tools/embedded/core-only.sh DIRECTORY     where to build
set -eu
cd "$(dirname "$0")/../.."
out=$1
rm -rf "$out/sysroot" "$out/probe"
host=$(rustc --version --verbose | sed -n 's/^host: //p')
libraries=$out/sysroot/lib/rustlib/$host/lib
mkdir -p "$libraries"
# Some compilers keep the metadata in separate files (.rmeta).
for library in "$(rustc --print target-libdir)"/libcore-*.r* "$(rustc --print target-libdir)"/libcompiler_builtins-*.r*; do
    cp "$library" "$libraries/"
done

# With --target, the flags apply to code for the device and not to build scripts.
core_only() {
    RUSTFLAGS="--sysroot $(cd "$out/sysroot" && pwd)" \
        cargo build -q --release --target "$host" --target-dir "$out/target" "$@"
}

echo "== core only: core, link and detector need neither std nor alloc"
(
    out=$(cd "$out" && pwd)
    cd firmware
    core_only --locked -p evcal-core -p evcal-link -p evcal-detector
)

for library in std alloc; do
    probe=$out/probe/$library
    mkdir -p "$probe/src"
    printf '[package]\nname = "uses-%s"\nedition = "2024"\n[workspace]\n' "$library" > "$probe/Cargo.toml"
    printf '#![no_std]\nextern crate %s;\n' "$library" > "$probe/src/lib.rs"
    if core_only --manifest-path "$probe/Cargo.toml" > "$out/$library.log" 2>&1; then
        echo "core-only: a crate that uses $library compiles, so the test proves nothing" >&2
        exit 1
    fi
    if ! grep -q "E0463" "$out/$library.log"; then
        echo "core-only: a crate that uses $library fails for another reason:" >&2
        cat "$out/$library.log" >&2
        exit 1
    fi
    echo "a deliberate use of $library fails, as it should"
done
