//! A camera with the results of its calibration, for export.

use std::path::Path;

use evcal_core::camera::Camera;
use nalgebra::DMatrix;
use serde::Deserialize;

use crate::calibrate::calibrated::Calibrated;
use crate::result::calibration_file::CalibrationFile;
use evcal_core::sensor::Sensor;
use evcal_geometry::board::Board;
use evcal_geometry::lens::camera_file::{self, CameraDescription, CameraFileError};
use evcal_geometry::lens::covered_region::CoveredRegion;

/// Name of a camera without a name.
pub const UNNAMED: &str = "camera";

/// Default topic of the camera's images in ROS.
pub const ROS_TOPIC: &str = "/dvs/image_raw";

/// A camera with the results of its calibration.
#[derive(Clone, Debug)]
pub struct CalibratedCamera {
    /// The lens.
    pub camera: Camera<f64>,
    /// Width and height in pixels.
    pub sensor: Sensor,
    /// Model and serial number, such as `DAVIS346_00000001`, or [`UNNAMED`].
    pub name: String,
    /// Time of the recording, if known.
    pub recorded: Option<String>,
    /// Topic of its images in ROS.
    pub ros_topic: String,
    /// Region of the sensor in which the board was seen.
    pub covered: CoveredRegion,
    /// Standard deviation of each parameter, in the model's order, if known.
    pub sigma: Option<Vec<f64>>,
    /// Covariance of the parameters, in the model's order, if known.
    pub covariance: Option<Vec<Vec<f64>>>,
    /// Root mean square of the residuals in pixels, if known.
    pub residual_rms: Option<f64>,
    /// The verdict of the calibration; empty without one.
    pub verdict: String,
    /// The board, if known.
    pub board: Option<Board>,
}

/// Replaces characters that some format does not allow, because recordings and users may contain any text; `None` if the text is
/// empty.
pub fn plain(text: Option<&str>) -> Option<String> {
    let allowed = |character: char| character.is_ascii_alphanumeric() || " _-+.:,()/".contains(character);
    let plain: String =
        text?.trim().chars().map(|character| if allowed(character) { character } else { '_' }).collect();
    (!plain.is_empty()).then_some(plain)
}

/// A camera file without a version: `truth.json` of a simulation, the camera of an undistorted recording, or a calibration file
/// without a version of its layout.
#[derive(Deserialize)]
struct OtherFile {
    sensor: Sensor,
    camera: CameraDescription,
    covered_region: Option<Vec<[f64; 2]>>,
    sigma: Option<CameraDescription>,
    uncertainty: Option<OtherUncertainty>,
    residuals: Option<OtherResiduals>,
    board: Option<String>,
}

#[derive(Deserialize)]
struct OtherUncertainty {
    covariance: Option<Vec<Vec<f64>>>,
}

#[derive(Deserialize)]
struct OtherResiduals {
    rms: f64,
}

impl CalibratedCamera {
    /// Returns the camera of a new calibration.
    pub fn new(calibrated: &Calibrated, board: &Board) -> Self {
        let uncertainty = &calibrated.quality.uncertainty;
        let covariance = uncertainty.covariance.row_iter().map(|row| row.iter().copied().collect()).collect();
        Self {
            camera: *calibrated.camera(),
            sensor: calibrated.sensor,
            name: plain(calibrated.camera_name()).unwrap_or_else(|| UNNAMED.to_owned()),
            recorded: plain(calibrated.recorded()),
            ros_topic: ROS_TOPIC.to_owned(),
            covered: calibrated.covered_region(),
            sigma: Some(uncertainty.sigma()),
            covariance: Some(covariance),
            residual_rms: Some(calibrated.residuals().rms),
            verdict: calibrated.verdict.sentence.clone(),
            board: Some(*board),
        }
    }

    /// Reads `calibration.json`, or another camera file such as `truth.json` of a simulation, for which the whole sensor counts
    /// as seen. `path` is the file or its folder.
    ///
    /// # Errors
    /// [`CameraFileError`] if the file cannot be read or is not a camera file.
    pub fn read(path: &Path) -> Result<Self, CameraFileError> {
        let path = &camera_file::camera_path(path);
        match camera_file::version(path)? {
            Some(_) => Self::of_calibration(camera_file::parse(path)?, path),
            None => Self::of_other(camera_file::parse(path)?, path),
        }
    }

    /// Returns the covariance of the parameters, if known.
    pub fn covariance_matrix(&self) -> Option<DMatrix<f64>> {
        let count = self.camera.kind().parameter_names().len();
        let rows = self.covariance.as_ref().filter(|rows| rows.len() == count)?;
        let is_square = rows.iter().all(|row| row.len() == count);
        is_square.then(|| DMatrix::from_row_iterator(count, count, rows.iter().flatten().copied()))
    }

    fn of_calibration(file: CalibrationFile, path: &Path) -> Result<Self, CameraFileError> {
        let camera = file.camera.camera().map_err(|error| camera_file::wrong(path, error))?;
        let names = camera.kind().parameter_names();
        Ok(Self {
            name: plain(file.camera_name.as_deref()).unwrap_or_else(|| UNNAMED.to_owned()),
            recorded: plain(file.recorded.as_deref()),
            covered: CoveredRegion::around(file.covered_region.into_iter().map(Into::into), file.sensor),
            sigma: names.iter().map(|name| file.sigma.parameters.get(name)).collect(),
            covariance: Some(file.uncertainty.covariance),
            residual_rms: Some(file.residuals.rms),
            verdict: file.verdict.sentence,
            board: file.board.parse().ok(),
            ..Self::seen_everywhere(camera, file.sensor)
        })
    }

    fn of_other(file: OtherFile, path: &Path) -> Result<Self, CameraFileError> {
        let camera = file.camera.camera().map_err(|error| camera_file::wrong(path, error))?;
        let names = camera.kind().parameter_names();
        let everywhere = Self::seen_everywhere(camera, file.sensor);
        Ok(Self {
            covered: match file.covered_region {
                Some(corners) => CoveredRegion::around(corners.into_iter().map(Into::into), file.sensor),
                None => everywhere.covered,
            },
            sigma: file.sigma.and_then(|sigma| names.iter().map(|name| sigma.parameters.get(name)).collect()),
            covariance: file.uncertainty.and_then(|uncertainty| uncertainty.covariance),
            residual_rms: file.residuals.map(|residuals| residuals.rms),
            board: file.board.and_then(|board| board.parse().ok()),
            ..everywhere
        })
    }

    /// Returns a camera without further information.
    pub fn seen_everywhere(camera: Camera<f64>, sensor: Sensor) -> Self {
        Self {
            camera,
            sensor,
            name: UNNAMED.to_owned(),
            recorded: None,
            ros_topic: ROS_TOPIC.to_owned(),
            covered: CoveredRegion::whole(sensor),
            sigma: None,
            covariance: None,
            residual_rms: None,
            verdict: String::new(),
            board: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evcal_geometry::lens::camera_file::LATEST_VERSION;

    fn read(text: &str) -> Result<CalibratedCamera, CameraFileError> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("camera.json");
        std::fs::write(&path, text).unwrap();
        CalibratedCamera::read(&path)
    }

    const CAMERA: &str = r#""sensor": {"width": 346, "height": 260},
        "camera": {"model": "ucm", "parameters": {"fx": 300.0, "fy": 301.0, "cx": 172.5, "cy": 129.5, "alpha": 0.5}}"#;

    #[test]
    fn a_file_without_a_version_covers_the_whole_sensor() {
        let camera = read(&format!(r#"{{ {CAMERA}, "format": "evcal-calibration", "verdict": 7 }}"#)).unwrap();
        assert_eq!(camera.camera.parameters().to_vec(), [300.0, 301.0, 172.5, 129.5, 0.5]);
        assert_eq!(camera.covered, CoveredRegion::whole(Sensor::new(346, 260)));
        assert!(camera.sigma.is_none() && camera.board.is_none());
        let truth =
            read(&format!(r#"{{ {CAMERA}, "board": "acircles:9x4:55mm:r17.5mm", "settings": {{}} }}"#)).unwrap();
        assert!(truth.board.is_some());
    }

    #[test]
    fn names_of_recordings_fit_into_every_format() {
        assert_eq!(plain(Some(" DAVIS346_00000001 ")).as_deref(), Some("DAVIS346_00000001"));
        assert_eq!(plain(Some("a\n\"b\" <é>&")).as_deref(), Some("a__b_ ____"));
        assert_eq!((plain(Some(" ")), plain(None)), (None, None));
    }

    #[test]
    fn a_calibration_of_a_later_version_is_refused() {
        let error = read(&format!(r#"{{ {CAMERA}, "version": 99 }}"#)).unwrap_err();
        assert!(matches!(error, CameraFileError::Version { version: 99, known: LATEST_VERSION, .. }), "{error}");
    }
}
