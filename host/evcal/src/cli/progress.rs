//! Progress: a bar on a terminal, otherwise one line per stage.

use std::fmt;
use std::io::IsTerminal;
use std::path::Path;
use std::time::Duration;

use evcal_files::visible;
use indicatif::{ProgressBar, ProgressState, ProgressStyle};

/// Style without a known total.
const WITHOUT_END: &str = "{spinner} {elapsed:>4} {wide_msg}";
/// Style with a known total.
const WITH_END: &str = "{spinner} {elapsed:>4} {bar:24} {percent:>3} %{left} {wide_msg}";
/// Style of a bar for many stages.
const OF_STAGES: &str = "{spinner} {elapsed:>4} {bar:24} {wide_msg}";
/// Share of the rest of the bar that each of an unknown number of stages takes: the bar grows with each stage and never ends early.
const SHARE_OF_STAGE: f64 = 0.25;
/// Length of the bar in steps.
const LENGTH: u64 = 1000;
/// Share of the work, and time in seconds, before the remaining time is shown.
const FIRST_SHARE: f64 = 0.02;
const FIRST_SECOND: f64 = 1.0;

/// Creates a spinner with a message on standard error; invisible if that is not a terminal.
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

/// Estimates the remaining time from the share `done` of the work after `elapsed` seconds.
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

/// Returns the name of a file without its folders, for lines with little room.
pub fn short_name(path: &Path) -> String {
    visible::path(path.file_name().unwrap_or(path.as_os_str()))
}

/// The progress of a command.
pub struct Waiting {
    bar: ProgressBar,
    /// `true` if each stage is printed as a line.
    lines: bool,
    stage: String,
    /// Style of the bar.
    style: &'static str,
    /// If the command has many stages, the share of the bar before the current one.
    before: Option<f64>,
    /// Another receiver of the progress.
    listener: Option<Listener>,
}

/// Callback that receives the current stage and the share of it that is done (0 to 1, if known).
pub type Listener = Box<dyn FnMut(&str, Option<f64>) + Send>;

impl Waiting {
    /// Creates the progress of a command with one stage; if `silent`, nothing is shown.
    pub fn new(silent: bool) -> Self {
        let lines = !silent && !std::io::stderr().is_terminal();
        Self { bar: spinner(silent), lines, stage: String::new(), style: WITHOUT_END, before: None, listener: None }
    }

    /// Creates the progress of a calibration: one bar for all of its stages, which only grows.
    pub fn of_stages(silent: bool) -> Self {
        Self { before: Some(0.0), ..Self::new(silent) }
    }

    /// Also reports the progress to `listener`.
    pub fn and(self, listener: Option<Listener>) -> Self {
        Self { listener, ..self }
    }

    /// Shows the current stage, and the share that is done, 0 to 1, if it is known.
    pub fn stage(&mut self, text: &str, done: Option<f64>) {
        self.part(text, text, done);
    }

    /// Shows the current stage as [`Self::stage`] does, with the longer `text` on a terminal.
    pub fn part(&mut self, stage: &str, text: &str, done: Option<f64>) {
        if self.stage != stage {
            match &mut self.before {
                Some(before) if !self.stage.is_empty() => *before += (1.0 - *before) * SHARE_OF_STAGE,
                Some(_) => {}
                None => self.bar.reset(),
            }
            stage.clone_into(&mut self.stage);
            if self.lines {
                super::print::aside(format_args!("{stage} ..."));
            }
        }
        let done = match self.before {
            Some(before) => Some(before + (1.0 - before) * SHARE_OF_STAGE * done.unwrap_or(0.0).clamp(0.0, 1.0)),
            None => done,
        };
        let wanted = match (self.before, done) {
            (Some(_), _) => OF_STAGES,
            (None, Some(_)) => WITH_END,
            (None, None) => WITHOUT_END,
        };
        if self.style != wanted {
            self.style = wanted;
            self.bar.set_style(style(wanted));
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

    /// Removes the bar.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bar_of_many_stages_only_grows() {
        let (sender, seen) = std::sync::mpsc::channel();
        let mut waiting = Waiting::of_stages(true).and(Some(Box::new(move |_, done| {
            let _ = sender.send(done);
        })));
        for (stage, done) in
            [("search", None), ("search", Some(0.7)), ("solve", None), ("solve", Some(0.9)), ("end", Some(1.0))]
        {
            waiting.stage(stage, done);
        }
        drop(waiting);
        let seen: Vec<f64> = seen.iter().flatten().collect();
        assert_eq!(seen.len(), 5);
        assert!(seen.is_sorted() && seen[0] == 0.0 && seen[4] < 1.0, "{seen:?}");
    }

    #[test]
    fn remaining_time_is_shown_after_some_progress() {
        assert_eq!(time_left(0.5, 0.5), None);
        assert_eq!(time_left(10.0, 0.001), None);
        assert_eq!(time_left(10.0, 0.25).as_deref(), Some("30 s"));
        assert_eq!(time_left(10.0, 1.0).as_deref(), Some("0 s"));
        assert_eq!(time_left(60.0, 0.1).as_deref(), Some("9 min"));
        assert_eq!(time_left(3600.0, 0.1).as_deref(), Some("9 h"));
    }
}
