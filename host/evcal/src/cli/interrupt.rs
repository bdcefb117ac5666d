//! Signals such as Ctrl-C, a closed terminal or a file that is too large: the first asks the program to finish, the second ends it.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
use signal_hook::iterator::Signals;

/// Exit code of an interrupted program, by the convention of shells.
const INTERRUPTED: i32 = 130;

/// Returns the signals that end the program, except signals that the parent process set to be ignored, as `nohup` does
/// with SIGHUP.
fn ending() -> Vec<i32> {
    let ignored = ignored();
    let optional = [SIGHUP, SIGXFSZ].into_iter().filter(|signal| ignored & (1 << (signal - 1)) == 0);
    [SIGINT, SIGTERM].into_iter().chain(optional).collect()
}

/// Returns a bit for each ignored signal, from signal 1 on; 0 if the system does not provide them.
fn ignored() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let field = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    field.and_then(|field| u64::from_str_radix(field.trim(), 16).ok()).unwrap_or(0)
}

/// Installs a handler that removes unfinished files and ends the program on a signal.
#[cfg(unix)]
pub fn leave_nothing_unfinished() -> io::Result<()> {
    on_each_signal(|signal| {
        let _stopped = evcal_files::unfinished::remove_all();
        // The default handler reports the signal to the shell.
        let _ = signal_hook::low_level::emulate_default_handler(signal);
        std::process::exit(INTERRUPTED);
    })
}

/// Calls `react` for each signal that ends the program, on a thread of its own.
fn on_each_signal(react: impl FnMut(i32) + Send + 'static) -> io::Result<()> {
    let mut signals = Signals::new(ending())?;
    std::thread::Builder::new().name("signals".to_owned()).spawn(move || signals.forever().for_each(react))?;
    Ok(())
}

/// The request of the user to finish.
#[derive(Clone)]
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Installs a handler for the signals: the first sets the flag; one that finds it set ends the program.
    pub fn catch() -> io::Result<Self> {
        let asked = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&asked);
        on_each_signal(move |_| {
            if flag.swap(true, Ordering::Relaxed) {
                let _stopped = evcal_files::unfinished::remove_all();
                signal_hook::low_level::exit(INTERRUPTED);
            }
        })?;
        Ok(Self(asked))
    }

    /// Returns whether there was a signal.
    pub fn is_asked(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Resets the request, so that the next signal asks the program to finish.
    pub fn hold(&self) {
        self.0.store(false, Ordering::Relaxed);
    }

    /// Lets the next signal end the program.
    pub fn release(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
}
