//! IMU samples and their checks.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::error::{IN_ANOTHER, IN_G, IN_METRES, InertialError};
use super::sample::Sample;
use super::timing::{Ordered, Timing, ordered};
use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;
use evcal_geometry::numerics::statistics::{median, quantile};
use event_recordings::extras::Extra;
use event_recordings::{Recording, RecordingError};

/// Largest share of saturated samples.
const MOST_SATURATED: f64 = 0.1;
/// Number of successive samples with the same extreme value that shows saturation.
const RUN: usize = 5;
/// Share of the median acceleration that nearly every sample exceeds, or that the mean acceleration exceeds, if gravity is
/// included.
const STEADY: f64 = 0.6;

/// Statistics of a stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StreamReport {
    /// Number of samples.
    pub samples: usize,
    /// Samples per second, from the median interval.
    pub rate: f64,
    /// Share of the samples that are missing.
    pub missing: f64,
    /// Longest time without a sample (s).
    pub longest_gap: f64,
    /// Number of samples without a time of their own; they are excluded.
    pub out_of_order: usize,
    /// Treatment of the timestamps.
    #[serde(default, skip_serializing_if = "Timing::is_own")]
    pub timing: Timing,
    /// Share of the saturated samples; they are excluded.
    pub saturated: f64,
}

/// The IMU samples of a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReadSamples {
    /// The samples, on the clock of the recording's file (s).
    pub samples: Vec<Sample>,
    /// Parts of the recording that could not be read, as sentences.
    pub lost: Vec<String>,
}

/// Reads the IMU samples of a recording; samples before a damaged part are kept.
///
/// # Errors
/// [`RecordingError`] if it cannot be opened.
pub fn read(recording: &Recording) -> Result<ReadSamples, RecordingError> {
    let mut extras = recording.open_extras()?;
    let (mut samples, mut lost) = (Vec::new(), Vec::new());
    while let Some(extra) = extras.next_until(i64::MAX, &mut lost) {
        if let Extra::Inertial(sample) = extra {
            samples.push(Sample {
                t: sample.t as f64 * 1e-6,
                acceleration: Vector3::from(sample.acceleration).map(|value| f64::from(value) * STANDARD_GRAVITY),
                angular_velocity: Vector3::from(sample.angular_velocity).map(|value| f64::from(value).to_radians()),
            });
        }
    }
    Ok(ReadSamples { samples, lost })
}

/// Removes unusable samples, and checks times, units, gaps and saturation.
///
/// # Errors
/// [`InertialError`] if all timestamps are equal, a quantity is missing, the accelerations have another unit or no gravity, or too
/// many samples are saturated.
pub fn check(samples: Vec<Sample>) -> Result<(Vec<Sample>, StreamReport), InertialError> {
    check_content(&samples)?;
    let total = samples.len();
    let Ordered { samples: kept, timing } = ordered(samples);
    let mut intervals: Vec<f64> = kept.windows(2).map(|pair| pair[1].t - pair[0].t).collect();
    let longest_gap = intervals.iter().copied().fold(0.0, f64::max);
    let interval = median(&mut intervals, f64::total_cmp).unwrap_or(1.0);
    let mut missing: f64 = intervals.iter().map(|one| (one / interval).round() - 1.0).filter(|&one| one > 0.0).sum();
    let mut rate = 1.0 / interval;
    if let Timing::Sorted { .. } = timing {
        // Timestamps that scatter do not show which samples are missing.
        (missing, rate) = (0.0, kept.len() as f64 / intervals.iter().sum::<f64>());
    }
    let mut sizes: Vec<f64> = kept.iter().map(|sample| sample.acceleration.norm() / STANDARD_GRAVITY).collect();
    let reading = median(&mut sizes, f64::total_cmp).unwrap_or(1.0);
    sizes.sort_by(f64::total_cmp);
    // Motion adds to gravity and subtracts from it, but hardly changes the mean. Without gravity the mean is small.
    let mean = kept.iter().map(|sample| sample.acceleration).sum::<Vector3<f64>>() / kept.len().max(1) as f64;
    let steady = quantile(&sizes, 0.05).is_some_and(|low| low > STEADY * reading)
        || mean.norm() > STEADY * reading * STANDARD_GRAVITY;
    match reading {
        0.08..0.17 if steady => return Err(InertialError::acceleration_unit(reading, IN_G)),
        7.0..17.0 => return Err(InertialError::acceleration_unit(reading, IN_METRES)),
        ..0.6 => return Err(InertialError::GravityRemoved { reading }),
        1.7.. => return Err(InertialError::acceleration_unit(reading, IN_ANOTHER)),
        _ => {}
    }
    let at_end = at_end_of_scale(&kept);
    let saturated = at_end.iter().filter(|end| **end).count() as f64 / kept.len().max(1) as f64;
    if saturated > MOST_SATURATED {
        return Err(InertialError::Saturated { share: saturated });
    }
    let report = StreamReport {
        samples: kept.len(),
        rate,
        missing: missing / (missing + kept.len() as f64),
        longest_gap,
        out_of_order: total - kept.len(),
        timing,
        saturated,
    };
    let usable = kept.iter().zip(at_end).filter(|(_, end)| !end).map(|(sample, _)| *sample).collect();
    Ok((usable, report))
}

/// Checks that samples have different times, accelerations and angular velocities.
///
/// # Errors
/// [`InertialError::OneTime`] or [`InertialError::Lacks`] if they do not.
fn check_content(samples: &[Sample]) -> Result<(), InertialError> {
    let Some(first) = samples.first().filter(|_| samples.len() > 1) else { return Ok(()) };
    if samples.iter().all(|sample| sample.t == first.t) {
        return Err(InertialError::OneTime { t: first.t });
    }
    for (what, value) in [
        ("angular velocities", (|sample| sample.angular_velocity) as fn(&Sample) -> Vector3<f64>),
        ("accelerations", |sample| sample.acceleration),
    ] {
        if samples.iter().all(|sample| value(sample) == Vector3::zeros()) {
            return Err(InertialError::Lacks { what });
        }
    }
    Ok(())
}

/// Returns `true` for samples with an axis at its largest value, if that value repeats like a limit.
fn at_end_of_scale(samples: &[Sample]) -> Vec<bool> {
    let mut at_end = vec![false; samples.len()];
    for axis in 0..6 {
        let value = |sample: &Sample| {
            if axis < 3 { sample.acceleration[axis] } else { sample.angular_velocity[axis - 3] }
        };
        for sign in [-1.0, 1.0] {
            let end = samples.iter().map(|sample| sign * value(sample)).fold(f64::NEG_INFINITY, f64::max);
            let is_end: Vec<bool> = samples.iter().map(|sample| sign * value(sample) >= end).collect();
            if end > 0.0 && !is_end.iter().all(|end| *end) && is_end.windows(RUN).any(|run| run.iter().all(|end| *end))
            {
                at_end.iter_mut().zip(is_end).for_each(|(all, this)| *all |= this);
            }
        }
    }
    at_end
}

#[cfg(test)]
mod tests {
    use super::*;
    use event_recordings::aedat4::header::Compression;
    use event_recordings::aedat4::write::Encoder;
    use event_recordings::encode::Encode;
    use event_recordings::extras::{InertialSample, OtherStreams};
    use event_recordings::{Damage, RecordingOptions};

    fn stream(scale: f64) -> Vec<Sample> {
        (0..2000)
            .map(|index| {
                let t = 0.001 * f64::from(index);
                Sample {
                    t,
                    acceleration: Vector3::new((9.0 * t).sin(), -9.8 + (5.0 * t).cos(), 0.4) * scale,
                    angular_velocity: Vector3::new((3.0 * t).sin(), (4.0 * t).cos(), t.sin()),
                }
            })
            .collect()
    }

    #[test]
    fn samples_lost_to_damage_are_reported() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording.aedat4");
        let sample = |t| InertialSample { t, temperature: 1.0, acceleration: [0.0; 3], angular_velocity: [90.0; 3] };
        // Packets of 10 ms.
        let samples: Vec<InertialSample> = (0..30).map(|index| sample(1000 * index)).collect();
        let others = OtherStreams { frames: false, imu: true };
        let file = std::fs::File::create(&path).unwrap();
        let mut encoder = Encoder::with_streams(file, Compression::None, (346, 260).into(), "", others).unwrap();
        encoder.imu(&samples).unwrap();
        encoder.finish().unwrap();
        let content = std::fs::read(&path).unwrap();
        let last = content.windows(5).rposition(|bytes| bytes == b"IMUS\x06").unwrap();
        let read = |damage| {
            let options = RecordingOptions { damage, ..RecordingOptions::default() };
            read(&Recording::new(&path, options).unwrap()).unwrap()
        };
        let whole = read(Damage::Refuse);
        assert_eq!((whole.samples.len(), whole.lost.len()), (30, 0));
        assert!((whole.samples[29].angular_velocity.x - std::f64::consts::FRAC_PI_2).abs() < 1e-6);
        std::fs::write(&path, [&content[..last], b"X", &content[last + 1..]].concat()).unwrap();
        for damage in [Damage::Refuse, Damage::Skip] {
            let part = read(damage);
            assert_eq!(part.samples, whole.samples[..20]);
            assert!(part.lost.len() == 1 && part.lost[0].contains("damaged"), "{:?}", part.lost);
        }
    }

    #[test]
    fn a_good_stream_is_kept_whole() {
        let (kept, report) = check(stream(1.0)).unwrap();
        assert_eq!((kept.len(), report.samples, report.out_of_order), (2000, 2000, 0));
        assert!((report.rate - 1000.0).abs() < 1e-6 && report.missing == 0.0 && report.saturated == 0.0, "{report:?}");
    }

    #[test]
    fn wrong_units_and_missing_gravity_are_reported() {
        let text = |scale: f64| check(stream(scale)).unwrap_err().to_string();
        assert!(text(9.8).contains("m/s², and were read as g"));
        assert!(text(1.0 / 9.8).contains("g, and were read as m/s²"));
        let mut samples = stream(1.0);
        samples.iter_mut().for_each(|sample| sample.acceleration.y += 9.8);
        assert!(check(samples).unwrap_err().to_string().contains("gravity seems to have been removed"));
    }

    /// A fast motion varies the magnitude too much to show gravity in it.
    #[test]
    fn accelerations_in_g_of_a_fast_motion_are_not_taken_for_accelerations_without_gravity() {
        let mut samples = stream(1.0 / STANDARD_GRAVITY);
        for sample in &mut samples {
            sample.acceleration += Vector3::new(0.6 * (11.0 * sample.t).sin(), 0.9 * (7.0 * sample.t).sin(), 0.3);
        }
        assert!(check(samples.clone()).unwrap_err().to_string().contains("seem to be in g, and were read as m/s²"));
        let count = samples.len() as f64;
        let mean = samples.iter().map(|sample| sample.acceleration).sum::<Vector3<f64>>() / count;
        samples.iter_mut().for_each(|sample| sample.acceleration -= mean);
        assert!(check(samples).unwrap_err().to_string().contains("gravity seems to have been removed"));
    }

    #[test]
    fn samples_without_times_or_with_one_quantity_are_named() {
        let text = |change: fn(&mut Sample)| {
            let mut samples = stream(1.0);
            samples.iter_mut().for_each(change);
            check(samples).unwrap_err().to_string()
        };
        assert!(text(|sample| sample.t = 0.0).contains("all IMU samples have the timestamp 0.000000 s"));
        assert!(text(|sample| sample.acceleration = Vector3::zeros()).contains("contain no accelerations"));
        assert!(text(|sample| sample.angular_velocity = Vector3::zeros()).contains("contain no angular velocities"));
    }

    #[test]
    fn lost_late_and_saturated_samples_are_counted() {
        let mut samples = stream(1.0);
        samples.iter_mut().for_each(|sample| sample.angular_velocity.x = sample.angular_velocity.x.min(0.99));
        let clipped = samples.iter().filter(|sample| sample.angular_velocity.x == 0.99).count();
        samples[500].t = 0.3;
        let samples: Vec<Sample> =
            samples.into_iter().enumerate().filter(|(i, _)| i % 20 != 7).map(|(_, s)| s).collect();
        let (kept, report) = check(samples).unwrap();
        assert_eq!(report.out_of_order, 1);
        assert!((report.missing - 0.05).abs() < 2e-3, "{report:?}");
        assert!(clipped > 20 && kept.len() < report.samples);
        assert!(kept.iter().all(|sample| sample.angular_velocity.x < 0.99));
    }
}
