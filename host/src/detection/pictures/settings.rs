//! Thresholds of the calibration from frames.

use serde::{Deserialize, Serialize};

/// Every threshold of the frames, with its unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PictureSettings {
    /// Smallest part of the light around a dot that is missing in its middle.
    pub min_contrast: f64,
    /// Smallest radius of a dot (px).
    pub min_radius: f64,
    /// Largest radius of a dot (px).
    pub max_radius: f64,
    /// Largest ratio of a dot's longest to its shortest diameter.
    pub max_elongation: f64,
    /// Largest difference of a dot's area from that of the ellipse with its moments, as a part of it.
    pub max_ellipse_error: f64,
    /// Largest scatter of the light around a dot, as a part of the dot's contrast.
    pub max_unevenness: f64,
    /// Largest blur of the dots' edges, as the standard deviation of a Gaussian (px): the median of a
    /// frame's dots.
    pub max_blur: f64,
    /// Distance in units of the centres' spread from which a centre counts linearly instead of
    /// squared.
    pub huber: f64,
    /// Frames and events agree while their projections differ by up to this many times what is
    /// expected from the uncertainty of both.
    pub agreement: f64,
    /// Expected difference (px, rms over the sensor) beyond which the frames cannot tell.
    pub too_uncertain: f64,
    /// Largest time between a frame's exposure and the events of the same moment (s).
    pub max_time_offset: f64,
}

impl Default for PictureSettings {
    fn default() -> Self {
        Self {
            min_contrast: 0.25,
            min_radius: 2.0,
            max_radius: 40.0,
            max_elongation: 4.0,
            max_ellipse_error: 0.25,
            max_unevenness: 0.15,
            max_blur: 2.5,
            huber: 2.5,
            agreement: 2.0,
            too_uncertain: 1.0,
            max_time_offset: 0.02,
        }
    }
}
