#!/bin/sh
# Compiles everything with the oldest Rust that Cargo.toml promises (rust-version), if rustup has it
# (`rustup toolchain install VERSION --profile minimal`). Otherwise only clippy detects newer features (incompatible_msrv, for the
# standard library; a part of `make check`), and this script prints a message.
set -eu
cd "$(dirname "$0")/../.."

version=$(sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml)
if cargo "+$version" --version >/dev/null 2>&1; then
    cargo "+$version" check --workspace --all-targets --locked --target-dir "${CARGO_TARGET_DIR:-target}/oldest-rust"
    echo "oldest-rust: everything compiles with Rust $version"
elif cargo --version | grep -q "^cargo $version\."; then
    echo "oldest-rust: this is Rust $version"
else
    echo "oldest-rust: SKIPPED, Rust $version is not installed; only clippy checked for newer features"
fi
