//! The formats by name.

use evcal_core::camera::{Camera, ModelKind};

use super::{basalt, csv, dv_processing, dv_xml, kalibr, mrcal, opencv, ros};
use crate::lens::nearest::{Replacement, nearest};
use crate::result::calibrated_camera::CalibratedCamera;

/// A file format for cameras.
pub struct ExportFormat {
    /// Its name on the command line.
    pub name: &'static str,
    /// Name of its file in a folder of all formats.
    pub file: &'static str,
    /// Models that it holds.
    pub models: &'static [ModelKind],
    /// Those of them that replace a model which it does not hold.
    pub substitutes: &'static [ModelKind],
    /// The file.
    pub write: fn(&Content) -> String,
}

/// The formats.
pub const FORMATS: &[ExportFormat] = &[
    opencv::YAML,
    opencv::XML,
    opencv::JSON,
    ros::FORMAT,
    kalibr::FORMAT,
    basalt::FORMAT,
    dv_xml::FORMAT,
    dv_processing::FORMAT,
    mrcal::FORMAT,
    csv::FORMAT,
];

/// What goes into a file.
pub struct Content<'a> {
    /// What is known of the camera.
    pub calibrated: &'a CalibratedCamera,
    /// fx, fy, cx, cy of the camera that is written.
    pub matrix: [f64; 4],
    /// Its distortion coefficients.
    pub distortion: &'a [f64],
    /// Its model, one of [`ExportFormat::models`].
    pub model: ModelKind,
    /// What it cost to get it.
    pub refit: Option<&'a Replacement>,
}

impl Content<'_> {
    /// Where the file comes from, where pixel (0, 0) is and what a refit costs, in sentences for comments.
    pub fn remarks(&self) -> Vec<String> {
        let from = format!("written by evcal {}; pixel (0, 0) is the centre of the top-left pixel", crate::VERSION);
        [from].into_iter().chain(self.refit.map(ToString::to_string)).collect()
    }

    /// The camera matrix, row by row.
    pub fn camera_matrix(&self) -> [f64; 9] {
        let [fx, fy, cx, cy] = self.matrix;
        [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    }
}

/// A file for another program.
#[derive(Clone, Debug)]
pub struct Exported {
    /// Its content.
    pub text: String,
    /// The camera in it.
    pub camera: Camera<f64>,
    /// What it cost to get it, where the format does not hold the calibrated model.
    pub refit: Option<Replacement>,
}

/// A format cannot hold a camera, nor one near it.
#[derive(Debug, thiserror::Error)]
#[error("{format} has no model that comes near this {model} camera where the board was seen")]
pub struct ExportError {
    format: &'static str,
    model: ModelKind,
}

impl ExportFormat {
    /// The format of this name.
    pub fn from_name(name: &str) -> Option<&'static Self> {
        FORMATS.iter().find(|format| format.name == name)
    }

    /// The file for a camera.
    ///
    /// # Errors
    /// [`ExportError`] if neither the camera nor one near it can be held.
    pub fn export(&self, calibrated: &CalibratedCamera) -> Result<Exported, ExportError> {
        let model = calibrated.camera.kind();
        let cannot = || ExportError { format: self.name, model };
        let CalibratedCamera { camera, sensor, covered, .. } = calibrated;
        let near = nearest(camera, self.models, self.substitutes, *sensor, covered).ok_or_else(cannot)?;
        let parameters = near.camera.parameters();
        let (matrix, distortion) = parameters.split_first_chunk::<4>().ok_or_else(cannot)?;
        let (model, refit) = (near.camera.kind(), near.refit.as_ref());
        let text = (self.write)(&Content { calibrated, matrix: *matrix, distortion, model, refit });
        Ok(Exported { text, camera: near.camera, refit: near.refit })
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::lens::covered_region::CoveredRegion;
    use crate::result::calibrated_camera::{ROS_TOPIC, UNNAMED};

    #[test]
    fn names_and_files_differ_and_substitutes_can_be_written() {
        for (index, format) in FORMATS.iter().enumerate() {
            assert!(FORMATS[..index].iter().all(|other| other.name != format.name && other.file != format.file));
            assert!(format.substitutes.iter().all(|model| format.models.contains(model)), "{}", format.name);
            assert!(ExportFormat::from_name(format.name).is_some_and(|found| found.file == format.file));
        }
    }

    #[test]
    fn every_format_holds_every_mild_lens_and_states_a_refit() {
        // A small sensor: cameras are compared at every pixel.
        let sensor = Sensor::new(80, 60);
        let parameters = [80.4, 80.1, 39.3, 29.4, -0.1, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let opencv: Camera<f64> = Camera::from_parameters(ModelKind::Radtan8, &parameters).unwrap();
        for &kind in ModelKind::ALL {
            let camera = evcal_core::camera::refit::refit(kind, &opencv, sensor).unwrap();
            let calibrated = CalibratedCamera {
                camera,
                sensor,
                name: UNNAMED.to_owned(),
                ros_topic: ROS_TOPIC.to_owned(),
                covered: CoveredRegion::whole(sensor),
                sigma: None,
                covariance: None,
                residual_rms: None,
                board: None,
            };
            for format in FORMATS {
                let exported = format.export(&calibrated).unwrap();
                assert!(format.models.contains(&exported.camera.kind()), "{} {kind}", format.name);
                if let Some(refit) = exported.refit {
                    assert!(refit.covered.largest < 0.1 && refit.covered.unseen == 0.0, "{}: {refit}", format.name);
                    assert!(exported.text.contains(&format!("no model {kind}")), "{}: {}", format.name, exported.text);
                }
            }
        }
    }
}
