//! Uncertainty of the inertial parameters: the formal covariance, enlarged to the scatter of blocks of time.

use nalgebra::{DMatrix, Vector3};

use super::error::InertialError;
use super::parameters::{
    ACCELEROMETER_BIAS, ACCELEROMETER_DELAY, COUNT, GRAVITY, GYROSCOPE_DELAY, InertialParameters, POSITION,
};
use crate::quality::uncertainty::blocks::{jackknife_step, scatter, sum_by_block};
use evcal_solve::solve::equations::normal::Equations;
use evcal_solve::solve::equations::system::{Blocks, Reduced};

/// Lengths of blocks (s).
const LENGTHS: [f64; 4] = [0.25, 0.5, 1.0, 2.0];
/// Fewest blocks per length.
const FEWEST: f64 = 10.0;

/// Relative error of the length of trajectories: a trajectory that is too long moves the IMU away along the line of sight, and
/// all blocks agree on it. From simulated recordings.
const TRAJECTORY_SCALE: f64 = 4e-4;

/// Common error of gravity's direction in all blocks (rad), and the share of it that the accelerometer's bias along the line of
/// sight absorbs: only tilts separate the two, so that small errors of real pixels matter much. Mean errors of seeds 337 to 368:
/// 0.016° and 0.32 mg; with ideal pixels, gravity's error is a third of that.
const GRAVITY_TURN: f64 = 2.5e-4;

/// Adds errors that blocks of time do not show to `covariance` of `parameters`, for a board at a distance of `distance` metres.
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

/// Adds the largest of the uncertainties `timings` (s) of the relation between timestamps and samples to the delays in `covariance`:
/// the same for both sensors.
pub fn add_timing(covariance: &mut DMatrix<f64>, timings: impl Iterator<Item = f64>) {
    let timing = timings.fold(0.0, f64::max);
    for row in [GYROSCOPE_DELAY, ACCELEROMETER_DELAY] {
        for column in [GYROSCOPE_DELAY, ACCELEROMETER_DELAY] {
            covariance[(row, column)] += timing * timing;
        }
    }
}

/// Uncertainty of a solve.
pub struct InertialUncertainty {
    /// Covariance of the inertial parameters.
    pub covariance: DMatrix<f64>,
    /// Formal σ of the other estimated parameters, the intrinsics first.
    pub sigma_of_others: Vec<f64>,
    /// Ratio of the scatter of rotation, position and delays between blocks to the formal covariance.
    pub block_scatter: f64,
}

/// Computes the uncertainty of a solution from `total` seconds of samples; `reduced` is the sum of all `pieces`.
///
/// # Errors
/// [`InertialError::Singular`] if the samples do not determine the parameters.
pub fn inertial_uncertainty(
    reduced: Reduced,
    pieces: &[Equations],
    total: f64,
) -> Result<InertialUncertainty, InertialError> {
    let formal = reduced.whole_covariance()?;
    let Blocks { times, contributions } = reduced.into_follows().blocks(pieces, LENGTHS[0])?;
    let lengths = LENGTHS.iter().filter(|&&length| length == LENGTHS[0] || length * FEWEST <= total);
    let scatters: Vec<DMatrix<f64>> = lengths
        .filter_map(|&length| scatter(&formal, sum_by_block(&times, &contributions, length), COUNT, jackknife_step))
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
    Ok(InertialUncertainty { covariance, sigma_of_others, block_scatter })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    #[test]
    fn the_bias_is_less_certain_along_the_line_of_sight() {
        // The camera's z is the IMU's −y.
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
