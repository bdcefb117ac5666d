#!/bin/sh
# Tests the packages (build.sh) in a bare Debian root: the .deb is installed and calibrates the fixture, and the tarball's program is
# the same one; then the Python wheel (tools/python/wheel.sh), in a second root. Prints a message if it cannot make a root.
set -eu
cd "$(dirname "$0")/../.."
script=packages
. tools/setup/packages.sh
. tools/package/names.sh

[ -f "$deb" ] || exit 0
binary=$packages/$name/bin/evcal

# The package must be complete and have no dependencies.
! readelf -d "$binary" | grep -q NEEDED || fail "the program needs shared libraries"
for file in share/man/man1/evcal.1 share/man/man1/evcal-calibrate.1 share/bash-completion/completions/evcal \
    share/zsh/site-functions/_evcal share/fish/vendor_completions.d/evcal.fish share/udev/65-inivation.rules \
    share/doc/evcal/third-party.txt share/doc/evcal/LICENSE-MIT INSTALL.md; do
    tar -tzf "$archive" "$name/$file" >/dev/null || fail "$file is not in the archive"
done
grep -q 'LGPL-2.1' "$packages/$name/share/doc/evcal/third-party.txt" || fail "the licence of libusb is not named"
grep -qF "$(grep SUBSYSTEM tools/package/65-inivation.rules)" docs/usb.md || fail "docs/usb.md has another udev rule"

if ! is_debian || ! run_as_root true 2>/dev/null; then
    echo "packages: the .deb was not installed: this needs Debian and root" >&2
    exit 0
fi
root=$(cd "$target_folder" && pwd)/package-root
bare_root "$root" ""
run_as_root cp "$deb" "$session/events.dvraw" "$session/truth.json" "$root/tmp/"
run_as_root chroot "$root" dpkg --install "/tmp/${deb##*/}" >/dev/null
inside() {
    run_as_root chroot "$root" "$@"
}
run_as_root rm -rf "$root/tmp/calibration"
inside sh -c "evcal calibrate /tmp/events.dvraw --board $board -o /tmp/calibration" >/dev/null
inside sh -c 'test -f /usr/lib/udev/rules.d/65-inivation.rules && test -f /usr/share/man/man1/evcal.1.gz'
# The error must be below 0.05 px, as in the demo.
inside evcal evaluate /tmp/calibration --truth /tmp/truth.json --json |
    /usr/bin/python3 -c 'import json, sys; rms = json.load(sys.stdin)["projection_difference"]["rms_px"]; print("rms", rms, "px"); sys.exit(rms > 0.05)' ||
    fail "the calibration in the bare root differs from the ground truth"
cmp -s "$root/usr/bin/evcal" "$binary" || fail "tarball and .deb hold different programs"
inside dpkg --purge evcal >/dev/null
inside sh -c '! command -v evcal' >/dev/null || fail "evcal is still there after it was removed"
echo "packages: installed in a bare Debian root, used for a calibration, removed again"
sh tools/package/test-wheel.sh "$root/tmp/calibration"
