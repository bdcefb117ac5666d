#!/bin/sh
# Builds the code that needs neither std nor an allocator against a sysroot with the core library alone: any use of
# another library, also in a dependency, is an error (E0463). Needs no other target.
set -eu
cd "$(dirname "$0")/../.."

host=$(rustc -vV | sed -n 's/^host: //p')
libraries=$(rustc --print target-libdir)
target="${CARGO_TARGET_DIR:-target}/no-std"
sysroot="$target/sysroot"
rm -rf "$sysroot"
mkdir -p "$sysroot/lib/rustlib/$host/lib"
for library in core compiler_builtins; do
    # Newer compilers keep the metadata next to the library.
    cp "$libraries/lib$library-"* "$sysroot/lib/rustlib/$host/lib/"
done

# With --target, build scripts and procedural macros still use the whole library.
RUSTFLAGS="--sysroot $(cd "$sysroot" && pwd)" cargo build --release --locked --target "$host" \
    --target-dir "$target" -p evcal-core -p usb-davis --no-default-features
echo "check-no-std: evcal-core without geometry and the protocol of usb-davis build with the core library alone"
