//! The mean delay of the first OFF events of all bursts, which is the zero of all latencies.
//!
//! A delay of all events looks like a shift of the clock, so one latency has to be fixed. A single class is not a good
//! zero: the speed of the edge influences which bursts are long, and thereby the position on the edge at which bursts
//! of one length begin. A position that changes with the speed looks like a delay. The delay extrapolated to the middle
//! of the sensor and to infinitely large dots is not a good zero either, because no events are observed there. So the
//! zero is the mean of all first OFF events.

use evcal_core::event::Polarity;

use super::bias::Bias;
use super::{EventBias, EventKind};
use crate::solve::observation_range::EventResidual;
use crate::trajectory::Trajectory;
use evcal_geometry::numerics::statistics::{SIGMA_BY_MEDIAN, median};

/// Events farther from the fitted line than this many times their spread do not count.
const OUTLIER: f64 = 3.0;
/// Number of passes that remove outliers.
const PASSES: usize = 3;

/// Computes the mean delay (s) of the first OFF events of all bursts from `residuals` at `bias`.
pub fn common_delay(bias: &EventBias, residuals: &[EventResidual]) -> f64 {
    let place = |event: &EventResidual| {
        let class = usize::from(event.class);
        let known = bias.get(class).filter(|_| is_first_off(class))?;
        let speed = f64::from(event.normal_speed);
        // The known latency was already subtracted from the time.
        Some((speed, f64::from(event.distance) + known.biases[Bias::Latency] * speed))
    };
    delay(residuals.iter().filter_map(place).collect())
}

fn is_first_off(class: usize) -> bool {
    let EventKind { polarity, place } = EventKind::of_class(class);
    polarity == Polarity::Off && place.rank == 0
}

/// Reduces the latencies of all classes by `delay` (s), and shifts the trajectories later by it: events alone do not
/// distinguish the two.
pub fn shift_clock(bias: &mut EventBias, trajectories: &mut [Trajectory], delay: f64) {
    bias.iter_mut().for_each(|class| class.biases[Bias::Latency] -= delay);
    trajectories.iter_mut().flat_map(|trajectory| &mut trajectory.knots).for_each(|knot| *knot += delay);
}

/// Returns the slope of a robust line through (speed in px/s, distance in px), which is a delay (s); 0 if all speeds are the
/// same.
fn delay(mut places: Vec<(f64, f64)>) -> f64 {
    let mut slope = 0.0;
    for _ in 0..PASSES {
        let line = line(&places);
        slope = line.1;
        let off = |&(speed, distance): &(f64, f64)| (distance - line.0 - line.1 * speed).abs();
        let mut sizes: Vec<f64> = places.iter().map(off).collect();
        let Some(middle) = median(&mut sizes, f64::total_cmp) else { break };
        places.retain(|place| off(place) <= OUTLIER * SIGMA_BY_MEDIAN * middle);
    }
    slope
}

/// Returns offset and slope of the least-squares line.
fn line(places: &[(f64, f64)]) -> (f64, f64) {
    let count = places.len().max(1) as f64;
    let sum = |of: &dyn Fn(f64, f64) -> f64| places.iter().map(|&(speed, distance)| of(speed, distance)).sum::<f64>();
    let [speed, distance] = [sum(&|speed, _| speed) / count, sum(&|_, distance| distance) / count];
    let spread = sum(&|one, _| (one - speed) * (one - speed));
    let product = sum(&|one, other| (one - speed) * (other - distance));
    let slope = if spread > 0.0 { product / spread } else { 0.0 };
    (distance - slope * speed, slope)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::rows::event_bias::{CLASSES_OF_LENGTH, unknown};

    /// All first events are 0.3 ms late, at positions on the edge that do not depend on the speed. Those that begin farther out
    /// have long bursts; their share grows as the edge gets slower. Some events are noise.
    #[test]
    fn the_selection_by_burst_length_does_not_look_like_a_latency() {
        let late = 3e-4;
        let mut bias = unknown(1.0);
        bias[0].biases[Bias::Offset] = 0.2;
        bias[0].biases[Bias::Latency] = 1e-4;
        let mut residuals = Vec::new();
        for step in 0..100_u16 {
            let speed = -100.0 - 5.0 * f64::from(step);
            for place in 0..100_u16 {
                let class = if place > 20 + step / 2 { 0 } else { CLASSES_OF_LENGTH };
                let known = bias[class].biases;
                // The known latency was already subtracted from the time.
                let distance = f64::from(place) / 100.0 - 0.5 + (late - known[Bias::Latency]) * speed;
                let noise = if place == 50 { 4.0 + 0.01 * speed } else { 0.0 };
                residuals.push(EventResidual {
                    class: class as u8,
                    normal_speed: speed as f32,
                    distance: (distance + noise) as f32,
                    residual: (distance + noise - known[Bias::Offset]) as f32,
                    ..EventResidual::default()
                });
            }
        }
        assert!((common_delay(&bias, &residuals) - late).abs() < 1e-5);
        // An event of another class does not count.
        let other = EventResidual { class: 1, normal_speed: 1e6, distance: 50.0, ..EventResidual::default() };
        residuals.push(other);
        assert!((common_delay(&bias, &residuals) - late).abs() < 1e-5);
    }

    #[test]
    fn without_events_or_differences_of_speed_the_delay_is_zero() {
        let bias = unknown(1.0);
        assert_eq!(common_delay(&bias, &[]), 0.0);
        let event = EventResidual { normal_speed: -50.0, distance: 0.3, ..EventResidual::default() };
        assert_eq!(common_delay(&bias, &[event; 9]), 0.0);
    }
}
