//! The joint solve (sections 9 and 10 of method.md).
//!
//! Estimates the intrinsics, the control points of every trajectory segment and the biases of the event classes together. They
//! minimise Σ ρ(r), where r is the distance of an event from its edge on the print. The event is projected onto the board plane
//! with the pose at the event's own time (equation of section III-C of the paper). The optimiser is Levenberg-Marquardt. Its
//! normal equations are block-banded per segment, with a border of global parameters ([`equations`]); the rows are analytic ([`rows`]).

pub mod association;
pub mod equations;
pub mod event_sample;
pub mod fixed_camera;
pub mod fixed_intrinsics;
pub mod half;
pub mod knot_choice;
pub mod left_out;
pub mod lens_step;
pub mod levenberg;
pub mod observation;
pub mod observation_range;
pub mod refinement;
pub mod residual_statistics;
pub mod rows;
pub mod unexplained;

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use evcal_core::settings;
use serde::{Deserialize, Serialize};

use crate::trajectory::Trajectory;
use equations::stiffness::Stiffness;
use evcal_core::camera::MAX_PARAMETERS;
use evcal_geometry::board::shape::{self, BoardShape, CircleArea};
use observation::SegmentObservations;
use rows::board_edge::BoardEdges;
use rows::event_bias::bias::{Bias, Biases};
use rows::event_bias::{BIAS_COUNT, CLASS_COUNT, EventBias, bias_place};

/// Number of parameters of the board: print ratio, bend along x and y, radius (see [`BoardShape`]).
pub const BOARD_PARAMETERS: usize = shape::PARAMETERS;

/// Number of global parameters: the intrinsics, the parameters of the board, then the biases of the event classes.
pub const GLOBAL_COUNT: usize = MAX_PARAMETERS + BOARD_PARAMETERS + BIAS_COUNT;

/// Index of the first parameter of the board among the global parameters.
pub const BOARD_INDEX: usize = MAX_PARAMETERS;

/// Returns the index of a bias of `class` among the global parameters; some classes share biases.
pub const fn bias_index(class: usize, bias: Bias) -> usize {
    MAX_PARAMETERS + BOARD_PARAMETERS + bias_place(class, bias)
}

/// The quantity that the residual of an event measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ResidualMeasure {
    /// Distance from the edge divided by the local scale of the board in the image (pixels), so that noise has the same weight
    /// near and far, head-on and tilted.
    Pixel,
    /// Distance from the edge on the board plane, as in the paper, in units of the mean scale.
    Plane,
}

/// Flags of the parameters that are estimated, in addition to the control points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FreeParameters {
    /// `true` for each estimated intrinsic, in the order of the camera model; entries beyond its parameters are unused.
    pub intrinsics: [bool; MAX_PARAMETERS],
    /// `true` for each estimated parameter of the board.
    pub board: [bool; BOARD_PARAMETERS],
    /// `true` for each estimated bias of each event class. A shared bias is estimated if it is estimated in any of the
    /// classes that share it.
    pub biases: [Biases<bool>; CLASS_COUNT],
}

impl FreeParameters {
    /// Returns one flag for each global parameter.
    pub fn mask(&self) -> [bool; GLOBAL_COUNT] {
        let mut mask = [false; GLOBAL_COUNT];
        for (flag, free) in mask.iter_mut().zip(self.intrinsics) {
            *flag = free;
        }
        for (flag, free) in mask.iter_mut().skip(BOARD_INDEX).zip(self.board) {
            *flag = free;
        }
        for (class, biases) in self.biases.iter().enumerate() {
            for bias in Bias::ALL {
                mask[bias_index(class, bias)] |= biases[bias];
            }
        }
        mask
    }

    /// Returns the indices of the estimated parameters among the global parameters.
    pub fn places(&self) -> Vec<usize> {
        places(&self.mask())
    }
}

/// Returns the indices of the set flags of `mask`.
pub fn places(mask: &[bool; GLOBAL_COUNT]) -> Vec<usize> {
    (0..GLOBAL_COUNT).filter(|&global| mask[global]).collect()
}

settings! {
    /// The joint solve (sections 9 and 10 of method.md).
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct SolveSettings {
        /// Quantity that a residual measures: `"pixel"`, the distance to the projected edge, or `"plane"`, the paper's distance
        /// on the board plane. With `"plane"` no biases of event classes are fitted in the solve.
        pub residual: ResidualMeasure = ResidualMeasure::Pixel;
    }
}

/// Residual from which an event counts linearly instead of squared, in units of its class's spread (σ).
pub const HUBER: f64 = 1.5;
/// Largest number of Levenberg-Marquardt iterations in one solve.
pub const ITERATIONS: usize = 12;

/// Input of the joint solve, constant while it runs.
pub struct Problem {
    /// Sensor size (width, height) in pixels.
    pub sensor: Sensor,
    /// The points of the board on the print, in metres.
    pub points: Vec<[f64; 2]>,
    /// The edges of the print.
    pub edges: BoardEdges,
    /// The area that the circles cover.
    pub area: CircleArea,
    /// Metres on the board per pixel, on average: the unit of the plane residual.
    pub mean_scale: f64,
    /// Spread of a circle centre in pixels, for observations that are centres.
    pub point_sigma: f64,
    /// Latency of each event class that the association subtracted from the events' times (s).
    pub associated_latencies: [f64; CLASS_COUNT],
    /// Observations of each segment.
    pub segments: Vec<SegmentObservations>,
    /// Weights of the jerks of each segment's trajectory; empty for no weight.
    pub stiffness: Vec<Stiffness>,
    /// The parameters that are estimated.
    pub free: FreeParameters,
    /// The quantity that a residual measures.
    pub residual: ResidualMeasure,
    /// Residual from which an event counts linearly instead of squared (σ of its class); [`HUBER`] except in tests.
    pub huber: f64,
    /// Largest number of iterations; [`ITERATIONS`] for solves that lead to a result.
    pub iterations: usize,
}

impl Problem {
    /// Returns the same problem with other observations.
    pub fn with_segments(&self, segments: Vec<SegmentObservations>) -> Self {
        Self {
            segments,
            stiffness: self.stiffness.clone(),
            points: self.points.clone(),
            edges: self.edges.clone(),
            ..*self
        }
    }

    /// Returns the same problem with every `step`-th event, and all circle centres.
    pub fn every(&self, step: usize) -> Self {
        self.with_segments(self.segments.iter().map(|segment| segment.every(step)).collect())
    }

    /// Returns the metres on the board per unit of the residual, if it is the same everywhere.
    pub fn residual_scale(&self) -> Option<f64> {
        match self.residual {
            ResidualMeasure::Pixel => None,
            ResidualMeasure::Plane => Some(self.mean_scale),
        }
    }
}

/// The estimated parameters: camera, board, biases of the event classes, and one trajectory per segment.
#[derive(Clone, Debug)]
pub struct State {
    /// Intrinsics.
    pub camera: Camera<f64>,
    /// The board.
    pub board: BoardShape,
    /// Offset, latency and spread of each event class.
    pub bias: EventBias,
    /// T_world_camera of each segment.
    pub trajectories: Vec<Trajectory>,
}

/// Statistics of a solve.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SolveReport {
    /// Observations used.
    pub observations: usize,
    /// Iterations made.
    pub iterations: usize,
    /// Number of steps that raised the cost and were undone.
    pub rejected: usize,
    /// Sum of ρ and of the costs of the trajectory priors before the solve.
    pub initial_cost: f64,
    /// Sum of ρ and of the costs of the trajectory priors after the solve.
    pub final_cost: f64,
}

/// Reasons why a joint solve failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SolveError {
    /// There are no observations.
    #[error("no event is near the board's circles: is the board description right?")]
    NoObservations,
    /// The normal equations are singular.
    #[error("the observations do not determine the camera: move the board closer, tilt it and cover the whole image")]
    Singular,
    /// An observation acts on parameters that its equations do not contain.
    #[error("an observation lies outside its equations: an error of this program, please report it")]
    OutOfBand,
}
