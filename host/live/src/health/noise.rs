//! Event rate of pixels without motion in front of them.
//!
//! The sensor is divided into cells. A cell that an edge passes has hundreds of events in a tenth of a second; any
//! other cell has only its noise. A low quantile over cells and time is therefore noise, regardless of motion elsewhere
//! and of hot pixels.

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;

/// Width and height of a cell (px).
const CELL: u16 = 16;
/// Length of the slots in which cells are counted (µs).
const SLOT: i64 = 100_000;
/// Number of slots whose counts are combined: 2 s.
const SLOTS: u32 = 20;
/// The quantile.
const SHARE: f64 = 0.2;
/// The corresponding quantile of a normal distribution, if all cells are at rest.
const DEVIATIONS: f64 = -0.84;

/// Measures the noise from the events of cells.
#[derive(Clone, Debug)]
pub struct NoiseMeter {
    columns: usize,
    cells: Vec<u32>,
    /// Counts of all cells in the slots since the previous figure.
    counts: Vec<u32>,
    slots: u32,
    /// The current slot; `None` before the first event.
    current: Option<i64>,
    rate: Option<f64>,
}

impl NoiseMeter {
    /// Creates a meter for this sensor; incomplete cells at its right and lower edge are ignored.
    pub fn new(sensor: Sensor) -> Self {
        let (columns, rows) = (usize::from(sensor.width / CELL), usize::from(sensor.height / CELL));
        Self { columns, cells: vec![0; columns * rows], counts: Vec::new(), slots: 0, current: None, rate: None }
    }

    /// Adds the next events, in order of time (µs).
    pub fn push(&mut self, events: &[Event]) {
        for event in events {
            let slot = event.t.div_euclid(SLOT);
            if self.current.is_some_and(|current| slot > current) {
                self.close_slot();
            }
            self.current = Some(slot);
            let column = usize::from(event.x / CELL);
            if column < self.columns
                && let Some(cell) = self.cells.get_mut(usize::from(event.y / CELL) * self.columns + column)
            {
                *cell += 1;
            }
        }
    }

    fn close_slot(&mut self) {
        self.counts.extend_from_slice(&self.cells);
        self.cells.fill(0);
        self.slots += 1;
        if self.slots >= SLOTS {
            self.rate = self.rate_so_far();
            self.counts.clear();
            self.slots = 0;
        }
    }

    /// Returns the events per second of a pixel at rest in the complete slots since the previous figure; `None` without
    /// such slots.
    pub fn rate_so_far(&mut self) -> Option<f64> {
        let at = (SHARE * self.counts.len() as f64) as usize;
        if at >= self.counts.len() {
            return None;
        }
        let (_, count, _) = self.counts.select_nth_unstable(at);
        let pixel_seconds = f64::from(CELL) * f64::from(CELL) * SLOT as f64 * 1e-6;
        Some(mean_of_quantile(f64::from(*count)) / pixel_seconds)
    }

    /// Returns the events per second of a pixel at rest in the last complete 2 s; `None` before.
    pub fn rate(&self) -> Option<f64> {
        self.rate
    }
}

/// Returns the mean m of a Poisson distribution from its quantile: count = m + z √m.
fn mean_of_quantile(count: f64) -> f64 {
    let root = 0.5 * (-DEVIATIONS + (DEVIATIONS * DEVIATIONS + 4.0 * count).sqrt());
    if count > 0.0 { root * root } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use evcal_geometry::numerics::random::uniform_in;

    #[test]
    fn noise_is_measured_next_to_moving_edges() {
        let sensor = Sensor::new(346, 260);
        for rate in [0.3, 2.0, 10.0] {
            let mut random = ChaCha8Rng::seed_from_u64(7);
            let mut meter = NoiseMeter::new(sensor);
            let total = rate * 346.0 * 260.0;
            let (mut t, mut events) = (0.0, Vec::new());
            while t < 2.3e6 {
                t -= 1e6 / total * uniform_in(&mut random, 1e-12, 1.0).ln();
                let (x, y) = (uniform_in(&mut random, 0.0, 346.0) as u16, uniform_in(&mut random, 0.0, 260.0) as u16);
                events.push(Event { t: t as i64, x, y, polarity: Polarity::On });
                // The left half is full of edges.
                events.extend((0..20).map(|_| Event { t: t as i64, x: x / 2, y, polarity: Polarity::Off }));
            }
            meter.push(&events);
            let found = meter.rate().unwrap();
            assert!((found / rate - 1.0).abs() < 0.3, "{found} {rate}");
        }
        assert_eq!(NoiseMeter::new(sensor).rate(), None);
    }
}
