#!/bin/sh
# Licences, sources and known vulnerabilities of all dependencies, as deny.toml allows them. Needs cargo-deny
# (`cargo install cargo-deny --locked`); prints a message if it is not installed. Vulnerabilities are looked up in the database
# that `cargo deny fetch` keeps on this machine; nothing is downloaded here.
set -eu
cd "$(dirname "$0")/../.."

if ! cargo deny --version >/dev/null 2>&1; then
    echo "dependencies: SKIPPED, cargo-deny is not installed; licences and sources of dependencies were not checked"
    exit 0
fi
cargo deny --offline check --hide-inclusion-graph licenses bans sources
if cargo metadata --offline --locked --format-version 1 --manifest-path firmware/Cargo.toml >/dev/null 2>&1; then
    cargo deny --offline --manifest-path firmware/Cargo.toml check --hide-inclusion-graph licenses bans sources
else
    echo "dependencies: SKIPPED for the firmware, whose dependencies are not downloaded; make test-embedded downloads them"
fi
if cargo metadata --offline --locked --format-version 1 --manifest-path python/Cargo.toml >/dev/null 2>&1; then
    cargo deny --offline --manifest-path python/Cargo.toml check --hide-inclusion-graph licenses bans sources
else
    echo "dependencies: SKIPPED for the Python package, whose dependencies are not downloaded; make test-python downloads them"
fi
if ls "${CARGO_HOME:-$HOME/.cargo}"/advisory-db*/*/ >/dev/null 2>&1; then
    cargo deny --offline check advisories
else
    echo "dependencies: known vulnerabilities were not checked because there is no database; cargo deny fetch downloads it"
fi
