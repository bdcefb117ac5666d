//! All settings of a calibration, by name.
//!
//! The settings that were used are written to `settings.toml`; such a file can be read for another calibration. It may contain
//! any part of them; an unknown name is an error, and so is a name of an earlier version with another value than the built-in
//! one.
//!
//! The stages declare their settings ([`evcal_core::settings`](mod@evcal_core::settings)) with unit, bounds and meaning; this
//! module collects them. The check of a file, the comments of `settings.toml` and the tables of `docs/settings.md` are generated
//! from the declarations.

pub mod bounds;
pub mod fixed;
mod live;
mod text;

use bounds::OutOfBounds;
use fixed::{FixedSetting, take_fixed};
use std::path::Path;

use evcal_core::settings;
use serde::{Deserialize, Serialize};
use toml::Table;

pub use self::live::LiveSettings;
pub use self::text::document;
use crate::quality::board_evidence::BoardShapeSettings;
use crate::quality::poses::PoseSettings;
use crate::quality::verdict::VerdictSettings;
use evcal_detection::detection::pictures::settings::PictureSettings;
use evcal_detection::detection::settings::DetectionSettings;
use evcal_solve::initial::InitialSettings;
use evcal_solve::solve::SolveSettings;
use evcal_solve::solve::association::AssociationSettings;
use evcal_solve::solve::refinement::RefinementSettings;
use evcal_solve::trajectory::knot_grid::KnotSettings;
use evcal_solve::trajectory::segment::SegmentSettings;
use evcal_solve::trajectory::settings::SplineSettings;

settings! {
    /// All settings.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Settings {
        /// Sections 1 to 4 of method.md: windows, clusters, circles, grid.
        pub detection: DetectionSettings;
        /// Section 5: gates, initial camera and poses, cross-validation.
        pub initial: InitialSettings;
        /// Section 6: segments.
        pub segment: SegmentSettings;
        /// Section 7: splines.
        pub spline: SplineSettings;
        /// Section 7: density of knots.
        pub knots: KnotSettings;
        /// Section 8: assignment of events to circles.
        pub association: AssociationSettings;
        /// Sections 9 and 10: the joint solve.
        pub solve: SolveSettings;
        /// Section 11: rounds of association and solve, and the biases of events.
        pub refinement: RefinementSettings;
        /// Poses that are written.
        pub poses: PoseSettings;
        /// Estimation of the board's shape.
        pub board: BoardShapeSettings;
        /// Bounds of a good calibration.
        pub verdict: VerdictSettings;
        /// Cross-check with the camera's frames.
        pub frames: PictureSettings;
        /// Conditions under which a live session stops.
        pub live: LiveSettings;
    }
}

/// Reasons why settings could not be read.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// The file could not be read.
    #[error("{file} cannot be read as settings: {error}; the settings.toml of a calibration shows their form")]
    Read {
        /// The file.
        file: String,
        /// The error of the system.
        error: std::io::Error,
    },
    /// The text is not a settings file.
    #[error("{file}: {error}")]
    Parse {
        /// The file.
        file: String,
        /// The problem and its position.
        error: Box<toml::de::Error>,
    },
    /// A setting is fixed now.
    #[error("{file}: {reason}")]
    Fixed {
        /// The file.
        file: String,
        /// The setting and the remedy.
        reason: FixedSetting,
    },
    /// A value is out of range.
    #[error("{file}: {reason}")]
    Range {
        /// The file.
        file: String,
        /// The setting and its range.
        reason: OutOfBounds,
    },
}

impl evcal_files::remedy::Remedy for SettingsError {}

impl Settings {
    /// Reads a TOML file; settings that it does not contain keep their defaults.
    ///
    /// # Errors
    /// [`SettingsError`] if the file cannot be read or is invalid.
    pub fn read(path: &Path) -> Result<Self, SettingsError> {
        let file = path.display().to_string();
        let text = evcal_files::text::read(path, evcal_files::text::SETTINGS)
            .map_err(|error| SettingsError::Read { file: file.clone(), error })?;
        let parse = |error| SettingsError::Parse { file: file.clone(), error: Box::new(error) };
        let mut table: Table = toml::from_str(&text).map_err(parse)?;
        let fixed = take_fixed(&mut table).map_err(|reason| SettingsError::Fixed { file: file.clone(), reason })?;
        // The text contains the position of a mistake, the table does not.
        let settings: Self = if fixed { table.try_into() } else { toml::from_str(&text) }.map_err(parse)?;
        bounds::check(&Self::GROUP, &settings.table()).map_err(|reason| SettingsError::Range { file, reason })?;
        Ok(settings)
    }

    /// Returns the settings as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_default()
    }

    /// Returns the settings as TOML, each with its meaning, unit and bounds in a comment before it.
    pub fn to_commented_toml(&self) -> String {
        text::commented(&Self::GROUP, &self.to_toml())
    }

    /// Returns the settings by name, with numbers as in [`Self::to_toml`].
    pub fn table(&self) -> Table {
        self.to_toml().parse().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evcal_solve::trajectory::RotationSpline;

    /// The number of settings is limited, because users cannot choose many of them with a reason.
    #[test]
    fn the_number_of_settings_is_limited() {
        let count = Settings::default().to_toml().matches(" = ").count();
        assert!(count <= 45, "{count}");
    }

    #[test]
    fn defaults_survive_being_written_and_read() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("settings.toml");
        for text in [Settings::default().to_toml(), Settings::default().to_commented_toml()] {
            std::fs::write(&path, text).unwrap();
            assert_eq!(Settings::read(&path).unwrap(), Settings::default());
        }
    }

    #[test]
    fn an_incomplete_file_is_accepted_and_a_typo_is_refused() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("settings.toml");
        std::fs::write(&path, "[spline]\nrotation = \"so3\"\n").unwrap();
        assert_eq!(Settings::read(&path).unwrap().spline.rotation, RotationSpline::So3);
        for wrong in [
            "[spline]\nrotatoin = \"so3\"\n",
            "[spline]\ndegree = 9\n",
            "[poses]\nrate = 0.0\n",
            "[solve]\nbin = 0.0\n",
            "nonsense",
        ] {
            std::fs::write(&path, wrong).unwrap();
            let message = Settings::read(&path).unwrap_err().to_string();
            assert!(message.contains("settings.toml"), "{message}");
        }
    }
}
