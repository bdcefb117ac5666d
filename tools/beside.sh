#!/bin/sh
# Runs steps of the Makefile in two rows beside each other: much of each uses one processor only. What the second row prints follows
# when both are done. Fails when a step fails; the steps after it in its row are left out.
#
#   sh tools/beside.sh "STEP STEP..." "STEP STEP..."
set -eu
cd "$(dirname "$0")/.."
[ $# -eq 2 ] || { echo 'usage: sh tools/beside.sh "STEP STEP..." "STEP STEP..."' >&2; exit 2; }

# row STEP...
row() {
    for step in "$@"; do
        start=$(date +%s)
        make "$step" || { echo "beside: make $step failed" >&2; return 1; }
        spent=$(($(date +%s) - start))
        printf '== make %s took %d:%02d\n' "$step" $((spent / 60)) $((spent % 60))
    done
}

log=$(mktemp)
trap 'rm -f "$log"' EXIT
# shellcheck disable=SC2086 # one word a step
row $2 >"$log" 2>&1 &
second=$!
failed=0
# shellcheck disable=SC2086
row $1 || failed=1
wait "$second" || failed=1
cat "$log"
exit "$failed"
