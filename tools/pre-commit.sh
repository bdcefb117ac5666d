#!/bin/sh
# Checks that take seconds: white space, formatting, the syntax of scripts, and the lints of the crates that a commit changes (some
# 20 s once they have been compiled). `make test` checks the rest.
#
#   ln -s ../../tools/pre-commit.sh "$(git rev-parse --git-path hooks)/pre-commit"     runs it at each commit
#   git commit --no-verify                                                             commits without it
set -eu
cd "$(git rev-parse --show-toplevel)"

fail() { echo "pre-commit: $*" >&2; exit 1; }
changed() { git diff --cached --name-only --diff-filter=d -- "$@"; }

git diff --cached --check -- . ':!fixtures' || fail "white space or marks of a conflict, see above"
cargo fmt --all --check >/dev/null || fail "not formatted: run cargo fmt --all and add what changes"
changed '*.sh' .ci/run | while read -r script; do
    sh -n "$script" || fail "$script is no shell script"
done
crates=""
for folder in core firmware/link host/* tests usb-davis; do
    [ -z "$(changed "$folder/**.rs" "$folder/Cargo.toml")" ] ||
        crates="$crates -p $(sed -n 's/^name = "\(.*\)"/\1/p' "$folder/Cargo.toml" | head -n 1)"
done
if [ -n "$(changed Cargo.toml clippy.toml)" ]; then
    crates=" --workspace"
fi
if [ -n "$crates" ]; then
    # shellcheck disable=SC2086 # one word a crate
    cargo clippy -q$crates --lib --bins -- -D warnings || fail "lints, see above"
fi
