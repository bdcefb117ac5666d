//! Are two calibrations of the same camera? Where both put the same point in the image, against how sure they are.

use std::fmt;
use std::path::{Path, PathBuf};

use evcal_core::sensor::Sensor;
use nalgebra::DMatrix;
use serde::Serialize;

use super::calibrated_camera::CalibratedCamera;
use crate::trust::uncertainty::projection::projection_uncertainty;
use evcal_geometry::lens::camera_file::CameraFileError;
use evcal_geometry::lens::projection_difference::{NoCommonView, projection_difference};

/// A difference of so many times what is to be expected is that of another camera or lens (or of a lens that was
/// touched); below, that of conditions that the stated uncertainty does not know, such as light and speed.
const ANOTHER: f64 = 10.0;
/// A difference below it (px) is not yet that of another lens, however sure the calibrations are.
const SMALLEST_OF_ANOTHER: f64 = 0.2;
/// A difference below it (px) is that of the same camera, however sure the calibrations are.
const SMALLEST: f64 = 0.05;

/// Whether two calibrations are of the same camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sameness {
    /// They differ by no more than they are uncertain.
    Same,
    /// They differ by more, but not by as much as another lens would.
    Near,
    /// They are of different cameras or lenses, or of one whose focus was changed.
    Different,
    /// Neither says how sure it is.
    Unknown,
}

/// Two calibrations side by side.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ComparedCalibrations {
    /// The files, as they were given.
    pub files: [PathBuf; 2],
    /// Whether they are of the same camera.
    pub sameness: Sameness,
    /// Root mean square over the sensor of the difference of their projections, the rotation between them removed (px).
    pub difference_rms: f64,
    /// The greatest difference (px).
    pub difference_max: f64,
    /// The pixel where it is greatest.
    pub difference_max_at: [f64; 2],
    /// What the root mean square should be by their stated uncertainties, if they are of one camera (px).
    pub expected_rms: Option<f64>,
    /// What each is uncertain by itself (px, root mean square over the sensor).
    pub stated_rms: [Option<f64>; 2],
}

/// Why two calibrations cannot be compared.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CompareError {
    /// One cannot be read.
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
    /// They see nothing in common.
    #[error("{0}")]
    Projection(#[from] NoCommonView),
}

/// Compares the calibrations at two paths, files or folders.
///
/// # Errors
/// [`CompareError`] when one cannot be read, or they are for sensors of different size.
pub fn compare_calibrations(first: &Path, second: &Path) -> Result<ComparedCalibrations, CompareError> {
    let files = [first.to_owned(), second.to_owned()];
    compare_cameras(files, [&CalibratedCamera::read(first)?, &CalibratedCamera::read(second)?])
}

/// The same for two that are at hand, which `files` are the names of.
///
/// # Errors
/// As there.
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
    let stated_rms = [stated(first), stated(second)];
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

/// The expected root mean square error of a calibration's projection; `None` where it does not tell.
fn stated(camera: &CalibratedCamera) -> Option<f64> {
    let rows = camera.covariance.as_ref()?;
    let size = camera.camera.parameters().len();
    let values: Vec<f64> = rows.iter().flatten().copied().collect();
    if rows.len() != size || values.len() != size * size {
        return None;
    }
    let covariance = DMatrix::from_row_slice(size, size, &values);
    Some(projection_uncertainty(&camera.camera, &covariance, camera.sensor).ok()?.rms)
}

/// Two and a half standard deviations: one in a hundred pairs of one camera differ by more.
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
            Sameness::Same => "The same camera: either calibration can take the place of the other.",
            Sameness::Near => {
                "Not the same within their uncertainties: the lens was touched between them, or one is less certain than it \
                 says. Use the better one; the reports say which."
            }
            Sameness::Different => {
                "Different cameras or lenses, or the lens was refocused between them: do not use one for the other."
            }
            Sameness::Unknown => {
                "Neither file states its uncertainty, so it cannot be told whether they are of the same camera."
            }
        })?;
        let [x, y] = self.difference_max_at;
        write!(
            f,
            "\nthe same point is {:.3} px apart in the image (rms over the sensor), at most {:.3} px, at ({x:.0}, {y:.0})",
            self.difference_rms, self.difference_max
        )?;
        if let Some(expected) = self.expected_rms {
            write!(
                f,
                "\nwith these uncertainties, two calibrations of one camera are expected to differ by {expected:.3} px (rms)"
            )?;
        }
        for (file, stated) in self.files.iter().zip(self.stated_rms) {
            if let Some(stated) = stated {
                write!(f, "\n  {}: projection known to {stated:.3} px (rms)", file.display())?;
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
    fn a_difference_is_held_against_what_the_calibrations_say() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let sure = write(folder, "sure", 170.0, -0.35, Some(0.001));
        let compare = |second: &Path| compare_calibrations(&sure, second).unwrap();
        let same = compare(&write(folder, "same", 170.0, -0.351, Some(0.001)));
        assert_eq!(same.sameness, Sameness::Same);
        // One parameter alone: the difference in its standard deviations.
        let near = compare(&write(folder, "near", 170.0, -0.358, Some(0.001)));
        let expected = near.expected_rms.unwrap();
        assert!((near.difference_rms / expected - 8.0 / 2f64.sqrt()).abs() < 0.1, "{near:?}");
        assert_eq!(near.sameness, Sameness::Near);
        // 0.57 px, where 0.02 are expected, was "perhaps the same camera".
        let apart = compare(&write(folder, "apart", 170.0, -0.367, Some(0.001)));
        assert!((0.2..1.0).contains(&apart.difference_rms), "{apart:?}");
        assert_eq!(apart.sameness, Sameness::Different);
        let different = compare(&write(folder, "different", 175.0, -0.2, Some(0.001)));
        assert_eq!(different.sameness, Sameness::Different);
        assert!(different.to_string().contains("do not use one for the other"));
        // The same distance, but neither was sure of it.
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
