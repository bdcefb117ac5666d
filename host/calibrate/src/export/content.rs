//! Export formats, their input and their output.

use evcal_core::camera::{Camera, ModelKind};

use crate::result::calibrated_camera::{CalibratedCamera, UNNAMED};
use evcal_geometry::lens::nearest::{Replacement, nearest, share_behind};

/// A file format for cameras.
pub struct ExportFormat {
    /// Its name on the command line.
    pub name: &'static str,
    /// Programs that read it, in sentences.
    pub program: &'static str,
    /// Name of its file in a folder with all formats.
    pub file: &'static str,
    /// Models that it supports.
    pub models: &'static [ModelKind],
    /// Models among them that may replace a model which it does not support.
    pub substitutes: &'static [ModelKind],
    /// Writes the file.
    pub write: fn(&Content) -> String,
    /// Both coordinates of the centre of the top-left pixel.
    pub first_pixel: f64,
    /// `true` if the program computes nothing for points behind the camera, whatever the model.
    pub front_only: bool,
}

/// Content of a file.
pub struct Content<'a> {
    /// The camera with the results of its calibration.
    pub calibrated: &'a CalibratedCamera,
    /// fx, fy, cx, cy of the camera that is written.
    pub matrix: [f64; 4],
    /// Its distortion coefficients.
    pub distortion: &'a [f64],
    /// Its model, one of [`ExportFormat::models`].
    pub model: ModelKind,
    /// Error of the replacement, if the model was replaced.
    pub refit: Option<&'a Replacement>,
    /// The error of the replacement, and what the program cannot use, in a sentence.
    pub note: Option<&'a str>,
    /// [`ExportFormat::first_pixel`].
    pub first_pixel: f64,
}

impl Content<'_> {
    /// Returns sentences for comments: origin of the file, position of pixel (0, 0), camera and date of the recording, verdict,
    /// and error of the replacement.
    pub fn remarks(&self) -> Vec<String> {
        let (version, first) = (crate::VERSION, self.first_pixel);
        let from = format!("written by evcal {version}; pixel ({first}, {first}) is the centre of the top-left pixel");
        // Some readers accept ASCII only.
        let verdict = self.calibrated.verdict.replace('±', "+-");
        let verdict = Some(verdict).filter(|verdict| !verdict.is_empty());
        let CalibratedCamera { name, recorded, .. } = self.calibrated;
        let camera = (name != UNNAMED).then(|| format!("camera {name}"));
        let recorded = recorded.as_ref().map(|date| format!("recorded {date}"));
        let origin = Some(camera.into_iter().chain(recorded).collect::<Vec<_>>().join(", "));
        let origin = origin.filter(|origin| !origin.is_empty());
        [from].into_iter().chain(origin).chain(verdict).chain(self.note.map(str::to_owned)).collect()
    }

    /// Returns the camera matrix, row by row.
    pub fn camera_matrix(&self) -> [f64; 9] {
        let [fx, fy, cx, cy] = self.matrix;
        [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    }
}

/// A file for another program.
#[derive(Clone, Debug)]
pub struct Exported {
    /// Its text.
    pub text: String,
    /// The camera in it.
    pub camera: Camera<f64>,
    /// Error of the replacement, if the format does not support the calibrated model.
    pub refit: Option<Replacement>,
    /// The error of the replacement, and what the program cannot use, in a sentence.
    pub note: Option<String>,
}

/// A format supports neither a camera nor one near it.
#[derive(Debug, thiserror::Error)]
#[error("{format} has no model that comes near this {model} camera where the board was seen")]
pub struct ExportError {
    format: &'static str,
    model: ModelKind,
}

impl evcal_files::remedy::Remedy for ExportError {}

impl ExportFormat {
    /// Exports a camera.
    ///
    /// # Errors
    /// [`ExportError`] if the format supports neither the camera nor one near it.
    pub fn export(&self, calibrated: &CalibratedCamera) -> Result<Exported, ExportError> {
        let model = calibrated.camera.kind();
        let cannot = || ExportError { format: self.name, model };
        let CalibratedCamera { camera, sensor, covered, .. } = calibrated;
        let near = nearest(camera, self.models, self.substitutes, *sensor, covered).ok_or_else(cannot)?;
        let parameters = near.camera.parameters();
        let (&[fx, fy, cx, cy], distortion) = parameters.split_first_chunk::<4>().ok_or_else(cannot)?;
        let (model, refit) = (near.camera.kind(), near.refit.as_ref());
        let behind = if self.front_only { share_behind(&near.camera, *sensor) } else { 0.0 };
        let behind = (behind > 0.0).then(|| {
            let (program, percent) = (self.program, 100.0 * behind);
            format!("{program} sees nothing beyond 90 degrees from the axis: {percent:.1} % of the sensor")
        });
        let sentences = refit.map(|refit| refit.sentence(self.program, self.models)).into_iter().chain(behind);
        let note = Some(sentences.collect::<Vec<_>>().join("; ")).filter(|note| !note.is_empty());
        let first_pixel = self.first_pixel;
        let matrix = [fx, fy, cx + first_pixel, cy + first_pixel];
        let content = Content { calibrated, matrix, distortion, model, refit, note: note.as_deref(), first_pixel };
        Ok(Exported { text: (self.write)(&content), camera: near.camera, refit: near.refit, note })
    }
}
