//! Thresholds of the initial model.

use std::fmt::Debug;

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use evcal_core::settings;
use evcal_core::settings::{above, at_least, from_to};
use serde::{Deserialize, Serialize};

use super::planar_pose::{PlanarPose, PlanePoint};
use super::report::OpencvStart;
use super::sighting::BoardPoint;
use crate::circles::reference_frame::ReferenceFrame;
use evcal_geometry::board::Board;
use evcal_geometry::board::homography::MINIMUM_POINTS;
use evcal_geometry::numerics::statistics::median;

/// Finds a first camera and the pose of a plane.
///
/// [`NativeStart`](super::NativeStart) is part of this crate; `evcal-opencv` has the other one.
pub trait Start: Debug + Send + Sync {
    /// Name for people.
    fn name(&self) -> &'static str;

    /// A first camera of model `kind` from some `views` of the board.
    fn camera(
        &self,
        kind: ModelKind,
        views: &[&[BoardPoint]],
        sensor: Sensor,
        settings: &InitialSettings,
    ) -> StartedCamera;

    /// `T_camera_world` of a plane of which some points may be wrong, by at most `iterations` samples. Points within `threshold` of
    /// their image, in units of the focal length, agree.
    fn plane_pose(&self, points: &[PlanePoint], threshold: f64, iterations: u16) -> Option<PlanarPose>;
}

/// Starts are equal that have the same name.
impl PartialEq for dyn Start {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

/// A first camera.
#[derive(Clone, Debug)]
pub struct StartedCamera {
    /// The camera; `None` where none was found.
    pub camera: Option<Camera<f64>>,
    /// How the calibration of OpenCV went; `None` for the native start.
    pub opencv: Option<OpencvStart>,
}

settings! {
    /// The first camera and the pose of every reference frame (section 5 of method.md).
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct InitialSettings {
        /// What the first camera and the poses of frames start from; `None` is the native start. Not in settings files: all
        /// reach the same camera.
        #[serde(skip)]
        pub start: Option<&'static dyn Start> = None;
        /// Fewest circles of a usable frame, and fewest that must agree with its pose. Never less than 4, never
        /// more than the board has.
        pub min_circles: usize = 8, "circles", at_least(4.0);
        /// Fewest frames from which a camera is estimated.
        pub min_frames: usize = 10, "frames", at_least(3.0);
        /// Longest time from a circle to the same circle in a neighbouring frame over which its motion is taken as
        /// straight.
        pub max_interpolation_gap: f64 = 0.1, "s", at_least(0.0);
        /// Neighbouring frames on each side that vote on a frame.
        pub voters: usize = 3, "frames", at_least(1.0);
        /// Rotation gate: fastest turn of the pattern's rows in the image.
        pub max_row_rate: f64 = 20.0, "rad/s", above(0.0);
        /// Rotation gate: turn of a row that noise and perspective explain at any rate.
        pub row_angle_floor: f64 = 0.1, "rad", at_least(0.0);
        /// Views of the first calibration.
        pub start_views: usize = 24, "views", at_least(3.0);
        /// Views of the bundle refinement after the first calibration.
        pub first_bundle_views: usize = 80, "views", at_least(3.0);
        /// Views of the last bundle refinement.
        pub bundle_views: usize = 400, "views", at_least(3.0);
        /// Largest root mean square error of OpenCV's calibration; above it the worst views are left out.
        pub max_start_rms: f64 = 1.0, "px", above(0.0);
        /// How often the worst views may be left out.
        pub start_retries: usize = 3, "times", at_least(0.0);
        /// Distance from which an observation counts linearly instead of squared.
        pub huber: f64 = 0.5, "px", above(0.0);
        /// Largest distance of a circle from its projection; beyond, it is left out of its frame. Circles with radii above 12 px may
        /// be further away, in proportion.
        pub max_circle_error: f64 = 3.0, "px", above(0.0);
        /// Samples of RANSAC for each frame.
        pub ransac_iterations: u16 = 100, "samples", at_least(1.0);
        /// Smallest share of a frame's circles that must agree with its pose.
        pub min_inlier_fraction: f64 = 0.6, "", above(0.0).at_most(1.0);
        /// Largest root mean square error of a frame; larger for circles with radii above 12 px, in proportion.
        pub max_frame_rms: f64 = 2.0, "px", above(0.0);
        /// Largest root mean square error of a frame as a multiple of the median of all frames.
        pub max_frame_rms_ratio: f64 = 5.0, "", at_least(1.0);
        /// Largest standard deviation of the focal length, as a share of it, that counts as calibrated.
        pub max_focal_deviation: f64 = 0.05, "", above(0.0);
        /// Velocity gate: fastest motion between board and camera.
        pub max_speed: f64 = 5.0, "m/s", above(0.0);
        /// Velocity gate: distance that noise of the poses explains at any speed.
        pub position_floor: f64 = 0.02, "m", at_least(0.0);
        /// Velocity gate: fastest rotation between board and camera.
        pub max_angular_speed: f64 = 20.0, "rad/s", above(0.0);
        /// Velocity gate: angle that noise of the poses explains at any speed.
        pub angle_floor: f64 = 0.05, "rad", at_least(0.0);
        /// Velocity gate: largest acceleration; judges a frame against the line between its neighbours.
        pub max_acceleration: f64 = 60.0, "m/s²", above(0.0);
        /// Velocity gate: largest angular acceleration.
        pub max_angular_acceleration: f64 = 300.0, "rad/s²", above(0.0);
        /// Velocity gate: largest acceleration and angular acceleration as a multiple of the recording's median.
        pub max_acceleration_ratio: f64 = 4.0, "", at_least(1.0);
        /// Longest time between two frames over which their motion is judged.
        pub max_motion_gap: f64 = 0.1, "s", above(0.0);
        /// Cross-validation.
        pub cross_validation: CrossValidationSettings;
    }
}

/// Radius of circles up to which the gates of pixels are as stated (px). What perspective, distortion and motion within a window do to the
/// centre of a circle's image grows with it.
const USUAL_RADIUS: f64 = 12.0;

/// How much further from where they are expected circles may be in frames of a rolling shutter.
const ROWS_IN_TURN: f64 = 10.0;

impl InitialSettings {
    /// As they are for `frames` of `board`: small boards may be used when they are complete, and large circles may be further from where
    /// they are expected.
    pub fn of_frames(&self, frames: &[ReferenceFrame], board: &Board) -> Self {
        let mut radii: Vec<f64> =
            frames.iter().flat_map(|frame| &frame.circles).filter_map(|circle| circle.radius).collect();
        let larger = median(&mut radii, f64::total_cmp).map_or(1.0, |radius| (radius / USUAL_RADIUS).max(1.0));
        Self {
            min_circles: self.min_circles.min(board.circle_count()).max(MINIMUM_POINTS),
            max_circle_error: self.max_circle_error * larger,
            max_frame_rms: self.max_frame_rms * larger,
            ..self.clone()
        }
    }

    /// As they are for frames whose rows may be exposed one after the other: while the board moves, no pose explains all of it well.
    pub fn of_rows_in_turn(&self) -> Self {
        Self {
            max_circle_error: self.max_circle_error * ROWS_IN_TURN,
            max_frame_rms: self.max_frame_rms * ROWS_IN_TURN,
            ..self.clone()
        }
    }
}

settings! {
    /// Circles found again where the first model expects them.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct CrossValidationSettings {
        /// Distance from a projected rim within which events belong to it, for a circle at rest.
        pub rim_band: f64 = 3.0, "px", above(0.0);
        /// Most that motion within the window may add to the band.
        pub max_motion_band: f64 = 4.0, "px", at_least(0.0);
        /// Fewest event pixels of each polarity.
        pub min_events: usize = 5, "pixels", at_least(1.0);
        /// Distance from which an event counts linearly instead of squared.
        pub huber: f64 = 0.7, "px", above(0.0);
        /// Largest distance between the refitted and the projected centre.
        pub max_center_shift: f64 = 2.5, "px", above(0.0);
        /// Largest difference between the refitted and the projected radius.
        pub max_radius_change: f64 = 2.0, "px", above(0.0);
        /// Largest mean distance of the events from the refitted rim, for a circle at rest.
        pub max_fit_error: f64 = 1.3, "px", above(0.0);
        /// Largest standard deviation of the refitted centre in its worst direction.
        pub max_center_deviation: f64 = 0.5, "px", above(0.0);
        /// Smallest share of the frame's circles inside the sensor that must pass.
        pub min_fraction: f64 = 0.5, "", from_to(0.0, 1.0);
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::circles::reference_frame::{ObservedCircle, SeenIn};

    /// Dots of 35 mm half a metre away are 22 px large; with the bound of small ones, no frame of theirs had a pose.
    #[test]
    fn gates_of_pixels_grow_with_large_circles() {
        let board: Board = "circles:3x4:90mm:r35mm".parse().unwrap();
        let of_radius = |radius: Option<f64>| {
            let circle = ObservedCircle { index: 0, t: 0.0, center: Vector2::zeros(), radius, velocity: None };
            let circles = vec![circle];
            let frame = ReferenceFrame { recording: 0, start: 0.0, end: 0.01, circles, seen_in: SeenIn::Circles };
            InitialSettings::default().of_frames(&[frame], &board)
        };
        assert_eq!((of_radius(Some(24.0)).max_circle_error, of_radius(Some(24.0)).max_frame_rms), (6.0, 4.0));
        for small in [Some(7.0), None] {
            assert_eq!(of_radius(small), InitialSettings::default());
        }
    }
}
