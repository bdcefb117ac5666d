//! The clustering: from pixels to runs, and from runs to clusters.

use super::bitmap::{Bitmap, Touched, ones};
use super::neighbourhood::Neighbourhood;
use super::runs::{NONE, Pixel, PixelRuns, RecentRows, Runs};
use super::{CentralMoments, Cluster, ClusterSettings, PixelSums};
use crate::event::{Event, Polarity};
use crate::sensor::Sensor;
use heapless::Vec;
use nalgebra::{RealField, Vector2};

/// Number of events and pixels processed, dropped by reason, and clusters found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClusterCounts {
    /// Events received.
    pub events: u32,
    /// Events outside the sensor.
    pub outside_sensor: u32,
    /// Pixels with events of both polarities, which are dropped.
    pub both_polarities: u32,
    /// Pixels with events of one polarity only: OFF, ON.
    pub pixels: [u32; 2],
    /// Core pixels: OFF, ON.
    pub core_pixels: [u32; 2],
    /// Border pixels: OFF, ON.
    pub border_pixels: [u32; 2],
    /// Clusters kept: OFF, ON.
    pub clusters: [u32; 2],
    /// Clusters with fewer than [`ClusterSettings::min_pixels`] pixels: OFF, ON.
    pub clusters_too_small: [u32; 2],
    /// Core or border pixels lost because there was no room for another run.
    pub pixels_over_capacity: u32,
    /// Clusters lost because there was no room for another one.
    pub clusters_over_capacity: u32,
}

impl ClusterCounts {
    /// Returns the number of distinct pixels with events of one polarity.
    pub const fn unique_pixels(&self) -> u32 {
        self.pixels[0].saturating_add(self.pixels[1])
    }
}

/// The sensor does not fit into the bitmaps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorTooLarge {
    /// The sensor.
    pub sensor: Sensor,
    /// Largest sensor that fits.
    pub capacity: Sensor,
}

impl core::fmt::Display for SensorTooLarge {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self { sensor, capacity } = self;
        write!(
            formatter,
            "a sensor of {}x{} pixels does not fit into bitmaps for {}x{}: enlarge ROW_BYTES or ROWS",
            sensor.width, sensor.height, capacity.width, capacity.height
        )
    }
}

impl core::error::Error for SensorTooLarge {}

/// Bitmaps, runs and clusters of one window, of fixed capacity.
///
/// `ROW_BYTES` and `ROWS` follow from the sensor by [`row_bytes`](super::row_bytes) and
/// [`row_count`](super::row_count). `RUNS` limits the runs of clustered pixels of both polarities (below 65535; in real
/// windows half the number of events is enough), `CLUSTERS` the clusters of each polarity. The initial value is all
/// zeros, so a static of this type takes no flash.
#[derive(Debug)]
pub struct Clusterer<T, const ROW_BYTES: usize, const ROWS: usize, const RUNS: usize, const CLUSTERS: usize> {
    pixels: [Bitmap<ROW_BYTES, ROWS>; 2],
    core: Bitmap<ROW_BYTES, ROWS>,
    touched: Touched<ROW_BYTES, ROWS>,
    /// Words with pixels that have neighbours but are not core pixels.
    undecided: Touched<ROW_BYTES, ROWS>,
    runs: Runs<RUNS>,
    clusters: [Vec<Cluster<T>, CLUSTERS>; 2],
    height: u16,
}

impl<T: RealField + Copy, const ROW_BYTES: usize, const ROWS: usize, const RUNS: usize, const CLUSTERS: usize>
    Clusterer<T, ROW_BYTES, ROWS, RUNS, CLUSTERS>
{
    /// Creates empty storage.
    pub const fn new() -> Self {
        const { assert!(CLUSTERS < NONE as usize, "clusters are numbered in 16 bits") };
        Self {
            pixels: [Bitmap::new(), Bitmap::new()],
            core: Bitmap::new(),
            touched: Touched::new(),
            undecided: Touched::new(),
            runs: Runs::new(),
            clusters: [Vec::new(), Vec::new()],
            height: 0,
        }
    }

    /// Clusters the events of a window, and discards the results of the previous window.
    pub fn cluster(
        &mut self,
        sensor: Sensor,
        events: impl IntoIterator<Item = Event>,
        settings: &ClusterSettings,
    ) -> Result<ClusterCounts, SensorTooLarge> {
        let capacity = Bitmap::<ROW_BYTES, ROWS>::CAPACITY;
        if sensor.width > capacity.width || sensor.height > capacity.height {
            return Err(SensorTooLarge { sensor, capacity });
        }
        self.clear();
        self.height = sensor.height;
        let mut counts = ClusterCounts::default();
        self.insert(sensor, events, &mut counts);
        self.drop_both_polarities(&mut counts);
        let neighbourhood = Neighbourhood::new(settings);
        for polarity in [Polarity::Off, Polarity::On] {
            let first_run = self.runs.len();
            self.find_core_runs(polarity, &neighbourhood, settings, &mut counts);
            self.find_border_runs(polarity, &neighbourhood, first_run, &mut counts);
            self.collect_clusters(polarity, first_run, settings, &mut counts);
        }
        Ok(counts)
    }

    /// Returns the clusters of one polarity, ordered by their first core pixel in reading order.
    pub fn clusters(&self, polarity: Polarity) -> &[Cluster<T>] {
        of(&self.clusters, polarity).as_slice()
    }

    /// Returns the pixels of a cluster, as runs in no particular order.
    pub fn runs<'a>(&'a self, cluster: &Cluster<T>) -> PixelRuns<'a> {
        self.runs.list(cluster.first_run)
    }

    fn clear(&mut self) {
        for y in self.touched.rows(self.height) {
            for bit in self.touched.words(y) {
                for bitmap in &mut self.pixels {
                    bitmap.set_word(bit, 0);
                }
                self.core.set_word(bit, 0);
            }
        }
        self.touched.clear();
        self.runs.clear();
        for clusters in &mut self.clusters {
            clusters.clear();
        }
    }

    fn insert(&mut self, sensor: Sensor, events: impl IntoIterator<Item = Event>, counts: &mut ClusterCounts) {
        let [off, on] = &mut self.pixels;
        for event in events {
            counts.events += 1;
            if event.x >= sensor.width || event.y >= sensor.height {
                counts.outside_sensor += 1;
                continue;
            }
            let (x, y) = (usize::from(event.x), usize::from(event.y));
            self.touched.mark(x, y);
            let bit = Bitmap::<ROW_BYTES, ROWS>::bit(x, y);
            match event.polarity {
                Polarity::Off => off.set(bit),
                Polarity::On => on.set(bit),
            }
        }
    }

    fn drop_both_polarities(&mut self, counts: &mut ClusterCounts) {
        let [off, on] = &mut self.pixels;
        for y in self.touched.rows(self.height) {
            for bit in self.touched.words(y) {
                let (off_word, on_word) = (off.word(bit), on.word(bit));
                let both = off_word & on_word;
                if both != 0 {
                    counts.both_polarities += both.count_ones();
                    off.set_word(bit, off_word & !both);
                    on.set_word(bit, on_word & !both);
                }
            }
        }
    }

    /// Marks the core pixels and joins their runs to clusters. Removes pixels without neighbours.
    fn find_core_runs(
        &mut self,
        polarity: Polarity,
        neighbourhood: &Neighbourhood,
        settings: &ClusterSettings,
        counts: &mut ClusterCounts,
    ) {
        let pixels = of_mut(&mut self.pixels, polarity);
        let enough = u32::from(settings.min_points);
        let (mut pixel_count, mut core_count, mut lost) = (0, 0, 0);
        let mut recent_rows = RecentRows::default();
        self.undecided.clear();
        for y in self.touched.rows(self.height) {
            let row_bit = Bitmap::<ROW_BYTES, ROWS>::bit(0, y);
            let first = self.runs.len();
            for bit in self.touched.words(y) {
                let word = pixels.word(bit);
                if word == 0 {
                    self.core.set_word(bit, 0);
                    continue;
                }
                pixel_count += word.count_ones();
                let left = neighbourhood.judge(pixels, bit, word & 0xffff, enough);
                let right = neighbourhood.judge(pixels, bit + 16, word >> 16, enough);
                let core = left.core | right.core << 16;
                let alone = left.alone | right.alone << 16;
                // A pixel without neighbours is in no other pixel's neighbourhood: it is noise.
                if alone != 0 {
                    pixels.set_word(bit, word & !alone);
                }
                if word != core | alone {
                    self.undecided.mark(bit - row_bit, y);
                }
                self.core.set_word(bit, core);
                core_count += core.count_ones();
                lost += self.runs.push_core(first, bit - row_bit, y, core, neighbourhood.half_width(0));
            }
            recent_rows.join(&mut self.runs, y, first, neighbourhood);
        }
        *of_mut(&mut counts.pixels, polarity) = pixel_count;
        *of_mut(&mut counts.core_pixels, polarity) = core_count;
        counts.pixels_over_capacity += lost;
    }

    /// Adds the border pixels to the clusters; `first_run` is the first run of this polarity.
    fn find_border_runs(
        &mut self,
        polarity: Polarity,
        neighbourhood: &Neighbourhood,
        first_run: usize,
        counts: &mut ClusterCounts,
    ) {
        let pixels = of(&self.pixels, polarity);
        let row_bits = Bitmap::<ROW_BYTES, ROWS>::ROW_BITS;
        let end = self.runs.len();
        for y in self.undecided.rows(self.height) {
            let row_bit = Bitmap::<ROW_BYTES, ROWS>::bit(0, y);
            for bit in self.undecided.words(y) {
                for index in ones(pixels.word(bit) & !self.core.word(bit)) {
                    let Some(core_bit) = neighbourhood.first(&self.core, bit + index) else { continue };
                    let core_y = (core_bit / row_bits).wrapping_sub(1);
                    let core = Pixel { x: (core_bit % row_bits) as u16, y: core_y as u16 };
                    let border = Pixel { x: (bit - row_bit + index) as u16, y: y as u16 };
                    if self.runs.push_border(border, core, first_run..end) {
                        *of_mut(&mut counts.border_pixels, polarity) += 1;
                    } else {
                        counts.pixels_over_capacity += 1;
                    }
                }
            }
        }
    }

    /// Numbers the clusters, drops the small ones, and sums up the pixels of each.
    fn collect_clusters(
        &mut self,
        polarity: Polarity,
        first_run: usize,
        settings: &ClusterSettings,
        counts: &mut ClusterCounts,
    ) {
        let clusters = of_mut(&mut self.clusters, polarity);
        let dropped = self.runs.collect(first_run, settings.min_pixels, clusters);
        *of_mut(&mut counts.clusters_too_small, polarity) = dropped.too_small;
        counts.clusters_over_capacity += dropped.over_capacity;
        for cluster in clusters.iter_mut() {
            cluster.measure(self.runs.list(cluster.first_run));
        }
        *of_mut(&mut counts.clusters, polarity) = clusters.len() as u32;
    }
}

impl<T: RealField + Copy, const ROW_BYTES: usize, const ROWS: usize, const RUNS: usize, const CLUSTERS: usize> Default
    for Clusterer<T, ROW_BYTES, ROWS, RUNS, CLUSTERS>
{
    fn default() -> Self {
        Self::new()
    }
}

impl<T: RealField + Copy> Cluster<T> {
    /// Returns a cluster without pixels.
    pub(super) fn empty() -> Self {
        let zero = T::zero();
        Self {
            moments: CentralMoments {
                n: zero,
                mean_x: zero,
                mean_y: zero,
                uu: zero,
                uv: zero,
                vv: zero,
                uz: zero,
                vz: zero,
            },
            center: Vector2::new(zero, zero),
            min: [0; 2],
            max: [0; 2],
            pixels: 0,
            first_run: NONE,
        }
    }

    /// Computes the moments, centre and bounding box from the pixels.
    fn measure(&mut self, runs: PixelRuns<'_>) {
        let Some(origin) = runs.clone().next() else { return };
        let (origin_x, origin_y) = (i32::from(origin.x), i32::from(origin.y));
        let mut sums = PixelSums::default();
        let mut min = [origin.x, origin.y];
        let mut max = min;
        for run in runs {
            sums.add_run(i32::from(run.x) - origin_x, i32::from(run.y) - origin_y, run.length());
            min = [min[0].min(run.x), min[1].min(run.y)];
            max = [max[0].max(run.last), max[1].max(run.y)];
        }
        if let Some(moments) = CentralMoments::new(&sums, origin_x, origin_y) {
            self.center = Vector2::new(moments.mean_x, moments.mean_y);
            self.moments = moments;
        }
        self.pixels = sums.n.unsigned_abs();
        self.min = min;
        self.max = max;
    }
}

fn of<V>(pair: &[V; 2], polarity: Polarity) -> &V {
    let [off, on] = pair;
    match polarity {
        Polarity::Off => off,
        Polarity::On => on,
    }
}

fn of_mut<V>(pair: &mut [V; 2], polarity: Polarity) -> &mut V {
    let [off, on] = pair;
    match polarity {
        Polarity::Off => off,
        Polarity::On => on,
    }
}
