//! Trajectory segments (section 6 of method.md).
//!
//! The board is only seen while it moves and is in view, so the trajectory consists of smooth segments: reference frames close in
//! time share one (paper III-C, the grouping into Φ_l).

use evcal_core::settings;
use evcal_core::settings::above;
use serde::{Deserialize, Serialize};

use evcal_geometry::numerics::statistics::median;

/// Longest gap within a segment, in median intervals of the frames: circle tracks may contain few frames.
const LONGEST_GAP_RATIO: f64 = 2.5;
/// Upper limit of that gap (s): a curve cannot follow a board for longer without a frame, and times in another unit would make
/// segments of years.
const LONGEST_BRIDGED_GAP: f64 = 0.5;
/// Fewest reference frames in a segment, if the spline does not need more.
const FEWEST_FRAMES: usize = 4;
/// Shortest segment that is kept (s).
const SHORTEST: f64 = 0.02;

settings! {
    /// Trajectory segments (section 6 of method.md).
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct SegmentSettings {
        /// A gap between neighbouring reference frames starts a new segment if it is longer than this, and also longer than the
        /// smaller of 0.5 s and 2.5 median intervals of the frames.
        pub longest_gap: f64 = 0.03, "s", above(0.0).at_most(10.0);
    }
}

/// Counts of the reference frames that were kept and dropped.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SegmentReport {
    /// Number of input frames.
    pub frames_in: usize,
    /// Frames in the segments that are kept.
    pub frames_out: usize,
    /// Number of kept segments.
    pub segments: usize,
    /// Number of segments dropped because of too few frames.
    pub too_few_frames: usize,
    /// Number of segments dropped because they are too short.
    pub too_short: usize,
    /// Time covered by the kept segments (s).
    pub duration: f64,
}

impl SegmentSettings {
    /// Returns the longest gap (s) within a segment of frames with an interval of `interval` seconds.
    pub fn longest_gap_at(&self, interval: f64) -> f64 {
        self.longest_gap.max((LONGEST_GAP_RATIO * interval).min(LONGEST_BRIDGED_GAP))
    }
}

/// Returns the median time between neighbouring frames of a recording (s), 0 without any.
pub fn typical_interval(times: &[(usize, f64)]) -> f64 {
    let pairs = times.iter().zip(times.iter().skip(1));
    let mut intervals: Vec<f64> = pairs.filter(|(a, b)| a.0 == b.0).map(|(a, b)| b.1 - a.1).collect();
    median(&mut intervals, f64::total_cmp).unwrap_or(0.0)
}

/// Returns the fewest reference frames in a segment with a spline of this degree.
pub fn fewest_frames(degree: usize) -> usize {
    FEWEST_FRAMES.max(degree + 1)
}

/// Groups frames, given by (recording, time) in order of recording and time, into segments: ranges of indices into `times`. A gap
/// of more than `longest_gap` seconds starts a new one.
pub fn segment(
    times: &[(usize, f64)],
    degree: usize,
    longest_gap: f64,
) -> (Vec<std::ops::Range<usize>>, SegmentReport) {
    let mut report = SegmentReport { frames_in: times.len(), ..SegmentReport::default() };
    let mut segments = Vec::new();
    let fewest = fewest_frames(degree);
    let mut end = 0;
    for group in times.chunk_by(|a, b| a.0 == b.0 && b.1 - a.1 <= longest_gap) {
        let start = end;
        end += group.len();
        let duration = group.last().map_or(0.0, |frame| frame.1) - group.first().map_or(0.0, |frame| frame.1);
        if group.len() < fewest {
            report.too_few_frames += 1;
        } else if duration < SHORTEST {
            report.too_short += 1;
        } else {
            report.frames_out += group.len();
            report.duration += duration;
            segments.push(start..end);
        }
    }
    report.segments = segments.len();
    (segments, report)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_and_recordings_split_and_short_groups_are_dropped() {
        let mut times: Vec<(usize, f64)> = (0..10).map(|i| (0, i as f64 * 0.01)).collect();
        times.extend((0..3).map(|i| (0, 1.0 + i as f64 * 0.01)));
        times.extend((0..6).map(|i| (0, 2.0 + i as f64 * 0.001)));
        times.extend((0..8).map(|i| (1, 2.01 + i as f64 * 0.01)));
        let (segments, report) = segment(&times, 3, SegmentSettings::default().longest_gap);
        assert_eq!(segments, [0..10, 19..27]);
        assert_eq!(report.frames_in, 27);
        assert_eq!(report.frames_out, 18);
        assert_eq!((report.segments, report.too_few_frames, report.too_short), (2, 1, 1));
        assert!((report.duration - 0.16).abs() < 1e-12);
    }

    /// Milliseconds or microseconds in a column of seconds.
    #[test]
    fn timestamps_in_another_unit_do_not_make_segments() {
        let kept = |interval: f64| {
            let times: Vec<(usize, f64)> = (0..60).map(|frame| (0, f64::from(frame) * interval)).collect();
            let longest_gap = SegmentSettings::default().longest_gap_at(typical_interval(&times));
            segment(&times, 3, longest_gap).1.frames_out
        };
        for interval in [0.01, 0.033, 0.1, 0.4] {
            assert_eq!(kept(interval), 60, "{interval}");
        }
        for interval in [1.0, 33.0, 33_333.0, 1e5, 1e300] {
            assert_eq!(kept(interval), 0, "{interval}");
        }
    }
}
