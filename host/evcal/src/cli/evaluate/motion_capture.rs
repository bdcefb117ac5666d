//! `evcal evaluate --motion-capture`.

use std::path::Path;

use evcal_calibrate::evaluate::captured::{CapturedFiles, compare_captured};
use evcal_calibrate::evaluate::pose_by_intrinsics::KnownCamera;
use evcal_calibrate::result::calibrated_camera::CalibratedCamera;
use evcal_files::visible;
use evcal_solve::motion_capture::held_out::{Errors, SLICE, SliceErrors};
use evcal_solve::motion_capture::{Compared, Measured, MeasuredPose};
use nalgebra::Vector3;
use serde_json::{Value, json};

use crate::cli::print;

/// Compares the trajectory with the capture, and prints the result.
pub fn run(files: &CapturedFiles, as_json: bool) -> crate::cli::Outcome {
    let (trajectory, compared) = compare_captured(files, known_camera(&files.calibration).as_ref())?;
    if as_json {
        let mut value = to_json(&compared);
        value["trajectory"] = json!(trajectory);
        value["motion_capture"] = json!(files.capture);
        return print::json(&value);
    }
    print::line(format!(
        "trajectory {}\nmotion capture {}\n",
        visible::path(trajectory),
        visible::path(&files.capture)
    ))?;
    print::line(text(&compared))
}

/// Reads the camera of a calibration; `None` if it is missing next to the trajectory, or has no σ.
fn known_camera(calibration: &Path) -> Option<KnownCamera> {
    let known = CalibratedCamera::read(calibration).ok()?;
    let covariance = known.covariance_matrix()?;
    Some(KnownCamera { camera: known.camera, sensor: known.sensor, covariance, board: known.board? })
}

fn text(compared: &Compared) -> String {
    let mut lines = vec![format!(
        "{} poses of the marker body, {:.1} per second, {:.1} % missing; {} of them during the camera's trajectory",
        compared.captured,
        compared.rate,
        100.0 * compared.missing,
        compared.used
    )];
    lines.push(
        "\nT_camera_body: from the body frame to the camera frame (x right, y down, z along the line of sight)"
            .to_owned(),
    );
    lines.extend(pose_lines(&compared.camera_body, "origin of the body in the camera frame"));
    lines.push("T_mocap_world: from the board frame to the capture frame".to_owned());
    lines.extend(pose_lines(&compared.mocap_world, "first circle of the board in the capture frame"));
    if !compared.intrinsics_known {
        lines.push("  note: these σ do not include the uncertainty of the intrinsics, because no calibration with σ is next to the trajectory".to_owned());
    }
    let Measured { value, sigma } = compared.offset;
    lines.push(format!(
        "capture timestamps are {:.3} ± {:.3} ms {} than event timestamps (t_mocap = t_events + {value:.6} s)",
        1e3 * value.abs(),
        1e3 * sigma,
        if value < 0.0 { "earlier" } else { "later" },
    ));
    if let Some(Measured { value, sigma }) = compared.drift {
        let word = if value < 0.0 { "slow" } else { "fast" };
        lines.push(format!(
            "  this offset applies at the middle of the recording; the capture's clock runs {:.1} ± {:.1} ppm {word}",
            1e6 * value.abs(),
            1e6 * sigma
        ));
    }
    let Measured { value, sigma } = compared.scale;
    lines.push(format!("lengths in the capture are {value:.5} ± {sigma:.5} times the nominal lengths of the board"));
    if compared.lengths_differ() {
        lines.push(
            "  note: this ratio is not 1: measure the spacing of the board, or calibrate the capture system".to_owned(),
        );
    }
    lines.push(format!(
        "\n{:<44} {:>8} {:>12} {:>12} {:>20}",
        "error of the trajectory, root mean square", "poses", "total", "noise", "without noise"
    ));
    let halves = [("fitted", &compared.errors.fitted), ("held out", &compared.errors.held_out)];
    for (name, errors) in halves {
        let name = format!("slices of {SLICE:.0} s that were {name}");
        lines.push(error_line(&format!("{name}: position mm"), &errors.position, 1e3));
        lines.push(error_line(
            &format!("{:width$}  orientation °", "", width = name.len()),
            &errors.rotation,
            1f64.to_degrees(),
        ));
    }
    lines.push("Quote the error of the held-out slices. \"noise\" is the noise of the capture system.".to_owned());
    lines.join("\n")
}

fn error_line(name: &str, errors: &Errors, factor: f64) -> String {
    format!(
        "{name:<44} {:>8} {:>12.4} {:>12.4} {:>11.4} ± {:.4}",
        errors.sizes.count,
        factor * errors.sizes.rmse,
        factor * errors.noise,
        factor * errors.error.value,
        factor * errors.error.sigma
    )
}

fn pose_lines(measured: &MeasuredPose, what: &str) -> [String; 2] {
    let numbers = |values: Vector3<f64>, sigmas: Vector3<f64>, factor: f64, digits: usize| {
        let pairs = values.iter().zip(sigmas.iter());
        let list = pairs.map(|(value, sigma)| format!("{:.digits$} ± {:.digits$}", factor * value, factor * sigma));
        list.collect::<Vec<_>>().join(", ")
    };
    let rotation = measured.pose.rotation.scaled_axis();
    [
        format!(
            "  translation mm ({what}): {}",
            numbers(measured.pose.translation.vector, measured.translation_sigma, 1e3, 3)
        ),
        format!("  rotation vector degrees: {}", numbers(rotation, measured.rotation_sigma, 1f64.to_degrees(), 4)),
    ]
}

fn to_json(compared: &Compared) -> Value {
    let measured = |measured: &Measured| json!({ "value": measured.value, "sigma": measured.sigma });
    let pose = |measured: &MeasuredPose| {
        let matrix = measured.pose.to_homogeneous();
        let rows: Vec<Vec<f64>> = matrix.row_iter().map(|row| row.iter().copied().collect()).collect();
        json!({
            "matrix": rows,
            "translation_sigma": measured.translation_sigma.as_slice(),
            "rotation_sigma": measured.rotation_sigma.as_slice(),
        })
    };
    let errors = |errors: &SliceErrors| {
        let of =
            |errors: &Errors| json!({ "sizes": errors.sizes, "noise": errors.noise, "error": measured(&errors.error) });
        json!({ "position": of(&errors.position), "rotation": of(&errors.rotation) })
    };
    json!({
        "captured": compared.captured,
        "used": compared.used,
        "rate": compared.rate,
        "missing": compared.missing,
        "correlation": compared.correlation,
        "T_camera_body": pose(&compared.camera_body),
        "T_mocap_world": pose(&compared.mocap_world),
        "sigma_with_intrinsics": compared.intrinsics_known,
        "offset": measured(&compared.offset),
        "drift": compared.drift.as_ref().map(measured),
        "scale": measured(&compared.scale),
        "scatter": { "position": compared.spread.position, "rotation": compared.spread.rotation },
        "fitted": errors(&compared.errors.fitted),
        "held_out": errors(&compared.errors.held_out),
    })
}
