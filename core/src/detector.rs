//! Detection of circle candidates in the events of a window, with the storage for it.
//!
//! ```
//! use evcal_core::cluster::{row_bytes, row_count};
//! use evcal_core::sensor::Sensor;
//! use evcal_core::detector::{Detector, DetectorSettings};
//! use evcal_core::event::{Event, Polarity};
//!
//! // Room for a sensor of 346×260 pixels, 2048 runs of pixels, 128 clusters of each polarity.
//! type Detector346 = Detector<f32, { row_bytes(346) }, { row_count(260) }, 2048, 128>;
//!
//! let mut detector = Detector346::new();
//! let sensor = Sensor { width: 346, height: 260 };
//! // A dot of radius 8 px at (100, 100) that moves to the right.
//! let events = (-60..=60).flat_map(|degrees| {
//!     let (sin, cos) = f32::from(degrees as i16).to_radians().sin_cos();
//!     let y = (100.0 + 8.0 * sin).round() as u16;
//!     let on = Event { t: 0, x: (100.0 - 8.0 * cos).round() as u16, y, polarity: Polarity::On };
//!     let off = Event { t: 0, x: (100.0 + 8.0 * cos).round() as u16, y, polarity: Polarity::Off };
//!     [on, off]
//! });
//! let detection = detector.detect(sensor, events, &DetectorSettings::default())?;
//! assert_eq!(detection.circles.circles, 1);
//! let circle = detector.circles()[0];
//! assert!((circle.center.x - 100.0).abs() < 0.1 && (circle.radius - 8.0).abs() < 0.3);
//! # Ok::<(), evcal_core::cluster::SensorTooLarge>(())
//! ```

use crate::circle::{CircleCandidate, CircleCounts, CircleSettings, Extraction, extract};
use crate::cluster::{Cluster, ClusterCounts, ClusterSettings, Clusterer, PixelRuns, SensorTooLarge};
use crate::event::{Event, Polarity};
use crate::sensor::Sensor;
use heapless::Vec;
use nalgebra::RealField;

/// Settings of the stages from events to circles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DetectorSettings {
    /// Method of deriving a circle from a pair of clusters.
    pub extraction: Extraction,
    /// Settings of the clustering of events.
    pub cluster: ClusterSettings,
    /// Settings of the search for circles among clusters.
    pub circle: CircleSettings,
}

/// Inputs, results and rejections of each stage, counted by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Detection {
    /// Counts of the clustering.
    pub clusters: ClusterCounts,
    /// Counts of the search for circles.
    pub circles: CircleCounts,
}

impl Detection {
    /// Returns `true` if anything was lost because the storage was full.
    pub const fn overflowed(&self) -> bool {
        self.clusters.pixels_over_capacity > 0
            || self.clusters.clusters_over_capacity > 0
            || self.circles.pairs_over_capacity > 0
    }
}

/// Finds circle candidates in the events of a window.
///
/// For 346×260 pixels, 2048 runs and 128 clusters of each polarity the detector takes 73 KiB in `f32`, enough for
/// windows of about 5000 events. The capacities have the same meaning as in [`Clusterer`]; there can be as many circles
/// as ON clusters. The initial value is all zeros, so a static of this type takes no flash.
#[derive(Debug)]
pub struct Detector<T, const ROW_BYTES: usize, const ROWS: usize, const RUNS: usize, const CLUSTERS: usize> {
    clusterer: Clusterer<T, ROW_BYTES, ROWS, RUNS, CLUSTERS>,
    circles: Vec<CircleCandidate<T>, CLUSTERS>,
}

impl<T: RealField + Copy, const ROW_BYTES: usize, const ROWS: usize, const RUNS: usize, const CLUSTERS: usize>
    Detector<T, ROW_BYTES, ROWS, RUNS, CLUSTERS>
{
    /// Creates empty storage.
    pub const fn new() -> Self {
        Self { clusterer: Clusterer::new(), circles: Vec::new() }
    }

    /// Finds the circles among the events of a window, and discards the results of the previous window.
    pub fn detect(
        &mut self,
        sensor: Sensor,
        events: impl IntoIterator<Item = Event>,
        settings: &DetectorSettings,
    ) -> Result<Detection, SensorTooLarge> {
        self.circles.clear();
        let clusters = self.clusterer.cluster(sensor, events, &settings.cluster)?;
        let circles = extract(
            self.clusterer.clusters(Polarity::On),
            self.clusterer.clusters(Polarity::Off),
            |cluster| self.clusterer.runs(cluster),
            settings.extraction,
            &settings.circle,
            &mut self.circles,
        );
        Ok(Detection { clusters, circles })
    }

    /// Returns the circles of the last window, in the order of their ON clusters.
    pub fn circles(&self) -> &[CircleCandidate<T>] {
        &self.circles
    }

    /// Returns the clusters of one polarity in the last window, ordered by their first core pixel in reading order.
    pub fn clusters(&self, polarity: Polarity) -> &[Cluster<T>] {
        self.clusterer.clusters(polarity)
    }

    /// Returns the pixels of a cluster of the last window, as runs in no particular order.
    pub fn runs<'a>(&'a self, cluster: &Cluster<T>) -> PixelRuns<'a> {
        self.clusterer.runs(cluster)
    }
}

impl<T: RealField + Copy, const ROW_BYTES: usize, const ROWS: usize, const RUNS: usize, const CLUSTERS: usize> Default
    for Detector<T, ROW_BYTES, ROWS, RUNS, CLUSTERS>
{
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::{row_bytes, row_count};

    /// A microcontroller with 128 KiB of RAM has room for the detector, a window of 4000 events and a stack.
    #[test]
    fn the_detector_of_a_small_sensor_is_small() {
        type Detector346 = Detector<f32, { row_bytes(346) }, { row_count(260) }, 2048, 128>;
        assert!(size_of::<Detector346>() <= 75 * 1024, "{} bytes", size_of::<Detector346>());
        assert!(size_of::<crate::window::EventStorage<4000>>() <= 32 * 1024);
    }
}
