//! What is known of a camera when it is exported.

use std::path::Path;

use evcal_core::camera::Camera;
use nalgebra::Vector2;
use serde::Deserialize;

use crate::board::Board;
use crate::calibrate::calibrated::Calibrated;
use crate::lens::camera_file::{self, CameraDescription, CameraFileError};
use crate::lens::covered_region::CoveredRegion;
use evcal_core::sensor::Sensor;

/// Name of a camera that has none.
pub const UNNAMED: &str = "camera";

/// Topic of the camera's images in ROS, where none is given.
pub const ROS_TOPIC: &str = "/dvs/image_raw";

/// Points on the rim of a circle that stand for it.
const RIM_POINTS: u32 = 16;

/// Where the board's circles were seen in the frames that the calibration used.
pub fn covered_region(calibrated: &Calibrated) -> CoveredRegion {
    let rim = calibrated.posed().flat_map(|(_, frame)| &frame.circles).flat_map(|circle| {
        (0..RIM_POINTS).map(|step| {
            let angle = f64::from(step) * std::f64::consts::TAU / f64::from(RIM_POINTS);
            circle.center + Vector2::new(libm::cos(angle), libm::sin(angle)) * circle.radius.unwrap_or(0.0)
        })
    });
    CoveredRegion::around(rim, calibrated.sensor)
}

/// A camera and what its calibration says of it.
#[derive(Clone, Debug)]
pub struct CalibratedCamera {
    /// The lens.
    pub camera: Camera<f64>,
    /// Width and height in pixels.
    pub sensor: Sensor,
    /// Model and serial number, such as `DAVIS346_00000001`.
    pub name: String,
    /// Topic of its images in ROS.
    pub ros_topic: String,
    /// Where the board was seen.
    pub covered: CoveredRegion,
    /// Standard deviation of each parameter, in the model's order, if known.
    pub sigma: Option<Vec<f64>>,
    /// Covariance of the parameters, in the model's order, if known.
    pub covariance: Option<Vec<Vec<f64>>>,
    /// Root mean square of the residuals in pixels, if known.
    pub residual_rms: Option<f64>,
    /// The board, if known.
    pub board: Option<Board>,
}

/// The part of `calibration.json` that is exported. Of `truth.json` only the first two are there.
#[derive(Deserialize)]
struct CalibrationFile {
    sensor: Sensor,
    camera: CameraDescription,
    covered_region: Option<Vec<[f64; 2]>>,
    sigma: Option<CameraDescription>,
    uncertainty: Option<Uncertainty>,
    residuals: Option<Residuals>,
    board: Option<String>,
}

#[derive(Deserialize)]
struct Uncertainty {
    covariance: Option<Vec<Vec<f64>>>,
}

#[derive(Deserialize)]
struct Residuals {
    rms: f64,
}

impl CalibratedCamera {
    /// The camera of a calibration that was just made.
    pub fn new(calibrated: &Calibrated, board: &Board) -> Self {
        let uncertainty = &calibrated.trust.uncertainty;
        let covariance = uncertainty.covariance.row_iter().map(|row| row.iter().copied().collect()).collect();
        Self {
            camera: *calibrated.camera(),
            sensor: calibrated.sensor,
            name: UNNAMED.to_owned(),
            ros_topic: ROS_TOPIC.to_owned(),
            covered: covered_region(calibrated),
            sigma: Some(uncertainty.sigma()),
            covariance: Some(covariance),
            residual_rms: Some(calibrated.residuals().rms),
            board: Some(*board),
        }
    }

    /// Reads `calibration.json`, or `truth.json` of a simulation: there the whole sensor counts as seen. `path` is the
    /// file or its folder.
    ///
    /// # Errors
    /// [`CameraFileError`].
    pub fn read(path: &Path) -> Result<Self, CameraFileError> {
        let path = camera_file::camera_path(path);
        let file: CalibrationFile = camera_file::parse(&path)?;
        let camera = file.camera.camera().map_err(|error| camera_file::wrong(&path, error))?;
        let sensor = file.sensor;
        let covered = match file.covered_region {
            Some(corners) => CoveredRegion::around(corners.into_iter().map(Into::into), sensor),
            None => CoveredRegion::whole(sensor),
        };
        let names = camera.kind().parameter_names();
        let sigma = file.sigma.and_then(|sigma| names.iter().map(|name| sigma.parameters.get(name)).collect());
        Ok(Self {
            camera,
            sensor,
            name: UNNAMED.to_owned(),
            ros_topic: ROS_TOPIC.to_owned(),
            covered,
            sigma,
            covariance: file.uncertainty.and_then(|uncertainty| uncertainty.covariance),
            residual_rms: file.residuals.map(|residuals| residuals.rms),
            board: file.board.and_then(|board| board.parse().ok()),
        })
    }
}
