//! `evcal evaluate`.

use std::error::Error;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use evcal::evaluate::intrinsics::{IntrinsicsComparison, compare_intrinsics};
use evcal::evaluate::trajectory_error::{AbsoluteTrajectoryError, Association, best_time_shift, trajectory_error};
use evcal::lens::projection_difference::{ProjectionDifference, projection_difference};
use evcal::result::calibrated_camera::CalibratedCamera;
use evcal::trajectory::timed_pose::TimedPose;
use evcal::trajectory::tum;
use nalgebra::Vector3;
use serde_json::{Value, json};

use super::{UsageError, print, value};

/// The camera of a directory: the first of these files that it holds.
const CAMERA_FILES: [&str; 2] = ["calibration.json", "truth.json"];
const TRAJECTORY_FILE: &str = "trajectory.txt";

/// Arguments of `evcal evaluate`.
#[derive(clap::Args)]
pub struct Arguments {
    /// The calibration: calibration.json, truth.json or a directory that holds one of them
    #[arg(value_name = "CALIBRATION")]
    calibration: PathBuf,
    /// What to compare it with: the truth or another calibration, file or directory
    #[arg(long, value_name = "FILE|DIR")]
    truth: PathBuf,
    /// Estimated trajectory (TUM) [default: trajectory.txt beside the calibration, if it is there]
    #[arg(long, value_name = "FILE")]
    trajectory: Option<PathBuf>,
    /// True trajectory (TUM) [default: trajectory.txt beside the truth, if it is there]
    #[arg(long, value_name = "FILE")]
    true_trajectory: Option<PathBuf>,
    /// Largest constant difference of the clocks that is looked for
    #[arg(long, value_name = "TIME", default_value = "20ms", value_parser = value::seconds)]
    time_shift: f64,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
    /// Print all figures of the trajectory errors and, as JSON, the difference at every point
    #[arg(short, long)]
    verbose: bool,
}

/// The figures of a trajectory.
struct TrajectoryFigures {
    estimate: PathBuf,
    truth: PathBuf,
    /// With the times as they are.
    direct: AbsoluteTrajectoryError,
    /// With the times of the estimate shifted to fit best; `None` where too little is left.
    shifted: Option<AbsoluteTrajectoryError>,
}

/// Runs `evcal evaluate`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let calibration_file = camera_path(&arguments.calibration);
    let truth_file = camera_path(&arguments.truth);
    let CalibratedCamera { camera: calibration, sensor, .. } = CalibratedCamera::read(&calibration_file)?;
    let CalibratedCamera { camera: truth, sensor: true_sensor, .. } = CalibratedCamera::read(&truth_file)?;
    if sensor != true_sensor {
        return Err(format!(
            "{} is for a sensor of {}x{} pixels, {} for one of {}x{}: they cannot be compared",
            calibration_file.display(),
            sensor.width,
            sensor.height,
            truth_file.display(),
            true_sensor.width,
            true_sensor.height
        )
        .into());
    }
    let intrinsics = compare_intrinsics(&truth, &calibration);
    let projection = projection_difference(&truth, &calibration, sensor)?;
    let trajectory = match trajectories(arguments, &calibration_file, &truth_file)? {
        Some((estimate, truth)) => Some(compare_trajectories(estimate, truth, arguments.time_shift)?),
        None => None,
    };
    if arguments.json {
        return print::json(&json!({
            "calibration": calibration_file,
            "truth": truth_file,
            "intrinsics": intrinsics_json(&intrinsics),
            "projection_difference": projection_json(&projection, arguments.verbose),
            "trajectory": trajectory.as_ref().map(trajectory_json),
        }));
    }
    print::line(format!("first {}\nsecond {}\n{intrinsics}\n", truth_file.display(), calibration_file.display()))?;
    print::line(&projection)?;
    match trajectory {
        Some(figures) => print_trajectory(&figures, arguments.verbose),
        None => print::line("\nno trajectories to compare: trajectory.txt is not beside both files"),
    }
}

/// The file itself, or the camera file of a directory.
fn camera_path(path: &Path) -> PathBuf {
    if !path.is_dir() {
        return path.to_owned();
    }
    let candidates = CAMERA_FILES.map(|name| path.join(name));
    let found = candidates.iter().find(|candidate| candidate.exists()).or(candidates.first());
    found.cloned().unwrap_or_else(|| path.to_owned())
}

/// The estimated and the true trajectory file; `None` when none was asked for and not both are there.
fn trajectories(
    arguments: &Arguments,
    calibration: &Path,
    truth: &Path,
) -> Result<Option<(PathBuf, PathBuf)>, UsageError> {
    let beside = |file: &Path| Some(file.with_file_name(TRAJECTORY_FILE)).filter(|path| path.exists());
    let estimate = arguments.trajectory.clone().or_else(|| beside(calibration));
    let real = arguments.true_trajectory.clone().or_else(|| beside(truth));
    let missing = |option: &str, file: &Path| {
        UsageError(format!("there is no {TRAJECTORY_FILE} beside {}: give {option} too", file.display()))
    };
    match (estimate, real) {
        (Some(estimate), Some(real)) => Ok(Some((estimate, real))),
        (Some(_), None) if arguments.trajectory.is_some() => Err(missing("--true-trajectory", truth)),
        (None, Some(_)) if arguments.true_trajectory.is_some() => Err(missing("--trajectory", calibration)),
        _ => Ok(None),
    }
}

fn read_trajectory(path: &Path) -> Result<Vec<TimedPose>, Box<dyn Error>> {
    let file = File::open(path).map_err(|error| format!("{}: {error}", path.display()))?;
    Ok(tum::read(BufReader::new(file)).map_err(|error| format!("{}: {error}", path.display()))?)
}

fn compare_trajectories(estimate: PathBuf, truth: PathBuf, range: f64) -> Result<TrajectoryFigures, Box<dyn Error>> {
    let (estimated, real) = (read_trajectory(&estimate)?, read_trajectory(&truth)?);
    let error = |shift| trajectory_error(&real, &estimated, Association::Interpolated, shift);
    let direct = error(0.0).map_err(|few| format!("{} and {}: {few}", estimate.display(), truth.display()))?;
    let shifted = best_time_shift(&real, &estimated, range).and_then(|shift| error(shift).ok());
    Ok(TrajectoryFigures { estimate, truth, direct, shifted })
}

fn print_trajectory(figures: &TrajectoryFigures, verbose: bool) -> super::Outcome {
    let TrajectoryFigures { estimate, truth, direct, shifted } = figures;
    print::line(format!("\ntrajectory {} against {}", estimate.display(), truth.display()))?;
    if verbose {
        print::line(direct)?;
        return shifted.as_ref().map_or(Ok(()), print::line);
    }
    print::line(format!("{:24} {:>12} {:>12} {:>16}", "rms", "aligned mm", "as is mm", "orientation deg"))?;
    let row = |name: String, error: &AbsoluteTrajectoryError| {
        print::line(format!(
            "{name:24} {:12.4} {:12.4} {:16.4}",
            1e3 * error.aligned.rmse,
            1e3 * error.direct.rmse,
            error.direct_rotation.rmse.to_degrees()
        ))
    };
    row(format!("{} poses, own clock", direct.direct.count), direct)?;
    match shifted {
        Some(error) => row(format!("times {:+.1} us", 1e6 * error.time_shift), error),
        None => print::line("no time shift was looked for: fewer than 3 poses are far enough from both ends"),
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

fn trajectory_json(figures: &TrajectoryFigures) -> Value {
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
        "own_clock": error(&figures.direct),
        "best_time_shift": figures.shifted.as_ref().map(error),
    })
}
