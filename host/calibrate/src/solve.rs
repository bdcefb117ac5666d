//! Sections 9 and 10 of method.md: the joint solve.
//!
//! The intrinsics, the control points of every trajectory segment and the biases of the event
//! classes together minimise Σ ρ(r), where r is the distance of an event from its edge of the
//! print, carried to the board plane through the pose at the event's own time (paper, eq. of
//! III-C). Levenberg-Marquardt on the normal equations, which are block-banded per segment with a
//! border of global parameters ([`normal`]); the rows are analytic ([`event_row`], [`point_row`]).

pub mod association;
pub mod bearing_table;
pub mod board_edge;
pub mod board_ray;
pub mod board_surface;
pub mod bordered;
pub mod burst;
pub mod control_band;
pub mod edge_batch;
pub mod eliminated;
pub mod event_bias;
pub mod event_row;
pub mod event_sample;
pub mod half;
pub mod held_camera;
pub mod held_intrinsics;
pub mod knot_choice;
pub mod knot_fit;
pub mod left_out;
pub mod levenberg;
pub mod loss;
pub mod normal;
pub mod observation;
pub mod point_row;
pub mod pose_bin;
pub mod pose_covariance;
pub mod refinement;
pub mod residual_statistics;
pub mod row_batch;
pub mod row_products;
pub mod smoothness;
pub mod stiffness;
pub mod stretch;
pub mod system;
pub mod unexplained;

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use evcal_core::settings;
use serde::{Deserialize, Serialize};

use crate::solve::event_bias::bias::{Bias, Biases};
use crate::solve::event_bias::{BIAS_COUNT, CLASS_COUNT, EventBias, bias_place};
use crate::trajectory::Trajectory;
use board_edge::BoardEdges;
use evcal_core::camera::MAX_PARAMETERS;
use evcal_geometry::board::shape::{self, BoardShape, CircleArea};
use observation::SegmentObservations;
use stiffness::Stiffness;

/// Number of parameters of the board: print ratio, bend along x and y, radius (see [`BoardShape`]).
pub const BOARD_PARAMETERS: usize = shape::PARAMETERS;

/// Number of global parameters: intrinsics, the board's, then the biases of the event classes.
pub const GLOBAL_COUNT: usize = MAX_PARAMETERS + BOARD_PARAMETERS + BIAS_COUNT;

/// Index of the first parameter of the board among the global parameters.
pub const BOARD_INDEX: usize = MAX_PARAMETERS;

/// Index of a bias of `class` among the global parameters; some classes share biases.
pub const fn bias_index(class: usize, bias: Bias) -> usize {
    MAX_PARAMETERS + BOARD_PARAMETERS + bias_place(class, bias)
}

/// What the residual of an event measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ResidualMeasure {
    /// Distance from the edge divided by the local scale of the board in the image: pixels, so that
    /// noise counts alike near and far, head-on and tilted.
    Pixel,
    /// Distance from the edge on the board plane, as in the paper, in units of the mean scale.
    Plane,
}

/// Which parameters beside the control points may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FreeParameters {
    /// Which intrinsics are free, in the order of the camera model; those beyond its own stay unused.
    pub intrinsics: [bool; MAX_PARAMETERS],
    /// Which parameters of the board are free.
    pub board: [bool; BOARD_PARAMETERS],
    /// Which biases of each event class are free; one that classes share is free if it is in any of them.
    pub biases: [Biases<bool>; CLASS_COUNT],
}

impl FreeParameters {
    /// One flag for each global parameter.
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

    /// Where those that are free stand among the global parameters.
    pub fn places(&self) -> Vec<usize> {
        places(&self.mask())
    }
}

/// Where the set flags of `mask` are.
pub fn places(mask: &[bool; GLOBAL_COUNT]) -> Vec<usize> {
    (0..GLOBAL_COUNT).filter(|&global| mask[global]).collect()
}

settings! {
    /// The joint solve (sections 9 and 10 of method.md).
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct SolveSettings {
        /// What a residual measures: `"pixel"`, the distance to the projected edge, or `"plane"`, the paper's
        /// distance on the board plane. With `"plane"` no biases of event classes are fitted in the solve.
        pub residual: ResidualMeasure = ResidualMeasure::Pixel;
    }
}

/// Residual from which an event counts linearly instead of squared, in units of its class's spread (σ).
pub const HUBER: f64 = 1.5;
/// Most Levenberg-Marquardt iterations in one solve.
pub const ITERATIONS: usize = 12;

/// What the joint solve works on; nothing of it changes while it runs.
pub struct Problem {
    /// Sensor size (width, height) in pixels.
    pub sensor: Sensor,
    /// The points of the board on the print, in metres.
    pub points: Vec<[f64; 2]>,
    /// The edges of the print.
    pub edges: BoardEdges,
    /// The area that they cover.
    pub area: CircleArea,
    /// Metres on the board for each pixel, on average: the unit of the plane residual.
    pub mean_scale: f64,
    /// Spread of a circle centre in pixels, for observations that are centres.
    pub point_sigma: f64,
    /// Latency of each event class that the association took off the events' times (s).
    pub associated_latencies: [f64; CLASS_COUNT],
    /// Observations of each segment.
    pub segments: Vec<SegmentObservations>,
    /// What the jerks of each segment's trajectory weigh; empty: nothing.
    pub stiffness: Vec<Stiffness>,
    /// Which parameters may change.
    pub free: FreeParameters,
    /// What a residual measures.
    pub residual: ResidualMeasure,
    /// Residual from which an event counts linearly instead of squared (σ of its class); [`HUBER`] but for tests.
    pub huber: f64,
    /// Most iterations; [`ITERATIONS`] where the result counts.
    pub iterations: usize,
}

impl Problem {
    /// The same with other observations.
    pub fn with_segments(&self, segments: Vec<SegmentObservations>) -> Self {
        Self {
            segments,
            stiffness: self.stiffness.clone(),
            points: self.points.clone(),
            edges: self.edges.clone(),
            ..*self
        }
    }

    /// The same with every `step`-th event, and all circle centres.
    pub fn every(&self, step: usize) -> Self {
        self.with_segments(self.segments.iter().map(|segment| segment.every(step)).collect())
    }

    /// Metres on the board for each unit of the residual, where that is the same everywhere.
    pub fn residual_scale(&self) -> Option<f64> {
        match self.residual {
            ResidualMeasure::Pixel => None,
            ResidualMeasure::Plane => Some(self.mean_scale),
        }
    }
}

/// The parameters: camera, board, biases of the event classes, one trajectory a segment.
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

/// How a solve went.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SolveReport {
    /// Observations used.
    pub observations: usize,
    /// Iterations made.
    pub iterations: usize,
    /// Steps that were taken back.
    pub rejected: usize,
    /// Sum of ρ before.
    pub initial_cost: f64,
    /// Sum of ρ after.
    pub final_cost: f64,
}

/// Why a joint solve failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SolveError {
    /// There is nothing to solve from.
    #[error("no event lies near the board's circles: is the board description right?")]
    NoObservations,
    /// The normal equations are singular.
    #[error("the observations do not determine the camera: move the board closer, tilt it and cover the whole image")]
    Singular,
}
