//! The hints that are printed once per second.

use std::io::IsTerminal;

use evcal_files::visible;
use evcal_live::checkpoint::Checkpoint;
use evcal_live::health::Health;
use evcal_live::recorder::RecordingStatus;
use evcal_live::wanted::words;
use evcal_live::{DISTANCES, Seen, Tilt};
use indicatif::ProgressBar;
use serde_json::{Map, Value, json};

use super::super::{Outcome, print, progress, record};

/// Number of times that a line is repeated. A recording with wrong times may last for years.
const MOST_REPETITIONS: u32 = 20;

/// Prints hints: as JSON, on a changing line of a terminal, or otherwise line by line.
pub struct Lines {
    json: bool,
    /// `true` if hints are mirrored.
    mirrored: bool,
    is_terminal: bool,
    bar: ProgressBar,
    /// The last line without its time, and the number of lines after it that are the same.
    last: (String, u32),
    /// The first failure to print, as text because hints come from other threads.
    printed: Outcome,
}

impl Lines {
    /// Creates a printer of JSON objects or of text, with hints `mirrored` or not.
    pub fn new(json: bool, mirrored: bool) -> Self {
        Self {
            json,
            mirrored,
            is_terminal: std::io::stderr().is_terminal(),
            bar: progress::spinner(json),
            last: (String::new(), 0),
            printed: Ok(()),
        }
    }

    /// Prints the hint, the observations, and the state of the recording if there is one.
    pub fn print_hint(&mut self, seen: &Seen, status: Option<&RecordingStatus>) {
        if self.json {
            let object = as_json(seen, status, self.mirrored);
            self.print(|| print::json(&object));
            return;
        }
        let text = as_text(seen, status, self.mirrored);
        if !self.is_terminal && self.is_news(&text) {
            self.print(|| print::line(&text));
        }
        self.bar.set_message(visible::name(&text).into_owned());
    }

    /// Returns `false` if a line repeats the lines before it, except for its time, and they were [`MOST_REPETITIONS`].
    fn is_news(&mut self, text: &str) -> bool {
        let content = text.split_once(" s: ").map_or(text, |(_, content)| content);
        let (last, repetitions) = &mut self.last;
        if last != content {
            (*last, *repetitions) = (content.to_owned(), 0);
            return true;
        }
        *repetitions = repetitions.saturating_add(1);
        *repetitions <= MOST_REPETITIONS
    }

    fn print(&mut self, print: impl FnOnce() -> Outcome) {
        if self.printed.is_ok() {
            self.printed = print();
        }
    }

    /// Ends the output; fails if a line could not be printed.
    pub fn finish(self) -> Outcome {
        self.bar.finish_and_clear();
        self.printed
    }
}

/// Returns one line with the hint, the observations of the board, and the state of the recording.
fn as_text(seen: &Seen, status: Option<&RecordingStatus>, mirrored: bool) -> String {
    let coverage = &seen.coverage;
    let tilts: Vec<String> = Tilt::ALL
        .iter()
        .zip(coverage.tilts)
        .map(|(tilt, count)| format!("{} {count}", tilt.seen(mirrored).name()))
        .collect();
    let nothing = seen.explanation.as_ref().map_or_else(String::new, |found| format!(" ({})", found.obstacle));
    let health = health_as_text(&seen.health);
    let seconds = status.map_or(seen.t, |status| status.seconds);
    let error = error_as_text(seen);
    let missing = words(&seen.missing(), mirrored);
    let wanted = if missing.is_empty() { String::new() } else { format!("; still missing: {}", missing.join(", ")) };
    let recording = status.map_or_else(String::new, |status| {
        format!("; {}; {} transfers not displayed", record::as_text(status), seen.left_out)
    });
    format!(
        "{seconds:.0} s: {}{nothing}; {:.0} % done; {} windows with the board, {:.0} % of the sensor, tilts {}{error}{wanted}{health}{recording}",
        seen.hint.words(mirrored),
        100.0 * seen.progress(),
        coverage.boards,
        100.0 * coverage.covered,
        tilts.join(" "),
    )
}

/// Returns the known state of the camera: rates, noise, flicker, focus.
fn health_as_text(health: &Health) -> String {
    let mut parts = Vec::new();
    if let Some(rates) = health.rates {
        let load =
            rates.load.map_or_else(String::new, |load| format!(" (peak {:.0} % of the readout's limit)", 100.0 * load));
        parts.push(format!("{:.2} Mev/s{load}, {:.0} % ON", 1e-6 * rates.mean, 100.0 * rates.on_share));
    }
    if let Some(noise) = health.noise {
        parts.push(format!("noise {noise:.1} Hz per pixel"));
    }
    if let Some(count) = health.hot_pixels {
        parts.push(format!("{count} hot pixels"));
    }
    if let Some(Some(flicker)) = health.flicker {
        parts.push(format!("light flickers at {} Hz", flicker.frequency));
    }
    if let Some(focus) = health.focus {
        parts.push(format!("edges {:.1} px wide ({:.1} at best in 5 s)", focus.width, focus.sharpest));
    }
    if parts.is_empty() { String::new() } else { format!("; {}", parts.join(", ")) }
}

fn health_as_json(health: &Health) -> Value {
    json!({
        "rate": health.rates.map(|rates| rates.mean),
        "peak_rate": health.rates.map(|rates| rates.peak),
        "load": health.rates.and_then(|rates| rates.load),
        "on_share": health.rates.map(|rates| rates.on_share),
        "noise": health.noise,
        "hot_pixels": health.hot_pixels,
        "flicker": health.flicker.flatten(),
        "edge_width": health.focus.map(|focus| focus.width),
        "sharpest_edge_width": health.focus.map(|focus| focus.sharpest),
    })
}

/// Returns the uncertainty of the camera: from the last checkpoint, with an estimate of its present value, or from the quick estimate.
fn error_as_text(seen: &Seen) -> String {
    let mut text = match (&seen.checkpoint, seen.about, seen.sigma) {
        (Some(Checkpoint { t, accuracy: Ok(accuracy) }), about, _) => {
            let about = about.map_or_else(String::new, |about| format!(", now about ±{about:.3}"));
            format!(", ±{:.3} px after {t:.0} s{about}", accuracy.rms)
        }
        (_, _, Some(sigma)) => format!(", ±{sigma:.3} px (quick estimate)"),
        _ => String::new(),
    };
    if let Some(t) = seen.calibrating_until {
        text += &format!(", calibrating the first {t:.0} s");
    }
    text
}

/// Returns the content of the line of [`as_text`] as a JSON object.
fn as_json(seen: &Seen, status: Option<&RecordingStatus>, mirrored: bool) -> Value {
    let coverage = &seen.coverage;
    let named = |names: &[&str], counts: &[u64]| {
        Value::Object(names.iter().zip(counts).map(|(name, count)| ((*name).to_owned(), (*count).into())).collect())
    };
    let corners = |points: &[nalgebra::Vector2<f64>]| points.iter().map(|point| [point.x, point.y]).collect::<Vec<_>>();
    let mut object = Map::new();
    let mut put = |name: &str, value: Value| {
        object.insert(name.to_owned(), value);
    };
    put("t", json!(seen.t));
    put("hint", json!(seen.hint.words(mirrored)));
    put("progress", json!(seen.progress()));
    put("missing", json!(words(&seen.missing(), mirrored)));
    put("boards", json!(coverage.boards));
    put("covered", json!(coverage.covered));
    put("tilts", named(&Tilt::ALL.map(Tilt::name), &coverage.tilts));
    put("distances", named(&DISTANCES, &coverage.distances));
    put("sigma", json!(seen.sigma));
    put("about", json!(seen.about));
    put("sigma_in_cells", json!(seen.sigma_in_cells));
    put("checkpoint", json!(seen.checkpoint.as_ref().map(checkpoint_as_json)));
    put("checkpoint_under_way", json!(seen.calibrating_until));
    put("target", json!(seen.target));
    put("nothing_found", json!(seen.explanation.as_ref().map(|found| found.obstacle.to_string())));
    put("health", health_as_json(&seen.health));
    put("camera", json!(seen.camera));
    put("board", json!(seen.board.as_ref().map(|board| corners(&board.corners))));
    put("ghost", json!(seen.ghost.as_ref().map(|ghost| corners(&ghost.corners))));
    if let Some(status) = status {
        put("recording", json!(status));
        put("transfers_not_displayed", json!(seen.left_out));
    }
    Value::Object(object)
}

fn checkpoint_as_json(checkpoint: &Checkpoint) -> Value {
    match &checkpoint.accuracy {
        Ok(accuracy) => json!({
            "t": checkpoint.t,
            "stated": accuracy.rms,
            "largest": accuracy.max,
            "halves_agree": accuracy.halves_agree,
        }),
        Err(reason) => json!({ "t": checkpoint.t, "failed": reason }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A recording whose times were wrong printed 100,000 times that there are hardly any events.
    #[test]
    fn a_line_without_news_is_repeated_a_few_times() {
        let mut lines = Lines::new(false, false);
        let mut count = |content: &str| {
            let times = 0..1000;
            times.filter(|t| lines.is_news(&format!("{} s: {content}", t * 86_400))).count()
        };
        let most = MOST_REPETITIONS as usize + 1;
        assert_eq!(["no events", "the board", "no events"].map(&mut count), [most; 3]);
    }
}
