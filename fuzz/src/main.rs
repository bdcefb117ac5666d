//! Fuzzes the target in the variable `EVCAL_FUZZ_TARGET` with libFuzzer; see `tools/fuzz.sh`.
#![no_main]

mod targets;

use std::sync::LazyLock;

use libfuzzer_sys::{Corpus, fuzz_target};
use targets::{TARGETS, Target};

static TARGET: LazyLock<&Target> = LazyLock::new(|| {
    let wanted = std::env::var("EVCAL_FUZZ_TARGET").unwrap_or_default();
    let names: Vec<&str> = TARGETS.iter().map(|target| target.name).collect();
    let found = TARGETS.iter().find(|target| target.name == wanted);
    found.unwrap_or_else(|| panic!("set EVCAL_FUZZ_TARGET to one of {}", names.join(", ")))
});

fuzz_target!(|bytes: &[u8]| -> Corpus { if TARGET.run(bytes) { Corpus::Keep } else { Corpus::Reject } });
