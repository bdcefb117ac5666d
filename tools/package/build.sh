#!/bin/sh
# Makes the packages for users who do not build evcal, in target/packages:
#   evcal-VERSION-x86_64-unknown-linux-gnu.tar.gz   the program, man pages, completions, udev rule, licences
#   evcal_VERSION_amd64.deb                         the same for Debian and its relatives
# The program is static: it needs no library of the system. It is built with glibc, because Debian has no Rust standard library for
# musl, without OpenCV, and with the libusb of the crate libusb1-sys, which is notified of cameras by the kernel instead of udev.
set -eu
cd "$(dirname "$0")/../.."
script=packages
. tools/setup/packages.sh
. tools/package/names.sh

if [ "$(uname -m)" != x86_64 ]; then
    echo "packages: SKIPPED, these are for x86_64, and this machine is $(uname -m)" >&2
    exit 0
fi
if is_debian; then
    install_packages gcc libc6-dev dpkg python3
fi

# Without pkg-config, which would find the system's libusb and libudev, which cannot be linked statically.
CARGO_INCREMENTAL=0 PKG_CONFIG=false RUSTFLAGS="-C target-feature=+crt-static" \
    cargo build --profile distribution --locked -p evcal --no-default-features --features cli --target "$target"

rm -rf "$packages"
root=$packages/$name
mkdir -p "$root/bin" "$root/share/udev" "$root/share/doc/evcal"
strip -o "$root/bin/evcal" "$target_folder/$target/distribution/evcal"
"$root/bin/evcal" man "$root/share/man/man1" >/dev/null
for completion in bash:bash-completion/completions/evcal zsh:zsh/site-functions/_evcal \
    fish:fish/vendor_completions.d/evcal.fish; do
    file=$root/share/${completion#*:}
    mkdir -p "$(dirname "$file")"
    "$root/bin/evcal" completions "${completion%%:*}" >"$file"
done
cp tools/package/65-inivation.rules "$root/share/udev/"
cp tools/package/INSTALL.md "$root/"
cp README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE "$root/share/doc/evcal/"
/usr/bin/python3 tools/package/licences.py "$target" >"$root/share/doc/evcal/third-party.txt"
tar --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$(git log -1 --format=%ct 2>/dev/null || echo 0)" \
    -C "$packages" -czf "$archive" "$name"
sh tools/package/deb.sh
ls -l "$root/bin/evcal" "$archive" "$deb" | awk '{ print $5, $NF }'
