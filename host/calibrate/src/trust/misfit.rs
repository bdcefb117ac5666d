//! What another lens model says where this one cannot follow the lens.
//!
//! Residuals that stay in the same places of the image say that a model cannot bend as the lens does, but not how far
//! it is off: poses and other parameters take up a part of it. So the other models are solved from where this one
//! ended, on a part of its events. The projection of the best of them differs by about what this one is wrong.

use evcal_core::camera::refit::refit;
use evcal_core::camera::{Camera, MAX_PARAMETERS, ModelKind};
use nalgebra::DMatrix;

use crate::solve::levenberg::solve;
use crate::solve::{BOARD_PARAMETERS, FreeParameters, Problem, SolveSettings, State};
use crate::trust::residual_map::ResidualPattern;
use crate::trust::uncertainty::Uncertainty;
use crate::trust::uncertainty::projection::ProjectionUncertainty;
use evcal_geometry::board::shape::BoardShape;
use evcal_geometry::lens::folds::folds;
use evcal_geometry::lens::projection_difference::{ProjectionDifference, projection_difference};

/// Models that are tried, those first that OpenCV and ROS hold.
const CANDIDATES: [ModelKind; 6] = [
    ModelKind::Radtan,
    ModelKind::KannalaBrandt,
    ModelKind::Radtan8,
    ModelKind::Eucm,
    ModelKind::DoubleSphere,
    ModelKind::Omni,
];

/// Events with which a model is tried, about.
const EVENTS: usize = 80_000;

/// Most iterations for each model.
const ITERATIONS: usize = 6;

/// Most iterations where the board changes, further than models usually do.
const SHAPE_ITERATIONS: usize = 10;

/// A model explains the events better when it takes so many times the cost that chance can away, in variances of the
/// estimate over those of independent events.
const CERTAIN: f64 = 8.0;

/// A lens model that follows the lens better.
#[derive(Clone, Debug, PartialEq)]
pub struct BetterModel {
    /// The model.
    pub kind: ModelKind,
    /// What the calibrated camera is off if it is right.
    pub difference: ProjectionDifference,
}

/// Where two models differ by more than this (px), the wrong one did not find its events, and what is known there is a
/// guess.
const LOST: f64 = 1.0;

/// Such places count as so many times the largest difference: the other model did not see events there either.
const GUESS: f64 = 2.0;

/// How far a lens model is from the lens.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Misfit {
    /// Error of the projection over the sensor that the model brings (rms, px).
    pub rms: f64,
    /// A model without that error, if there is one.
    pub better: Option<BetterModel>,
}

/// How far the model of `state`, which solves `problem`, is from the lens, when `pattern` is what its residuals leave and
/// `inflation` the variance of the estimate over that of independent events.
pub fn misfit(problem: &Problem, state: &State, pattern: &ResidualPattern, inflation: f64) -> Misfit {
    let better = better_model(problem, state, inflation);
    let rms = better.as_ref().map_or(0.0, |better| cautious_rms(&better.difference)).max(pattern.shift);
    Misfit { rms, better }
}

/// The root mean square of a difference over the sensor, in which places beyond [`LOST`] count
/// [`GUESS`] times as much as the worst.
fn cautious_rms(difference: &ProjectionDifference) -> f64 {
    let squares = difference.grid.iter().filter_map(|place| {
        let [x, y] = place.difference?;
        let size = x.hypot(y);
        Some(if size > LOST { GUESS * difference.max } else { size }.powi(2))
    });
    let (count, sum) = squares.fold((0_usize, 0.0), |(count, sum), square| (count + 1, sum + square));
    (sum / count.max(1) as f64).sqrt()
}

/// Whether another lens model, with the board as it is, explains more than a board of another `shape` with the `asked` parameters
/// free.
pub fn lens_explains_more(
    problem: &Problem,
    state: &State,
    shape: BoardShape,
    asked: [bool; BOARD_PARAMETERS],
    inflation: f64,
) -> bool {
    let step = thinning(problem);
    let own = state.camera.kind();
    let free = FreeParameters { board: asked, ..problem.free };
    let shaped = State { board: shape, ..state.clone() };
    let Ok(with_shape) = solve(&thinned(problem, step, free, SHAPE_ITERATIONS), shaped) else { return false };
    let chance = CERTAIN * (inflation / step as f64).max(1.0);
    CANDIDATES.into_iter().filter(|&kind| kind != own).any(|kind| {
        let Some(camera) = refit(kind, &state.camera, problem.sensor) else { return false };
        let free = FreeParameters { intrinsics: intrinsics_of(kind), ..problem.free };
        let solved = solve(&thinned(problem, step, free, ITERATIONS), State { camera, ..state.clone() });
        solved.is_ok_and(|solved| solved.report.final_cost + chance < with_shape.report.final_cost)
    })
}

/// One of how many events a model is tried with.
fn thinning(problem: &Problem) -> usize {
    let count: usize = problem.segments.iter().map(|segment| segment.events.len()).sum();
    (count / EVENTS).max(1)
}

fn intrinsics_of(kind: ModelKind) -> [bool; MAX_PARAMETERS] {
    std::array::from_fn(|index| index < kind.parameter_names().len())
}

/// `problem` with one in `step` of its events and these parameters free.
fn thinned(problem: &Problem, step: usize, free: FreeParameters, iterations: usize) -> Problem {
    let settings = SolveSettings { iterations, ..problem.settings.clone() };
    let segments = problem.segments.iter().map(|segment| segment.every(step)).collect();
    Problem { settings, free, ..problem.with_segments(segments) }
}

fn better_model(problem: &Problem, state: &State, inflation: f64) -> Option<BetterModel> {
    let step = thinning(problem);
    let solved = |kind: ModelKind, camera: Camera<f64>| {
        let free = FreeParameters { intrinsics: intrinsics_of(kind), ..problem.free };
        let solved = solve(&thinned(problem, step, free, ITERATIONS), State { camera, ..state.clone() }).ok()?;
        Some((kind, solved.state.camera, solved.report.final_cost))
    };
    let own = state.camera.kind();
    let (_, _, own_cost) = solved(own, state.camera)?;
    let others: Vec<_> = CANDIDATES
        .into_iter()
        .filter(|&kind| kind != own)
        .filter_map(|kind| solved(kind, refit(kind, &state.camera, problem.sensor)?))
        .collect();
    let best = others.iter().map(|(_, _, cost)| *cost).fold(f64::INFINITY, f64::min);
    let chance = CERTAIN * (inflation / step as f64).max(1.0);
    if best + chance >= own_cost {
        return None;
    }
    // Of those that explain as much, the first that does not fold over inside the image.
    let as_good = others.into_iter().filter(|(_, _, cost)| *cost <= best + chance);
    let (kind, camera, _) = as_good.min_by_key(|(_, camera, _)| folds(camera, problem.sensor))?;
    let difference = projection_difference(&state.camera, &camera, problem.sensor).ok()?;
    Some(BetterModel { kind, difference })
}

/// `uncertainty` made so much larger that the bound of `projection` has room for the misfit too.
pub fn with_misfit(uncertainty: Uncertainty, projection: &ProjectionUncertainty, misfit: &Misfit) -> Uncertainty {
    if projection.rms_95 <= 0.0 {
        return uncertainty;
    }
    let larger = (1.0 + misfit.rms / projection.rms_95).powi(2);
    let covariance: DMatrix<f64> = uncertainty.covariance * larger;
    Uncertainty { covariance, inflation: uncertainty.inflation * larger, ..uncertainty }
}

#[cfg(test)]
mod tests {
    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::trust::uncertainty::projection::projection_uncertainty;

    #[test]
    fn the_bound_grows_by_the_misfit() {
        let parameters = [331.0, 332.0, 176.0, 134.0, -0.35, 0.15, -4e-4, 5e-4, -0.03];
        let camera = Camera::from_parameters(ModelKind::Radtan, &parameters).unwrap();
        let sigma = [0.1, 0.1, 0.1, 0.1, 1e-3, 1e-3, 1e-4, 1e-4, 1e-3];
        let covariance =
            DMatrix::from_fn(9, 9, |row, column| if row == column { sigma[row] * sigma[row] } else { 0.0 });
        let systematic = DMatrix::zeros(9, 9);
        let uncertainty =
            Uncertainty { covariance, systematic, systematic_scale: 0.0, inflation: 2.0, observations: 100, blocks: 8 };
        let bound = |uncertainty: &Uncertainty| {
            projection_uncertainty(&camera, &uncertainty.covariance, Sensor::new(346, 260)).unwrap()
        };
        let before = bound(&uncertainty);
        let misfit = Misfit { rms: 0.3, better: None };
        let after = bound(&with_misfit(uncertainty, &before, &misfit));
        assert!((after.rms_95 - before.rms_95 - 0.3).abs() < 1e-9, "{} {}", before.rms_95, after.rms_95);
    }
}
