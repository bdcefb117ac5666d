//! Two halves of the observations, calibrated apart.
//!
//! Time is cut into slices; the even ones make one half, the odd ones the other. Each half is solved on its
//! own, from the common result on: two cameras from data that have no event in common. They should differ
//! by what the stated uncertainty of both says, and each should explain the other half's events about as well
//! as that half's own camera does (with the trajectory free in both cases).
//!
//! The common result is so near to that of each half that two Gauss-Newton steps lead there: with the robust loss, one is some
//! 10 % short. More would only move the trajectory where a half has no events and nothing but its smoothness holds it.

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::solve::levenberg::{
    Solved, intrinsics_covariance, intrinsics_of, one_step, one_step_with_covariance, solve,
};
use crate::solve::residual_statistics::{ResidualStatistics, residual_statistics};
use crate::solve::stretch::residuals_at;
use crate::solve::{FreeParameters, GLOBAL_COUNT, Problem, SolveError, State};
use crate::trust::uncertainty::parts::CovarianceParts;
use crate::trust::uncertainty::projection::projection_uncertainty;
use evcal_geometry::lens::camera_file::CameraDescription;
use evcal_geometry::lens::projection_difference::{ProjectionDifference, projection_difference};

/// Length of a slice of time (s); even slices make one half, odd ones the other.
const SLICE: f64 = 0.5;
/// Recordings with fewer slices are not halved.
const FEWEST_SLICES: f64 = 4.0;

/// How well a camera explains events that it was not calibrated from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeldOutResidual {
    /// Observations in both halves.
    pub count: usize,
    /// Root mean square residual with the camera of the other half (px).
    pub rms: f64,
    /// The same with the half's own camera (px).
    pub own_rms: f64,
}

/// Two calibrations from one half of the observations each.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SplitHalf {
    /// The two cameras.
    pub cameras: [CameraDescription; 2],
    /// Where the second would put what the first sees.
    pub difference: ProjectionDifference,
    /// The root mean square difference that their stated uncertainties lead to expect (px).
    pub expected_rms: f64,
    /// What it stays below in 95 of 100 cases if those are right (px).
    pub bound: f64,
    /// Held-out residuals.
    pub held_out: HeldOutResidual,
}

impl SplitHalf {
    /// Whether the halves differ by no more than stated.
    pub fn consistent(&self) -> bool {
        self.difference.rms <= self.bound
    }
}

/// Halves `problem`, which `state` solves, and compares; `parts` say where the covariance of the whole comes from. `None` when there is
/// too little to halve.
pub fn split_half(problem: &Problem, state: &State, parts: &CovarianceParts) -> Option<SplitHalf> {
    let total: f64 = state.trajectories.iter().map(|trajectory| trajectory.end() - trajectory.start()).sum();
    if total < SLICE * FEWEST_SLICES {
        return None;
    }
    let halves = [0, 1].map(|parity| half(problem, parity));
    let [first, second] = [solved(&halves[0], state).ok()?, solved(&halves[1], state).ok()?];
    // What both halves have in common cancels.
    let scattered = &parts.noise + &parts.between_parts;
    let formal = &first.formal_covariance + &second.formal_covariance;
    let covariance = alike(&formal, &parts.noise, &scattered, &problem.free.mask())?;
    let (first_residuals, second_residuals) = (first.residuals, second.residuals);
    let (first, second) = (&first.state, &second.state);
    let difference = projection_difference(&first.camera, &second.camera, problem.sensor).ok()?;
    let expected = projection_uncertainty(&state.camera, &covariance, problem.sensor).ok()?;

    let mut held_out = HeldOutResidual { count: 0, rms: 0.0, own_rms: 0.0 };
    let owns = [(first, first_residuals), (second, second_residuals)];
    for ((half, (own, own_residuals)), other) in halves.iter().zip(owns).zip([&second.camera, &first.camera]) {
        let held = with_camera_held(half, own, other)?;
        held_out.count += own_residuals.count;
        held_out.rms += held.rms * held.rms * held.count as f64;
        held_out.own_rms += own_residuals.rms * own_residuals.rms * own_residuals.count as f64;
    }
    let mean = |sum: f64| (sum / held_out.count.max(1) as f64).sqrt();
    let held_out = HeldOutResidual { rms: mean(held_out.rms), own_rms: mean(held_out.own_rms), ..held_out };
    Some(SplitHalf {
        cameras: [CameraDescription::new(&first.camera), CameraDescription::new(&second.camera)],
        difference,
        expected_rms: expected.rms,
        bound: expected.rms_95,
        held_out,
    })
}

/// What is to `formal` as `scattered` is to `noise`: covariances of the intrinsics, with zeros where a parameter is not `free`. For a
/// `formal` that is k times `noise` it is k times `scattered`. `None` where one of them is not positive definite.
fn alike(
    formal: &DMatrix<f64>,
    noise: &DMatrix<f64>,
    scattered: &DMatrix<f64>,
    free: &[bool; GLOBAL_COUNT],
) -> Option<DMatrix<f64>> {
    let count = noise.nrows();
    let places: Vec<usize> = (0..count).filter(|&index| free[index]).collect();
    let of_free = |matrix: &DMatrix<f64>| matrix.select_rows(&places).select_columns(&places);
    let root = |matrix: &DMatrix<f64>| Some(of_free(matrix).cholesky()?.unpack());
    let (formal, noise) = (root(formal)?, root(noise)?);
    let half = noise.solve_lower_triangular(&of_free(scattered))?;
    let shape = noise.solve_lower_triangular(&half.transpose())?;
    Some(intrinsics_of(&(&formal * shape * formal.transpose()), free, count))
}

/// Steps that lead astray leave a smaller part of the observations than this, or make the residuals so many times as large. The loss is
/// robust, so that a step in the right direction may make their root mean square a little larger too.
const FEWEST_LEFT: f64 = 0.999;
/// See there.
const MOST_WORSE: f64 = 1.01;

/// What one half says.
struct SolvedHalf {
    state: State,
    /// Covariance of the intrinsics, if observations were independent.
    formal_covariance: DMatrix<f64>,
    residuals: ResidualStatistics,
}

/// The solution of `half` from `state` on, which solves the whole.
fn solved(half: &Problem, state: &State) -> Result<SolvedHalf, SolveError> {
    let before = statistics(half, state);
    let two_steps = one_step(half, state).and_then(|first| one_step_with_covariance(half, &first));
    if let Ok((state, formal_covariance)) = two_steps {
        let residuals = statistics(half, &state);
        if residuals.count as f64 > FEWEST_LEFT * before.count as f64 && residuals.rms < MOST_WORSE * before.rms {
            return Ok(SolvedHalf { state, formal_covariance, residuals });
        }
    }
    // Too far for them.
    let Solved { state: own, system, .. } = solve(half, state.clone())?;
    let formal_covariance = intrinsics_covariance(&system, &half.free.mask(), own.camera.parameters().len())?;
    let residuals = statistics(half, &own);
    Ok(SolvedHalf { state: own, formal_covariance, residuals })
}

fn statistics(problem: &Problem, state: &State) -> ResidualStatistics {
    residual_statistics(problem, state, &residuals_at(problem, state))
}

/// Residuals of `half` with `camera`, its trajectories solved anew.
fn with_camera_held(half: &Problem, own: &State, camera: &Camera<f64>) -> Option<ResidualStatistics> {
    let free = FreeParameters { intrinsics: [false; MAX_PARAMETERS], ..half.free };
    let held = Problem { free, ..half.with_segments(half.segments.clone()) };
    let followed = one_step(&held, &State { camera: *camera, ..own.clone() }).ok()?;
    Some(statistics(&held, &followed))
}

/// The slices of `problem` whose number has this parity.
fn half(problem: &Problem, parity: i64) -> Problem {
    let wanted = |t: f64| (t / SLICE).floor() as i64 & 1 == parity;
    problem.with_segments(problem.segments.iter().map(|segment| segment.within(wanted)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scatter_of_halves_has_the_shape_of_that_of_the_whole() {
        let noise = DMatrix::from_row_slice(3, 3, &[2.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.5, 0.0, 1.0]);
        let scattered = DMatrix::from_row_slice(3, 3, &[9.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 3.0]);
        let mut free = [false; GLOBAL_COUNT];
        (free[0], free[2]) = (true, true);
        // Each half alone is half as sure, and the difference of two once more.
        let four = alike(&(&noise * 4.0), &noise, &scattered, &free).unwrap();
        assert!((four - &scattered * 4.0).norm() < 1e-12);
        let formal = DMatrix::from_row_slice(3, 3, &[7.0, 0.0, 2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 5.0]);
        // Without a shape of its own, the scatter only enlarges.
        let enlarged = alike(&formal, &noise, &(&noise * 2.5), &free).unwrap();
        assert!((enlarged - &formal * 2.5).norm() < 1e-12);
        let scatter = alike(&formal, &noise, &scattered, &free).unwrap();
        assert!((&scatter - scatter.transpose()).norm() < 1e-12 && scatter[(0, 0)] > formal[(0, 0)]);
        assert_eq!(scatter[(1, 1)], 0.0);
        let held = DMatrix::zeros(3, 3);
        assert_eq!(alike(&held, &held, &held, &[false; GLOBAL_COUNT]), Some(held));
    }
}
