//! Workers that give way to everything else on the computer.

use std::io;

use rayon::{ThreadPool, ThreadPoolBuilder};

/// Niceness of their threads: beside others they get a tenth of the time, and still come to an end on a busy computer.
#[cfg(target_os = "linux")]
const NICE: i32 = 10;

/// Workers that give way.
///
/// # Errors
/// When the system gives no threads.
pub fn workers(name: &'static str) -> io::Result<ThreadPool> {
    ThreadPoolBuilder::new()
        .thread_name(move |_| name.to_owned())
        .start_handler(|_| give_way())
        .build()
        .map_err(io::Error::other)
}

/// From now on others go before this thread. Where that is not possible it runs as they do.
pub fn give_way() {
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(NICE);
}
