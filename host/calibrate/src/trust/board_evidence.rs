//! Whether the board is as it is stated: what the observations say of its print ratio, bending and radius.
//!
//! From where the solve ended, one step of Newton's method with these four free beside all else tells where they would go. How
//! sure that is, the scatter of blocks of time tells, as it does for the intrinsics, each block counted from where the step
//! leads: two halves of a recording that want the board bent to opposite sides make the σ large. A parameter is asked for where
//! its step is far beyond its σ and large enough to matter. Then the solve is repeated with it free.

use evcal_core::camera::Camera;
use evcal_core::settings;
use serde::{Deserialize, Serialize};

use crate::solve::event_bias::bias::Bias;
use crate::solve::refinement::Refined;
use crate::solve::system::Contribution;
use crate::solve::{BOARD_INDEX, FreeParameters, Problem, State};
use evcal_geometry::board::Board;
use evcal_geometry::board::shape::{BoardShape, PARAMETERS};

settings! {
    /// When the board is not taken as it is stated.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct BoardShapeSettings {
        /// Estimate print ratio, bending and radius of the board where the observations ask for it.
        pub estimate: bool = true;
    }
}

/// How far from what is stated a parameter of the board must come out, in units of its standard deviation (σ): print ratio, bend
/// along x and y, and the radius, which changes nothing else and is known less well.
const SIGNIFICANCE: [f64; PARAMETERS] = [5.0, 5.0, 5.0, 3.0];
/// Smallest difference of the print's scales along x and y that is estimated, as a share.
const SMALLEST_RATIO: f64 = 2e-4;
/// Smallest bend that is estimated, as a share of the longer side of the circles' area.
const SMALLEST_BEND: f64 = 1e-4;
/// Smallest difference of the radius that is estimated, as a share of the stated one, or of half the width of a square or module.
const SMALLEST_RADIUS: f64 = 0.017;

/// Where the radius is among the parameters.
pub const RADIUS: usize = PARAMETERS - 1;

/// What the observations say of the board, with all its parameters free, each in the order of the solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardEvidence {
    /// Where each parameter would go.
    pub values: [f64; PARAMETERS],
    /// Its standard deviation there; infinite where it cannot be told.
    pub sigma: [f64; PARAMETERS],
}

/// Which parameters of the board the observations of `problem` tell anything of: circle centres nothing of the radius, and events
/// without offsets of their own cannot tell it from these.
pub fn testable(problem: &Problem) -> [bool; PARAMETERS] {
    let offsets = problem.free.biases.iter().any(|biases| biases[Bias::Offset]);
    let points = problem.segments.iter().any(|segment| !segment.points.is_empty());
    let shape = offsets || points;
    [shape, shape, shape, offsets]
}

/// The free parameters of `problem` and those of the board.
pub fn with_board(problem: &Problem) -> FreeParameters {
    let testable = testable(problem);
    FreeParameters { board: std::array::from_fn(|index| problem.free.board[index] || testable[index]), ..problem.free }
}

/// A `contribution` as it is where the `step` of the global parameters leads to, in which all of `free` may move.
pub fn after(step: &[f64], contribution: Contribution, free: &[bool]) -> Contribution {
    let moved = nalgebra::DVector::from_iterator(
        free.iter().filter(|&&free| free).count(),
        step.iter().zip(free).filter(|(_, free)| **free).map(|(value, _)| *value),
    );
    Contribution { gradient: contribution.gradient + &contribution.information * moved, ..contribution }
}

/// The board as the solve has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardEstimate {
    /// Its shape.
    pub shape: BoardShape,
    /// Which of its parameters were estimated.
    pub estimated: [bool; PARAMETERS],
    /// Their standard deviations; zero where a parameter is as stated.
    pub sigma: [f64; PARAMETERS],
    /// What the observations say with all parameters free.
    pub evidence: Option<BoardEvidence>,
    /// The camera with the board as it is stated; `None` where nothing was estimated.
    pub camera_as_stated: Option<Camera<f64>>,
}

impl BoardEstimate {
    /// The board of `refined` with its `sigma` and with the `evidence` there; `camera_as_stated` came out
    /// before.
    pub fn new(
        refined: &Refined,
        sigma: [f64; PARAMETERS],
        evidence: Option<BoardEvidence>,
        camera_as_stated: Option<Camera<f64>>,
    ) -> Self {
        Self { shape: refined.state.board, estimated: refined.problem.free.board, sigma, evidence, camera_as_stated }
    }
}

impl BoardEvidence {
    /// Where the `step` of the global parameters leads the board of `state`, and how sure that is by the variances of its `testable` parameters, in their
    /// order, and by an error of the radius that no scatter shows.
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
        let told = sigma.iter_mut().zip(testable).filter(|(_, told)| *told);
        told.zip(variances).for_each(|((sigma, _), variance)| *sigma = variance.max(0.0).sqrt());
        sigma[RADIUS] = libm::hypot(sigma[RADIUS], radius_error);
        Self { values, sigma }
    }

    /// Which parameters are not as in the `stated` shape of `board`.
    pub fn asks_for(&self, stated: &BoardShape, board: &Board) -> [bool; PARAMETERS] {
        let stated = stated.parameters();
        let bend = SMALLEST_BEND * board.longer_side();
        let smallest = [SMALLEST_RATIO, bend, bend, SMALLEST_RADIUS * board.print_radius()];
        std::array::from_fn(|index| {
            let difference = (self.values[index] - stated[index]).abs();
            difference > SIGNIFICANCE[index] * self.sigma[index] && difference > smallest[index]
        })
    }
}
