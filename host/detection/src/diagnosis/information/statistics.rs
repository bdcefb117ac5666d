//! Statistics of the events of a recording.

use std::cmp::Reverse;
use std::collections::HashMap;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;

use super::{Gap, HotPixel, LISTED, Peak, SaturatedReadout, seconds};
use crate::diagnosis::bad_pixels::hot_pixels;
use crate::diagnosis::flicker::RateBins;
use crate::diagnosis::saturation::SaturationDetector;
use crate::diagnosis::silent_lines::{SilentLines, dead_lines};
use crate::diagnosis::time_steps::TimeSteps;

/// Length of the bins for the peak rate, in microseconds.
const RATE_BIN: i64 = 10_000;
/// Shortest time without events that counts as a gap, in microseconds.
const GAP: i64 = 100_000;

/// Counts so far.
#[derive(Default)]
pub(super) struct Statistics {
    pub(super) events: u64,
    pub(super) on_events: u64,
    /// Timestamps of the first and the latest event (µs).
    pub(super) first: Option<i64>,
    pub(super) latest: i64,
    /// The largest column and row of an event.
    pub(super) largest: (u16, u16),
    /// Start and number of events of the current bin.
    bin: (i64, u64),
    /// Start and number of events of the fullest bin so far.
    fullest_bin: (i64, u64),
    pub(super) gap_count: u64,
    /// Duration and start of the longest gaps.
    longest_gaps: Vec<(i64, i64)>,
    /// Number of events of each pixel.
    pub(super) pixels: HashMap<(u16, u16), u64>,
    saturation: SaturationDetector,
    pub(super) bins: RateBins,
    pub(super) steps: TimeSteps,
}

impl Statistics {
    pub(super) fn add(&mut self, event: &Event) {
        match self.first {
            None => {
                self.first = Some(event.t);
                self.bin.0 = event.t;
            }
            Some(_) if event.t - self.latest > GAP => {
                self.gap_count += 1;
                self.longest_gaps.push((event.t - self.latest, self.latest));
                if self.longest_gaps.len() > 2 * LISTED {
                    self.keep_longest_gaps();
                }
            }
            Some(_) => {}
        }
        self.steps.add(event.t);
        self.latest = event.t;
        self.events += 1;
        self.on_events += u64::from(event.polarity == Polarity::On);
        self.largest = (self.largest.0.max(event.x), self.largest.1.max(event.y));
        let after_bin = event.t - self.bin.0;
        if after_bin >= RATE_BIN {
            self.close_bin();
            self.bin = (event.t - after_bin % RATE_BIN, 0);
        }
        self.bin.1 += 1;
        self.saturation.add(event.t - self.first.unwrap_or(event.t));
        self.bins.add(event.t - self.first.unwrap_or(event.t), event.polarity);
        *self.pixels.entry((event.x, event.y)).or_default() += 1;
    }

    fn close_bin(&mut self) {
        if self.bin.1 > self.fullest_bin.1 {
            self.fullest_bin = self.bin;
        }
    }

    /// Returns the largest rate; `None` if the recording is shorter than a bin, because then it would be less than the mean rate.
    pub(super) fn peak(&mut self) -> Option<Peak> {
        if self.latest - self.first? < RATE_BIN {
            return None;
        }
        self.close_bin();
        let (start, events) = self.fullest_bin;
        Some(Peak { rate: events as f64 / seconds(RATE_BIN), t_s: seconds(start - self.first?) })
    }

    pub(super) fn saturation(&self) -> Option<SaturatedReadout> {
        let found = self.saturation.finish();
        let (t_s, _) = *found.intervals.first()?;
        Some(SaturatedReadout { rate: found.rate, duration_s: found.duration(), t_s })
    }

    fn keep_longest_gaps(&mut self) {
        self.longest_gaps.sort_by_key(|&(duration, start)| (Reverse(duration), start));
        self.longest_gaps.truncate(LISTED);
    }

    pub(super) fn gaps(&mut self) -> Vec<Gap> {
        self.keep_longest_gaps();
        self.longest_gaps.sort_by_key(|&(_, start)| start);
        let first = self.first.unwrap_or_default();
        let gap = |&(duration, start): &(i64, i64)| Gap { t_s: seconds(start - first), duration_s: seconds(duration) };
        self.longest_gaps.iter().map(gap).collect()
    }

    /// Returns the lines of pixels without events if most lines have many; `line` returns the column or the row of a pixel.
    pub(super) fn dead_lines(&self, line: impl Fn(u16, u16) -> u16) -> Vec<u16> {
        let largest = usize::from(line(self.largest.0, self.largest.1));
        let mut lines = vec![0; if self.events > 0 { largest + 1 } else { 0 }];
        for ((x, y), events) in &self.pixels {
            if let Some(line) = lines.get_mut(usize::from(line(*x, *y))) {
                *line += events;
            }
        }
        dead_lines(&lines)
    }

    /// Returns the meaning of columns and rows of `sensor` without events.
    pub(super) fn silent(&self, sensor: Sensor) -> Option<SilentLines> {
        /// Larger sensors are not examined.
        const LARGEST: usize = 1 << 22;
        let width = usize::from(sensor.width);
        let size = width * usize::from(sensor.height);
        let mut counts = vec![0_u32; if size <= LARGEST { size } else { 0 }];
        for ((x, y), events) in &self.pixels {
            if let Some(count) = counts.get_mut(usize::from(*y) * width + usize::from(*x)).filter(|_| *x < sensor.width)
            {
                *count = u32::try_from(*events).unwrap_or(u32::MAX);
            }
        }
        SilentLines::found(&counts, width)
    }

    /// Returns the number of hot pixels, and the hottest of them.
    pub(super) fn hot_pixels(&self) -> (u64, Vec<HotPixel>) {
        let count = |x, y| {
            let place = u16::try_from(x).ok().zip(u16::try_from(y).ok());
            place.and_then(|place| self.pixels.get(&place)).copied().unwrap_or(0)
        };
        let pixels = self.pixels.iter().map(|(&(x, y), &events)| (usize::from(x), usize::from(y), events));
        let mut hot: Vec<HotPixel> = hot_pixels(pixels, count)
            .into_iter()
            .map(|(x, y, events)| HotPixel { x: x as u16, y: y as u16, events })
            .collect();
        hot.sort_by_key(|pixel| (Reverse(pixel.events), pixel.y, pixel.x));
        let count = hot.len() as u64;
        hot.truncate(LISTED);
        (count, hot)
    }
}
