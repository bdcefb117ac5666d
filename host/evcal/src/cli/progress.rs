//! How far the work is: a bar on a terminal, a line for each stage in a pipe.

use std::fmt;
use std::io::IsTerminal;
use std::path::Path;
use std::time::Duration;

use evcal_files::visible;
use indicatif::{ProgressBar, ProgressState, ProgressStyle};

/// Where it is not known how much is to be done.
const WITHOUT_END: &str = "{spinner} {elapsed:>4} {wide_msg}";
/// Where it is.
const WITH_END: &str = "{spinner} {elapsed:>4} {bar:24} {percent:>3} %{left} {wide_msg}";
/// Length of the bar in steps.
const LENGTH: u64 = 1000;
/// Time left is told after so much of the work, and so long.
const FIRST_SHARE: f64 = 0.02;
const FIRST_SECOND: f64 = 1.0;

/// A spinner with a message on standard error; invisible when that is no terminal.
pub fn spinner(silent: bool) -> ProgressBar {
    if silent || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new_spinner();
    bar.set_style(style(WITHOUT_END));
    bar.enable_steady_tick(Duration::from_millis(120));
    bar
}

fn style(template: &str) -> ProgressStyle {
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    style.with_key("left", |state: &ProgressState, text: &mut dyn fmt::Write| {
        let left = time_left(state.elapsed().as_secs_f64(), f64::from(state.fraction()));
        let _ = left.map_or(Ok(()), |left| write!(text, ", {left} left,"));
    })
}

/// How long the rest takes if it goes on as it went for `elapsed` seconds, in which the part `done` was done.
fn time_left(elapsed: f64, done: f64) -> Option<String> {
    if done < FIRST_SHARE || elapsed < FIRST_SECOND {
        return None;
    }
    let seconds = (elapsed * (1.0 - done) / done).ceil() as u64;
    Some(match seconds {
        0..100 => format!("{seconds} s"),
        100..6000 => format!("{} min", seconds.div_ceil(60)),
        _ => format!("{} h", seconds.div_ceil(3600)),
    })
}

/// The file without the folders that it is in: a line has no room for more.
pub fn short_name(path: &Path) -> String {
    visible::path(path.file_name().unwrap_or(path.as_os_str()))
}

/// What is going on, for who waits.
pub struct Waiting {
    bar: ProgressBar,
    /// Whether a line is printed for each stage.
    lines: bool,
    stage: String,
    has_end: bool,
    /// Who else is told.
    listener: Option<Listener>,
}

/// Is told what is done, and which part of it is done.
pub type Listener = Box<dyn FnMut(&str, Option<f64>) + Send>;

impl Waiting {
    /// Tells nothing if `silent`.
    pub fn new(silent: bool) -> Self {
        let lines = !silent && !std::io::stderr().is_terminal();
        Self { bar: spinner(silent), lines, stage: String::new(), has_end: false, listener: None }
    }

    /// Tells `listener`, too.
    pub fn and(self, listener: Option<Listener>) -> Self {
        Self { listener, ..self }
    }

    /// Tells what is done now, and which part of it is done, 0 to 1, if that is known.
    pub fn stage(&mut self, text: &str, done: Option<f64>) {
        self.part(text, text, done);
    }

    /// As [`Self::stage`], with more words where someone looks at it.
    pub fn part(&mut self, stage: &str, text: &str, done: Option<f64>) {
        if self.stage != stage {
            stage.clone_into(&mut self.stage);
            self.bar.reset();
            if self.lines {
                super::print::aside(format_args!("{stage} ..."));
            }
        }
        if self.has_end != done.is_some() {
            self.has_end = done.is_some();
            self.bar.set_style(style(if self.has_end { WITH_END } else { WITHOUT_END }));
        }
        if let Some(done) = done {
            self.bar.set_length(LENGTH);
            self.bar.set_position((done.clamp(0.0, 1.0) * LENGTH as f64) as u64);
        }
        self.bar.set_message(visible::name(text).into_owned());
        if let Some(listener) = &mut self.listener {
            listener(stage, done);
        }
    }

    /// The work is over.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_left_is_told_when_something_is_known_of_it() {
        assert_eq!(time_left(0.5, 0.5), None);
        assert_eq!(time_left(10.0, 0.001), None);
        assert_eq!(time_left(10.0, 0.25).as_deref(), Some("30 s"));
        assert_eq!(time_left(10.0, 1.0).as_deref(), Some("0 s"));
        assert_eq!(time_left(60.0, 0.1).as_deref(), Some("9 min"));
        assert_eq!(time_left(3600.0, 0.1).as_deref(), Some("9 h"));
    }
}
