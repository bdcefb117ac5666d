//! Prediction error of a camera on views from which it was not calibrated.
//!
//! The frames are cut into blocks of neighbours, and the blocks are distributed over folds. For each fold the camera is refined
//! on the frames of the other folds; then the pose of every frame of the fold is estimated with that camera fixed, and the cost
//! of its circles is summed. Neighbouring frames show the board at nearly the same pixels, so single frames are not
//! independent, but blocks of frames are.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;
use rayon::prelude::*;
use serde::Serialize;

use super::InitialModel;
use super::bundle::{BundleView, bundle};
use super::pose::refine_pose;
use super::settings::{HUBER, InitialSettings};
use super::sighting::BoardPoint;
use super::view_selection::select_views;
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_geometry::board::Board;
use evcal_geometry::numerics::huber::huber_cost;

/// Cost of held-out points with one camera model.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct HeldOutCost {
    /// Number of held-out points.
    pub count: usize,
    /// Mean Huber's loss of a point in each block (px²), in the order of the blocks.
    pub block_costs: Vec<f64>,
}

impl HeldOutCost {
    /// Returns the mean of the blocks' costs (px²).
    pub fn mean(&self) -> f64 {
        self.block_costs.iter().sum::<f64>() / self.block_costs.len().max(1) as f64
    }
}

/// Number of blocks of neighbouring frames.
const BLOCKS: usize = 20;
/// Number of folds, over which the blocks are distributed; each is held out once.
const FOLDS: usize = 5;
/// Number of views that refine the camera of each fold.
const VIEWS: usize = 100;

/// Circles of one frame, all at the frame's time.
#[derive(Clone, Debug)]
struct SeenFrame {
    points: Vec<BoardPoint>,
    /// `T_camera_world`.
    pose: Isometry3<f64>,
}

/// Circles on which camera models are compared, the same for all.
#[derive(Clone, Debug)]
pub struct ComparedCircles {
    frames: Vec<SeenFrame>,
}

impl ComparedCircles {
    /// Returns the circles of `model`, which was computed from `frames`.
    pub fn new(model: &InitialModel, frames: &[ReferenceFrame], board: &Board) -> Self {
        let seen = |posed: &super::PosedFrame| {
            let t = frames.get(posed.frame)?.t();
            let points = posed.circles.iter().map(|circle| BoardPoint {
                object: board.point(circle.index),
                image: circle.center + circle.velocity.unwrap_or_default() * (t - circle.t),
            });
            Some(SeenFrame { points: points.collect(), pose: posed.pose.inverse() })
        };
        Self { frames: model.frames.iter().filter_map(seen).collect() }
    }
}

/// Computes the cost of held-out points, with cameras of the model of `start`; `None` if a camera cannot be refined without one
/// of the folds.
///
/// `sensor` is (width, height) in pixels. In a frame without a pose, because the model does not reach its circles, each circle
/// costs as much as if its error were [`InitialSettings::max_circle_error`].
pub fn held_out(
    circles: &ComparedCircles,
    start: &Camera<f64>,
    board: &Board,
    sensor: Sensor,
    settings: &InitialSettings,
) -> Option<HeldOutCost> {
    let frames = &circles.frames;
    let blocks = BLOCKS.min(frames.len().max(1));
    let folds = FOLDS.min(blocks.max(2));
    let block_of = |position: usize| position * blocks / frames.len().max(1);
    let lost = huber_cost(settings.max_circle_error.powi(2), HUBER);
    let posed = |camera: &Camera<f64>, frame: &SeenFrame| refine_pose(camera, &frame.points, &frame.pose, HUBER);
    let mut sums = vec![(0.0, 0_usize); blocks];
    for fold in 0..folds {
        let in_fold = |position: usize| block_of(position) % folds == fold;
        let others: Vec<&SeenFrame> =
            frames.iter().enumerate().filter(|(position, _)| !in_fold(*position)).map(|(_, frame)| frame).collect();
        let points: Vec<&[BoardPoint]> = others.iter().map(|frame| frame.points.as_slice()).collect();
        let chosen = select_views(&points, board, sensor, VIEWS);
        let views: Vec<BundleView<'_>> = chosen
            .par_iter()
            .map(|&position| {
                let frame = others.get(position)?;
                Some(BundleView { points: &frame.points, pose: posed(start, frame)?.pose, noise: 1.0 })
            })
            .collect::<Vec<_>>()
            .into_iter()
            .flatten()
            .collect();
        if views.len() < settings.min_frames {
            return None;
        }
        let free = vec![true; start.kind().parameter_names().len()];
        let camera = bundle(start, &views, &free, sensor, HUBER)?.camera;
        let costs: Vec<(usize, f64, usize)> = frames
            .par_iter()
            .enumerate()
            .filter(|(position, _)| in_fold(*position))
            .map(|(position, frame)| {
                let count = frame.points.len();
                let cost = posed(&camera, frame).map_or(lost * count as f64, |fit| fit.cost.min(lost * count as f64));
                (block_of(position), cost, count)
            })
            .collect();
        for (block, cost, count) in costs {
            if let Some(sum) = sums.get_mut(block) {
                sum.0 += cost;
                sum.1 += count;
            }
        }
    }
    Some(HeldOutCost {
        count: sums.iter().map(|sum| sum.1).sum(),
        block_costs: sums.iter().filter(|sum| sum.1 > 0).map(|(cost, count)| cost / *count as f64).collect(),
    })
}
