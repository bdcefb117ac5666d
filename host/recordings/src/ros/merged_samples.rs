//! IMU samples whose angular velocities and accelerations are in two topics, as drivers of some cameras publish them.
//!
//! Each angular velocity gets the acceleration at its time, interpolated between the accelerations before and after it.

use std::collections::VecDeque;

use crate::extras::InertialSample;

/// Largest number of angular velocities that wait for a later acceleration; the topic of accelerations has ended if it is exceeded.
const MOST_WAITING: usize = 4096;

/// Quantities that a sample contains. A sensor never reads exactly zero along all axes, so zeros were not measured.
#[derive(Clone, Copy, Debug)]
pub struct Quantities {
    pub acceleration: bool,
    pub angular_velocity: bool,
}

impl Quantities {
    /// Returns the quantities in `sample`.
    pub fn of(sample: &InertialSample) -> Self {
        let is_measured = |values: [f32; 3]| values.iter().any(|value| *value != 0.0 && value.is_finite());
        Self { acceleration: is_measured(sample.acceleration), angular_velocity: is_measured(sample.angular_velocity) }
    }

    /// `true` if the sample is complete.
    pub fn are_both(&self) -> bool {
        self.acceleration && self.angular_velocity
    }
}

/// Samples made of messages of two topics.
#[derive(Debug, Default)]
pub struct MergedSamples {
    /// Angular velocities without an acceleration, in order of arrival.
    waiting: VecDeque<InertialSample>,
    /// The last two accelerations.
    accelerations: [Option<InertialSample>; 2],
}

impl MergedSamples {
    /// Adds the next angular velocity.
    pub fn add_angular_velocity(&mut self, sample: InertialSample) {
        if self.waiting.len() < MOST_WAITING {
            self.waiting.push_back(sample);
        }
    }

    /// Adds the next acceleration.
    pub fn add_acceleration(&mut self, sample: InertialSample) {
        let [_, before] = self.accelerations;
        self.accelerations = [before, Some(sample)];
        // Without an acceleration before them, the first angular velocities have none.
        if before.is_none() {
            self.waiting.retain(|waiting| waiting.t >= sample.t);
        }
    }
}

/// The complete samples; `None` until more messages were added.
impl Iterator for MergedSamples {
    type Item = InertialSample;

    fn next(&mut self) -> Option<InertialSample> {
        let [_, after] = self.accelerations;
        let (next, after) = (*self.waiting.front()?, after?);
        if next.t > after.t {
            return None;
        }
        self.waiting.pop_front();
        let before = self.accelerations.first().copied().flatten().unwrap_or(after);
        let share = match after.t - before.t {
            0 => 1.0,
            apart => ((next.t - before.t) as f64 / apart as f64).clamp(0.0, 1.0) as f32,
        };
        let acceleration = std::array::from_fn(|axis| {
            before.acceleration[axis] + share * (after.acceleration[axis] - before.acceleration[axis])
        });
        Some(InertialSample { acceleration, ..next })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(t: i64, acceleration: f32, angular_velocity: f32) -> InertialSample {
        InertialSample {
            t,
            temperature: 0.0,
            acceleration: [acceleration, 0.0, 2.0 * acceleration],
            angular_velocity: [0.0, angular_velocity, 0.0],
        }
    }

    #[test]
    fn accelerations_are_interpolated_to_the_times_of_the_angular_velocities() {
        let mut merged = MergedSamples::default();
        let mut found = Vec::new();
        // Accelerations every 4 ms, a = t / 1 ms; angular velocities every 3 ms, half a millisecond later.
        let mut messages: Vec<(i64, bool)> = (0..20).map(|index| (4000 * index, true)).collect();
        messages.extend((0..25).map(|index| (3000 * index + 500, false)));
        messages.sort();
        for (t, is_acceleration) in messages {
            match is_acceleration {
                true => merged.add_acceleration(sample(t, t as f32 / 1000.0, 0.0)),
                false => merged.add_angular_velocity(sample(t, 0.0, t as f32)),
            }
            found.extend(merged.by_ref());
        }
        assert!(found.len() >= 24 && found.is_sorted_by_key(|sample| sample.t));
        for sample in found {
            let expected = sample.t as f32 / 1000.0;
            assert!((sample.acceleration[0] - expected).abs() < 1e-3, "{sample:?}");
            assert!((sample.acceleration[2] - 2.0 * expected).abs() < 1e-3, "{sample:?}");
            assert_eq!(sample.angular_velocity[1], sample.t as f32);
        }
    }

    #[test]
    fn angular_velocities_before_the_first_acceleration_are_left_out() {
        let mut merged = MergedSamples::default();
        merged.add_angular_velocity(sample(1000, 0.0, 1.0));
        merged.add_acceleration(sample(2000, 5.0, 0.0));
        merged.add_angular_velocity(sample(3000, 0.0, 1.0));
        assert_eq!(merged.next(), None);
        merged.add_acceleration(sample(4000, 7.0, 0.0));
        assert_eq!(merged.next().map(|sample| (sample.t, sample.acceleration[0])), Some((3000, 6.0)));
        assert_eq!(merged.next(), None);
    }
}
