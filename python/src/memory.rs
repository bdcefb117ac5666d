//! Memory for events. Events that would not fit are refused, because the system ends Python if memory is exhausted.

use std::fs::read_to_string;

use pyo3::PyResult;
use pyo3::exceptions::PyMemoryError;

/// Checks that there is memory for `needed` bytes of events; succeeds if the system does not report its memory.
///
/// # Errors
/// `MemoryError` names the limit.
pub fn check(needed: u64) -> PyResult<()> {
    let smallest = limits().into_iter().filter_map(|(limit, left)| Some((left?, limit))).min();
    let Some((left, limit)) = smallest.filter(|(left, _)| *left < needed) else { return Ok(()) };
    let [needed, left] = [needed, left].map(|bytes| bytes as f64 / 1e9);
    Err(PyMemoryError::new_err(format!(
        "the events need {needed:.2} GB, and {limit} leaves {left:.2} GB: give calibrate, check, convert and the others the path of \
         the file, which they read part by part"
    )))
}

/// Returns the limits of memory, each with the bytes that it leaves, as Linux reports them.
fn limits() -> [(&'static str, Option<u64>); 3] {
    let number = |file, name: &str| {
        let text = read_to_string(file).ok()?;
        text.lines().find_map(|line| line.strip_prefix(name)?.split_whitespace().next()?.parse::<u64>().ok())
    };
    let left = |limit: Option<u64>, used: Option<u64>| Some(limit?.saturating_sub(used?));
    let kilobytes = |number: Option<u64>| Some(number? * 1024);
    let address_space = number("/proc/self/limits", "Max address space");
    let group = number("/sys/fs/cgroup/memory.max", "");
    [
        ("the computer", kilobytes(number("/proc/meminfo", "MemAvailable:"))),
        (
            "the limit of the address space (ulimit -v)",
            left(address_space, kilobytes(number("/proc/self/status", "VmSize:"))),
        ),
        ("the limit of the container (memory.max)", left(group, number("/sys/fs/cgroup/memory.stat", "anon "))),
    ]
}
