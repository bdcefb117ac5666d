//! Comparison of two calibrations: the difference of their projections, relative to their uncertainty, shows whether they are of
//! the same camera.

use std::fmt;
use std::path::{Path, PathBuf};

use evcal_core::sensor::Sensor;
use nalgebra::DMatrix;
use serde::Serialize;

use super::calibrated_camera::CalibratedCamera;
use crate::quality::uncertainty::projection::projection_uncertainty;
use evcal_geometry::lens::camera_file::CameraFileError;
use evcal_geometry::lens::projection_difference::{NoCommonView, projection_difference};

/// Ratio of the difference to the expected difference from which the cameras or lenses differ (or the lens was touched). Below
/// it, the cause may be conditions that the reported uncertainty does not include, such as light and speed.
const ANOTHER: f64 = 10.0;
/// Difference (px) below which the lenses are not reported as different, however certain the calibrations are.
const SMALLEST_OF_ANOTHER: f64 = 0.2;
/// Difference (px) below which the cameras are the same, however certain the calibrations are.
const SMALLEST: f64 = 0.05;

/// Result of the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sameness {
    /// The difference is explained by the uncertainties.
    Same,
    /// The difference is larger, but not as large as with another lens.
    Near,
    /// They are of different cameras or lenses, or of one whose focus was changed.
    Different,
    /// Neither file contains its uncertainty.
    Unknown,
}

/// Comparison of two calibrations.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ComparedCalibrations {
    /// The file names, as given.
    pub files: [PathBuf; 2],
    /// The result.
    pub sameness: Sameness,
    /// Root mean square over the sensor of the projection difference, with the rotation between them removed (px).
    pub difference_rms: f64,
    /// The greatest difference (px).
    pub difference_max: f64,
    /// The pixel where it is greatest.
    pub difference_max_at: [f64; 2],
    /// Root mean square predicted by their reported uncertainties for the same camera (px).
    pub expected_rms: Option<f64>,
    /// Reported uncertainty of each (px, root mean square over the sensor).
    pub stated_rms: [Option<f64>; 2],
}

/// Reasons why two calibrations cannot be compared.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CompareError {
    /// A file cannot be read.
    #[error("{0}")]
    Camera(#[from] CameraFileError),
    /// They are of different sensors, and so of different cameras.
    #[error(
        "{} is for a sensor of {sensor} pixels, {} for one of {other_sensor}: they are of different cameras",
        file.display(), other_file.display()
    )]
    SensorsDiffer {
        /// The first.
        file: PathBuf,
        /// Its sensor.
        sensor: Sensor,
        /// The second.
        other_file: PathBuf,
        /// Its sensor.
        other_sensor: Sensor,
    },
    /// They have no common field of view.
    #[error("{0}")]
    Projection(#[from] NoCommonView),
}

impl evcal_files::remedy::Remedy for CompareError {}

/// Compares the calibrations at two paths, files or folders.
///
/// # Errors
/// [`CompareError`] if one cannot be read, if they are for sensors of different size, or if they have no common field
/// of view.
pub fn compare_calibrations(first: &Path, second: &Path) -> Result<ComparedCalibrations, CompareError> {
    let files = [first.to_owned(), second.to_owned()];
    compare_cameras(files, [&CalibratedCamera::read(first)?, &CalibratedCamera::read(second)?])
}

/// Compares two calibrations that were read already. `files` are their names for the result.
///
/// # Errors
/// [`CompareError`] if they are for sensors of different size, or have no common field of view.
pub fn compare_cameras(
    files: [PathBuf; 2],
    [first, second]: [&CalibratedCamera; 2],
) -> Result<ComparedCalibrations, CompareError> {
    if first.sensor != second.sensor {
        let [file, other_file] = files;
        return Err(CompareError::SensorsDiffer {
            file,
            sensor: first.sensor,
            other_file,
            other_sensor: second.sensor,
        });
    }
    let difference = projection_difference(&first.camera, &second.camera, first.sensor)?;
    let stated_rms = [reported_rms(first), reported_rms(second)];
    let expected_rms = match stated_rms {
        [None, None] => None,
        [one, other] => Some(one.unwrap_or(0.0).hypot(other.unwrap_or(0.0))),
    };
    Ok(ComparedCalibrations {
        files,
        sameness: sameness(difference.rms, expected_rms),
        difference_rms: difference.rms,
        difference_max: difference.max,
        difference_max_at: difference.max_at,
        expected_rms,
        stated_rms,
    })
}

/// Returns the expected root mean square error of a calibration's projection; `None` if the file does not contain it.
fn reported_rms(camera: &CalibratedCamera) -> Option<f64> {
    let rows = camera.covariance.as_ref()?;
    let size = camera.camera.parameters().len();
    let values: Vec<f64> = rows.iter().flatten().copied().collect();
    if rows.len() != size || values.len() != size * size {
        return None;
    }
    let covariance = DMatrix::from_row_slice(size, size, &values);
    Some(projection_uncertainty(&camera.camera, &covariance, camera.sensor).ok()?.rms)
}

/// Factor on the expected difference: 2.5 standard deviations, which one in a hundred pairs of the same camera exceeds.
const EXPECTED_TIMES: f64 = 2.5;

fn sameness(difference: f64, expected: Option<f64>) -> Sameness {
    match expected {
        _ if difference < SMALLEST => Sameness::Same,
        None => Sameness::Unknown,
        Some(expected) if difference < EXPECTED_TIMES * expected => Sameness::Same,
        Some(expected) if difference < (ANOTHER * expected).max(SMALLEST_OF_ANOTHER) => Sameness::Near,
        Some(_) => Sameness::Different,
    }
}

impl fmt::Display for ComparedCalibrations {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.sameness {
            Sameness::Same => "The same camera: the difference is explained by the uncertainties, or too small to matter.",
            Sameness::Near => {
                "Not the same within their uncertainties: the lens was touched between them, or a reported uncertainty is too \
                 small. Use the one with the better verdict."
            }
            Sameness::Different => {
                "Different cameras or lenses, or the lens was refocused between them: do not use one for the other."
            }
            Sameness::Unknown => {
                "Neither file states its uncertainty, so it is not known whether they are of the same camera."
            }
        })?;
        let [x, y] = self.difference_max_at;
        write!(
            f,
            "\nprojections of the same point differ by {:.3} px (rms over the sensor), at most {:.3} px, at ({x:.0}, {y:.0})",
            self.difference_rms, self.difference_max
        )?;
        if let Some(expected) = self.expected_rms {
            write!(
                f,
                "\nwith these uncertainties, two calibrations of one camera are expected to differ by {expected:.3} px (rms)"
            )?;
        }
        for (file, rms) in self.files.iter().zip(self.stated_rms) {
            if let Some(rms) = rms {
                write!(f, "\n  {}: projection known to {rms:.3} px (rms)", file.display())?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: &str = r#"{"model": "radtan4", "parameters": {"fx": 330.0, "fy": 331.0, "cx": CX, "cy": 131.0, "k1": K1, "k2": 0.1, "p1": 0.0, "p2": 0.0}}"#;

    /// A calibration with a standard deviation of k1 alone.
    fn write(folder: &Path, name: &str, cx: f64, k1: f64, sigma: Option<f64>) -> PathBuf {
        let camera = CAMERA.replace("CX", &cx.to_string()).replace("K1", &k1.to_string());
        let covariance: Vec<Vec<f64>> = (0..8)
            .map(|row| {
                (0..8).map(|column| if (row, column) == (4, 4) { sigma.unwrap_or(0.0).powi(2) } else { 0.0 }).collect()
            })
            .collect();
        let uncertainty = sigma.map_or("null".to_owned(), |_| format!(r#"{{"covariance": {covariance:?}}}"#));
        let text = format!(
            r#"{{"sensor": {{"width": 346, "height": 260}}, "camera": {camera}, "uncertainty": {uncertainty}}}"#
        );
        let path = folder.join(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    #[test]
    fn a_difference_is_compared_with_the_reported_uncertainties() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let sure = write(folder, "sure", 170.0, -0.35, Some(0.001));
        let compare = |second: &Path| compare_calibrations(&sure, second).unwrap();
        let same = compare(&write(folder, "same", 170.0, -0.351, Some(0.001)));
        assert_eq!(same.sameness, Sameness::Same);
        // Only k1 differs and has a standard deviation, so the ratio is the difference of k1 in its standard
        // deviations.
        let near = compare(&write(folder, "near", 170.0, -0.358, Some(0.001)));
        let expected = near.expected_rms.unwrap();
        assert!((near.difference_rms / expected - 8.0 / 2f64.sqrt()).abs() < 0.1, "{near:?}");
        assert_eq!(near.sameness, Sameness::Near);
        // A difference of 0.57 px where 0.02 px are expected must not count as the same camera.
        let different = compare(&write(folder, "apart", 170.0, -0.367, Some(0.001)));
        assert!((0.2..1.0).contains(&different.difference_rms), "{different:?}");
        assert_eq!(different.sameness, Sameness::Different);
        let different = compare(&write(folder, "different", 175.0, -0.2, Some(0.001)));
        assert_eq!(different.sameness, Sameness::Different);
        assert!(different.to_string().contains("do not use one for the other"));
        // The same distance, but with a larger uncertainty.
        let unsure = write(folder, "unsure", 170.0, -0.358, Some(0.01));
        assert_eq!(compare(&unsure).sameness, Sameness::Same);
    }

    #[test]
    fn without_uncertainty_only_equal_cameras_are_known_to_be_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let one = write(folder, "one", 170.0, -0.35, None);
        let other = write(folder, "other", 170.0, -0.3, None);
        assert_eq!(compare_calibrations(&one, &one).unwrap().sameness, Sameness::Same);
        let compared = compare_calibrations(&one, &other).unwrap();
        assert_eq!((compared.sameness, compared.expected_rms), (Sameness::Unknown, None));
    }
}
