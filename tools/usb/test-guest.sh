#!/bin/sh
# Runs usb-davis/tests/vhci in a virtual machine: a real kernel, its USB core and libusb against
# the emulated camera on the module vhci-hcd. Needs no KVM and does not touch the kernel of this machine.
#
# Installs QEMU and takes the kernel from Debian's package linux-image-amd64, unpacked below
# the target directory. If they are not available, it prints a message and exits with 0.
set -eu
cd "$(dirname "$0")/../.."
script=test-usb-guest
. tools/setup/packages.sh

# The guest is killed after this many seconds.
time_limit=900
machine=$(uname -m)

skip() {
    echo "test-usb-guest: SKIPPED, $1; the emulated camera on a real kernel was not tested" >&2
    exit 0
}

fail() {
    echo "test-usb-guest: $1" >&2
    exit 1
}

[ "$machine" = x86_64 ] || skip "the guest is made for x86_64, this machine is $machine"
is_debian || skip "QEMU and the guest's kernel come from Debian packages, and there is no apt-get"

needed=""
command -v qemu-system-x86_64 >/dev/null 2>&1 || needed="$needed qemu-system-x86"
[ -x /bin/busybox ] || needed="$needed busybox-static"
command -v xz >/dev/null 2>&1 || needed="$needed xz-utils"
# shellcheck disable=SC2086 # one word a package
install_packages $needed || skip "these packages cannot be installed:$needed"

# Kernel and modules, once for each version. linux-image-cloud-amd64 has no USB.
find_package() {
    package=$(apt-cache depends linux-image-amd64 2>/dev/null |
        sed -n 's/^ *Depends: \(linux-image-[0-9].*-amd64\)$/\1/p' | head -n 1)
    cache="${CARGO_TARGET_DIR:-target}/usb-guest/$package"
    [ -n "$package" ]
}
download() {
    rm -rf "$cache"
    mkdir -p "$cache/package"
    (cd "$cache/package" && apt-get -q download "$package")
}
find_package || { update_package_lists && find_package; } || skip "apt knows no package linux-image-amd64"
modules="usb-common usbcore usbip-core vhci-hcd"
if [ ! -e "$cache/complete" ]; then
    echo "test-usb-guest: unpacking $package into $cache"
    download || { update_package_lists && find_package && download; } || skip "$package cannot be downloaded"
    dpkg-deb --fsys-tarfile "$cache/package/$package"_*.deb | tar -x -C "$cache" --wildcards \
        './boot/vmlinuz-*' '*/kernel/drivers/usb/common/*' '*/kernel/drivers/usb/core/*' '*/kernel/drivers/usb/usbip/*'
    rm -r "$cache/package"
    for module in $modules; do
        file=$(find "$cache" -name "$module.ko*")
        case "$file" in
        *.ko) cp "$file" "$cache/" ;;
        *.ko.xz) xz -dc "$file" >"$cache/$module.ko" ;;
        *) fail "$package has no module $module that can be unpacked: ${file:-none}" ;;
        esac
    done
    # QEMU starts an unpacked kernel in half the time. The kernel is an xz stream after its loader.
    image=$(find "$cache/boot" -name 'vmlinuz-*')
    offset=$(LC_ALL=C grep -abo -m 1 "$(printf '\3757zXZ')" "$image" | head -n 1 | cut -d : -f 1)
    if [ -n "$offset" ] && tail -c "+$((offset + 1))" "$image" | xz -dc --single-stream >"$cache/kernel" 2>/dev/null; then
        :
    elif [ ! -s "$cache/kernel" ]; then
        cp "$image" "$cache/kernel"
    fi
    : >"$cache/complete"
fi

# The tests, the programs that they run, and all their libraries.
build() {
    cargo test --workspace --release --locked --test vhci --no-run --message-format=json
}
executables=$(build | sed -n 's/.*"executable":"\([^"]*\)".*/\1/p')
root=$(mktemp -d)
trap 'rm -rf "$root" "$root.libraries" "$root.cpio" "$root.log"' EXIT
chmod 755 "$root"
mkdir -p "$root/bin" "$root/dev" "$root/proc" "$root/sys" "$root/tmp" "$root/modules"
chmod 1777 "$root/tmp"
cp /bin/busybox "$root/bin/"
for module in $modules; do
    cp "$cache/$module.ko" "$root/modules/"
done
for name in vhci davis-emulate davis-record; do
    # Cargo adds a hash to the names of tests.
    file=$(echo "$executables" | grep -E "/$name(-[0-9a-f]+)?\$" | tail -n 1)
    [ -n "$file" ] || fail "cargo did not say where the program $name is"
    strip -o "$root/bin/$name" "$file"
    ldd "$file" >>"$root.libraries"
done
grep -o '/[^ ]*' "$root.libraries" | sort -u | while read -r library; do
    mkdir -p "$root$(dirname "$library")"
    cp -L "$library" "$root$library"
done
cat >"$root/init" <<END
#!/bin/busybox sh
/bin/busybox --install -s /bin
export PATH=/bin DAVIS_RECORD=/bin/davis-record DAVIS_EMULATE=/bin/davis-emulate
mount -t proc none /proc
mount -t sysfs none /sys
mount -t devtmpfs none /dev
for module in $modules; do insmod /modules/\$module.ko; done
vhci --ignored --test-threads=1 --nocapture
echo "guest: exit status \$?"
poweroff -f
END
chmod 755 "$root/init"
(cd "$root" && find . -print | busybox cpio -o -H newc 2>/dev/null) >"$root.cpio"

echo "test-usb-guest: starting $package in QEMU"
# /dev/kvm may exist and not work. These timers are reliable on a busy host.
timeout "$time_limit" qemu-system-x86_64 -accel tcg -machine q35 -cpu max -smp 1 -m 512 -nodefaults -no-reboot \
    -display none -serial stdio -kernel "$cache/kernel" -initrd "$root.cpio" \
    -append "console=ttyS0 quiet panic=-1 no_timer_check clocksource=hpet" </dev/null 2>&1 | tee "$root.log" || true
grep -q '^guest: exit status 0' "$root.log" || fail "the tests failed in the guest, or it did not end in $time_limit s"
