#!/bin/sh
# Checks the packages for crates.io: each contains its licences and its README, and no large or test files, and cargo would publish
# all of them together. With --build it also builds them from their content, which takes as long as evcal itself.
set -eu
cd "$(dirname "$0")/../.."
verify=--no-verify
[ "${1:-}" != --build ] || verify=

for folder in core firmware/link host/* usb-davis; do
    package=$(sed -n 's/^name = "\(.*\)"/\1/p' "$folder/Cargo.toml" | head -n 1)
    files=$(cargo package --list --allow-dirty --locked --offline -p "$package")
    for file in LICENSE-MIT LICENSE-APACHE README.md src/lib.rs; do
        echo "$files" | grep -qx "$file" || { echo "crates: $package has no $file" >&2; exit 1; }
    done
    if echo "$files" | grep -E '^(tests|benches|fixtures)/|\.(dvraw|aedat4)$' >&2; then
        echo "crates: $package contains files that only tests need" >&2
        exit 1
    fi
done
# shellcheck disable=SC2086 # none or one word
if cargo publish --help | grep -q -- --workspace; then
    cargo publish --workspace --dry-run --allow-dirty --locked $verify
else
    cargo package --workspace --exclude evcal-tests --allow-dirty --locked $verify
fi
