//! The summary of a calibration for a terminal.

use std::fmt::Write as _;

use evcal_core::camera::ModelKind;

use evcal_calibrate::result::calibration_file::{CalibrationFile, FramesResult};
use evcal_calibrate::result::second_camera_result::SecondCameraResult;
use event_recordings::pass::RecordingReport;

/// Returns the parameters of the lens, the verdict and the figures behind it.
pub fn summary(calibration: &CalibrationFile) -> String {
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
    let _ = writeln!(text, "{}", calibration.verdict);
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
            "\nsolved jointly with {} dots in {} frames; frame timestamps are {:.3} ± {:.3} ms earlier than event timestamps",
            joint.dots,
            joint.frames,
            1e3 * joint.time_offset,
            1e3 * joint.time_offset_sigma
        );
    }
    if let Some(inertial) = &calibration.inertial {
        let _ = write!(text, "\n{}", inertial.sentences());
    }
    let is_other = |second: &&SecondCameraResult| second.from_identity.is_none();
    for (number, second) in (1..).zip(calibration.second_cameras.iter().filter(is_other)) {
        let _ = write!(text, "\ncam{number} in exports: {}", second.sentences());
    }
    for own_frames in calibration.second_cameras.iter().filter(|second| !is_other(second)) {
        let _ = write!(text, "\n{}", own_frames.sentences());
    }
    text.extend(notes(&calibration.stages.recordings));
    text
}

/// Returns the notes on recordings; recordings with the same note share a line.
fn notes(recordings: &[RecordingReport]) -> Vec<String> {
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
        [first, .., last] => format!("\nnote on {} recordings, {first} to {last}: {note}", numbers.len()),
        [number] => format!("\nnote on recording {number}: {note}"),
        [] => String::new(),
    };
    noted.into_iter().map(line).collect()
}

/// Returns the names of a model's parameters in their order.
fn parameter_names(model: &str) -> &'static [&'static str] {
    ModelKind::from_name(model).map_or(&[], ModelKind::parameter_names)
}
