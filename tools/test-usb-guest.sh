#!/bin/sh
# Runs usb-davis/tests/vhci_camera.rs in a virtual machine: a real kernel, its USB core and libusb against
# the emulated camera on the module vhci-hcd. Needs no KVM and does not touch the kernel of this machine.
#
# Installs QEMU and takes the kernel from Debian's package linux-image-amd64, unpacked below the
# cache directory. Where that cannot be had, it says so and exits with 0.
set -eu
cd "$(dirname "$0")/.."

# The guest is killed after this many seconds.
time_limit=900
machine=$(uname -m)

run_as_root() {
    if [ "$(id -u)" -eq 0 ]; then
        "$@"
    elif command -v sudo >/dev/null 2>&1; then
        sudo "$@"
    else
        return 1
    fi
}

skip() {
    echo "test-usb-guest: SKIPPED, $1; what the emulated camera does on a real kernel was not tested" >&2
    exit 0
}

fail() {
    echo "test-usb-guest: $1" >&2
    exit 1
}

[ "$machine" = x86_64 ] || skip "the guest is made for x86_64, this machine is $machine"
command -v apt-get >/dev/null 2>&1 || skip "QEMU and the guest's kernel come from Debian packages, and there is no apt-get"

missing=""
command -v qemu-system-x86_64 >/dev/null 2>&1 || missing="$missing qemu-system-x86"
[ -x /bin/busybox ] || missing="$missing busybox-static"
command -v xz >/dev/null 2>&1 || missing="$missing xz-utils"
if [ -n "$missing" ]; then
    echo "test-usb-guest: installing$missing"
    run_as_root apt-get -o DPkg::Lock::Timeout=900 update -q || skip "the package lists cannot be updated"
    # shellcheck disable=SC2086 # one word a package
    run_as_root env DEBIAN_FRONTEND=noninteractive \
        apt-get -o DPkg::Lock::Timeout=900 install -q -y --no-install-recommends $missing ||
        skip "these packages cannot be installed:$missing"
fi

# Kernel and modules, once for each version. linux-image-cloud-amd64 has no USB.
package=$(apt-cache depends linux-image-amd64 2>/dev/null | sed -n 's/^ *Depends: \(linux-image-[0-9].*-amd64\)$/\1/p')
[ -n "$package" ] || skip "apt knows no package linux-image-amd64"
cache="${XDG_CACHE_HOME:-$HOME/.cache}/evcal/$package"
modules="usb-common usbcore usbip-core vhci-hcd"
if [ ! -e "$cache/complete" ]; then
    echo "test-usb-guest: unpacking $package into $cache"
    rm -rf "$cache"
    mkdir -p "$cache/package"
    (cd "$cache/package" && apt-get -q download "$package") || skip "$package cannot be downloaded"
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
    # QEMU starts an unpacked kernel in half the time. It follows its loader as an xz stream.
    image=$(find "$cache/boot" -name 'vmlinuz-*')
    offset=$(LC_ALL=C grep -abo -m 1 "$(printf '\3757zXZ')" "$image" | head -n 1 | cut -d : -f 1)
    if [ -n "$offset" ] && tail -c "+$((offset + 1))" "$image" | xz -dc --single-stream >"$cache/kernel" 2>/dev/null; then
        :
    elif [ ! -s "$cache/kernel" ]; then
        cp "$image" "$cache/kernel"
    fi
    : >"$cache/complete"
fi

# The test, the program it runs, and the libraries of both.
build() {
    cargo test --workspace --release --locked --test vhci_camera --no-run --message-format=json
}
test_program=$(build | sed -n 's/.*"executable":"\([^"]*vhci_camera-[^"]*\)".*/\1/p' | tail -n 1)
[ -n "$test_program" ] || fail "cargo did not say where the test program is"
recorder="$(dirname "$test_program")/../davis-record"
root=$(mktemp -d)
trap 'rm -rf "$root"' EXIT
mkdir -p "$root/bin" "$root/dev" "$root/proc" "$root/sys" "$root/tmp" "$root/modules"
cp /bin/busybox "$root/bin/"
for module in $modules; do
    cp "$cache/$module.ko" "$root/modules/"
done
strip -o "$root/bin/vhci_camera" "$test_program"
strip -o "$root/bin/davis-record" "$recorder"
{ ldd "$test_program"; ldd "$recorder"; } | grep -o '/[^ ]*' | sort -u | while read -r library; do
    mkdir -p "$root$(dirname "$library")"
    cp -L "$library" "$root$library"
done
cat >"$root/init" <<END
#!/bin/busybox sh
/bin/busybox --install -s /bin
export PATH=/bin DAVIS_RECORD=/bin/davis-record RUST_BACKTRACE=1
mount -t proc none /proc
mount -t sysfs none /sys
mount -t devtmpfs none /dev
for module in $modules; do insmod /modules/\$module.ko; done
vhci_camera --ignored --test-threads=1 --nocapture
echo "guest: exit status \$?"
poweroff -f
END
chmod 755 "$root/init" "$root/bin/"* && chmod 755 "$root" && chmod 1777 "$root/tmp"
(cd "$root" && find . -print | busybox cpio -o -H newc 2>/dev/null) >"$root.cpio"
trap 'rm -rf "$root" "$root.cpio" "$root.log"' EXIT

echo "test-usb-guest: starting $package in QEMU"
# /dev/kvm may exist and not work; the timers are those that hold on a busy host.
timeout "$time_limit" qemu-system-x86_64 -accel tcg -machine q35 -cpu max -smp 1 -m 512 -nodefaults -no-reboot \
    -display none -serial stdio -kernel "$cache/kernel" -initrd "$root.cpio" \
    -append "console=ttyS0 quiet panic=-1 no_timer_check clocksource=hpet" </dev/null 2>&1 | tee "$root.log" || true
grep -q '^guest: exit status 0' "$root.log" || fail "the tests failed in the guest, or it did not end in $time_limit s"
