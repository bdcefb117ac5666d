//! Every threshold of a calibration, by name.
//!
//! The settings that were used are written to `settings.toml`; such a file can be read for another calibration. It may hold any part of them; an unknown name is an error.
//!
//! The stages declare their settings ([`evcal_core::settings`](mod@evcal_core::settings)) with unit, bounds and meaning; here they are gathered.
//! From the declarations come the check of a file, the comments of `settings.toml` and the tables of
//! `docs/settings.md`.

pub mod bounds;
mod live;
mod text;

use bounds::OutOfBounds;
use std::path::Path;

use evcal_core::settings;
use serde::{Deserialize, Serialize};
use toml::Table;

pub use self::live::LiveSettings;
pub use self::text::document;
use crate::detection::pictures::settings::PictureSettings;
use crate::detection::settings::DetectionSettings;
use crate::initial::InitialSettings;
use crate::initial::model_choice::ModelChoiceSettings;
use crate::solve::SolveSettings;
use crate::solve::association::AssociationSettings;
use crate::solve::refinement::RefinementSettings;
use crate::solve::unexplained::UnexplainedSettings;
use crate::trajectory::knot_grid::KnotSettings;
use crate::trajectory::segment::SegmentSettings;
use crate::trajectory::settings::SplineSettings;
use crate::trust::board_evidence::BoardShapeSettings;
use crate::trust::poses::PoseSettings;
use crate::trust::residual_map::ResidualMapSettings;
use crate::trust::split_half::SplitHalfSettings;
use crate::trust::uncertainty::UncertaintySettings;
use crate::trust::verdict::VerdictSettings;

settings! {
    /// All settings.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Settings {
        /// Sections 1 to 4 of method.md: windows, clusters, circles, grid.
        pub detection: DetectionSettings;
        /// Section 5: gates, initial camera and poses, cross-validation.
        pub initial: InitialSettings;
        /// Section 5: which camera model, where that is left to the program.
        pub model_choice: ModelChoiceSettings;
        /// Section 6: segments.
        pub segment: SegmentSettings;
        /// Section 7: splines.
        pub spline: SplineSettings;
        /// Section 7: how dense knots may be.
        pub knots: KnotSettings;
        /// Section 7: which stretches no curve explains.
        pub unexplained: UnexplainedSettings;
        /// Section 8: which event belongs to which circle.
        pub association: AssociationSettings;
        /// Sections 9 and 10: the joint solve.
        pub solve: SolveSettings;
        /// Section 11: rounds of association and solve, and the biases of events.
        pub refinement: RefinementSettings;
        /// Which poses are written.
        pub poses: PoseSettings;
        /// When the board is not taken as it is stated.
        pub board: BoardShapeSettings;
        /// How sure the intrinsics are.
        pub uncertainty: UncertaintySettings;
        /// Comparison of two halves of the observations.
        pub split_half: SplitHalfSettings;
        /// When a calibration is good.
        pub verdict: VerdictSettings;
        /// The camera's frames as a witness.
        pub frames: PictureSettings;
        /// How residuals are gathered over the sensor.
        pub residual_map: ResidualMapSettings;
        /// When a live camera has seen enough.
        pub live: LiveSettings;
    }
}

/// Why settings could not be read.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// The file could not be read.
    #[error("{file} cannot be read as settings: {error}; the settings.toml of a calibration shows their form")]
    Read {
        /// The file.
        file: String,
        /// What the system said.
        error: std::io::Error,
    },
    /// The text is no settings file.
    #[error("{file}: {error}")]
    Parse {
        /// The file.
        file: String,
        /// What is wrong and where.
        error: Box<toml::de::Error>,
    },
    /// A value is out of its range.
    #[error("{file}: {reason}")]
    Range {
        /// The file.
        file: String,
        /// Which value, and what it may be.
        reason: OutOfBounds,
    },
}

impl Settings {
    /// Reads a TOML file; what it does not name keeps its default.
    ///
    /// # Errors
    /// [`SettingsError`].
    pub fn read(path: &Path) -> Result<Self, SettingsError> {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|error| SettingsError::Read { file: file.clone(), error })?;
        let settings: Self = toml::from_str(&text)
            .map_err(|error| SettingsError::Parse { file: file.clone(), error: Box::new(error) })?;
        bounds::check(&Self::GROUP, &settings.table()).map_err(|reason| SettingsError::Range { file, reason })?;
        Ok(settings)
    }

    /// The settings as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_default()
    }

    /// The settings as TOML, each with its meaning, unit and bounds in comments before it.
    pub fn to_commented_toml(&self) -> String {
        text::commented(&Self::GROUP, &self.to_toml())
    }

    /// The settings by name, numbers as [`Self::to_toml`] writes them.
    pub fn table(&self) -> Table {
        self.to_toml().parse().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trajectory::RotationSpline;

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
    fn a_part_is_enough_and_a_typo_is_refused() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("settings.toml");
        std::fs::write(&path, "[spline]\nrotation = \"so3\"\n").unwrap();
        assert_eq!(Settings::read(&path).unwrap().spline.rotation, RotationSpline::So3);
        for wrong in ["[spline]\nrotatoin = \"so3\"\n", "[spline]\ndegree = 9\n", "[solve]\nbin = 0.0\n", "nonsense"] {
            std::fs::write(&path, wrong).unwrap();
            let message = Settings::read(&path).unwrap_err().to_string();
            assert!(message.contains("settings.toml"), "{message}");
        }
    }
}
