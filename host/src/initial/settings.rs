//! Thresholds of the initial model.

use serde::{Deserialize, Serialize};

/// What the first camera and the poses of frames start from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "opencv", derive(Default))]
pub enum Start {
    /// OpenCV's calibration and its PnP; the native start where its calibration fails.
    #[cfg(feature = "opencv")]
    #[default]
    Opencv,
    /// A scan over focal lengths, and IPPE in RANSAC.
    Native {
        /// Seed of RANSAC's samples.
        seed: u64,
    },
}

#[cfg(not(feature = "opencv"))]
impl Default for Start {
    fn default() -> Self {
        Self::Native { seed: 0 }
    }
}

/// Every threshold of the initial model, with its unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InitialSettings {
    /// What the first camera and the poses of frames start from: OpenCV where the program is built with
    /// it. Not in settings files: both reach the same camera.
    #[serde(skip)]
    pub start: Start,
    /// Fewest circles of a frame that may be used, and fewest that must agree with its pose; never
    /// less than 4, never more than the board has.
    pub min_circles: usize,
    /// Fewest frames from which a camera is estimated.
    pub min_frames: usize,
    /// Longest time from a circle to the same circle in a neighbouring frame, in seconds, over which
    /// its motion is taken as straight when the circle file gives no velocity.
    pub max_interpolation_gap: f64,
    /// Neighbouring frames on each side that vote on a frame.
    pub voters: usize,
    /// Rotation gate: fastest turn of the pattern's rows in the image, in rad/s.
    pub max_row_rate: f64,
    /// Rotation gate: turn of a row that noise and perspective explain at any rate, in rad.
    pub row_angle_floor: f64,
    /// Views of the first calibration (OpenCV's, or the native one).
    pub start_views: usize,
    /// Views of the bundle refinement that follows the first calibration.
    pub first_bundle_views: usize,
    /// Views of the last bundle refinement.
    pub bundle_views: usize,
    /// Largest root mean square error of OpenCV's calibration in pixels; above it, the worst views
    /// are left out.
    pub max_start_rms: f64,
    /// How often the worst views may be left out.
    pub start_retries: usize,
    /// Distance in pixels from which an observation counts linearly instead of squared (Huber).
    pub huber: f64,
    /// Largest distance of a circle from its projection in pixels; beyond, it is left out of its frame.
    pub max_circle_error: f64,
    /// Samples of RANSAC per frame.
    pub ransac_iterations: u16,
    /// Smallest part of a frame's circles that must agree with its pose.
    pub min_inlier_fraction: f64,
    /// Largest root mean square error of a frame in pixels.
    pub max_frame_rms: f64,
    /// Largest root mean square error of a frame, as a multiple of the median of all frames.
    pub max_frame_rms_ratio: f64,
    /// Largest standard deviation of the focal length, as a part of it, that counts as calibrated.
    pub max_focal_deviation: f64,
    /// Velocity gate: fastest motion between board and camera, in m/s.
    pub max_speed: f64,
    /// Velocity gate: distance that noise of the poses explains at any speed, in m.
    pub position_floor: f64,
    /// Velocity gate: fastest rotation between board and camera, in rad/s.
    pub max_angular_speed: f64,
    /// Velocity gate: angle that noise of the poses explains at any speed, in rad.
    pub angle_floor: f64,
    /// Velocity gate: largest acceleration, in m/s²; judges a frame against the line between its
    /// neighbours.
    pub max_acceleration: f64,
    /// Velocity gate: largest angular acceleration, in rad/s².
    pub max_angular_acceleration: f64,
    /// Velocity gate: largest acceleration and angular acceleration as a multiple of the recording's
    /// median.
    pub max_acceleration_ratio: f64,
    /// Longest time in seconds between two frames over which their motion is judged.
    pub max_motion_gap: f64,
    /// Cross-validation.
    pub cross_validation: CrossValidationSettings,
}

impl Default for InitialSettings {
    fn default() -> Self {
        Self {
            start: Start::default(),
            min_circles: 8,
            min_frames: 10,
            max_interpolation_gap: 0.1,
            voters: 3,
            max_row_rate: 20.0,
            row_angle_floor: 0.1,
            start_views: 24,
            first_bundle_views: 80,
            bundle_views: 400,
            max_start_rms: 1.0,
            start_retries: 3,
            huber: 0.5,
            max_circle_error: 3.0,
            ransac_iterations: 100,
            min_inlier_fraction: 0.6,
            max_frame_rms: 2.0,
            max_frame_rms_ratio: 5.0,
            max_focal_deviation: 0.05,
            max_speed: 5.0,
            position_floor: 0.02,
            max_angular_speed: 20.0,
            angle_floor: 0.05,
            max_acceleration: 60.0,
            max_angular_acceleration: 300.0,
            max_acceleration_ratio: 4.0,
            max_motion_gap: 0.1,
            cross_validation: CrossValidationSettings::default(),
        }
    }
}

/// Thresholds of the feature cross-validation (paper III).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CrossValidationSettings {
    /// Distance in pixels from a projected rim within which events belong to it, for a circle at rest.
    pub rim_band: f64,
    /// Largest distance in pixels that motion within the window may add to the band.
    pub max_motion_band: f64,
    /// Fewest event pixels of each polarity.
    pub min_events: usize,
    /// Distance in pixels from which an event counts linearly instead of squared (Huber).
    pub huber: f64,
    /// Largest distance in pixels between the refitted and the projected centre.
    pub max_center_shift: f64,
    /// Largest difference in pixels between the refitted and the projected radius.
    pub max_radius_change: f64,
    /// Largest mean distance in pixels of the events from the refitted rim, for a circle at rest.
    pub max_fit_error: f64,
    /// Largest standard deviation in pixels of the refitted centre in its worst direction.
    pub max_center_deviation: f64,
    /// Smallest part of the frame's circles inside the sensor that must pass.
    pub min_fraction: f64,
}

impl Default for CrossValidationSettings {
    fn default() -> Self {
        Self {
            rim_band: 3.0,
            max_motion_band: 4.0,
            min_events: 5,
            huber: 0.7,
            max_center_shift: 2.5,
            max_radius_change: 2.0,
            max_fit_error: 1.3,
            max_center_deviation: 0.5,
            min_fraction: 0.5,
        }
    }
}
