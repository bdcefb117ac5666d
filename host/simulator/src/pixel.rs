//! The electronics of one pixel: photoreceptor, change amplifier, comparators, reset.

use evcal_core::event::{Event, Polarity};
use rand_chacha::ChaCha8Rng;

use super::sensor::SensorModel;
use evcal_geometry::numerics::random::{exponential, normal, uniform, uniform_in};

/// Length of a sub-step over which a settling photoreceptor is treated as linear, in time constants.
const RELAXATION_STEP: f64 = 0.3;
/// Deviation from steady tracking, in log intensity, below which no sub-steps are needed.
const RELAXATION_TOLERANCE: f64 = 0.02;
/// Distance of the photoreceptor from its input, in log intensity, at which it has settled.
const SETTLED: f64 = 1e-5;
/// Smallest threshold after mismatch.
const LEAST_THRESHOLD: f64 = 0.05;

/// Log intensity at the input of a pixel, and cut-off of the photoreceptor.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Input {
    /// Natural logarithm of the intensity.
    log_intensity: f64,
    /// Cut-off of the photoreceptor in radians per microsecond; infinite without a photoreceptor delay.
    rate: f64,
}

/// One pixel. Times are in microseconds since the start of the simulation.
#[derive(Clone, Debug)]
pub struct Pixel {
    x: u16,
    y: u16,
    gain: f64,
    thresholds: [f64; 2],
    next_thresholds: [f64; 2],
    leak: f64,
    noise_interval: f64,
    next_noise: f64,
    radiance: f64,
    input: Input,
    output: f64,
    memory: f64,
    reset_until: f64,
}

/// Output of a row and its random numbers.
pub struct RowOutput<'a> {
    /// Random numbers of the row.
    pub rng: &'a mut ChaCha8Rng,
    /// Events of the row in the current slice, in no particular order.
    pub events: &'a mut Vec<Event>,
}

impl Pixel {
    /// Creates a pixel at rest in the light of `radiance`, with random mismatch. `gain` is its light relative to the
    /// image centre; a `hot` pixel fires on its own.
    pub fn new(
        x: u16,
        y: u16,
        sensor: &SensorModel,
        gain: f64,
        hot: bool,
        radiance: f64,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let [off, on] = [sensor.threshold_off, sensor.threshold_on]
            .map(|threshold| (threshold + sensor.threshold_mismatch * normal(rng)).max(LEAST_THRESHOLD));
        // Subtract half the variance, so that the mean of all pixels is the specified rate.
        let deviation = sensor.noise_spread * std::f64::consts::LN_10;
        let spread = libm::exp(deviation * normal(rng) - 0.5 * deviation * deviation);
        let [slowest, fastest] = sensor.hot_rate;
        let hot_rate = uniform_in(rng, slowest, fastest);
        let noise_rate = sensor.noise_rate * spread + if hot { hot_rate } else { 0.0 };
        let noise_interval = 1e6 / noise_rate;
        let mut pixel = Self {
            x,
            y,
            gain,
            thresholds: [off, on],
            next_thresholds: [off, on],
            leak: sensor.leak_rate * 1e-6 * on,
            noise_interval,
            next_noise: noise_interval * exponential(rng),
            radiance,
            input: Input { log_intensity: 0.0, rate: f64::INFINITY },
            output: 0.0,
            memory: 0.0,
            reset_until: f64::NEG_INFINITY,
        };
        pixel.input = pixel.input_at(sensor, radiance);
        pixel.output = pixel.input.log_intensity;
        // The leak of each pixel starts at a random point of its cycle.
        let cycle = if sensor.leak_rate > 0.0 { uniform(rng) } else { 0.0 };
        pixel.memory = pixel.output - cycle * on;
        pixel
    }

    /// Changes the light to `radiance` from `start` to `end` (linear in log intensity), and emits events.
    #[inline]
    pub fn see(&mut self, sensor: &SensorModel, start: f64, end: f64, radiance: f64, out: &mut RowOutput<'_>) {
        if radiance == self.radiance && (self.output - self.input.log_intensity).abs() < SETTLED {
            self.compare(sensor, start, end, self.output, out);
            return;
        }
        self.radiance = radiance;
        let input = self.input_at(sensor, radiance);
        self.respond(sensor, start, end, input, out);
    }

    fn input_at(&self, sensor: &SensorModel, radiance: f64) -> Input {
        let intensity = self.gain * radiance + sensor.dark;
        let rate = match sensor.photoreceptor {
            Some(photoreceptor) => {
                let share = (intensity + photoreceptor.offset) / (1.0 + photoreceptor.offset);
                1e-6 * std::f64::consts::TAU * photoreceptor.bandwidth * share
            }
            None => f64::INFINITY,
        };
        Input { log_intensity: libm::log(intensity), rate }
    }

    #[inline]
    fn respond(&mut self, sensor: &SensorModel, start: f64, end: f64, input: Input, out: &mut RowOutput<'_>) {
        let from = std::mem::replace(&mut self.input, input);
        if input.rate.is_infinite() {
            self.compare(sensor, start, end, input.log_intensity, out);
            return;
        }
        // First-order low-pass of a ramp, exact for a constant rate: the output follows the ramp with a lag of its
        // slope divided by the rate, plus a transient that decays.
        let rate = 0.5 * (from.rate + input.rate);
        let rise = input.log_intensity - from.log_intensity;
        let mut rest = rate * (end - start);
        let lag = rise / rest;
        let mut transient = self.output - from.log_intensity + lag;
        let mut time = start;
        while rest > RELAXATION_STEP && transient.abs() > RELAXATION_TOLERANCE {
            rest -= RELAXATION_STEP;
            transient *= DECAY;
            let output = input.log_intensity - lag * (1.0 + rest) + transient;
            let next = time + RELAXATION_STEP / rate;
            self.compare(sensor, time, next, output, out);
            time = next;
        }
        let output = input.log_intensity - lag + transient * libm::exp(-rest);
        self.compare(sensor, time, end, output, out);
    }

    /// Changes the photoreceptor's output linearly to `output`, and emits events at thresholds.
    #[inline]
    fn compare(&mut self, sensor: &SensorModel, start: f64, end: f64, output: f64, out: &mut RowOutput<'_>) {
        let from = std::mem::replace(&mut self.output, output);
        if self.reset_until == f64::NEG_INFINITY {
            let leaked = self.memory - self.leak * (end - start);
            let change = output - leaked;
            let [off, on] = self.next_thresholds;
            if change < on && change > -off {
                self.memory = leaked;
                return;
            }
        }
        self.fire_between(sensor, start, from, end, output, out);
    }

    /// Emits events at thresholds on the straight line of the output from `from` at `start` to `output` at `end`.
    fn fire_between(
        &mut self,
        sensor: &SensorModel,
        start: f64,
        from: f64,
        end: f64,
        output: f64,
        out: &mut RowOutput<'_>,
    ) {
        let slope = (output - from) / (end - start);
        let at = |time: f64| from + slope * (time - start);
        let mut time = start;
        if self.reset_until >= time {
            if self.reset_until >= end {
                return;
            }
            time = self.reset_until;
            self.leave_reset(at(time));
        }
        let rise = slope + self.leak;
        loop {
            let change = at(time) - self.memory;
            let [off, on] = self.next_thresholds;
            let (polarity, wait) = if rise > 0.0 {
                (Polarity::On, (on - change) / rise)
            } else if rise < 0.0 {
                (Polarity::Off, (off + change) / -rise)
            } else {
                return;
            };
            if time + wait >= end {
                self.memory -= self.leak * (end - time);
                return;
            }
            time += wait.max(0.0);
            self.fire(sensor, time, polarity, out);
            self.reset_until = time + sensor.refractory * 1e6;
            if self.reset_until >= end {
                return;
            }
            time = self.reset_until;
            self.leave_reset(at(time));
        }
    }

    fn leave_reset(&mut self, output: f64) {
        self.memory = output;
        self.reset_until = f64::NEG_INFINITY;
    }

    fn fire(&mut self, sensor: &SensorModel, time: f64, polarity: Polarity, out: &mut RowOutput<'_>) {
        self.emit(sensor, time, polarity, out);
        if sensor.threshold_jitter > 0.0 {
            let factor = 1.0 + sensor.threshold_jitter * normal(out.rng);
            self.next_thresholds = self.thresholds.map(|threshold| (threshold * factor).max(LEAST_THRESHOLD));
        }
    }

    fn emit(&self, sensor: &SensorModel, time: f64, polarity: Polarity, out: &mut RowOutput<'_>) {
        let delay = match sensor.arbiter {
            Some(arbiter) => 1e6 * (arbiter.latency + arbiter.jitter * normal(out.rng).abs()),
            None => 0.0,
        };
        out.events.push(Event { t: (time + delay) as i64, x: self.x, y: self.y, polarity });
    }

    /// Emits noise events up to `end`. They do not affect the pixel's memory, so that the specified rates hold for any
    /// scene.
    #[inline]
    pub fn make_noise(&mut self, sensor: &SensorModel, end: f64, out: &mut RowOutput<'_>) {
        let refractory = (sensor.refractory * 1e6).min(self.noise_interval);
        while self.next_noise < end {
            let polarity = if uniform(out.rng) < 0.5 { Polarity::Off } else { Polarity::On };
            self.emit(sensor, self.next_noise, polarity, out);
            self.next_noise += refractory + (self.noise_interval - refractory) * exponential(out.rng);
        }
    }
}

/// exp(-[`RELAXATION_STEP`]).
const DECAY: f64 = 0.740_818_220_681_717_9;

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;
    use crate::sensor::Photoreceptor;

    fn pixel(sensor: &SensorModel, radiance: f64) -> (Pixel, ChaCha8Rng) {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        (Pixel::new(3, 4, sensor, 1.0, false, radiance, &mut rng), rng)
    }

    #[test]
    fn a_ramp_fires_at_every_threshold() {
        let sensor = SensorModel::ideal();
        let (mut pixel, mut rng) = pixel(&sensor, 1.0);
        let mut events = Vec::new();
        let mut out = RowOutput { rng: &mut rng, events: &mut events };
        // Log intensity decreases by 2 in 1 ms: by 0.43 every 215 µs.
        pixel.see(&sensor, 0.0, 1000.0, libm::exp(-2.0), &mut out);
        pixel.see(&sensor, 1000.0, 2000.0, libm::exp(-2.0), &mut out);
        let times: Vec<(i64, Polarity)> = events.iter().map(|event| (event.t, event.polarity)).collect();
        assert_eq!(times, [215, 430, 645, 860].map(|t| (t, Polarity::Off)));
    }

    #[test]
    fn changes_during_the_reset_are_ignored() {
        let sensor = SensorModel { refractory: 300e-6, ..SensorModel::ideal() };
        let (mut pixel, mut rng) = pixel(&sensor, 1.0);
        let mut events = Vec::new();
        let mut out = RowOutput { rng: &mut rng, events: &mut events };
        // With a slope of 1/ms, the threshold is reached after 430 µs, followed by 300 µs of reset, and so on.
        pixel.see(&sensor, 0.0, 2500.0, libm::exp(-2.5), &mut out);
        let times: Vec<i64> = events.iter().map(|event| event.t).collect();
        assert_eq!(times, [430, 1160, 1890]);
    }

    #[test]
    fn a_reset_that_ends_with_a_step_is_over() {
        let sensor = SensorModel { refractory: 100e-6, threshold_off: 0.4, ..SensorModel::ideal() };
        let (mut pixel, mut rng) = pixel(&sensor, 1.0);
        let mut events = Vec::new();
        let mut out = RowOutput { rng: &mut rng, events: &mut events };
        pixel.see(&sensor, 0.0, 500.0, libm::exp(-0.5), &mut out);
        pixel.see(&sensor, 500.0, 1000.0, libm::exp(-1.0), &mut out);
        let times: Vec<i64> = events.iter().map(|event| event.t).collect();
        assert_eq!(times.len(), 2, "{times:?}");
        assert!((times[0] - 400).abs() <= 1 && (times[1] - 900).abs() <= 1, "{times:?}");
    }

    /// The response to a step of light equals the response of a first-order low-pass, for one long look or many short
    /// ones.
    #[test]
    fn the_photoreceptor_is_a_first_order_low_pass() {
        let photoreceptor = Some(Photoreceptor { bandwidth: 500.0, offset: 1e9 });
        let sensor = SensorModel { photoreceptor, threshold_on: 0.3, ..SensorModel::ideal() };
        // With this offset the bandwidth does not depend on the light.
        let time_constant = 1e6 / (std::f64::consts::TAU * 500.0);
        for intervals in [1u32, 7, 100] {
            let (mut pixel, mut rng) = pixel(&sensor, 0.2);
            let mut events = Vec::new();
            let mut out = RowOutput { rng: &mut rng, events: &mut events };
            pixel.see(&sensor, 0.0, 1.0, 1.0, &mut out);
            for interval in 0..intervals {
                let time = |interval: u32| 1.0 + 5000.0 * f64::from(interval) / f64::from(intervals);
                pixel.see(&sensor, time(interval), time(interval + 1), 1.0, &mut out);
            }
            let rise = libm::log(5.0);
            assert_eq!(events.len(), 5);
            for (index, event) in (1..).zip(&events) {
                let expected = -time_constant * libm::log(1.0 - 0.3 * f64::from(index) / rise);
                // Straight lines over 0.3 time constants are accurate to 1 % of the step.
                let tolerance = 2.0 + 0.012 * rise / (rise - 0.3 * f64::from(index)) * time_constant;
                assert!((event.t as f64 - expected).abs() < tolerance, "{} and {expected}", event.t);
            }
        }
    }

    #[test]
    fn leak_fires_at_its_rate() {
        let sensor = SensorModel { leak_rate: 5.0, ..SensorModel::ideal() };
        let (mut pixel, mut rng) = pixel(&sensor, 0.5);
        let mut events = Vec::new();
        let mut out = RowOutput { rng: &mut rng, events: &mut events };
        for step in 0..1000 {
            pixel.see(&sensor, f64::from(step) * 1e4, f64::from(step + 1) * 1e4, 0.5, &mut out);
        }
        assert_eq!(events.len(), 50);
        assert!(events.iter().all(|event| event.polarity == Polarity::On));
        assert!(events.windows(2).all(|pair| (pair[1].t - pair[0].t - 200_000).abs() <= 1));
    }
}
