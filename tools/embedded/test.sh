#!/bin/sh
# Tests that the core and the firmware run on microcontrollers: they compile without std and alloc, link
# without a reachable panic, and run in QEMU with the same result as on this machine, within their budgets of
# RAM, flash and instructions. Installs missing packages of Debian.
#
#   tools/embedded/test.sh           on a Cortex-M4F
#   tools/embedded/test.sh --all     also on a Cortex-M7 and on RISC-V
#   tools/embedded/test.sh --record  writes the measured figures to firmware/budgets.txt, with which later runs are compared
set -eu
cd "$(dirname "$0")/../.."
script=test-embedded
. tools/setup/packages.sh
machines=cortex-m4f
[ "${1:-}" != --all ] || machines="cortex-m4f cortex-m7 rv32imafc"
out=${CARGO_TARGET_DIR:-$PWD/target}/embedded
mkdir -p "$out"
arm=thumbv7em-none-eabihf
riscv=riscv32imafc-unknown-none-elf

step() { echo "== $*"; }
fail() { echo "test-embedded: $*" >&2; exit 1; }

need_program() {
    command -v "$1" >/dev/null 2>&1 && return 0
    is_debian || fail "$1 is missing, and this is not Debian or a relative: install it yourself"
    install_packages "$2"
}

step "tools"
need_program size binutils
need_program qemu-system-arm qemu-system-arm
[ "$machines" = cortex-m4f ] || need_program qemu-system-riscv32 qemu-system-misc

tools/embedded/core-only.sh "$out/core-only"

targets=$arm
[ "$machines" = cortex-m4f ] || targets="$arm $riscv"
step "programs for $targets and this machine"
# shellcheck disable=SC2086 # one word a target
settings=$(tools/embedded/target.sh $targets)
eval "$settings"
(
    cd firmware
    cargo build -q --release --locked --target-dir "$out/firmware" -p on-host
    for target in $targets; do
        cargo build -q --release --locked --target-dir "$out/firmware" -p qemu --target "$target"
    done
    [ "$machines" = cortex-m4f ] || RUSTFLAGS="-C target-cpu=cortex-m7" \
        cargo build -q --release --locked --target-dir "$out/firmware-m7" -p qemu --target "$arm"
)
# programs MACHINE: prints the folder with the machine's programs.
programs() {
    case $1 in
        host) echo "$out/firmware/release" ;;
        cortex-m4f) echo "$out/firmware/$arm/release" ;;
        cortex-m7) echo "$out/firmware-m7/$arm/release" ;;
        rv32imafc) echo "$out/firmware/$riscv/release" ;;
    esac
}

tools/embedded/no-panic.sh "$out/firmware" "$arm"

# run MACHINE PROGRAM ARGUMENT...: runs a program in QEMU, where an instruction takes 64 ns (Arm) or 1 ns.
run() {
    machine=$1
    program=$2
    shift 2
    arguments=arg=$program
    for argument in "$@"; do arguments="$arguments,arg=$argument"; done
    case $machine in
        cortex-m4f) set -- qemu-system-arm -M mps2-an386 -icount shift=6 ;;
        cortex-m7) set -- qemu-system-arm -M mps2-an500 -icount shift=6 ;;
        rv32imafc) set -- qemu-system-riscv32 -M virt -bios none -icount shift=0 ;;
    esac
    timeout 600 "$@" -nographic -monitor none -serial none \
        -semihosting-config "enable=on,target=native,$arguments" -kernel "$(programs "$machine")/$program"
}

step "the same recording on each of: $machines"
recording=firmware/testdata/board.evt2
"$(programs host)/detector-on-host" "$recording" "$out/host.stream" evt2 > "$out/host.txt"
for machine in $machines; do
    run "$machine" detector "$recording" "$out/$machine.stream" evt2 > "$out/$machine.txt" ||
        fail "the detector fails on $machine: $(cat "$out/$machine.txt")"
    cmp "$out/host.stream" "$out/$machine.stream" || fail "the circles of $machine differ from the circles of this machine"
    run "$machine" window "$recording" > "$out/$machine-window.txt" ||
        fail "the window benchmark fails on $machine: $(cat "$out/$machine-window.txt")"
    run "$machine" spline > "$out/$machine-spline.txt" || fail "splines fail on $machine"
    echo "$machine: $(wc -c < "$out/host.stream") bytes of circles, identical"
done
sent=$(sed -n 's/^windows_sent=//p' "$out/cortex-m4f.txt")
[ "$sent" -ge 5 ] || fail "only $sent windows of the recording were sent"

step "figures"
# figure FILE NAME: prints one number of a program's output.
figure() { sed -n "s/^$2=//p" "$out/$1.txt"; }
# sections MACHINE NAME...: prints the total size of these sections of the detector in bytes.
sections() {
    machine=$1
    shift
    size -A "$(programs "$machine")/detector" |
        awk -v wanted=" $* " '{ name = $1; if (index(wanted, " " name " ")) sum += $2 } END { print sum + 0 }'
}
ram=$(($(sections cortex-m4f .data .bss .uninit) + $(figure cortex-m4f stack_bytes)))
flash=$(sections cortex-m4f .vector_table .text .rodata .data)
else_per_event=$(($(figure cortex-m4f instructions_else) / $(figure cortex-m4f events)))
{
    echo "ram_bytes $ram 131072"
    echo "stack_bytes $(figure cortex-m4f stack_bytes) 16384"
    echo "flash_bytes $flash 65536"
    echo "window_instructions_per_event $(figure cortex-m4f-window instructions_per_event) 400"
    echo "other_instructions_per_event $else_per_event 400"
    echo "spline_instructions $(figure cortex-m4f-spline instructions_per_evaluation) 700"
} > "$out/figures.txt"
if [ "${1:-}" = --record ]; then
    {
        echo "# Figures of the detector on a Cortex-M4F, by tools/embedded/test.sh --record: name, recorded value, limit."
        echo "# The test fails above the limit, or more than 3 % above the recorded value."
        cat "$out/figures.txt"
    } > firmware/budgets.txt
fi
printf '%-30s %10s %10s %10s\n' "Cortex-M4F" measured recorded limit
exceeded=""
while read -r name value limit; do
    recorded=$(sed -n "s/^$name \([0-9]*\) .*/\1/p" firmware/budgets.txt)
    [ -n "$recorded" ] || fail "firmware/budgets.txt has no $name: run tools/embedded/test.sh --record"
    printf '%-30s %10s %10s %10s\n' "$name" "$value" "$recorded" "$limit"
    if [ "$value" -gt "$limit" ] || [ $((value * 100)) -gt $((recorded * 103)) ]; then
        exceeded="$exceeded $name"
    fi
done < "$out/figures.txt"
for machine in $machines; do
    echo "$machine: $(figure "$machine-window" instructions_per_event) instructions per event of a 4000-event window," \
        "$(figure "$machine-spline" instructions_per_evaluation) per spline evaluation"
done
[ -z "$exceeded" ] || fail "over budget:$exceeded"

tools/embedded/board-examples.sh "$out/firmware"
echo "test-embedded: all passed"
