//! How sure the inertial parameters are: the formal covariance, enlarged to the scatter of blocks of time.

use nalgebra::{DMatrix, Vector3};

use super::error::InertialError;
use super::parameters::{ACCELEROMETER_BIAS, COUNT, GRAVITY, InertialParameters, POSITION};
use crate::solve::bordered::{Blocks, Part, System};
use crate::trust::uncertainty::blocks::{scatter, sum_by_block};

/// Lengths of blocks (s).
const LENGTHS: [f64; 4] = [0.25, 0.5, 1.0, 2.0];
/// Fewest blocks of a length.
const FEWEST: f64 = 10.0;

/// How far trajectories are too long or too short as a whole, as a share of the distance to the board: what makes them longer
/// puts the unit further along the line of sight, and all blocks agree on it. From simulated recordings.
const TRAJECTORY_SCALE: f64 = 4e-4;

/// How far gravity is turned in all blocks alike (rad), and how much of it the accelerometer's bias along the line of sight takes
/// for itself: by tilts alone the two are told from each other, so that small errors of real pixels count for much. From simulated
/// recordings; with ideal pixels it is a third.
const GRAVITY_TURN: f64 = 2.5e-4;

/// Adds to `covariance` of `parameters` what blocks of time cannot tell, for a board that is `distance` metres away.
pub fn add_systematic(covariance: &mut DMatrix<f64>, parameters: &InertialParameters, distance: f64) {
    let place = POSITION + 2;
    covariance[(place, place)] += (TRAJECTORY_SCALE * distance).powi(2);
    for angle in [GRAVITY, GRAVITY + 1] {
        covariance[(angle, angle)] += GRAVITY_TURN.powi(2);
    }
    let bias = parameters.rotation * Vector3::z() * (GRAVITY_TURN * parameters.gravity.norm());
    let mut of_bias = covariance.fixed_view_mut::<3, 3>(ACCELEROMETER_BIAS, ACCELEROMETER_BIAS);
    of_bias += bias * bias.transpose();
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

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    #[test]
    fn the_bias_is_less_sure_along_the_line_of_sight() {
        // The camera's z is the unit's -y.
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), FRAC_PI_2);
        let parameters =
            InertialParameters { rotation, ..InertialParameters::perfect(Vector3::new(0.0, 8.0, 0.0), 0.0) };
        let mut covariance = DMatrix::zeros(COUNT, COUNT);
        add_systematic(&mut covariance, &parameters, 0.5);
        let sigma = |place: usize| covariance[(place, place)].sqrt();
        let bias = [0, 1, 2].map(|axis| sigma(ACCELEROMETER_BIAS + axis));
        assert!(bias[0] < 1e-12 && (bias[1] - 2e-3).abs() < 1e-12 && bias[2] < 1e-12, "{bias:?}");
        assert!((sigma(POSITION + 2) - 2e-4).abs() < 1e-12 && (sigma(GRAVITY) - 2.5e-4).abs() < 1e-12);
    }
}
