//! Time of the last event of each cell of the sensor.

use crate::sensor::Sensor;

/// Bits by which microseconds are shifted right: a unit is 64 µs, and 16 bits wrap after 4.2 s.
const UNIT: u32 = 6;
/// Ages beyond this are too old.
const OLDEST: u16 = 0x8000;
const LARGEST_CELL: u32 = 6;

/// Times of the last event of square cells. Because times wrap, a cell that was silent for a multiple of 4.2 s seems to
/// have had a recent event; at worst an event of noise then passes.
#[derive(Debug)]
pub(super) struct CellGrid<'a, const CELLS: usize> {
    times: &'a mut [u16; CELLS],
    /// The width of a cell is 2 to this power.
    shift: u32,
    columns: u16,
    /// Last column and row of pixels.
    last: [u16; 2],
    /// Youngest age that is too old, in units; 0 when the filter is off.
    limit: u16,
}

impl<'a, const CELLS: usize> CellGrid<'a, CELLS> {
    /// Creates the grid with the smallest cells of which at most `CELLS` cover the sensor.
    pub fn new(sensor: Sensor, background_us: u32, times: &'a mut [u16; CELLS]) -> Option<Self> {
        let along = |pixels: u16, shift: u32| u32::from(pixels).div_ceil(1 << shift);
        let fits = |shift: &u32| along(sensor.width, *shift) * along(sensor.height, *shift) <= CELLS as u32;
        let off = background_us == 0;
        let shift = if off { 0 } else { (0..=LARGEST_CELL).find(fits)? };
        times.fill(0);
        Some(Self {
            times,
            shift,
            columns: along(sensor.width, shift) as u16,
            last: [sensor.width.saturating_sub(1), sensor.height.saturating_sub(1)],
            limit: if off { 0 } else { (background_us >> UNIT).clamp(1, u32::from(OLDEST) - 1) as u16 },
        })
    }

    pub const fn cell_size(&self) -> u16 {
        1 << self.shift
    }

    /// Returns `true` if the event has a neighbour, and records the event.
    #[inline]
    pub fn supports(&mut self, x: u16, y: u16, elapsed_us: i64) -> bool {
        if self.limit == 0 {
            return true;
        }
        // A cell without any event holds 0, which counts as too old during the first 2 s.
        let now = ((elapsed_us >> UNIT) as u16).wrapping_add(OLDEST);
        let [last_x, last_y] = self.last;
        let (left, right) = (x.saturating_sub(1) >> self.shift, x.saturating_add(1).min(last_x) >> self.shift);
        let (top, bottom) = (y.saturating_sub(1) >> self.shift, y.saturating_add(1).min(last_y) >> self.shift);
        let mut supported = false;
        for row in top..=bottom {
            let first = usize::from(row) * usize::from(self.columns) + usize::from(left);
            let length = usize::from(right.wrapping_sub(left)) + 1;
            let times = self.times.get(first..first + length).unwrap_or_default();
            supported |= times.iter().any(|&time| now.wrapping_sub(time) < self.limit);
        }
        let own = usize::from(y >> self.shift) * usize::from(self.columns) + usize::from(x >> self.shift);
        if let Some(time) = self.times.get_mut(own) {
            *time = now;
        }
        supported
    }
}
