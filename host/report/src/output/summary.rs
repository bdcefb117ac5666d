//! The summary of a calibration for a terminal.

use std::fmt::Write as _;
use std::ops::RangeInclusive;

use evcal_core::camera::ModelKind;

use evcal_calibrate::quality::verdict::Severity;
use evcal_calibrate::result::calibration_file::{CalibrationFile, FramesResult};
use evcal_calibrate::result::second_camera_result::SecondCameraResult;
use evcal_geometry::numerics::statistics::decimals;
use event_recordings::pass::RecordingReport;

/// A calibration in words, for a terminal.
pub struct Summary {
    /// Everything but the result: all parameters, the figures behind the verdict, notes.
    pub details: String,
    /// The focal lengths and the principal point in one line, the sentences on the IMU and on further cameras, and notes on the recordings.
    pub result: String,
    /// The warnings, and then the verdict in one sentence.
    pub verdict: String,
    /// Number of notes in `details`.
    pub notes: usize,
}

impl Summary {
    /// Builds the summary. The board was `distances` (m) away from the camera, if that is known; `more` has notes on written files.
    pub fn new(calibration: &CalibrationFile, distances: Option<RangeInclusive<f64>>, more: Vec<String>) -> Self {
        let verdict = &calibration.verdict;
        let (notes, grave): (Vec<_>, Vec<_>) =
            verdict.findings.iter().partition(|finding| finding.severity == Severity::Note);
        let of_verdict = notes.iter().map(ToString::to_string);
        let notes: Vec<String> = of_verdict.chain(more).collect();
        let mut lines: Vec<String> = grave.iter().map(|finding| format!("  {finding}")).collect();
        lines.push(verdict.sentence.clone());
        Self {
            details: [details(calibration, distances.as_ref()), notes.join("\n")].join("\n").trim_end().to_owned(),
            result: result(calibration, distances.as_ref()),
            verdict: lines.join("\n"),
            notes: notes.len(),
        }
    }
}

/// Returns the camera in one line, and what was calibrated with it.
fn result(calibration: &CalibrationFile, distances: Option<&RangeInclusive<f64>>) -> String {
    let (camera, sensor) = (&calibration.camera, calibration.sensor);
    let of = |name: &&str| {
        let (value, sigma) = (camera.parameters.get(name)?, calibration.sigma.parameters.get(name)?);
        let decimals = decimals(sigma);
        Some(format!("{name} {value:.decimals$} ± {sigma:.decimals$}"))
    };
    let shown: Vec<String> = parameter_names(&camera.model).iter().take(4).filter_map(of).collect();
    let mut text = format!("camera {}, {} x {}: {} px", camera.model, sensor.width, sensor.height, shown.join(", "));
    if let Some(distances) = distances {
        let _ = write!(text, "; board {:.2} to {:.2} m away", distances.start(), distances.end());
    }
    if let Some(inertial) = &calibration.inertial {
        let _ = write!(text, "\n{}", inertial.description());
    }
    let is_other = |second: &&SecondCameraResult| second.from_identity.is_none();
    for (number, second) in (1..).zip(calibration.second_cameras.iter().filter(is_other)) {
        let _ = write!(text, "\ncam{number} in exports: {}", second.description());
    }
    for own_frames in calibration.second_cameras.iter().filter(|second| !is_other(second)) {
        let _ = write!(text, "\n{}", own_frames.description());
    }
    let notes = notes_on(&calibration.stages.recordings);
    [vec![text.trim_end().to_owned()], notes].concat().join("\n")
}

/// Returns the parameters of the lens and the figures behind the verdict.
fn details(calibration: &CalibrationFile, distances: Option<&RangeInclusive<f64>>) -> String {
    let mut text = String::new();
    let sensor = calibration.sensor;
    if !calibration.second_cameras.is_empty() {
        text += "first camera (cam0 in exports): ";
    }
    let _ = writeln!(
        text,
        "camera {} on {} x {} pixels (± is one standard deviation)",
        calibration.camera.model, sensor.width, sensor.height
    );
    for (index, name) in parameter_names(&calibration.camera.model).iter().enumerate() {
        // The first four are focal lengths and principal point; the others have no unit.
        let unit = if index < 4 { " px" } else { "" };
        let value = calibration.camera.parameters.get(name).unwrap_or(f64::NAN);
        let sigma = calibration.sigma.parameters.get(name).unwrap_or(f64::NAN);
        let _ = writeln!(text, "  {name:<3} {value:>12.5} ± {sigma:.5}{unit}");
    }
    if let Some(choice) = &calibration.stages.model_choice {
        let _ = writeln!(text, "{}", choice.reason());
    }
    if let Some(halves) = &calibration.split_half {
        let _ = writeln!(
            text,
            "two halves of the recording, calibrated separately, differ by {:.4} px (expected: {:.4} px, at most {:.4} px in 95 of 100 cases); \
             residual {:.4} px with the camera of the same half, {:.4} px with the other camera",
            halves.difference_rms, halves.expected_rms, halves.bound, halves.held_out.own_rms, halves.held_out.rms
        );
    }
    let residuals = calibration.residuals;
    let _ = write!(
        text,
        "residual ({}): median {:.3} px, rms {:.3} px, {} observations",
        residuals.measure, residuals.median, residuals.rms, residuals.count
    );
    if !calibration.segments.is_empty() {
        let plural = if calibration.segments.len() == 1 { "" } else { "s" };
        let _ = write!(text, " in {} segment{plural}", calibration.segments.len());
    }
    if let Some(choice) = &calibration.chosen_seconds {
        let _ = write!(text, "\n{choice}");
    }
    match &calibration.frames {
        Some(FramesResult::CrossCheck(cross_check)) => {
            let _ = write!(text, "\nframes: {}", cross_check.sentence);
        }
        Some(FramesResult::Failed(failure)) => {
            let _ = write!(text, "\nthe camera's frames could not be calibrated for comparison: {}", failure.reason);
        }
        Some(FramesResult::Only(frames)) => {
            let _ = write!(
                text,
                "\nfrom {} of {} {}",
                frames.report.used, frames.report.detection.frames, frames.report.source
            );
        }
        None => {}
    }
    if let Some(joint) = &calibration.joint_frames {
        let _ = write!(
            text,
            "\nsolved jointly with {} points in {} frames; frame timestamps are {:.3} ± {:.3} ms earlier than event timestamps",
            joint.dots,
            joint.frames,
            1e3 * joint.time_offset,
            1e3 * joint.time_offset_sigma
        );
    }
    if let Some(distances) = distances {
        // A user notices a wrong unit of the board here.
        let _ = write!(
            text,
            "\nboard: {:.2} to {:.2} m away from the camera. If this is wrong, the lengths in the description of the board are wrong by \
             the same factor, which no other figure reveals",
            distances.start(),
            distances.end()
        );
    }
    text
}

/// Returns the notes on recordings; recordings with the same note share a line.
fn notes_on(recordings: &[RecordingReport]) -> Vec<String> {
    let mut noted: Vec<(&str, Vec<usize>)> = Vec::new();
    for (number, recording) in (1..).zip(recordings) {
        for note in &recording.notes {
            match noted.iter_mut().find(|(known, _)| *known == note.as_str()) {
                Some((_, numbers)) => numbers.push(number),
                None => noted.push((note, vec![number])),
            }
        }
    }
    let line = |(note, numbers): (&str, Vec<usize>)| match numbers[..] {
        [first, .., last] => format!("note on {} recordings, {first} to {last}: {note}", numbers.len()),
        [number] => format!("note on recording {number}: {note}"),
        [] => String::new(),
    };
    noted.into_iter().map(line).collect()
}

/// Returns the names of a model's parameters in their order.
fn parameter_names(model: &str) -> &'static [&'static str] {
    ModelKind::from_name(model).map_or(&[], ModelKind::parameter_names)
}
