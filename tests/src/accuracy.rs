//! Errors of a calibration against the ground truth, as `evcal evaluate` reports them.

use std::path::Path;

use serde_json::Value;

use crate::{camera, json, text};

/// Errors of a calibration.
#[derive(Clone, Copy, Debug)]
pub struct Accuracy {
    /// Larger relative error of the two focal lengths on the optical axis.
    pub focal: f64,
    /// Larger error of the two coordinates of the principal point, in pixels.
    pub center: f64,
    /// Projection difference over the sensor with the implied rotation removed, in pixels.
    pub projection_rms: f64,
    /// Largest projection difference over the sensor with the implied rotation removed, in pixels.
    pub projection_max: f64,
    /// Root mean square position error of the trajectory after the best constant time shift, not
    /// aligned, in metres.
    pub position: f64,
}

impl Accuracy {
    /// Compares the calibration in one folder with the ground truth in another.
    pub fn of(calibration: &Path, truth: &Path) -> Self {
        let figures = json(&["evaluate", text(calibration), "--truth", text(truth), "--json"]);
        let number = |value: &Value| value.as_f64().unwrap_or_else(|| panic!("no number in {figures}"));
        let parameter = |name: &str| &figures["intrinsics"]["parameters"][name];
        let axial = |file: &Path| camera(file).axial_focal_lengths().expect("the axis is in every domain");
        let found = axial(&calibration.join("calibration.json"));
        let relative =
            found.iter().zip(axial(&truth.join("truth.json"))).map(|(found, truth)| (found / truth - 1.0).abs());
        let absolute = |name: &str| number(&parameter(name)["difference"]);
        let projection = &figures["projection_difference"];
        Self {
            focal: relative.fold(0.0, f64::max),
            center: absolute("cx").abs().max(absolute("cy").abs()),
            projection_rms: number(&projection["rms_px"]),
            projection_max: number(&projection["max_px"]),
            position: number(&figures["trajectory"]["best_time_shift"]["as_is_m"]["rmse"]),
        }
    }
}
