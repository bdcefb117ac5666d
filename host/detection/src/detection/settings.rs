//! Settings from events to reference frames.

use std::borrow::Cow;
use std::str::FromStr;

use evcal_core::circle::{CircleSettings, Extraction};
use evcal_core::cluster::ClusterSettings;
use evcal_core::detector::DetectorSettings;
use evcal_core::grid::GridCandidate;
use evcal_core::pattern::Pattern;
use evcal_core::sensor::Sensor;
use evcal_core::settings;
use evcal_core::settings::from_to;
use evcal_core::window::WindowSettings;
use serde::{Deserialize, Serialize};

use super::board_finder::PlacedCircle;
use super::no_board::NoBoard;

/// Method that orders circles into the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", try_from = "String")]
pub enum Grid {
    /// Lattice growth; partial boards and clutter are tolerated.
    #[default]
    Lattice,
    /// OpenCV's `findCirclesGrid`, complete boards only.
    Opencv,
}

/// A text that is not the name of a grid finder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no grid finder of this name: write lattice or opencv")]
pub struct GridNameError;

/// Function that finds the circles of a whole board among candidates.
pub type FindWholeBoard = fn(&[GridCandidate<f32>], &Pattern) -> Result<Vec<PlacedCircle>, NoBoard>;

/// Implementation of OpenCV's `findCirclesGrid`.
#[derive(Clone, Copy, Debug)]
pub struct WholeBoardFinder(pub FindWholeBoard);

impl PartialEq for WholeBoardFinder {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::fn_addr_eq(self.0, other.0)
    }
}

impl FromStr for Grid {
    type Err = GridNameError;

    fn from_str(name: &str) -> Result<Self, GridNameError> {
        match name {
            "lattice" => Ok(Self::Lattice),
            "opencv" => Ok(Self::Opencv),
            _ => Err(GridNameError),
        }
    }
}

impl TryFrom<String> for Grid {
    type Error = GridNameError;

    fn try_from(name: String) -> Result<Self, GridNameError> {
        name.parse()
    }
}

settings! {
    /// From events to reference frames (sections 1 to 4 of method.md). `max_radius` and `most_events` are for 346 columns and grow with the sensor.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct DetectionSettings {
        /// Method that makes a circle of a pair of clusters: `"hard"` fits a circle to the pixels of both, `"soft"` takes the
        /// line between their centres as diameter.
        pub extraction: Extraction = Extraction::Hard;
        /// Method that orders circles into the board: `"lattice"` grows a lattice from neighbour to neighbour and tolerates
        /// partial boards and clutter; `"opencv"` is `findCirclesGrid`, complete boards only, in builds with OpenCV.
        pub grid: Grid = Grid::Lattice;
        /// OpenCV's grid finder, if it is built in. Not in settings files.
        #[serde(skip)]
        pub opencv: Option<WholeBoardFinder> = None;
        /// Smallest share of the board's circles in a reference frame; never fewer than 6 circles.
        pub fewest_circles: f64 = 0.4, "", from_to(0.0, 1.0);
        /// Windows of time that are searched.
        pub window: WindowSettings;
        /// DBSCAN.
        pub cluster: ClusterSettings;
        /// Circle extraction.
        pub circle: CircleSettings;
    }
}

/// Fewest circles of a frame, however small the board.
const FEWEST_CIRCLES: usize = 6;
/// Longer side in pixels of the sensor for which the defaults were chosen.
const USUAL_SIDE: f64 = 346.0;

impl DetectionSettings {
    /// Adapts the settings to this sensor: with more pixels, the same board has larger circles with more pixels on their edges.
    pub fn for_sensor(&self, sensor: Sensor) -> Cow<'_, Self> {
        let scale = f64::from(sensor.width.max(sensor.height)) / USUAL_SIDE;
        if scale <= 1.0 {
            return Cow::Borrowed(self);
        }
        let mut settings = self.clone();
        settings.circle.max_radius = (f64::from(self.circle.max_radius) * scale) as f32;
        settings.window.most_events = (f64::from(self.window.most_events) * scale) as u32;
        Cow::Owned(settings)
    }

    /// Returns the settings of the core's detector.
    pub fn detector(&self) -> DetectorSettings {
        DetectorSettings { extraction: self.extraction, cluster: self.cluster, circle: self.circle }
    }

    /// Returns the fewest circles of a board in a reference frame.
    pub fn fewest_circles(&self, pattern: &Pattern) -> usize {
        ((self.fewest_circles * pattern.circle_count() as f64).ceil() as usize).max(FEWEST_CIRCLES)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn circle_and_window_limits_grow_for_larger_sensors_only() {
        let settings = DetectionSettings::default();
        for sensor in [Sensor::new(346, 260), Sensor::new(128, 128), Sensor::new(240, 180)] {
            assert_eq!(*settings.for_sensor(sensor), settings);
        }
        let large = settings.for_sensor(Sensor::new(1280, 720)).into_owned();
        assert!((large.circle.max_radius - 32.0 * 1280.0 / 346.0).abs() < 0.01);
        assert_eq!(large.window.most_events, 29_595);
        let same = DetectionSettings { circle: settings.circle, window: settings.window, ..large };
        assert_eq!(same, settings);
    }
}
