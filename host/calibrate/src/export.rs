//! Export of cameras to files of other programs.
//!
//! A format is one file with an [`ExportFormat`], which lists the camera models that the format supports, and one line in
//! [`FORMATS`]. A calibration of another model is replaced by the nearest camera that the format supports
//! ([`evcal_geometry::lens::nearest`]), and the file states the difference: no coefficient is ever dropped.
//!
//! In most formats pixel (0, 0) is the centre of the top-left pixel, as in OpenCV, ROS, Kalibr and mrcal; in others it is
//! (0.5, 0.5) ([`ExportFormat::first_pixel`]).

pub mod basalt;
pub mod content;
pub mod csv;
pub mod dv_processing;
pub mod dv_xml;
pub mod file_storage;
pub mod fill;
pub mod inertial;
pub mod kalibr;
pub mod mrcal;
pub mod number;
pub mod opencv;
pub mod ros;
pub mod second_camera;
pub mod static_transform;
pub mod templates;
pub mod undistortion_table;

use std::path::Path;

use evcal_geometry::lens::camera_file::{self, CameraFileError, DescriptionError};

use self::content::ExportFormat;
use crate::result::calibrated_camera::CalibratedCamera;
use crate::result::calibration_file::CalibrationFile;

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
    templates::COLMAP,
    templates::NERFSTUDIO,
    templates::VINS_FUSION,
    templates::ORB_SLAM3,
    templates::SVO,
    csv::FORMAT,
];

/// Returns name and content of each file for the camera with its IMU, or with the other cameras on its mount, if the calibration
/// contains them.
///
/// # Errors
/// [`DescriptionError`] if evcal does not know the model of one of the other cameras.
pub fn rig_files(
    camera: &CalibratedCamera,
    calibration: &CalibrationFile,
) -> Result<Vec<(String, String)>, DescriptionError> {
    let others = &calibration.second_cameras;
    let with_unit = calibration.inertial.iter().flat_map(|unit| inertial::files(camera, unit, others));
    let with_unit = with_unit.map(|(name, text)| (name.to_owned(), text));
    Ok(with_unit.chain(second_camera::files(camera, others)?).collect())
}

/// Returns the files as [`rig_files`] does, from a calibration or its folder; none for another camera file.
///
/// # Errors
/// [`CameraFileError`] if the file cannot be read or is not a camera file.
pub fn read_rig_files(camera: &CalibratedCamera, path: &Path) -> Result<Vec<(String, String)>, CameraFileError> {
    let path = &camera_file::camera_path(path);
    match camera_file::version(path)? {
        Some(_) => rig_files(camera, &camera_file::parse(path)?).map_err(|error| camera_file::wrong(path, error)),
        None => Ok(Vec::new()),
    }
}

/// Returns `true` if a file of this name in a folder may be an export to all formats.
pub fn is_file(name: &Path) -> bool {
    FORMATS.iter().map(|format| format.file).chain(inertial::names()).any(|file| Path::new(file) == name)
        || name.to_str().is_some_and(second_camera::is_file)
}

/// Returns the format with this name.
pub fn from_name(name: &str) -> Option<&'static ExportFormat> {
    FORMATS.iter().find(|format| format.name == name)
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::{Camera, ModelKind};
    use evcal_core::sensor::Sensor;

    use super::*;

    #[test]
    fn names_and_files_of_formats_are_unique_and_substitutes_are_supported() {
        for (index, format) in FORMATS.iter().enumerate() {
            assert!(FORMATS[..index].iter().all(|other| other.name != format.name && other.file != format.file));
            assert!(format.substitutes.iter().all(|model| format.models.contains(model)), "{}", format.name);
            assert!(from_name(format.name).is_some_and(|found| found.file == format.file));
        }
    }

    #[test]
    fn camera_date_and_grade_are_in_the_comments() {
        let parameters = [300.0, 301.0, 172.5, 129.5, -0.3, 0.1, 0.0, 0.0, 0.0];
        let camera = Camera::from_parameters(ModelKind::Radtan, &parameters).unwrap();
        let calibrated = CalibratedCamera {
            name: "DAVIS346_7".to_owned(),
            recorded: Some("2022-01-27 00:33:48 UTC".to_owned()),
            verdict: "Usable, but: fx 300.00 ± 0.08 px.".to_owned(),
            ..CalibratedCamera::seen_everywhere(camera, Sensor::new(346, 260))
        };
        for format in [opencv::YAML, opencv::XML, opencv::JSON, ros::FORMAT] {
            let text = format.export(&calibrated).unwrap().text;
            let version = format!("evcal {}", crate::VERSION);
            for part in
                ["camera DAVIS346_7, recorded 2022-01-27 00:33:48 UTC", "Usable, but: fx 300.00 +- 0.08", &version]
            {
                assert!(text.contains(part), "{part}: {text}");
            }
        }
    }

    /// Exported files are read back, except for those that evcal does not read: the camera that is read equals the written
    /// one to the last digit.
    #[test]
    fn exported_files_are_read_back() {
        let sensor = Sensor::new(346, 260);
        let parameters = [330.4, 331.1, 171.3, 129.4, -0.1, 0.01, 1e-3, -2e-4, 0.0, 0.0, 0.0, 0.0];
        let opencv: Camera<f64> = Camera::from_parameters(ModelKind::Radtan8, &parameters).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let are_not_read = [
            &templates::COLMAP,
            &templates::NERFSTUDIO,
            &templates::VINS_FUSION,
            &templates::ORB_SLAM3,
            &templates::SVO,
        ];
        let not_read = are_not_read.into_iter().chain([&csv::FORMAT]).map(|format| format.name).collect::<Vec<_>>();
        for format in FORMATS.iter().filter(|format| !not_read.contains(&format.name)) {
            for &kind in format.models {
                let camera = evcal_core::camera::refit::refit(kind, &opencv, sensor).unwrap();
                let name = "DAVIS346_7".to_owned();
                let calibrated = CalibratedCamera { name, ..CalibratedCamera::seen_everywhere(camera, sensor) };
                let file = folder.path().join(format.file);
                std::fs::write(&file, format.export(&calibrated).unwrap().text).unwrap();
                let read = CalibratedCamera::read(&file).unwrap_or_else(|error| panic!("{}: {error}", format.name));
                assert_eq!((read.camera, read.sensor), (camera, sensor), "{} {kind}", format.name);
            }
        }
    }

    #[test]
    fn every_format_exports_every_mild_lens_and_states_a_refit() {
        // A small sensor, because cameras are compared at every pixel.
        let sensor = Sensor::new(80, 60);
        let parameters = [80.4, 80.1, 39.3, 29.4, -0.1, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let opencv: Camera<f64> = Camera::from_parameters(ModelKind::Radtan8, &parameters).unwrap();
        for &kind in ModelKind::ALL {
            let camera = evcal_core::camera::refit::refit(kind, &opencv, sensor).unwrap();
            let calibrated = CalibratedCamera::seen_everywhere(camera, sensor);
            for format in FORMATS {
                let exported = format.export(&calibrated).unwrap();
                assert!(format.models.contains(&exported.camera.kind()), "{} {kind}", format.name);
                if let Some(refit) = exported.refit {
                    assert!(refit.covered.largest < 0.1 && refit.covered.unseen == 0.0, "{}: {refit:?}", format.name);
                    assert!(exported.text.contains(&exported.note.unwrap()), "{}: {}", format.name, exported.text);
                }
            }
        }
    }
}
