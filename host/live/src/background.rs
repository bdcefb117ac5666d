//! Worker threads with low priority.

use std::io;

use rayon::{ThreadPool, ThreadPoolBuilder};

/// Niceness of the threads: next to other programs they get a tenth of the processor time, and still finish on a busy
/// computer.
#[cfg(target_os = "linux")]
const NICE: i32 = 10;

/// Creates worker threads with low priority.
///
/// # Errors
/// If the system cannot create threads.
pub fn workers(name: &'static str) -> io::Result<ThreadPool> {
    ThreadPoolBuilder::new()
        .thread_name(move |_| name.to_owned())
        .start_handler(|_| give_way())
        .build()
        .map_err(io::Error::other)
}

/// Lowers the priority of this thread. If that is not possible, the thread keeps its priority.
pub fn give_way() {
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(NICE);
}
