//! Ctrl-C, a closed terminal, a file that grew too large and other signals: the first asks the program to come to a good end, the second ends it.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
use signal_hook::flag;

/// Exit code of a program that was interrupted, as shells have it.
const INTERRUPTED: i32 = 130;

/// The signals that end a program. One that whoever started it wants to be ignored, as `nohup` does with SIGHUP, stays so.
fn ending() -> Vec<i32> {
    let ignored = ignored();
    let optional = [SIGHUP, SIGXFSZ].into_iter().filter(|signal| ignored & (1 << (signal - 1)) == 0);
    [SIGINT, SIGTERM].into_iter().chain(optional).collect()
}

/// A bit for each signal that is ignored, from signal 1 on, where the system tells.
fn ignored() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let field = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    field.and_then(|field| u64::from_str_radix(field.trim(), 16).ok()).unwrap_or(0)
}

/// From now on a signal ends the program, and takes what is not whole with it.
#[cfg(unix)]
pub fn leave_nothing_unfinished() -> io::Result<()> {
    let mut signals = signal_hook::iterator::Signals::new(ending())?;
    std::thread::Builder::new().name("signals".to_owned()).spawn(move || {
        if let Some(signal) = signals.forever().next() {
            let _stopped = evcal_files::unfinished::remove_all();
            // The shell is to see that it was a signal.
            let _ = signal_hook::low_level::emulate_default_handler(signal);
            std::process::exit(INTERRUPTED);
        }
    })?;
    Ok(())
}

/// Whether the user wants the program to come to its end.
#[derive(Clone)]
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Takes the signals from now on.
    pub fn catch() -> io::Result<Self> {
        let asked = Arc::new(AtomicBool::new(false));
        for signal in ending() {
            // In this order: the first signal only sets the flag, which the second one finds set.
            flag::register_conditional_shutdown(signal, INTERRUPTED, Arc::clone(&asked))?;
            flag::register(signal, Arc::clone(&asked))?;
        }
        Ok(Self(asked))
    }

    /// Whether there was a signal.
    pub fn is_asked(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// From now on the first signal asks again for a good end.
    pub fn hold(&self) {
        self.0.store(false, Ordering::Relaxed);
    }

    /// From now on the first signal ends the program.
    pub fn release(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
}
