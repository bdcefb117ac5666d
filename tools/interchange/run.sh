#!/bin/sh
# Compares which recordings other programs and evcal exchange with the table in docs/formats.md. Installs the programs in
# an environment of their own below the target folder; without pip's resolver, because not all of them agree on versions.
set -eu
cd "$(dirname "$0")/../.."

target="${CARGO_TARGET_DIR:-target}"
environment="$target/interchange"
requirements=tools/interchange/requirements.txt
if ! cmp -s "$requirements" "$environment/installed.txt"; then
    rm -rf "$environment"
    python3 -m venv "$environment"
    "$environment/bin/pip" install --quiet --disable-pip-version-check --only-binary=:all: --no-deps --requirement "$requirements"
    cp "$requirements" "$environment/installed.txt"
fi
"$environment/bin/python" tools/interchange/table.py "$target/release/evcal" docs/formats.md
