#!/bin/sh
# Makes the .deb from the folder that build.sh filled. MAINTAINER="NAME <ADDRESS>" is the contact of the package.
set -eu
cd "$(dirname "$0")/../.."
. tools/package/names.sh
from=$packages/$name
root=$packages/deb
rm -rf "$root"
mkdir -p "$root/DEBIAN" "$root/usr/bin" "$root/usr/lib/udev/rules.d" "$root/usr/share/zsh" "$root/usr/share/doc"
cp "$from/bin/evcal" "$root/usr/bin/"
cp -r "$from/share/man" "$from/share/bash-completion" "$from/share/fish" "$root/usr/share/"
gzip -9n "$root"/usr/share/man/man1/*.1
cp -r "$from/share/zsh/site-functions" "$root/usr/share/zsh/vendor-completions"
cp "$from/share/udev/65-inivation.rules" "$root/usr/lib/udev/rules.d/"
cp -r "$from/share/doc/evcal" "$root/usr/share/doc/"
cat "$from/share/doc/evcal/LICENSE-MIT" "$from/share/doc/evcal/LICENSE-APACHE" "$from/share/doc/evcal/third-party.txt" \
    >"$root/usr/share/doc/evcal/copyright"
rm "$root"/usr/share/doc/evcal/LICENSE-* "$root/usr/share/doc/evcal/third-party.txt"
gzip -9n "$root/usr/share/doc/evcal/CHANGELOG.md"

cat >"$root/DEBIAN/control" <<CONTROL
Package: evcal
Version: $version
Architecture: amd64
Maintainer: ${MAINTAINER:-The evcal authors}
Installed-Size: $(du -ks "$root/usr" | cut -f 1)
Section: science
Priority: optional
Description: calibrates event cameras
 Calibrates an event camera from the events of a moving or blinking board of
 circles, squares or tags: intrinsics with their uncertainty, a verdict, a
 report, and files for OpenCV, ROS, Kalibr and others.
CONTROL
# Applies the rule to cameras that are already plugged in. A container has no udev.
for step in postinst postrm; do
    cat >"$root/DEBIAN/$step" <<'STEP'
#!/bin/sh
set -e
if command -v udevadm >/dev/null 2>&1 && [ -d /run/udev ]; then
    udevadm control --reload || true
    udevadm trigger --subsystem-match=usb --attr-match=idVendor=152a || true
fi
STEP
    chmod 755 "$root/DEBIAN/$step"
done
chmod -R u=rwX,go=rX "$root/usr"
dpkg-deb --root-owner-group -Zxz --build "$root" "$deb" >/dev/null
