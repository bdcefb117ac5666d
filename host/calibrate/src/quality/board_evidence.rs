//! Evidence in the observations that the board differs from its nominal shape, in print ratio, bend and radius.
//!
//! After the solve, one Newton step in which these four parameters are estimated too returns their values. Their
//! uncertainty follows from the scatter of blocks of time, as for the intrinsics, with each block evaluated at the end
//! of the step. For example, if two halves of a recording require opposite bends, σ becomes large. A parameter is
//! selected if its step is far beyond its σ and large enough to matter. Then the solve is repeated with the selected
//! parameters estimated.

use evcal_core::camera::Camera;
use evcal_core::settings;
use serde::{Deserialize, Serialize};

use evcal_geometry::board::Board;
use evcal_geometry::board::shape::{BoardShape, PARAMETERS};
use evcal_solve::solve::equations::system::Contribution;
use evcal_solve::solve::refinement::Refined;
use evcal_solve::solve::rows::event_bias::bias::Bias;
use evcal_solve::solve::{BOARD_INDEX, FreeParameters, Problem, State};

settings! {
    /// Estimation of the board's shape.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct BoardShapeSettings {
        /// Estimate print ratio, bend and radius of the board if the observations require it.
        pub estimate: bool = true;
    }
}

/// Smallest deviation of an estimated board parameter from its nominal value, in units of its standard deviation (σ): print
/// ratio, bend along x and y, and the radius, which affects nothing else and is less well determined. This limit and the three
/// below were chosen on simulated boards with defects and on flat ones (seeds 1 to 7); no flat board was called bent.
const SIGNIFICANCE: [f64; PARAMETERS] = [5.0, 5.0, 5.0, 3.0];
/// Smallest difference of the print's scales along x and y that is estimated, as a share.
const SMALLEST_RATIO: f64 = 2e-4;
/// Smallest bend that is estimated, as a share of the longer side of the circles' area.
const SMALLEST_BEND: f64 = 1e-4;
/// Smallest difference of the radius that is estimated, as a share of the nominal one, or of half the width of a square or
/// module.
const SMALLEST_RADIUS: f64 = 0.017;

/// Index of the radius among the parameters.
pub const RADIUS: usize = PARAMETERS - 1;

/// Estimates of all parameters of the board from the observations, in the order of the solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardEvidence {
    /// Estimated value of each parameter.
    pub values: [f64; PARAMETERS],
    /// Its standard deviation; infinite if it cannot be determined.
    pub sigma: [f64; PARAMETERS],
}

/// Returns the parameters of the board that the observations of `problem` can determine. Circle centres do not
/// determine the radius. Events determine it only if their offsets are estimated, because an error of a fixed offset
/// looks like an error of the radius.
pub fn testable(problem: &Problem) -> [bool; PARAMETERS] {
    let offsets = problem.free.biases.iter().any(|biases| biases[Bias::Offset]);
    let points = problem.segments.iter().any(|segment| !segment.points.is_empty());
    let shape = offsets || points;
    [shape, shape, shape, offsets]
}

/// Returns the estimated parameters of `problem` together with the board's parameters.
pub fn with_board(problem: &Problem) -> FreeParameters {
    let testable = testable(problem);
    FreeParameters { board: std::array::from_fn(|index| problem.free.board[index] || testable[index]), ..problem.free }
}

/// Returns a `contribution` as it is after the `step` of the global parameters; `free` marks those that change.
pub fn after(step: &[f64], contribution: Contribution, free: &[bool]) -> Contribution {
    let moved = nalgebra::DVector::from_iterator(
        free.iter().filter(|&&free| free).count(),
        step.iter().zip(free).filter(|(_, free)| **free).map(|(value, _)| *value),
    );
    Contribution { gradient: contribution.gradient + &contribution.information * moved, ..contribution }
}

/// The board in a solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardEstimate {
    /// Its shape.
    pub shape: BoardShape,
    /// `true` for its estimated parameters.
    pub estimated: [bool; PARAMETERS],
    /// Their standard deviations; zero for nominal values.
    pub sigma: [f64; PARAMETERS],
    /// Evidence from the observations with all parameters estimated.
    pub evidence: Option<BoardEvidence>,
    /// The camera with the nominal board; `None` if no parameter was estimated.
    pub camera_with_nominal_board: Option<Camera<f64>>,
}

impl BoardEstimate {
    /// Creates the estimate of the board of `refined` with its `sigma` and the `evidence` there; `camera_with_nominal_board` is the
    /// camera of the solve with the nominal board.
    pub fn new(
        refined: &Refined,
        sigma: [f64; PARAMETERS],
        evidence: Option<BoardEvidence>,
        camera_with_nominal_board: Option<Camera<f64>>,
    ) -> Self {
        Self {
            shape: refined.state.board,
            estimated: refined.problem.free.board,
            sigma,
            evidence,
            camera_with_nominal_board,
        }
    }
}

impl BoardEvidence {
    /// Returns the board of `state` after the `step` of the global parameters. Its σ follow from the variances of its `testable`
    /// parameters, in their order, and from an error of the radius that no scatter shows.
    pub fn new(
        state: &State,
        step: &[f64],
        testable: [bool; PARAMETERS],
        variances: impl Iterator<Item = f64>,
        radius_error: f64,
    ) -> Self {
        let steps = step.iter().skip(BOARD_INDEX);
        let mut values = state.board.parameters();
        values.iter_mut().zip(steps).for_each(|(value, step)| *value += step);
        let mut sigma = [f64::INFINITY; PARAMETERS];
        let tested = sigma.iter_mut().zip(testable).filter(|(_, testable)| *testable);
        tested.zip(variances).for_each(|((sigma, _), variance)| *sigma = variance.max(0.0).sqrt());
        sigma[RADIUS] = libm::hypot(sigma[RADIUS], radius_error);
        Self { values, sigma }
    }

    /// Returns the parameters that differ significantly from the `nominal` shape of `board`.
    pub fn supported_parameters(&self, nominal: &BoardShape, board: &Board) -> [bool; PARAMETERS] {
        let nominal = nominal.parameters();
        let bend = SMALLEST_BEND * board.longer_side();
        let smallest = [SMALLEST_RATIO, bend, bend, SMALLEST_RADIUS * board.print_radius()];
        std::array::from_fn(|index| {
            let difference = (self.values[index] - nominal[index]).abs();
            difference > SIGNIFICANCE[index] * self.sigma[index] && difference > smallest[index]
        })
    }
}
