//! The delay of the first OFF events of all bursts together, which is the zero of all latencies.
//!
//! A delay of all events looks like a shift of the clock, so one latency has to be held. That of one class alone would not do: which
//! bursts are long changes with the speed of the edge, and so does the place on the edge where those of one length begin, as if they came
//! early or late. All lengths together have no such choice in them.

use evcal_core::event::Polarity;

use super::bias::Bias;
use super::{EventBias, EventKind};
use crate::solve::stretch::EventResidual;

/// Sums of a regression of the distance from the edge on the normal speed.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    count: f64,
    speed: f64,
    speed_squared: f64,
    distance: f64,
    product: f64,
}

impl Sums {
    fn add(&mut self, speed: f64, distance: f64) {
        self.count += 1.0;
        self.speed += speed;
        self.speed_squared += speed * speed;
        self.distance += distance;
        self.product += speed * distance;
    }

    /// Pixels for each px/s, which is a delay (s); 0 where all speeds are the same.
    fn slope(&self) -> f64 {
        let spread = self.count * self.speed_squared - self.speed * self.speed;
        if spread > 0.0 { (self.count * self.product - self.speed * self.distance) / spread } else { 0.0 }
    }
}

/// The latency (s) of the first OFF events of the class `reference`, relative to those of all lengths of bursts together, as `residuals` at
/// `bias` tell it.
pub fn relative_latency(bias: &EventBias, residuals: &[EventResidual], reference: usize) -> f64 {
    let is_first = |class: usize| {
        let EventKind { polarity, place } = EventKind::of_class(class);
        polarity == Polarity::Off && place.rank == 0
    };
    let (mut of_reference, mut of_all) = (Sums::default(), Sums::default());
    for event in residuals {
        let class = usize::from(event.class);
        let Some(known) = bias.get(class).filter(|_| is_first(class)) else { continue };
        let speed = f64::from(event.normal_speed);
        let distance = f64::from(event.residual) + known.biases[Bias::Offset] + known.biases[Bias::Latency] * speed;
        of_all.add(speed, distance);
        if class == reference {
            of_reference.add(speed, distance);
        }
    }
    of_reference.slope() - of_all.slope()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::event_bias::{CLASSES_OF_LENGTH, unknown};

    /// All first events come 0.3 ms late, at places on the edge that do not depend on the speed; those that begin farther out have long
    /// bursts, the more of them the slower the edge is.
    #[test]
    fn the_choice_of_the_lengths_is_no_latency() {
        let delay = 3e-4;
        let mut bias = unknown(1.0);
        bias[0].biases[Bias::Offset] = 0.2;
        bias[0].biases[Bias::Latency] = 1e-4;
        let mut residuals = Vec::new();
        for step in 0..100_u16 {
            let speed = -100.0 - 5.0 * f64::from(step);
            for place in 0..100_u16 {
                let distance = f64::from(place) / 100.0 - 0.5 + delay * speed;
                let class = if place > 20 + step / 2 { 0 } else { CLASSES_OF_LENGTH };
                let known = bias[class].biases;
                let residual = distance - known[Bias::Offset] - known[Bias::Latency] * speed;
                residuals.push(EventResidual {
                    class: class as u8,
                    normal_speed: speed as f32,
                    residual: residual as f32,
                    ..EventResidual::default()
                });
            }
        }
        // Long bursts begin at (0.71 + step / 200) / 2 - 0.5 on average, which is 0.5 ms for each px/s less.
        let long = relative_latency(&bias, &residuals, 0);
        assert!((long + 5e-4).abs() < 2e-5, "{long}");
        let others = relative_latency(&bias, &residuals, CLASSES_OF_LENGTH);
        assert!((others + 5e-4).abs() < 2e-5, "{others}");
        // An event of another kind is none of them.
        residuals.push(EventResidual { class: 1, normal_speed: 1e6, residual: 50.0, ..EventResidual::default() });
        assert_eq!(relative_latency(&bias, &residuals, 0), long);
    }
}
