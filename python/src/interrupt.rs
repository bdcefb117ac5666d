//! Long work without the interpreter's lock, which can be interrupted with Ctrl-C.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::thread;
use std::time::Duration;

use pyo3::prelude::*;

/// Interval at which signals are checked.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(100);

/// Runs `work` on its own thread and returns its result. When a signal arrives, the flag that `work` receives is set, and it should end.
///
/// # Errors
/// The exception of the signal, such as `KeyboardInterrupt`, after `work` has ended.
pub fn interruptible<T: Send>(py: Python<'_>, work: impl FnOnce(&AtomicBool) -> T + Send) -> PyResult<T> {
    let stop = AtomicBool::new(false);
    py.detach(|| {
        thread::scope(|scope| {
            let (sender, ended) = sync_channel(1);
            let stopped = &stop;
            let worker = scope.spawn(move || {
                let result = work(stopped);
                // After a signal, nobody receives the result.
                let _ = sender.send(());
                result
            });
            let mut signal = Ok(());
            while let Err(RecvTimeoutError::Timeout) = ended.recv_timeout(SIGNAL_INTERVAL) {
                if worker.is_finished() {
                    break;
                }
                if signal.is_ok() {
                    signal = Python::attach(|py| py.check_signals());
                    stop.store(signal.is_err(), Ordering::Relaxed);
                }
            }
            let result = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            signal.map(|()| result)
        })
    })
}
