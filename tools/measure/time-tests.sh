#!/bin/sh
# What `make test` spends where: runs its steps one by one and prints a table of their times, and within the tests of the
# workspace one of each test program. For a machine that does nothing else meanwhile.
#
#   make test-times                   with what is built already
#   make test-times COLD=--cold       from nothing: in target/time-tests, which is emptied first
#
# Prints Markdown (the table in CONTRIBUTING.md); what the steps print is in target/time-tests.logs.
set -eu
cd "$(dirname "$0")/../.."
cold=
if [ "${1:-}" = --cold ]; then
    cold=yes
    shift
fi
[ $# -gt 0 ] || { echo "usage: make test-times [COLD=--cold]" >&2; exit 2; }

logs="${CARGO_TARGET_DIR:-target}/time-tests.logs"
rm -rf "$logs"
mkdir -p "$logs"
if [ -n "$cold" ]; then
    CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$PWD/target}/time-tests"
    export CARGO_TARGET_DIR
    rm -rf "$CARGO_TARGET_DIR"
fi

# as_time SECONDS: minutes and seconds.
as_time() { printf '%d:%02d' $(($1 / 60)) $(($1 % 60)); }

if [ -n "$cold" ]; then state="from nothing"; else state="with what was built before"; fi
echo "$(nproc) processors, $(cargo --version | cut -d ' ' -f 1,2), $state:"
echo
echo "| step | min:s |"
echo "|---|---|"
total=0
for step in "$@"; do
    start=$(date +%s)
    if ! make "$step" >"$logs/$step" 2>&1; then
        tail -n 20 "$logs/$step" >&2
        echo "time-tests: make $step failed, see $logs/$step" >&2
        exit 1
    fi
    spent=$(($(date +%s) - start))
    total=$((total + spent))
    echo "| \`make $step\` | $(as_time "$spent") |"
    # Steps that ran beside each other, which are part of this one.
    sed -n 's/^== make \(.*\) took \(.*\)$/| in it, `make \1` | \2 |/p' "$logs/$step"
done
echo "| all | $(as_time "$total") |"
# A step that was left out took no time.
grep -h 'SKIPPED' "$logs"/* || true

# Cargo says what it runs on standard error, libtest how long it took on standard output; both are in one log.
tests="$logs/test-workspace"
[ -f "$tests" ] || exit 0
echo
echo "| tests | number | s |"
echo "|---|---|---|"
awk '
    /^ *Running / {
        program = $NF
        gsub(/[()]/, "", program)
        sub(/.*\//, "", program)
        sub(/-[0-9a-f]*$/, "", program)
        source = ($2 == "unittests") ? program " (" $3 ")" : program
    }
    /^ *Doc-tests / { source = "examples in the documentation of " $2 }
    /^test result: / {
        seconds = $0
        sub(/.*finished in /, "", seconds)
        sub(/s.*/, "", seconds)
        printf "%s\t%s\t%s\n", seconds, $4, source
    }' "$tests" | sort -k 1 -n -r | head -n 25 | awk -F '\t' '{ printf "| %s | %s | %.1f |\n", $3, $2, $1 }'
sed -n 's/^ *Finished .* in \(.*\)$/\nCompiled before the first test in \1./p' "$tests" | head -n 2
