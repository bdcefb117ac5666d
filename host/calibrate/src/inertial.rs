//! Calibration of an IMU that is fixed to the camera: position, rotation, time delays, and sensor errors.
//!
//! After the calibration of the camera, its trajectories determine the readings of an IMU that is fixed to it ([`parameters`]).
//! Samples are read and checked ([`stream`], [`csv`]), a `start` is computed, and [`solve`] fits trajectories, camera and IMU to
//! events and samples at once. [`findings()`] checks the result.

pub mod calibration;
pub mod csv;
pub mod error;
pub mod findings;
pub mod joint;
pub mod noise;
pub mod parameters;
pub mod prediction;
mod priors;
pub mod sample;
mod sample_rows;
pub mod settings;
pub mod solve;
mod start;
pub mod stream;
pub mod timing;
mod uncertainty;
pub mod units;

use nalgebra::{DMatrix, Vector3};

use calibration::InertialCalibration;
use error::InertialError;
use findings::findings;
use joint::{Estimate, Joint};
use parameters::{COUNT, ROTATION};
use sample::Sample;
use settings::InertialSettings;
use solve::Solved;
use stream::StreamReport;
use uncertainty::InertialUncertainty;

use crate::quality::uncertainty::Uncertainty;
use evcal_solve::solve::Problem;
use evcal_solve::solve::equations::system::Reduced;
use evcal_solve::solve::fixed_intrinsics::{self, FixedIntrinsics, share_of_fixed};
use evcal_solve::solve::left_out::covers;
use evcal_solve::solve::refinement::Refined;
use evcal_solve::trajectory::Trajectory;
use evcal_solve::trajectory::mean_distance;
use event_recordings::Files;

/// Fewest seconds of samples along trajectories.
pub const FEWEST_SECONDS: f64 = 3.0;

/// Largest σ of the rotation (rad) with which the IMU counts as determined.
const LEAST_KNOWN_ROTATION: f64 = 0.35;

/// Fewest samples per second: with fewer, a hand rotates too much between two samples.
const FEWEST_A_SECOND: f64 = 30.0;

/// Smallest knot spacing (s).
const NEAREST_KNOTS: f64 = 0.01;
/// Largest knot spacing (s).
const FARTHEST_KNOTS: f64 = 0.0225;
/// Number of samples per knot.
const SAMPLES_A_KNOT: f64 = 2.5;

/// The samples of one recording.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedSamples {
    /// Number of the recording.
    pub recording: usize,
    /// The samples, on the clock of the recording's file (s).
    pub samples: Vec<Sample>,
    /// Time of the first event in the file (s).
    pub start: f64,
    /// Parts of the recording that could not be read, as sentences.
    pub lost: Vec<String>,
}

/// Calibrates the IMU that recorded `recorded` during the observations of `refined`; `camera` is the uncertainty of the camera.
/// The intrinsics are estimated too, unless they are fixed (`fixed`).
///
/// # Errors
/// [`InertialError`] names the problem with the samples or the motion, and the remedy.
pub fn calibrate_unit(
    recorded: Vec<RecordedSamples>,
    refined: &Refined,
    camera: &Uncertainty,
    fixed: Option<&FixedIntrinsics>,
    settings: &InertialSettings,
) -> Result<InertialCalibration, InertialError> {
    let recordings = recorded.iter().map(|one| one.recording + 1).max().unwrap_or(0);
    let (mut samples, mut starts) = (vec![Vec::new(); recordings], vec![0.0; recordings]);
    let (mut streams, mut lost, mut clock_origin) = (Vec::new(), Vec::new(), 0.0);
    for one in recorded {
        lost.extend(one.lost);
        let (kept, report) = stream::check(one.samples)?;
        streams.push(report);
        let of_recording = refined.state.trajectories.iter().filter(|trajectory| trajectory.recording == one.recording);
        let (kept, moved) = on_events_clock(kept, one.start, of_recording);
        clock_origin += moved;
        if let Some(place) = samples.get_mut(one.recording) {
            *place = kept;
        }
        if let Some(start) = starts.get_mut(one.recording) {
            *start = one.start;
        }
    }
    let rate = streams.iter().map(|stream| stream.rate).fold(0.0, f64::max);
    // The median interval of timestamps in whole microseconds differs slightly from the interval of the rate.
    if rate.round() < FEWEST_A_SECOND {
        return Err(InertialError::TooSlow { rate, needed: FEWEST_A_SECOND });
    }
    let knot_spacing = settings.knot_spacing.unwrap_or((SAMPLES_A_KNOT / rate).clamp(NEAREST_KNOTS, FARTHEST_KNOTS));
    let trajectories = solve::smooth_trajectories(&refined.state.trajectories, knot_spacing)?;
    let longest = |recording: &usize| {
        let of_recording = trajectories.iter().filter(|one| one.recording == *recording);
        (1e3 * of_recording.map(|one| one.end() - one.start()).sum::<f64>()) as u64
    };
    let with_samples = (0..recordings).filter(|recording| samples.get(*recording).is_some_and(|one| !one.is_empty()));
    let first = with_samples.max_by_key(longest).unwrap_or(0);
    let seen: Vec<&Trajectory> = trajectories.iter().filter(|one| one.recording == first).collect();
    let seconds: f64 = seen.iter().map(|one| one.end() - one.start()).sum();
    if seconds < FEWEST_SECONDS {
        return Err(InertialError::TooShort { seconds, needed: FEWEST_SECONDS });
    }
    let start = start::start(&seen, samples.get(first).map(Vec::as_slice).unwrap_or_default(), settings.gravity)?;

    // Where no curve explains the events, the trajectory is not known.
    for (recording, samples) in samples.iter_mut().enumerate() {
        let delay = start.parameters.gyroscope_delay;
        samples.retain(|sample| !covers(&refined.left_out, recording, sample.t - delay));
    }
    let used = solve::samples_within(&trajectories, &samples, &start.parameters);
    let seconds = used.iter().map(ExactSizeIterator::len).sum::<usize>() as f64 / rate;
    if seconds < FEWEST_SECONDS {
        return Err(InertialError::TooShort { seconds, needed: FEWEST_SECONDS });
    }
    let with_fixed = fixed.map(|_| fixed_intrinsics::with_fixed(&refined.problem));
    let joint = Joint {
        problem: with_fixed.as_ref().unwrap_or(&refined.problem),
        inflation: camera.inflation,
        samples: &samples,
        used,
        rate,
        knot_spacing,
        settings,
    };
    let mut state = refined.state.clone();
    state.trajectories = trajectories;
    state.camera = fixed.map_or(state.camera, |fixed| fixed.camera);
    let estimate = Estimate { state, parameters: start.parameters, noise: solve::first_noise() };
    let solved = solve::solve(&joint, estimate)?;
    let delays_at = solved.estimate.parameters.middle + starts.get(first).unwrap_or(&0.0) + clock_origin;
    let separate = SeparateCalibration { refined, camera, fixed };
    let clock = Clock { correlation: start.correlation, streams, clock_origin, delays_at };
    let calibration = finish(&joint, solved, separate, clock)?;
    findings::explained(&calibration, joint.samples)?;
    // With a larger σ the equations are no longer linear, and all results are invalid.
    if !(ROTATION..ROTATION + 3).all(|axis| calibration.sigma(axis) < LEAST_KNOWN_ROTATION) {
        return Err(InertialError::Singular);
    }
    let damaged = lost.iter().map(|what| findings::damaged(what));
    Ok(InertialCalibration { findings: findings(&calibration).into_iter().chain(damaged).collect(), ..calibration })
}

/// The calibration of the camera without the IMU.
struct SeparateCalibration<'a> {
    refined: &'a Refined,
    camera: &'a Uncertainty,
    /// Its intrinsics, if they are fixed.
    fixed: Option<&'a FixedIntrinsics>,
}

/// The IMU's clock relative to the events' clock.
struct Clock {
    /// Largest correlation of the rotation rates.
    correlation: f64,
    streams: Vec<StreamReport>,
    /// Shift of the samples that makes them begin with the events (s).
    clock_origin: f64,
    /// Time at which the delays apply (s).
    delays_at: f64,
}

fn finish(
    joint: &Joint,
    solved: Solved,
    separate: SeparateCalibration,
    clock: Clock,
) -> Result<InertialCalibration, InertialError> {
    let SeparateCalibration { refined, camera, fixed } = separate;
    let total = joint.used.iter().map(ExactSizeIterator::len).sum::<usize>() as f64 / joint.rate;
    let Solved { estimate, residuals, spectra, mut system } = solved;
    let pieces = std::mem::take(&mut system.pieces);
    let reduced = system.into_reduced()?;
    // An error of the intrinsics that all events have in common moves the estimated IMU, but does not cause scatter
    // between blocks of time.
    let share = match fixed {
        Some(fixed) => {
            let with_uncertain = fixed.with_uncertain_estimated(joint.problem);
            let system = solve::system_at(&joint.of_problem(&with_uncertain), &estimate)?;
            share_of_intrinsics(&system.into_reduced()?, fixed.uncertain_covariance())?
        }
        None => share_of_intrinsics(&reduced, of_free(&camera.systematic, joint.problem))?,
    };
    let InertialUncertainty { mut covariance, sigma_of_others, block_scatter } =
        uncertainty::inertial_uncertainty(reduced, &pieces, total)?;
    uncertainty::add_systematic(&mut covariance, &estimate.parameters, mean_distance(&refined.state.trajectories));
    uncertainty::add_timing(&mut covariance, clock.streams.iter().map(|stream| stream.timing.uncertainty()));
    covariance += share;
    let (own, mut sigma) = (&refined.state.camera, camera.sigma());
    let camera_moved = match fixed {
        Some(fixed) => fixed.distance(own, &sigma),
        None => {
            for (place, together) in free_intrinsics(joint.problem, sigma.len()).into_iter().zip(sigma_of_others) {
                sigma[place] = sigma[place].hypot(together);
            }
            FixedIntrinsics { camera: estimate.state.camera, covariance: None }.distance(own, &sigma)
        }
    };
    let tilt = tilt(&estimate.state.trajectories, &estimate.parameters.gravity);
    Ok(InertialCalibration {
        source_files: Files::default(),
        prior_sigma: priors::priors(&estimate.parameters, joint.settings).map(|(_, sigma)| sigma),
        parameters: estimate.parameters,
        covariance,
        noise: estimate.noise,
        correlation: clock.correlation,
        streams: clock.streams,
        used: joint.used.iter().map(ExactSizeIterator::len).sum(),
        clock_origin: clock.clock_origin,
        delays_at: clock.delays_at,
        knot_spacing: joint.knot_spacing,
        camera: estimate.state.camera,
        camera_moved,
        fixed: fixed.map(|fixed| fixed.camera),
        block_scatter,
        tilt,
        residuals,
        spectra,
        findings: Vec::new(),
    })
}

/// Returns the covariance of the inertial parameters that follows from a `covariance` of the intrinsics estimated in `reduced`.
fn share_of_intrinsics(reduced: &Reduced, covariance: DMatrix<f64>) -> Result<DMatrix<f64>, InertialError> {
    let share = share_of_fixed(reduced, &[(COUNT..COUNT + covariance.nrows(), covariance)])?;
    Ok(share.view((0, 0), (COUNT, COUNT)).into_owned())
}

/// Returns the part of `covariance`, the covariance of all intrinsics, for the intrinsics that `problem` estimates.
fn of_free(covariance: &DMatrix<f64>, problem: &Problem) -> DMatrix<f64> {
    let free = free_intrinsics(problem, covariance.nrows());
    DMatrix::from_fn(free.len(), free.len(), |row, column| covariance[(free[row], free[column])])
}

/// Returns the indices of the intrinsics, among `count`, that `problem` estimates.
fn free_intrinsics(problem: &Problem, count: usize) -> Vec<usize> {
    (0..count).filter(|&index| problem.free.intrinsics[index]).collect()
}

/// Returns the largest angle between `gravity` and its mean direction, as seen from the camera.
fn tilt(trajectories: &[Trajectory], gravity: &Vector3<f64>) -> f64 {
    const STEP: f64 = 0.02;
    let along = |trajectory: &Trajectory| {
        let count = ((trajectory.end() - trajectory.start()) / STEP) as usize;
        let seen = |index: usize| {
            let pose = trajectory.pose(trajectory.start() + STEP * index as f64)?;
            Some(pose.rotation.inverse_transform_vector(gravity))
        };
        (0..=count).filter_map(seen).collect::<Vec<_>>()
    };
    let seen: Vec<Vector3<f64>> = trajectories.iter().flat_map(along).collect();
    let mean = seen.iter().sum::<Vector3<f64>>();
    seen.iter().map(|one| one.angle(&mean)).fold(0.0, f64::max)
}

/// Converts the times of the samples to the clock of the events, whose first event is at `start` of the file. Samples from a
/// clock with another origin are shifted to begin with the trajectories. Returns the samples and that shift.
fn on_events_clock<'a>(
    mut samples: Vec<Sample>,
    start: f64,
    trajectories: impl Iterator<Item = &'a Trajectory>,
) -> (Vec<Sample>, f64) {
    samples.iter_mut().for_each(|sample| sample.t -= start);
    let (Some(first), Some(last)) = (samples.first().map(|one| one.t), samples.last().map(|one| one.t)) else {
        return (samples, 0.0);
    };
    let (begin, end) =
        trajectories.fold((f64::INFINITY, 0.0_f64), |range, one| (range.0.min(one.start()), range.1.max(one.end())));
    // Clock offsets of some seconds are found from the rotations.
    let moved = if first > end + 10.0 || last < begin - 10.0 { first - begin.min(0.0) } else { 0.0 };
    samples.iter_mut().for_each(|sample| sample.t -= moved);
    (samples, moved)
}

#[cfg(test)]
mod tests;
