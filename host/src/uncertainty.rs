//! How sure the intrinsics are.
//!
//! The inverse of the normal equations would be their covariance if every event were a measurement of its
//! own. It is not: events of one passage of an edge share what the pixel, the spline and the bias terms get
//! wrong, so that the formal σ is several times too small. How much too small, the recording itself tells:
//! the observations are cut into blocks of time, each long enough that its errors hardly reach into the
//! next, and the estimate's scatter when one block after the other is left out (the jackknife, to first
//! order, with the trajectories giving way) gives another covariance. Its size can be trusted, its single
//! entries, from some tens of blocks, are noisy; those of the formal one are not, but too small. What is
//! stated is half of one and half of the other, blown up to the same size by one number,
//! [`Uncertainty::inflation`].

pub mod blocks;
pub mod projection;

use evcal_core::camera::MAX_PARAMETERS;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::event_bias::{BIAS_COUNT, CLASS_COUNT};
use crate::solve::levenberg::{intrinsics_of, linearised, system_of};
use crate::solve::stretch::stretches;
use crate::solve::{GLOBAL_COUNT, Problem, SolveError, State, bias_index};
use blocks::{inflation, jackknife, sum_by_block};

/// How observations are cut into blocks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UncertaintySettings {
    /// Length of a block; blocks of twice this length are looked at too (s).
    pub block: f64,
    /// Fewer blocks than this are shortened, as far as there are observations in between.
    pub fewest_blocks: usize,
}

impl Default for UncertaintySettings {
    fn default() -> Self {
        Self { block: 0.25, fewest_blocks: 8 }
    }
}

/// How sure a calibration is.
#[derive(Clone, Debug, PartialEq)]
pub struct Uncertainty {
    /// Covariance of the intrinsics, in the order of the camera model's parameters; rows and columns of
    /// parameters that are held are zero.
    pub covariance: DMatrix<f64>,
    /// Standard deviation of each bias of each event class; zero where it is held.
    pub bias_sigma: [[f64; BIAS_COUNT]; CLASS_COUNT],
    /// Variance of the estimate over what it would be if all observations were independent, at least 1.
    pub inflation: f64,
    /// Number of observations.
    pub observations: usize,
    /// Number of blocks of time that the inflation was found with.
    pub blocks: usize,
}

impl Uncertainty {
    /// Standard deviation of each intrinsic parameter, in the order of the camera model.
    pub fn sigma(&self) -> Vec<f64> {
        self.covariance.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect()
    }

    /// Correlation of the intrinsics, 1 on the diagonal; zero beside it where a parameter is held.
    pub fn correlation(&self) -> DMatrix<f64> {
        let sigma = self.sigma();
        DMatrix::from_fn(sigma.len(), sigma.len(), |row, column| {
            let scale = sigma[row] * sigma[column];
            if row == column {
                1.0
            } else if scale > 0.0 {
                self.covariance[(row, column)] / scale
            } else {
                0.0
            }
        })
    }

    /// Independent observations that would determine the camera as well.
    pub fn effective_observations(&self) -> f64 {
        self.observations as f64 / self.inflation
    }
}

/// The uncertainty of `state`, which solves `problem`.
///
/// # Errors
/// [`SolveError::Singular`] when the observations do not determine the free parameters.
pub fn uncertainty(
    problem: &Problem,
    state: &State,
    settings: &UncertaintySettings,
) -> Result<Uncertainty, SolveError> {
    let stretches = stretches(&problem.segments);
    let equations = linearised(problem, state, &stretches);
    let system = system_of(problem, state, &equations);
    let free = problem.free.mask();
    let formal = system.global_covariance(&free).map_err(|_| SolveError::Singular)?;
    let contributions = system.contributions(&equations, &free).map_err(|_| SolveError::Singular)?;
    let times: Vec<(usize, f64)> =
        stretches.iter().map(|stretch| (stretch.segment, stretch.start(&problem.segments))).collect();
    let intrinsics = free.iter().take(MAX_PARAMETERS).filter(|&&free| free).count();

    let total: f64 = state.trajectories.iter().map(|trajectory| trajectory.end() - trajectory.start()).sum();
    let longest = total / settings.fewest_blocks.max(2) as f64;
    let formal_intrinsics = formal.view((0, 0), (intrinsics, intrinsics)).into_owned();
    let mut found = (formal_intrinsics.clone(), 1.0, 0);
    for length in [settings.block, 2.0 * settings.block].map(|length| length.min(longest)) {
        let blocks = sum_by_block(&times, &contributions, length);
        let covariance = jackknife(&formal, &blocks, intrinsics);
        let ratio = covariance.as_ref().and_then(|covariance| inflation(&formal_intrinsics, covariance));
        if let (Some(covariance), Some(ratio)) = (covariance, ratio)
            && ratio > found.1
        {
            found = (covariance, ratio, blocks.len());
        }
    }
    let (scattered, inflation, blocks) = found;
    let stated = (scattered + formal_intrinsics * inflation) * 0.5;

    let count = state.camera.parameters().len();
    let mut variances = [0.0; GLOBAL_COUNT];
    let places = (0..GLOBAL_COUNT).filter(|&global| free[global]);
    for (global, variance) in places.zip(formal.diagonal().iter()) {
        variances[global] = inflation * variance.max(0.0);
    }
    let bias_sigma =
        std::array::from_fn(|class| std::array::from_fn(|bias| variances[bias_index(class) + bias].sqrt()));
    let covariance = intrinsics_of(&stated, &free, count);
    Ok(Uncertainty { covariance, bias_sigma, inflation, observations: system.count, blocks })
}
