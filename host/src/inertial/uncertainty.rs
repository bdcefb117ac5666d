//! How sure the inertial parameters are: the formal covariance, enlarged to the scatter of blocks of time.

use nalgebra::DMatrix;

use super::error::InertialError;
use super::parameters::{COUNT, GRAVITY, POSITION};
use crate::solve::bordered::{Blocks, Part, System};
use crate::trust::uncertainty::blocks::{scatter, sum_by_block};

/// Lengths of blocks (s).
const LENGTHS: [f64; 4] = [0.25, 0.5, 1.0, 2.0];
/// Fewest blocks of a length.
const FEWEST: f64 = 10.0;

/// How far trajectories are too long or too short as a whole, as a share of the distance to the board: what makes them longer
/// puts the unit further along the line of sight, and all blocks agree on it. From simulated recordings.
const TRAJECTORY_SCALE: f64 = 4e-4;

/// How far gravity is turned in all blocks alike (rad): what moves it along the board's normal is told from the accelerometer's bias
/// by tilts alone, so that small errors of real pixels count for much. From simulated recordings; with ideal pixels it is a third.
const GRAVITY_TURN: f64 = 2e-4;

/// Adds to `covariance` what blocks of time cannot tell, for a board that is `distance` metres away.
pub fn add_systematic(covariance: &mut DMatrix<f64>, distance: f64) {
    let place = POSITION + 2;
    covariance[(place, place)] += (TRAJECTORY_SCALE * distance).powi(2);
    for angle in [GRAVITY, GRAVITY + 1] {
        covariance[(angle, angle)] += GRAVITY_TURN.powi(2);
    }
}

/// How sure a solve is.
pub struct Stated {
    /// Covariance of the inertial parameters.
    pub covariance: DMatrix<f64>,
    /// Formal σ of what was free besides, the intrinsics first.
    pub sigma_of_others: Vec<f64>,
    /// How much more rotation, place and delays scatter from block to block than the formal covariance says.
    pub block_scatter: f64,
}

/// How sure the solution of `system` is from `total` seconds of samples.
///
/// # Errors
/// [`InertialError::Singular`].
pub fn stated(system: &System, parts: &[Part], total: f64) -> Result<Stated, InertialError> {
    let formal = system.covariance()?;
    let Blocks { times, contributions } = system.contributions(parts, LENGTHS[0])?;
    let lengths = LENGTHS.iter().filter(|&&length| length == LENGTHS[0] || length * FEWEST <= total);
    let scatters: Vec<DMatrix<f64>> = lengths
        .filter_map(|&length| scatter(&formal, sum_by_block(&times, &contributions, length), COUNT))
        .map(|scatter| scatter.covariance)
        .collect();
    let ratio = |index: usize| {
        let of_blocks: f64 = scatters.iter().map(|scatter| scatter[(index, index)]).sum();
        of_blocks / (scatters.len().max(1) as f64 * formal[(index, index)])
    };
    let ratios: Vec<f64> = (0..COUNT).map(ratio).collect();
    let block_scatter = ratios.iter().take(GRAVITY).sum::<f64>() / GRAVITY as f64;
    let factor = |index: usize| ratios[index].max(1.0).sqrt();
    let covariance = DMatrix::from_fn(COUNT, COUNT, |row, column| formal[(row, column)] * factor(row) * factor(column));
    let sigma_of_others = formal.diagonal().iter().skip(COUNT).map(|variance| variance.max(0.0).sqrt()).collect();
    Ok(Stated { covariance, sigma_of_others, block_scatter })
}
