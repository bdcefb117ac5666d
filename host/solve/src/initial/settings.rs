//! Settings of the initial model.

use std::fmt::Debug;

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use evcal_core::settings;
use evcal_core::settings::{above, from_to};
use serde::{Deserialize, Serialize};

use super::planar_pose::{PlanarPose, PlanePoint};
use super::report::OpencvStart;
use super::sighting::BoardPoint;
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_geometry::board::Board;
use evcal_geometry::board::homography::MINIMUM_POINTS;
use evcal_geometry::numerics::statistics::median;

/// Algorithm that computes a first camera and the pose of a plane.
///
/// [`NativeStart`](super::NativeStart) is part of this crate; `evcal-opencv` contains the other one.
pub trait Start: Debug + Send + Sync {
    /// Returns the name for messages.
    fn name(&self) -> &'static str;

    /// Computes a first camera of model `kind` from some `views` of the board.
    fn camera(
        &self,
        kind: ModelKind,
        views: &[&[BoardPoint]],
        sensor: Sensor,
        settings: &InitialSettings,
    ) -> StartedCamera;

    /// Estimates `T_camera_world` of a plane from points that include wrong ones, with at most `iterations` samples. Points
    /// within `threshold` of their image, in units of the focal length, agree.
    fn plane_pose(&self, points: &[PlanePoint], threshold: f64, iterations: u16) -> Option<PlanarPose>;
}

/// Starts with the same name are equal.
impl PartialEq for dyn Start {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

/// A first camera.
#[derive(Clone, Debug)]
pub struct StartedCamera {
    /// The camera; `None` if none was found.
    pub camera: Option<Camera<f64>>,
    /// Statistics of OpenCV's calibration; `None` for the native start.
    pub opencv: Option<OpencvStart>,
}

settings! {
    /// The first camera and the pose of every reference frame (section 5 of method.md).
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct InitialSettings {
        /// Start of the first camera and the poses of frames; `None` is the native start. Not in settings files: all starts lead
        /// to the same camera.
        #[serde(skip)]
        pub start: Option<&'static dyn Start> = None;
        /// Fewest circles of a usable frame, and fewest that must agree with its pose. Not in settings files: small boards have
        /// fewer.
        #[serde(skip)]
        pub min_circles: usize = 8;
        /// Fewest frames from which a camera is estimated. Not in settings files: one is enough if the camera is known.
        #[serde(skip)]
        pub min_frames: usize = 10;
        /// Largest distance of a circle from its projection (px); a circle with a larger one is excluded from its frame. Not in
        /// settings files: it grows with the circles.
        #[serde(skip)]
        pub max_circle_error: f64 = 3.0;
        /// Largest root mean square error of a frame (px). Not in settings files: it grows with the circles.
        #[serde(skip)]
        pub max_frame_rms: f64 = 2.0;
        /// Rotation gate: fastest rotation of the pattern's rows in the image.
        pub max_row_rate: f64 = 20.0, "rad/s", above(0.0);
        /// Velocity gate: fastest motion between board and camera.
        pub max_speed: f64 = 5.0, "m/s", above(0.0);
        /// Velocity gate: fastest rotation between board and camera.
        pub max_angular_speed: f64 = 20.0, "rad/s", above(0.0);
        /// Cross-validation.
        pub cross_validation: CrossValidationSettings;
    }
}

/// Distance from which an observation of a circle counts linearly instead of squared (px).
pub const HUBER: f64 = 0.5;
/// Number of views in the first calibration.
pub const START_VIEWS: usize = 24;
/// Largest root mean square error of a first calibration that counts as good (px).
pub const MAX_START_RMS: f64 = 1.0;
/// Longest time between two frames over which their motion is checked (s).
pub const MAX_MOTION_GAP: f64 = 0.1;

/// Radius of circles up to which pixel thresholds have their nominal value (px). The effect of perspective, distortion and motion
/// within a window on the centre of a circle's image grows with the radius.
const USUAL_RADIUS: f64 = 12.0;

/// Factor on the distance thresholds of circles in frames of a rolling shutter.
const ROWS_IN_TURN: f64 = 10.0;

impl InitialSettings {
    /// Adapts the settings to `frames` of `board`: small boards may be used if they are complete, and large circles may be
    /// further from their predicted positions.
    pub fn of_frames(&self, frames: &[ReferenceFrame], board: &Board) -> Self {
        let mut radii: Vec<f64> =
            frames.iter().flat_map(|frame| &frame.circles).filter_map(|circle| circle.radius).collect();
        let larger = median(&mut radii, f64::total_cmp).map_or(1.0, |radius| (radius / USUAL_RADIUS).max(1.0));
        Self {
            min_circles: self.min_circles.min(board.point_count()).max(MINIMUM_POINTS),
            max_circle_error: self.max_circle_error * larger,
            max_frame_rms: self.max_frame_rms * larger,
            ..self.clone()
        }
    }

    /// Adapts the settings to frames whose rows may be exposed one after the other: while the board moves, no pose explains all
    /// of it well.
    pub fn of_rows_in_turn(&self) -> Self {
        Self {
            max_circle_error: self.max_circle_error * ROWS_IN_TURN,
            max_frame_rms: self.max_frame_rms * ROWS_IN_TURN,
            ..self.clone()
        }
    }
}

settings! {
    /// Search for circles at the positions that the first model predicts.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct CrossValidationSettings {
        /// Largest distance between the refitted and the projected centre.
        pub max_center_shift: f64 = 2.5, "px", above(0.0);
        /// Largest difference between the refitted and the projected radius.
        pub max_radius_change: f64 = 2.0, "px", above(0.0);
        /// Smallest share of the frame's circles inside the sensor that must pass.
        pub min_fraction: f64 = 0.5, "", from_to(0.0, 1.0);
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use evcal_detection::circles::reference_frame::{ObservedCircle, SeenIn};

    /// Dots of 35 mm half a metre away are 22 px large; with the thresholds for small dots, none of their frames had a pose.
    #[test]
    fn pixel_thresholds_grow_with_large_circles() {
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
