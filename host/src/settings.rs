//! Every threshold of a calibration, by name.
//!
//! `evcal calibrate` writes the settings it used to `settings.toml`, and reads such a file with
//! `--settings`. A file may hold any part of them; an unknown name is an error. Times are in
//! seconds and lengths in pixels unless a name's documentation says otherwise.

mod range;

use std::path::Path;
use std::str::FromStr;

use evcal_core::circle::{ExtractionSettings, Method};
use evcal_core::cluster::ClusterSettings;
use evcal_core::detector::DetectorSettings;
use evcal_core::pattern::Pattern;
use evcal_core::window::{Advance, WindowPolicy};
use serde::{Deserialize, Serialize};

use crate::detection::pictures::settings::PictureSettings;
use crate::initial::InitialSettings;
use crate::initial::model_choice::ModelChoiceSettings;
use crate::live::LiveSettings;
use crate::solve::SolveSettings;
use crate::solve::association::AssociationSettings;
use crate::solve::refinement::RefinementSettings;
use crate::trajectory::RotationSpline;
use crate::trajectory::segment::SegmentSettings;
use crate::trust::residual_map::ResidualMapSettings;
use crate::trust::split_half::SplitHalfSettings;
use crate::trust::uncertainty::UncertaintySettings;
use crate::trust::verdict::VerdictSettings;

/// How a circle follows from a pair of clusters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Extraction {
    /// A circle fitted to both clusters.
    #[default]
    Hard,
    /// The line between the cluster centres as diameter.
    Soft,
}

/// How circles are ordered into the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", try_from = "String")]
pub enum Grid {
    /// Lattice growth; partial boards and clutter are tolerated.
    #[default]
    Lattice,
    /// OpenCV's `findCirclesGrid`, complete boards only.
    #[cfg(feature = "opencv")]
    Opencv,
}

/// Why a text names no grid finder of this build.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GridNameError {
    /// No grid finder has this name.
    #[error("no grid finder of this name: write lattice or opencv")]
    Unknown,
    /// It is OpenCV's, which is not built in.
    #[error("this evcal was built without OpenCV: write lattice, or build it with the cargo feature `opencv`")]
    WithoutOpencv,
}

impl FromStr for Grid {
    type Err = GridNameError;

    fn from_str(name: &str) -> Result<Self, GridNameError> {
        match name {
            "lattice" => Ok(Self::Lattice),
            #[cfg(feature = "opencv")]
            "opencv" => Ok(Self::Opencv),
            #[cfg(not(feature = "opencv"))]
            "opencv" => Err(GridNameError::WithoutOpencv),
            _ => Err(GridNameError::Unknown),
        }
    }
}

impl TryFrom<String> for Grid {
    type Error = GridNameError;

    fn try_from(name: String) -> Result<Self, GridNameError> {
        name.parse()
    }
}

/// All settings.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Stages 2 to 5: windows, clusters, circles, grid.
    pub detection: DetectionSettings,
    /// Stages 6 and 7: gates, initial camera and poses, cross-validation.
    pub initial: InitialSettings,
    /// Stages 6 and 7: which camera model, where that is left to the program.
    pub model_choice: ModelChoiceSettings,
    /// Stage 8: segments.
    pub segment: SegmentSettings,
    /// Stage 9: splines.
    pub spline: SplineSettings,
    /// Stage 10: which event belongs to which circle.
    pub association: AssociationSettings,
    /// Stage 11: the joint solve.
    pub solve: SolveSettings,
    /// Rounds of association and solve, and the biases of events.
    pub refinement: RefinementSettings,
    /// How sure the intrinsics are.
    pub uncertainty: UncertaintySettings,
    /// Comparison of two halves of the observations.
    pub split_half: SplitHalfSettings,
    /// When a calibration is good.
    pub verdict: VerdictSettings,
    /// The camera's frames as a witness.
    pub frames: PictureSettings,
    /// How residuals are gathered over the sensor.
    pub residual_map: ResidualMapSettings,
    /// When a live camera has seen enough.
    pub live: LiveSettings,
}

/// Settings of the stages from events to reference frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DetectionSettings {
    /// `hard` or `soft` circle extraction.
    pub extraction: Extraction,
    /// `lattice` or `opencv` grid finder.
    pub grid: Grid,
    /// Length of the chunks that are searched independently (s).
    pub chunk: f64,
    /// Smallest part of the board's circles that makes a reference frame.
    pub fewest_circles: f64,
    /// Longest time over which frames tell where the board lies in a window that does not (s).
    pub longest_prediction: f64,
    /// Window policy.
    pub window: WindowSettings,
    /// DBSCAN.
    pub cluster: DbscanSettings,
    /// Circle extraction.
    pub circle: CircleSettings,
}

/// The window policy of paper III-A.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WindowSettings {
    /// The step τ (µs).
    pub step: u32,
    /// Length of the first window tried at a start (steps).
    pub min_interval: u16,
    /// Length of the longest window tried at a start (steps).
    pub max_interval: u16,
    /// Time between the end of a successful window and the next start (steps).
    pub gap: u16,
    /// A window with at least this many events does not grow any more.
    pub most_events: u32,
    /// A window with fewer events is not tried.
    pub fewest_events: u32,
}

/// DBSCAN over the pixels of one polarity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DbscanSettings {
    /// Neighbourhood radius ε (px), 1 to 4.99.
    pub epsilon: f32,
    /// Pixels within ε, the pixel itself included, that make a core pixel.
    pub min_points: u16,
    /// Clusters of fewer pixels are noise.
    pub min_pixels: u16,
}

/// Circle extraction from pairs of clusters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CircleSettings {
    /// Nearest clusters of the other polarity tried for each cluster (hard).
    pub neighbours: u8,
    /// Smallest cosine between the direction of an arc's curvature and that to its partner.
    pub min_facing: f32,
    /// Smallest radius (px).
    pub min_radius: f32,
    /// Largest radius (px).
    pub max_radius: f32,
    /// Fewest pixels of each cluster (radii).
    pub min_arc: f32,
    /// Largest ratio of the fitted radius to half the distance of the cluster centres (hard).
    pub max_radius_ratio: f32,
    /// Smallest such ratio (hard).
    pub min_radius_ratio: f32,
    /// Largest distance of the fitted centre from the midpoint of the cluster centres (radii) (hard).
    pub max_center_offset: f32,
    /// Largest mean distance of the pixels from the circle (px) (hard).
    pub max_error: f32,
    /// What the mean distance may be beyond `max_error` (radii) (hard).
    pub max_relative_error: f32,
    /// Largest mean distance of the pixels from the circle (radii) (soft).
    pub max_soft_error: f32,
}

/// The splines of the trajectory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SplineSettings {
    /// Curve of the rotation: `quaternion` (Kang) or `so3` (Sommer).
    pub rotation: RotationSpline,
    /// Degree p, 2 to 5.
    pub degree: usize,
    /// Mean distance of knots (s); longer where reference frames are sparse.
    pub knot_spacing: f64,
}

impl Default for SplineSettings {
    fn default() -> Self {
        Self { rotation: RotationSpline::Quaternion, degree: 3, knot_spacing: 0.0175 }
    }
}

impl Default for DetectionSettings {
    fn default() -> Self {
        Self {
            extraction: Extraction::Hard,
            grid: Grid::Lattice,
            chunk: 0.1,
            fewest_circles: 0.4,
            longest_prediction: 0.03,
            window: WindowSettings::default(),
            cluster: DbscanSettings::default(),
            circle: CircleSettings::default(),
        }
    }
}

impl Default for WindowSettings {
    fn default() -> Self {
        let policy = WindowPolicy::default();
        Self {
            step: policy.step_us,
            min_interval: policy.minimum,
            max_interval: policy.maximum,
            gap: 10,
            most_events: policy.event_cap,
            fewest_events: policy.event_floor,
        }
    }
}

impl Default for DbscanSettings {
    fn default() -> Self {
        let settings = ClusterSettings::default();
        Self { epsilon: settings.epsilon, min_points: settings.min_points, min_pixels: settings.min_pixels }
    }
}

impl Default for CircleSettings {
    fn default() -> Self {
        let settings = ExtractionSettings::<f32>::default();
        Self {
            neighbours: settings.neighbours,
            min_facing: settings.min_facing,
            min_radius: settings.min_radius,
            max_radius: settings.max_radius,
            min_arc: settings.min_arc,
            max_radius_ratio: settings.max_radius_ratio,
            min_radius_ratio: settings.min_radius_ratio,
            max_center_offset: settings.max_center_offset,
            max_error: settings.max_error,
            max_relative_error: settings.max_relative_error,
            max_soft_error: settings.max_soft_error,
        }
    }
}

impl WindowSettings {
    /// The policy as the core takes it.
    pub fn policy(&self) -> WindowPolicy {
        WindowPolicy {
            step_us: self.step.max(1),
            minimum: self.min_interval.max(1),
            maximum: self.max_interval.max(self.min_interval),
            gap: self.gap,
            event_cap: self.most_events,
            event_floor: self.fewest_events,
            advance: Advance::HalfWindow,
        }
    }
}

impl DetectionSettings {
    /// The settings as the core takes them.
    pub fn detector(&self) -> DetectorSettings<f32> {
        let circle = &self.circle;
        DetectorSettings {
            cluster: ClusterSettings {
                epsilon: self.cluster.epsilon,
                min_points: self.cluster.min_points,
                min_pixels: self.cluster.min_pixels,
            },
            extraction: ExtractionSettings {
                method: match self.extraction {
                    Extraction::Hard => Method::Hard,
                    Extraction::Soft => Method::Soft,
                },
                neighbours: circle.neighbours,
                min_facing: circle.min_facing,
                min_radius: circle.min_radius,
                max_radius: circle.max_radius,
                min_arc: circle.min_arc,
                max_radius_ratio: circle.max_radius_ratio,
                min_radius_ratio: circle.min_radius_ratio,
                max_center_offset: circle.max_center_offset,
                max_error: circle.max_error,
                max_relative_error: circle.max_relative_error,
                max_soft_error: circle.max_soft_error,
            },
        }
    }

    /// Fewest circles of a board that make a reference frame.
    pub fn fewest_circles(&self, pattern: &Pattern) -> usize {
        ((self.fewest_circles * pattern.circle_count() as f64).ceil() as usize).max(6)
    }
}

/// Why settings could not be read.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// The file could not be read.
    #[error("{file}: {error}")]
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
        reason: String,
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
        settings.check().map_err(|reason| SettingsError::Range { file, reason })?;
        Ok(settings)
    }

    /// Refuses numbers that are out of their range.
    fn check(&self) -> Result<(), String> {
        let table = toml::Table::try_from(self).map_err(|error| error.to_string())?;
        range::check(&table)
    }

    /// The settings as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_survive_being_written_and_read() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("settings.toml");
        std::fs::write(&path, Settings::default().to_toml()).unwrap();
        assert_eq!(Settings::read(&path).unwrap(), Settings::default());
    }

    #[test]
    fn the_grid_finder_of_opencv_needs_a_build_with_it() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("settings.toml");
        std::fs::write(&path, "[detection]\ngrid = \"opencv\"\n").unwrap();
        let read = Settings::read(&path);
        #[cfg(feature = "opencv")]
        assert_eq!(read.unwrap().detection.grid, Grid::Opencv);
        #[cfg(not(feature = "opencv"))]
        assert!(read.unwrap_err().to_string().contains("built without OpenCV: write lattice"));
        assert_eq!("hexagon".parse::<Grid>(), Err(GridNameError::Unknown));
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
