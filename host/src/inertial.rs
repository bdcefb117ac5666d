//! The inertial unit beside the camera: where it is, how it is turned, when its stamps are, and its own errors.
//!
//! After the camera is calibrated, its trajectories tell what an inertial unit fixed to it must feel ([`parameters`]). Samples
//! are read and looked at ([`stream`], [`csv`]), a [`start`] is found, and [`solve`] fits trajectories, camera and unit to events
//! and samples at once. [`findings`] are what speaks against the result.

pub mod csv;
mod equations;
pub mod error;
pub mod findings;
pub mod noise;
pub mod parameters;
pub mod solve;
mod start;
pub mod stream;
mod uncertainty;

use nalgebra::DMatrix;

pub use error::InertialError;
use findings::{Finding, findings};
use noise::Line;
use parameters::{COUNT, InertialParameters};
use solve::{Estimate, Joint, Noise, Residual, Solved};
use stream::{STANDARD_GRAVITY, Sample, StreamReport};

use crate::solve::left_out::covers;
use crate::solve::refinement::Refined;
use crate::trajectory::Trajectory;
use crate::trust::uncertainty::Uncertainty;

/// Fewest seconds of samples along trajectories.
const FEWEST_SECONDS: f64 = 3.0;

/// Nearest and farthest knots (s), and samples between them.
const NEAREST_KNOTS: f64 = 0.01;
const FARTHEST_KNOTS: f64 = 0.0225;
const SAMPLES_A_KNOT: f64 = 2.5;

/// What is known beforehand, and how the solve is made.
#[derive(Clone, Debug, PartialEq)]
pub struct InertialSettings {
    /// Size of gravity at the place of the recording in m/s².
    pub gravity: f64,
    /// Distance of the knots of the inertial solve in seconds; without it, it suits the rate of the samples.
    pub knot_spacing: Option<f64>,
    /// σ of scale errors before any measurement.
    pub scale: f64,
    /// σ of misalignments before any measurement, in radians.
    pub misalignment: f64,
}

impl Default for InertialSettings {
    fn default() -> Self {
        Self { gravity: STANDARD_GRAVITY, knot_spacing: None, scale: 0.03, misalignment: 0.03 }
    }
}

/// The samples of one recording.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedSamples {
    /// Number of the recording.
    pub recording: usize,
    /// The samples, on the clock of the recording's file (s).
    pub samples: Vec<Sample>,
    /// Time of the first event in the file (s).
    pub start: f64,
}

/// A calibrated inertial unit.
#[derive(Clone, Debug)]
pub struct InertialCalibration {
    /// What was found.
    pub parameters: InertialParameters,
    /// Covariance of all parameters, in their order.
    pub covariance: DMatrix<f64>,
    /// σ of each parameter before any measurement.
    pub prior_sigma: [f64; COUNT],
    /// Noise of gyroscope (rad/s/√Hz) and accelerometer (m/s²/√Hz).
    pub noise: [Noise; 2],
    /// Correlation of the turns of camera and unit at the start.
    pub correlation: f64,
    /// What was found in the streams, one a recording.
    pub streams: Vec<StreamReport>,
    /// Samples used.
    pub used: usize,
    /// By how much stamps of the unit were moved before all else because the clocks have different origins (s).
    pub clock_origin: f64,
    /// Largest change of an intrinsic parameter by the solve with the unit, in its σ.
    pub camera_moved: f64,
    /// Scatter of blocks over the formal variance, the mean over rotation, place and delays.
    pub block_scatter: f64,
    /// Residuals of gyroscope (rad/s) and accelerometer (m/s²).
    pub residuals: [Vec<Residual>; 2],
    /// Their spectra, for each axis.
    pub spectra: [Vec<Vec<Line>>; 2],
    /// What speaks against it.
    pub findings: Vec<Finding>,
}

impl InertialCalibration {
    /// Standard deviation of a parameter.
    pub fn sigma(&self, parameter: usize) -> f64 {
        self.covariance[(parameter, parameter)].max(0.0).sqrt()
    }

    /// Root mean square of the residuals of gyroscope (rad/s) and accelerometer (m/s²), over all axes.
    pub fn residual_rms(&self) -> [f64; 2] {
        self.residuals.each_ref().map(|residuals| rms(residuals))
    }
}

fn rms(residuals: &[Residual]) -> f64 {
    let sum: f64 = residuals.iter().map(|residual| residual.value.norm_squared()).sum();
    (sum / (3 * residuals.len().max(1)) as f64).sqrt()
}

/// Calibrates the inertial unit that gave `recorded` while `refined` was seen, whose camera is as sure as `camera` says.
///
/// # Errors
/// [`InertialError`] names what is wrong with the samples or the motion, and what to do.
pub fn calibrate_unit(
    recorded: Vec<RecordedSamples>,
    refined: &Refined,
    camera: &Uncertainty,
    settings: &InertialSettings,
) -> Result<InertialCalibration, InertialError> {
    let recordings = recorded.iter().map(|one| one.recording + 1).max().unwrap_or(0);
    let mut samples = vec![Vec::new(); recordings];
    let (mut streams, mut clock_origin) = (Vec::new(), 0.0);
    for one in recorded {
        let (kept, report) = stream::check(one.samples)?;
        streams.push(report);
        let of_recording = refined.state.trajectories.iter().filter(|trajectory| trajectory.recording == one.recording);
        let (kept, moved) = on_events_clock(kept, one.start, of_recording);
        clock_origin += moved;
        if let Some(place) = samples.get_mut(one.recording) {
            *place = kept;
        }
    }
    let rate = streams.iter().map(|stream| stream.rate).fold(0.0, f64::max);
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

    // Where no curve explains the events the trajectory is not known.
    for (recording, samples) in samples.iter_mut().enumerate() {
        let delay = start.parameters.gyroscope_delay;
        samples.retain(|sample| !covers(&refined.left_out, recording, sample.t - delay));
    }
    let used = solve::samples_within(&trajectories, &samples, &start.parameters);
    let seconds = used.iter().map(ExactSizeIterator::len).sum::<usize>() as f64 / rate;
    if seconds < FEWEST_SECONDS {
        return Err(InertialError::TooShort { seconds, needed: FEWEST_SECONDS });
    }
    let joint = Joint {
        problem: &refined.problem,
        inflation: camera.inflation,
        samples: &samples,
        used,
        rate,
        knot_spacing,
        settings,
    };
    let mut state = refined.state.clone();
    state.trajectories = trajectories;
    let estimate = Estimate { state, parameters: start.parameters, noise: solve::first_noise() };
    let solved = solve::solve(&joint, estimate)?;
    finish(&joint, solved, refined, camera, (start.correlation, streams, clock_origin))
}

fn finish(
    joint: &Joint,
    solved: Solved,
    refined: &Refined,
    camera: &Uncertainty,
    (correlation, streams, clock_origin): (f64, Vec<StreamReport>, f64),
) -> Result<InertialCalibration, InertialError> {
    let total = joint.used.iter().map(ExactSizeIterator::len).sum::<usize>() as f64 / joint.rate;
    let (covariance, block_scatter) = uncertainty::covariance(&solved.system, &solved.parts, total)?;
    let Solved { estimate, residuals, spectra, .. } = solved;
    let before = refined.state.camera.parameters();
    let moved = before.iter().zip(estimate.state.camera.parameters().iter().copied().collect::<Vec<f64>>());
    let camera_moved = moved
        .zip(camera.sigma())
        .filter(|(_, sigma)| *sigma > 0.0)
        .map(|((before, after), sigma)| (after - before).abs() / sigma)
        .fold(0.0, f64::max);
    let mut calibration = InertialCalibration {
        prior_sigma: solve::priors(&estimate.parameters, joint.settings).map(|(_, sigma)| sigma),
        parameters: estimate.parameters,
        covariance,
        noise: estimate.noise,
        correlation,
        streams,
        used: joint.used.iter().map(ExactSizeIterator::len).sum(),
        clock_origin,
        camera_moved,
        block_scatter,
        residuals,
        spectra,
        findings: Vec::new(),
    };
    findings::explained(&calibration, joint.samples)?;
    calibration.findings = findings(&calibration);
    Ok(calibration)
}

/// The samples with times from the first event, which is at `start` of the file; where they are of another time altogether, as
/// clocks with different origins have it, they begin with the trajectories. Beside them, by how much they were moved for that.
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
    // Clocks that are seconds apart are found by their turns.
    let moved = if first > end + 10.0 || last < begin - 10.0 { first - begin.min(0.0) } else { 0.0 };
    samples.iter_mut().for_each(|sample| sample.t -= moved);
    (samples, moved)
}
