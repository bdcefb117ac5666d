#!/bin/sh
# Makes cargo able to build for the microcontroller targets given:
#
#   eval "$(tools/embedded/target.sh thumbv7em-none-eabihf riscv32imafc-unknown-none-elf)"
#
# Targets that the installed compiler has (`rustup target add ...`) are used unchanged. If one is
# missing, `core` is built once from Debian's Rust sources with Debian's compiler of the same version
# and kept below ~/.cache; the printed variables make cargo use both. Only `core` is built: code that
# needs `alloc` or `std` does not compile.
set -eu
script=embedded-target
. "$(dirname "$0")/../setup/packages.sh"

say() { echo "embedded-target: $*" >&2; }

need_packages() {
    is_debian || { say "this is not Debian or a relative: install $*, or run: rustup target add $targets"; exit 1; }
    install_packages "$@"
}

has_target() {
    directory=$(rustc --print target-libdir --target "$1" 2>/dev/null) || return 1
    ls "$directory"/libcore-*.rlib >/dev/null 2>&1
}

[ $# -gt 0 ] || { say "usage: tools/embedded/target.sh TARGET..."; exit 2; }
targets="$*"
missing_targets=""
for target in "$@"; do
    has_target "$target" || missing_targets="$missing_targets $target"
done
if [ -z "$missing_targets" ]; then
    exit 0
fi

need_packages rustc-web rust-web-src
compiler=/usr/bin/rustc
sources=/usr/lib/rustlib/src/rust/library
version=$("$compiler" --version | cut -d ' ' -f 2)
host=$("$compiler" --version --verbose | sed -n 's/^host: //p')
if ! "$compiler" --version --verbose | grep -q "^release: $version" || [ ! -d "$sources/core" ]; then
    say "$compiler has no matching sources in $sources"
    exit 1
fi
# The linker comes with rustup's compiler, or from Debian.
linker=$(rustc --print sysroot)/lib/rustlib/$host/bin/rust-lld
if [ ! -x "$linker" ]; then
    linker=$(command -v ld.lld || true)
    if [ -z "$linker" ]; then
        need_packages lld
        linker=$(command -v ld.lld)
    fi
fi

cache=${XDG_CACHE_HOME:-$HOME/.cache}/embedded-rust/$version
sysroot=$cache/sysroot
mkdir -p "$sysroot/lib/rustlib" "$cache/build/src"
# Build scripts and procedural macros run on this machine.
ln -sfn "$("$compiler" --print sysroot)/lib/rustlib/$host" "$sysroot/lib/rustlib/$host"
printf '#!/bin/sh\nexec %s --sysroot %s "$@"\n' "$compiler" "$sysroot" > "$cache/rustc.new"
chmod +x "$cache/rustc.new"
mv "$cache/rustc.new" "$cache/rustc"
cat > "$cache/build/Cargo.toml" <<'MANIFEST'
[package]
name = "empty"
edition = "2024"
[profile.release]
panic = "abort"
MANIFEST
echo '#![no_std]' > "$cache/build/src/lib.rs"
mkdir -p "$cache/build/.cargo"
cat > "$cache/build/.cargo/config.toml" <<CONFIGURATION
[source.crates-io]
replace-with = "sources-of-the-compiler"
[source.sources-of-the-compiler]
directory = "$sources/vendor"
CONFIGURATION

for target in $targets; do
    libraries=$sysroot/lib/rustlib/$target/lib
    if ! ls "$libraries"/libcore-*.rlib >/dev/null 2>&1; then
        say "building core $version for $target (about a minute)"
        (
            # The calling build's settings do not apply here. LLVM bitcode makes fat LTO possible.
            unset CARGO_TARGET_DIR CARGO_BUILD_TARGET CARGO_ENCODED_RUSTFLAGS
            cd "$cache/build"
            RUSTC=$compiler RUSTC_BOOTSTRAP=1 RUSTFLAGS=-Cembed-bitcode=yes \
                cargo build -q --release --offline -Zbuild-std=core --target "$target" --target-dir "$cache/build/target" >&2
        )
        rm -rf "$libraries.new"
        mkdir -p "$libraries.new"
        cp "$cache/build/target/$target/release/deps"/libcore-*.rlib \
            "$cache/build/target/$target/release/deps"/libcompiler_builtins-*.rlib "$libraries.new/"
        rm -rf "$libraries"
        mv "$libraries.new" "$libraries"
    fi
    variable=$(echo "$target" | tr 'a-z-' 'A-Z_')
    echo "export CARGO_TARGET_${variable}_LINKER=$linker"
done
echo "export RUSTC=$cache/rustc"
