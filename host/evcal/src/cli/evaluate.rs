//! `evcal evaluate`.

use std::path::PathBuf;

use evcal_calibrate::evaluate::captured::CapturedFiles;
use evcal_calibrate::evaluate::comparison::{
    CompareError, ComparedFiles, ComparedTrajectories, Comparison, TRAJECTORY_FILE, TrajectoryComparison, compare,
};
use evcal_calibrate::evaluate::intrinsics::IntrinsicsComparison;
use evcal_calibrate::evaluate::printed_board::{BoardComparison, BoardPair};
use evcal_calibrate::evaluate::trajectory_error::AbsoluteTrajectoryError;
use evcal_files::remedy::{Remedy as _, Words};
use evcal_files::visible;
use evcal_geometry::lens::projection_difference::ProjectionDifference;
use nalgebra::Vector3;
use serde_json::{Value, json};

use super::{UsageError, print, value};

mod motion_capture;

/// Arguments of `evcal evaluate`.
#[derive(clap::Args)]
pub struct Arguments {
    /// The calibration: calibration.json, truth.json or a folder with one of them
    #[arg(value_name = "CALIBRATION")]
    calibration: PathBuf,
    /// The truth or another calibration to compare with, file or folder
    #[arg(long, value_name = "FILE|DIR", required_unless_present = "motion_capture")]
    truth: Option<PathBuf>,
    /// Motion capture of a marker body on the camera; estimates the pose of the body and the error of the camera's trajectory
    /// (TUM, EuRoC, CSV of OptiTrack Motive)
    #[arg(long, value_name = "FILE", conflicts_with_all = ["truth", "true_trajectory"])]
    motion_capture: Option<PathBuf>,
    /// Name of the marker body on the camera, if the capture contains several
    #[arg(long, value_name = "NAME", requires = "motion_capture", conflicts_with = "truth")]
    body: Option<String>,
    /// Estimated trajectory (TUM) [default: trajectory.txt next to the calibration, if it exists]
    #[arg(long, value_name = "FILE")]
    trajectory: Option<PathBuf>,
    /// True trajectory (TUM) [default: trajectory.txt next to the truth, if it exists]
    #[arg(long, value_name = "FILE")]
    true_trajectory: Option<PathBuf>,
    /// Largest constant clock offset to search for
    #[arg(long, value_name = "TIME", default_value = "20ms", value_parser = value::seconds)]
    time_shift: f64,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
    /// Print all figures of the trajectory errors and, with --json, the difference at every point
    #[arg(short, long)]
    verbose: bool,
}

/// Runs `evcal evaluate`.
pub fn run(arguments: Arguments) -> super::Outcome {
    let Arguments { json, verbose, .. } = arguments;
    let truth = match (arguments.motion_capture, arguments.truth) {
        (Some(capture), _) => {
            let Arguments { calibration, trajectory, body, .. } = arguments;
            return motion_capture::run(&CapturedFiles { calibration, trajectory, capture, body }, json);
        }
        (None, Some(truth)) => truth,
        (None, None) => return Err(UsageError("give --truth or --motion-capture".to_owned()).into()),
    };
    let files = ComparedFiles {
        calibration: arguments.calibration,
        truth,
        trajectory: arguments.trajectory,
        true_trajectory: arguments.true_trajectory,
        time_shift: arguments.time_shift,
    };
    let comparison = match compare(&files) {
        Err(error @ CompareError::NoTrajectory { .. }) => return Err(UsageError(error.advised(&Words::PROGRAM)).into()),
        comparison => comparison?,
    };
    let Comparison { calibration, truth, intrinsics, projection, board, trajectory } = &comparison;
    if json {
        return print::json(&json!({
            "calibration": calibration,
            "truth": truth,
            "intrinsics": intrinsics_json(intrinsics),
            "projection_difference": projection_json(projection, verbose),
            "board": board.as_ref().map(board_json),
            "trajectory": match trajectory {
                ComparedTrajectories::Compared(figures) => Some(trajectory_json(figures)),
                _ => None,
            },
        }));
    }
    print::line(format!("first {}\nsecond {}\n{intrinsics}\n", visible::path(truth), visible::path(calibration)))?;
    print::line(projection)?;
    if let Some(board) = board {
        print::line(format!("\n{board}"))?;
    }
    match trajectory {
        ComparedTrajectories::Compared(figures) => print_trajectory(figures, verbose),
        ComparedTrajectories::OtherTimes { estimate, truth } => print::line(format!(
            "\nthe trajectories {} and {} have no times in common, so they are of different recordings and were not compared",
            visible::path(estimate),
            visible::path(truth)
        )),
        ComparedTrajectories::WithoutPoses(file) => print::line(format!(
            "\nthe trajectories were not compared: {} is empty because all poses are too uncertain; trajectory.csv in the same folder contains them",
            visible::path(file)
        )),
        _ => print::line(format!("\nno trajectories to compare: {TRAJECTORY_FILE} is not next to both files")),
    }
}

fn print_trajectory(figures: &TrajectoryComparison, verbose: bool) -> super::Outcome {
    let TrajectoryComparison { estimate, truth, direct, shifted } = figures;
    if !figures.is_related() {
        print::line(format!(
            "\nthe trajectories {} and {} are not of the same recording: they differ by {:.0} mm while the camera moves by {:.0} mm. \
             Compare with the trajectory of the same recording: --true-trajectory FILE",
            visible::path(estimate),
            visible::path(truth),
            1e3 * direct.aligned.rmse,
            1e3 * direct.extent
        ))?;
        if !verbose {
            return Ok(());
        }
    }
    print::line(format!("\ntrajectory {} compared with {}", visible::path(estimate), visible::path(truth)))?;
    if verbose {
        print::line(direct)?;
        return shifted.as_ref().map_or(Ok(()), print::line);
    }
    print::line(format!("{:28} {:>12} {:>12} {:>16}", "rms error", "aligned mm", "unaligned mm", "orientation deg"))?;
    let row = |name: String, error: &AbsoluteTrajectoryError| {
        print::line(format!(
            "{name:28} {:12.4} {:12.4} {:16.4}",
            1e3 * error.aligned.rmse,
            1e3 * error.direct.rmse,
            error.direct_rotation.rmse.to_degrees()
        ))
    };
    row(format!("{} poses, no time shift", direct.direct.count), direct)?;
    match shifted {
        Some(error) => row(format!("times shifted by {:+.1} us", 1e6 * error.time_shift), error),
        None => print::line("no time shift was estimated: fewer than 3 poses are far enough from both ends"),
    }
}

fn intrinsics_json(intrinsics: &IntrinsicsComparison) -> Value {
    let parameters = intrinsics.parameters.iter().map(|pair| {
        let pair_json = json!({ "truth": pair.first, "calibration": pair.second, "difference": pair.difference() });
        (pair.name.to_owned(), pair_json)
    });
    json!({
        "true_model": intrinsics.first_model,
        "model": intrinsics.second_model,
        "parameters": parameters.collect::<serde_json::Map<_, _>>(),
    })
}

fn board_json(board: &BoardComparison) -> Value {
    let parameters = board.parameters.iter().map(|pair| {
        let BoardPair { name, truth, calibration, sigma } = pair;
        let difference = calibration - truth;
        let pair_json = json!({ "truth": truth, "calibration": calibration, "difference": difference, "sigma": sigma });
        ((*name).to_owned(), pair_json)
    });
    Value::Object(parameters.collect())
}

fn projection_json(projection: &ProjectionDifference, verbose: bool) -> Value {
    json!({
        "rms_px": projection.rms,
        "max_px": projection.max,
        "max_at_px": projection.max_at,
        "implied_rotation_deg": Vector3::from(projection.rotation).norm().to_degrees(),
        "points": projection.grid.len(),
        "points_outside_a_model": projection.uncovered,
        "grid": verbose.then_some(&projection.grid),
    })
}

fn trajectory_json(figures: &TrajectoryComparison) -> Value {
    let error = |error: &AbsoluteTrajectoryError| {
        json!({
            "time_shift_s": error.time_shift,
            "poses_without_truth": error.unmatched,
            "aligned_m": error.aligned,
            "as_is_m": error.direct,
            "orientation_rad": error.direct_rotation,
        })
    };
    json!({
        "estimate": figures.estimate,
        "truth": figures.truth,
        "same_recording": figures.is_related(),
        "own_clock": error(&figures.direct),
        "best_time_shift": figures.shifted.as_ref().map(error),
    })
}
