#!/bin/sh
# Fuzzes everything that reads untrusted input (fuzz/src/targets.rs) with libFuzzer, on stable Rust; needs a C++ compiler.
#
#   SECONDS_EACH=60 sh tools/fuzz.sh [TARGET...]    each target for this time; all of them without arguments
# Findings are below target/fuzz/findings; new inputs that reach new code are collected below target/fuzz/corpus.
set -eu
cd "$(dirname "$0")/.."

seconds="${SECONDS_EACH:-60}"
target_folder="${CARGO_TARGET_DIR:-target}/fuzz"
host="$(rustc -vV | sed -n 's/^host: //p')"
# The flags of cargo-fuzz except the address sanitizer, which needs nightly Rust: all code is safe.
flags="--cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4"
flags="$flags -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table"
flags="$flags -Cllvm-args=-sanitizer-coverage-trace-compares -Ccodegen-units=1"
# With --target, so that build scripts are not instrumented.
RUSTFLAGS="$flags" cargo build --quiet --release --manifest-path fuzz/Cargo.toml --target "$host" --target-dir "$target_folder"

[ $# -gt 0 ] || set -- $(ls fuzz/corpus)
mkdir -p "$target_folder/findings"
found=0
for target in "$@"; do
    mkdir -p "$target_folder/corpus/$target"
    log="$target_folder/$target.log"
    echo "fuzz: $target, $seconds s"
    EVCAL_FUZZ_TARGET="$target" "$target_folder/$host/release/evcal-fuzz" \
        -max_total_time="$seconds" -timeout=10 -rss_limit_mb=1024 -max_len=65536 -print_final_stats=1 \
        -artifact_prefix="$target_folder/findings/$target-" \
        "$target_folder/corpus/$target" "fuzz/corpus/$target" >"$log" 2>&1 || {
        found=1
        grep -E "panicked|ERROR|Test unit written" "$log" >&2 || true
    }
    grep -E "^#.*DONE|stat::peak_rss|stat::number_of_executed" "$log" || true
done
exit $found
