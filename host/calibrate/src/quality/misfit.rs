//! Comparison with other lens models, when the model cannot follow the lens.
//!
//! Residuals that stay in the same parts of the image show that a model cannot follow the lens, but not how large its error is,
//! because poses and other parameters absorb a part of it. So the other models are solved on a part of the events, starting at
//! the result of this model. The projection difference to the best of them estimates the error of this model.
//!
//! A model that folds over inside the image is wrong there in any case. Other models that do not fold are better if they explain
//! the events as well.
//!
//! If evcal chose the model, other models that explain the events about as well may be right instead. Where the board was not seen
//! they can differ by much, and the difference to the farthest of them is a part of the uncertainty.

use evcal_core::camera::refit::refit_where;
use evcal_core::camera::{Camera, MAX_PARAMETERS, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::DMatrix;

use crate::quality::residual_map::ResidualPattern;
use crate::quality::uncertainty::Uncertainty;
use crate::quality::uncertainty::projection::ProjectionUncertainty;
use evcal_geometry::board::shape::BoardShape;
use evcal_geometry::lens::folds::folds;
use evcal_geometry::lens::projection_difference::{ProjectionDifference, projection_difference};
use evcal_solve::solve::levenberg::solve;
use evcal_solve::solve::{BOARD_PARAMETERS, FreeParameters, Problem, State};

/// Models to try, first those that OpenCV and ROS support.
const CANDIDATES: [ModelKind; 6] = [
    ModelKind::Radtan,
    ModelKind::KannalaBrandt,
    ModelKind::Radtan8,
    ModelKind::Eucm,
    ModelKind::DoubleSphere,
    ModelKind::Omni,
];

/// Approximate number of events with which a model is tried.
const EVENTS: usize = 80_000;

/// Largest number of iterations for each model.
const ITERATIONS: usize = 6;

/// Largest number of iterations if the board's shape is estimated, which converges more slowly than a change of the
/// model.
const SHAPE_ITERATIONS: usize = 10;

/// Largest number of iterations from the result of a model that folds over, whose poses may be far off.
const FOLDED_ITERATIONS: usize = 20;

/// A model explains the events better if it decreases the cost by more than this number times the inflation (the
/// variance of the estimate divided by the variance with independent events), because chance decreases the cost too.
const CERTAIN: f64 = 8.0;

/// Largest excess of the Bayesian information criterion (Schwarz 1978) over that of the chosen model at which another model may be
/// right: from 6 on the evidence against it is strong, 20 to 1 (Kass and Raftery 1995).
const STRONG_EVIDENCE: f64 = 6.0;

/// Another lens model, solved with the same events.
#[derive(Clone, Debug, PartialEq)]
pub struct OtherModel {
    /// The model.
    pub kind: ModelKind,
    /// Error of the calibrated camera if this model is right.
    pub difference: ProjectionDifference,
}

/// If two models differ by more than this at a position (px), the wrong model had no events in that part of the image
/// and only extrapolates there.
const EXTRAPOLATED_DIFFERENCE: f64 = 1.0;

/// Size of the difference at such positions, as a multiple of the largest difference. It is more than 1, because the
/// other model had no events there either. Chosen on seed 11 of wrong models, some of which are tens of pixels off
/// there.
const EXTRAPOLATION_FACTOR: f64 = 2.0;

/// Difference between a lens model and the lens.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Misfit {
    /// Error of the projection over the sensor that the model causes (rms, px).
    pub rms: f64,
    /// A model without that error, if there is one.
    pub better: Option<OtherModel>,
}

/// Computes the misfit of the model of `state`, the solution of `problem`. `pattern` is the pattern in its residuals, and
/// `inflation` the variance of the estimate divided by the variance with independent events.
pub fn misfit(problem: &Problem, state: &State, pattern: &ResidualPattern, inflation: f64) -> Misfit {
    let better = better_model(problem, state, inflation);
    let rms = better.as_ref().map_or(0.0, |better| cautious_rms(&better.difference)).max(pattern.shift);
    Misfit { rms, better }
}

/// Returns the root mean square of a difference over the sensor. Positions with more than [`EXTRAPOLATED_DIFFERENCE`]
/// count as [`EXTRAPOLATION_FACTOR`] times the largest difference.
fn cautious_rms(difference: &ProjectionDifference) -> f64 {
    let squares = difference.grid.iter().filter_map(|place| {
        let [x, y] = place.difference?;
        let size = x.hypot(y);
        Some(if size > EXTRAPOLATED_DIFFERENCE { EXTRAPOLATION_FACTOR * difference.max } else { size }.powi(2))
    });
    let (count, sum) = squares.fold((0_usize, 0.0), |(count, sum), square| (count + 1, sum + square));
    (sum / count.max(1) as f64).sqrt()
}

/// Returns `true` if another lens model with the present board explains the events better than this lens model with a
/// board of another `shape`, whose `estimated` parameters are part of the solve.
pub fn lens_explains_more(
    problem: &Problem,
    state: &State,
    shape: BoardShape,
    estimated: [bool; BOARD_PARAMETERS],
    inflation: f64,
) -> bool {
    let step = thinning(problem);
    let own = state.camera.kind();
    let free = FreeParameters { board: estimated, ..problem.free };
    let shaped = State { board: shape, ..state.clone() };
    let Ok(with_shape) = solve(&thinned(problem, step, free, SHAPE_ITERATIONS), shaped) else { return false };
    let chance = CERTAIN * (inflation / step as f64).max(1.0);
    CANDIDATES.into_iter().filter(|&kind| kind != own).any(|kind| {
        let Some(camera) = refitted(kind, &state.camera, problem.sensor) else { return false };
        let free = FreeParameters { intrinsics: intrinsics_of(kind), ..problem.free };
        let solved = solve(&thinned(problem, step, free, ITERATIONS), State { camera, ..state.clone() });
        solved.is_ok_and(|solved| solved.report.final_cost + chance < with_shape.report.final_cost)
    })
}

/// Returns the stride of the events with which a model is tried.
fn thinning(problem: &Problem) -> usize {
    let count: usize = problem.segments.iter().map(|segment| segment.events.len()).sum();
    (count / EVENTS).max(1)
}

fn intrinsics_of(kind: ModelKind) -> [bool; MAX_PARAMETERS] {
    std::array::from_fn(|index| index < kind.parameter_names().len())
}

/// Returns `problem` with one in `step` of its events and these estimated parameters.
fn thinned(problem: &Problem, step: usize, free: FreeParameters, iterations: usize) -> Problem {
    let segments = problem.segments.iter().map(|segment| segment.every(step)).collect();
    Problem { iterations, free, ..problem.with_segments(segments) }
}

/// Returns the camera of model `kind` nearest to `camera`, which may fold over: on the pixels that have a bearing.
pub fn refitted(kind: ModelKind, camera: &Camera<f64>, sensor: Sensor) -> Option<Camera<f64>> {
    refit_where(kind, camera, sensor, |pixel| camera.unproject(pixel).is_some())
}

/// A model that was solved with a part of the events.
struct Tried {
    kind: ModelKind,
    camera: Camera<f64>,
    cost: f64,
}

/// The model of a solution and other models, solved with the same part of the events.
struct Comparison {
    own_cost: f64,
    others: Vec<Tried>,
    /// Number of observations.
    count: f64,
    /// Variance of the estimate divided by the variance with independent observations.
    inflation: f64,
}

/// Solves the model of `state` and `others` with a part of the events of `problem`.
fn compare(problem: &Problem, state: &State, others: &[ModelKind], inflation: f64) -> Option<Comparison> {
    let step = thinning(problem);
    let own = state.camera.kind();
    let iterations = if folds(&state.camera, problem.sensor) { FOLDED_ITERATIONS } else { ITERATIONS };
    let solved = |kind: ModelKind, camera: Camera<f64>| {
        let free = FreeParameters { intrinsics: intrinsics_of(kind), ..problem.free };
        let solved = solve(&thinned(problem, step, free, iterations), State { camera, ..state.clone() }).ok()?;
        Some(Tried { kind, camera: solved.estimate.camera, cost: solved.report.final_cost })
    };
    let own_cost = solved(own, state.camera)?.cost;
    let others = others
        .iter()
        .filter(|&&kind| kind != own)
        .filter_map(|&kind| solved(kind, refitted(kind, &state.camera, problem.sensor)?))
        .collect();
    let count: usize = problem.segments.iter().map(|segment| segment.events.len()).sum();
    let inflation = (inflation / step as f64).max(1.0);
    Some(Comparison { own_cost, others, count: count as f64 / step as f64, inflation })
}

fn better_model(problem: &Problem, state: &State, inflation: f64) -> Option<OtherModel> {
    let Comparison { own_cost, others, inflation, .. } = compare(problem, state, &CANDIDATES, inflation)?;
    let own_folds = folds(&state.camera, problem.sensor);
    let best = others.iter().map(|other| other.cost).fold(f64::INFINITY, f64::min);
    let chance = CERTAIN * inflation;
    // Of the models that explain as much, the first that does not fold over inside the image.
    let as_good = others.into_iter().filter(|other| other.cost <= best + chance);
    let Tried { kind, camera, cost } = as_good.min_by_key(|other| folds(&other.camera, problem.sensor))?;
    let is_better =
        best + chance < own_cost || own_folds && cost <= own_cost + chance && !folds(&camera, problem.sensor);
    let difference = projection_difference(&state.camera, &camera, problem.sensor).ok()?;
    is_better.then_some(OtherModel { kind, difference })
}

/// Returns the one of `models` that may be right instead of the model of `state`, the solution of `problem`, and differs most from it
/// over the sensor: it explains the events about as well, and does not fold over inside the image.
pub fn rival(problem: &Problem, state: &State, models: &[ModelKind], inflation: f64) -> Option<OtherModel> {
    if models.is_empty() || folds(&state.camera, problem.sensor) {
        return None;
    }
    let Comparison { own_cost, others, count, inflation } = compare(problem, state, models, inflation)?;
    let criterion = |kind: ModelKind, cost: f64| {
        cost / inflation + kind.parameter_names().len() as f64 * (count / inflation).max(1.0).ln()
    };
    let own = criterion(state.camera.kind(), own_cost);
    others
        .into_iter()
        .filter(|other| criterion(other.kind, other.cost) <= own + STRONG_EVIDENCE)
        .filter(|other| !folds(&other.camera, problem.sensor))
        .filter_map(|Tried { kind, camera, .. }| {
            let difference = projection_difference(&state.camera, &camera, problem.sensor).ok()?;
            Some(OtherModel { kind, difference })
        })
        .max_by(|a, b| a.difference.rms.total_cmp(&b.difference.rms))
}

/// Enlarges `uncertainty` so that the bound of `projection` includes an error of the lens model of `rms` over the sensor (px).
pub fn with_misfit(uncertainty: Uncertainty, projection: &ProjectionUncertainty, rms: f64) -> Uncertainty {
    if projection.rms_95 <= 0.0 {
        return uncertainty;
    }
    let larger = (1.0 + rms / projection.rms_95).powi(2);
    let covariance: DMatrix<f64> = uncertainty.covariance * larger;
    Uncertainty { covariance, inflation: uncertainty.inflation * larger, ..uncertainty }
}

#[cfg(test)]
mod tests {
    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::quality::uncertainty::projection::projection_uncertainty;

    /// A pinhole model that was fitted to a fisheye defines less than half of the pixels. A comparison over the whole sensor found no
    /// camera of another model, so the verdict blamed the board.
    #[test]
    fn a_folded_camera_has_a_neighbour_of_another_model() {
        let sensor = Sensor::new(346, 260);
        let parameters = [102.7, 102.7, 173.1, 130.1, -0.24, 0.055, 0.0, 0.0, -0.0056];
        let folded = Camera::from_parameters(ModelKind::Radtan, &parameters).unwrap();
        assert_eq!(evcal_core::camera::refit::refit(ModelKind::KannalaBrandt, &folded, sensor), None);
        let near = refitted(ModelKind::KannalaBrandt, &folded, sensor).unwrap();
        for pixel in [[173.0, 130.0], [200.0, 130.0], [130.0, 150.0], [173.0, 180.0]].map(nalgebra::Vector2::from) {
            let seen = near.project(&folded.unproject(&pixel).unwrap()).unwrap();
            assert!((seen - pixel).norm() < 2.0, "{pixel} {seen}");
        }
        // Of a camera that defines all pixels, it is the fit over the whole sensor.
        let parameters = [331.0, 332.0, 176.0, 134.0, -0.35, 0.15, -4e-4, 5e-4, -0.03];
        let whole = Camera::from_parameters(ModelKind::Radtan, &parameters).unwrap();
        let over_all = evcal_core::camera::refit::refit(ModelKind::Eucm, &whole, sensor);
        assert!(over_all.is_some() && over_all == refitted(ModelKind::Eucm, &whole, sensor));
    }

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
        let after = bound(&with_misfit(uncertainty, &before, 0.3));
        assert!((after.rms_95 - before.rms_95 - 0.3).abs() < 1e-9, "{} {}", before.rms_95, after.rms_95);
    }
}
