//! The settings of a run, from a file or the defaults, with OpenCV for the initial camera if this build contains it.

use std::path::Path;

use evcal_calibrate::settings::Settings;
use evcal_detection::detection::settings::Grid;

use super::{Failure, UsageError};

/// Returns the settings in `file`, or the defaults; `grid` overrides the grid finder.
///
/// # Errors
/// The file cannot be read, or OpenCV's grid finder is requested from a build without OpenCV.
pub fn read_settings(file: Option<&Path>, grid: Option<Grid>) -> Result<Settings, Failure> {
    let mut settings = file.map(Settings::read).transpose()?.unwrap_or_default();
    settings.detection.grid = grid.unwrap_or(settings.detection.grid);
    #[cfg(feature = "opencv")]
    {
        settings.initial.start = Some(&evcal_opencv::Opencv);
        settings.detection.opencv = Some(evcal_opencv::WHOLE_BOARD);
    }
    if settings.detection.grid == Grid::Opencv && settings.detection.opencv.is_none() {
        let message = "this evcal was built without OpenCV: use lattice, or build it with the cargo feature `opencv`";
        return Err(UsageError(message.to_owned()).into());
    }
    Ok(settings)
}
