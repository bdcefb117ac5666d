//! Assembles frames from the words of their columns.
//!
//! ```text
//! ts · 8 (global) or 9 (rolling)                               frame start
//! 3 × misc10(0, ten bits)                                      exposure, ADC cycles, lowest first
//! 4 × misc8(1, upper) misc8(2, lower)                          first x, first y, last x, last y (user)
//! per column: ts · 11 · one sample per row · ts · 13           reset levels
//! ts · 14 … ts · 15                                            exposure start, end
//! per column: ts · 12 · one sample per row · ts · 13           signal levels
//! ts · 10                                                      frame end
//! ```
//! A rolling shutter interleaves reset and signal columns. The value of a pixel is reset − signal level, clamped to
//! 0..=1023, and 1023 if the reset level is below 384 or the signal level is 0, which both indicate saturation. Columns
//! and rows of the wire are counted within the region, mirrored, then swapped.

use super::anomaly::AnomalyKind;
use super::layout::PixelArray;
use super::message::{Frame, Region, Shutter};

/// Smallest reset level of a pixel that is not saturated.
const RESET_LEVEL_LEAST: u16 = 384;
/// Value of a saturated pixel.
pub(super) const SATURATED: u16 = 1023;
/// Marks a missing reset level.
const MISSING: u16 = u16::MAX;
/// Number of words that contain the exposure time.
const EXPOSURE_WORDS: u8 = 3;
/// Number of bytes that contain the region.
const CORNER_BYTES: usize = 8;

fn pixel(reset: u16, signal: u16) -> u16 {
    if reset == MISSING {
        0
    } else if reset < RESET_LEVEL_LEAST || signal == 0 {
        SATURATED
    } else {
        reset.saturating_sub(signal)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Level {
    Reset,
    Signal,
}

/// A region in wire columns and rows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Geometry {
    region: Region,
    pub(super) columns: u16,
    pub(super) rows: u16,
}

impl Geometry {
    pub(super) fn new(array: &PixelArray, region: Region) -> Self {
        let (columns, rows) = match array.swap_axes {
            true => (region.height, region.width),
            false => (region.width, region.height),
        };
        Self { region, columns, rows }
    }

    /// Returns the index of the first pixel of wire column `index`, and the step from row to row.
    pub(super) fn column(&self, array: &PixelArray, index: u16) -> (usize, isize) {
        let last = |count: u16| usize::from(count.saturating_sub(1));
        let column = if array.mirror_columns {
            last(self.columns).saturating_sub(usize::from(index))
        } else {
            usize::from(index)
        };
        let row = if array.mirror_rows { last(self.rows) } else { 0 };
        let width = usize::from(self.region.width);
        let (position, step) = match array.swap_axes {
            true => (column * width + row, 1),
            false => (row * width + column, width as isize),
        };
        (position, if array.mirror_rows { -step } else { step })
    }
}

#[derive(Clone, Copy, Debug)]
struct Column {
    level: Level,
    /// Index of the next sample's pixel.
    position: usize,
    /// Step to the pixel of the following sample.
    step: isize,
    samples: u16,
    overfull: bool,
}

#[derive(Clone, Copy, Debug)]
struct Current {
    shutter: Shutter,
    start: u64,
    exposure_start: Option<u64>,
    exposure_end: Option<u64>,
    exposure_cycles: u32,
    exposure_words: u8,
    corners: [u8; CORNER_BYTES],
    corner_bytes: usize,
    geometry: Option<Geometry>,
    /// `true` if the frame cannot or need not be collected: its words are skipped.
    discarded: bool,
    column: Option<Column>,
    /// `true` if a column has begun and not ended, even if it is not collected because there are too many.
    within_column: bool,
    reset_columns: u16,
    signal_columns: u16,
    damaged_columns: u16,
}

/// Collects one frame in memory provided by the caller.
#[derive(Clone, Debug)]
pub(super) struct FrameAssembly<S> {
    memory: S,
    array: PixelArray,
    /// `true` once a first frame has begun: after that, stray words are faults.
    pub(super) synchronised: bool,
    /// `true` if a sample out of place was reported; those directly after it are not reported.
    stray: bool,
    current: Option<Current>,
}

impl<S: AsRef<[u16]> + AsMut<[u16]>> FrameAssembly<S> {
    pub(super) fn new(array: PixelArray, memory: S) -> Self {
        Self { memory, array, synchronised: false, stray: false, current: None }
    }

    /// Drops the incomplete frame, because the stream may not continue it.
    pub(super) fn interrupt(&mut self) {
        self.current = None;
        self.synchronised = false;
    }

    /// Drops the incomplete frame when the clock restarts, and skips its remaining words. Returns `true` if there was
    /// one.
    pub(super) fn discard(&mut self) -> bool {
        let Some(current) = self.current.as_mut().filter(|current| !current.discarded) else { return false };
        (current.discarded, current.geometry, current.column) = (true, None, None);
        true
    }

    pub(super) fn start(&mut self, shutter: Shutter, time: u64, report: &mut impl FnMut(AnomalyKind)) {
        if self.current.is_some() {
            report(AnomalyKind::FrameIncomplete);
        }
        self.synchronised = true;
        self.current = Some(Current {
            shutter,
            start: time,
            exposure_start: None,
            exposure_end: None,
            exposure_cycles: 0,
            exposure_words: 0,
            corners: [0; CORNER_BYTES],
            corner_bytes: 0,
            geometry: None,
            discarded: false,
            column: None,
            within_column: false,
            reset_columns: 0,
            signal_columns: 0,
            damaged_columns: 0,
        });
    }

    pub(super) fn exposure_bits(&mut self, bits: u16) -> Result<(), AnomalyKind> {
        let current = self.current.as_mut().ok_or(AnomalyKind::FrameStray)?;
        if current.exposure_words >= EXPOSURE_WORDS {
            return Err(AnomalyKind::FrameStray);
        }
        current.exposure_cycles |= u32::from(bits) << (10 * current.exposure_words);
        current.exposure_words += 1;
        Ok(())
    }

    /// Adds a byte of the corners; `lower` is `true` for the lower half of a number.
    pub(super) fn corner_byte(&mut self, byte: u8, lower: bool) -> Result<(), AnomalyKind> {
        let current = self.current.as_mut().ok_or(AnomalyKind::FrameStray)?;
        if lower != (current.corner_bytes % 2 == 1) {
            return Err(AnomalyKind::FrameStray);
        }
        let slot = current.corners.get_mut(current.corner_bytes).ok_or(AnomalyKind::FrameStray)?;
        *slot = byte;
        current.corner_bytes += 1;
        Ok(())
    }

    pub(super) fn exposure_start(&mut self, time: u64) -> Result<(), AnomalyKind> {
        self.current.as_mut().ok_or(AnomalyKind::FrameStray)?.exposure_start = Some(time);
        Ok(())
    }

    pub(super) fn exposure_end(&mut self, time: u64) -> Result<(), AnomalyKind> {
        self.current.as_mut().ok_or(AnomalyKind::FrameStray)?.exposure_end = Some(time);
        Ok(())
    }

    pub(super) fn column_start(&mut self, level: Level, report: &mut impl FnMut(AnomalyKind)) {
        self.stray = false;
        let Some(current) = self.current.as_mut() else { return report(AnomalyKind::FrameStray) };
        if current.column.is_some() {
            report(AnomalyKind::ColumnEndLost);
            close_column(current, self.memory.as_mut(), report);
        }
        if current.geometry.is_none() && !current.discarded {
            if current.exposure_words != EXPOSURE_WORDS || current.corner_bytes != CORNER_BYTES {
                report(AnomalyKind::FrameHeaderIncomplete);
            }
            current.geometry = region_of(current, &self.array, self.memory.as_ref().len(), report)
                .map(|region| Geometry::new(&self.array, region));
            current.discarded = current.geometry.is_none();
        }
        current.within_column = true;
        let Some(geometry) = current.geometry else { return };
        let columns = match level {
            Level::Reset => &mut current.reset_columns,
            Level::Signal => &mut current.signal_columns,
        };
        let index = *columns;
        *columns = columns.saturating_add(1);
        if index < geometry.columns {
            let (position, step) = geometry.column(&self.array, index);
            current.column = Some(Column { level, position, step, samples: 0, overfull: false });
        }
    }

    /// Adds samples of one column, in the order of its rows. A fault is returned with the index of its word.
    pub(super) fn samples(&mut self, words: &[[u8; 2]]) -> Result<(), (AnomalyKind, usize)> {
        if self.current.as_ref().is_some_and(|current| current.discarded) {
            return Ok(());
        }
        let open = self.current.as_mut().and_then(|current| Some((current.geometry?, current.column.as_mut()?)));
        let Some((geometry, column)) = open else {
            let known = core::mem::replace(&mut self.stray, true);
            return if known { Ok(()) } else { Err((AnomalyKind::FrameStray, 0)) };
        };
        let room = usize::from(geometry.rows.saturating_sub(column.samples));
        let (words, surplus) = words.split_at_checked(room).unwrap_or((words, &[]));
        let memory = self.memory.as_mut();
        for word in words {
            let sample = u16::from_le_bytes(*word) & SATURATED;
            if let Some(place) = memory.get_mut(column.position) {
                *place = match column.level {
                    Level::Reset => sample,
                    Level::Signal => pixel(*place, sample),
                };
            }
            column.position = column.position.wrapping_add_signed(column.step);
        }
        column.samples += words.len() as u16;
        if surplus.is_empty() || column.overfull {
            return Ok(());
        }
        column.overfull = true;
        if let Some(current) = self.current.as_mut() {
            current.damaged_columns = current.damaged_columns.saturating_add(1);
        }
        Err((AnomalyKind::ColumnOverfull, words.len()))
    }

    pub(super) fn column_end(&mut self, report: &mut impl FnMut(AnomalyKind)) {
        self.stray = false;
        match self.current.as_mut() {
            Some(current) if current.within_column || current.discarded => {
                current.within_column = false;
                close_column(current, self.memory.as_mut(), report);
            }
            Some(_) | None => report(AnomalyKind::FrameStray),
        }
    }

    pub(super) fn end(&mut self, time: u64, report: &mut impl FnMut(AnomalyKind)) -> Option<Frame<'_>> {
        let Some(mut current) = self.current.take() else {
            report(AnomalyKind::FrameStray);
            return None;
        };
        if current.discarded {
            return None;
        }
        if current.column.is_some() {
            report(AnomalyKind::ColumnEndLost);
            close_column(&mut current, self.memory.as_mut(), report);
        }
        let complete = current
            .geometry
            .filter(|geometry| current.reset_columns == geometry.columns && current.signal_columns == geometry.columns);
        let Some(Geometry { region, columns, rows }) = complete else {
            report(AnomalyKind::FrameIncomplete);
            return None;
        };
        let pixels = self.memory.as_ref().get(..usize::from(columns) * usize::from(rows))?;
        Some(Frame {
            shutter: current.shutter,
            start: current.start,
            end: time,
            exposure_start: current.exposure_start,
            exposure_end: current.exposure_end,
            exposure_cycles: current.exposure_cycles,
            region,
            damaged_columns: current.damaged_columns,
            pixels,
        })
    }
}

/// Marks the missing samples of the open column, and closes it. A surplus column is not open.
fn close_column(current: &mut Current, memory: &mut [u16], report: &mut impl FnMut(AnomalyKind)) {
    let (Some(geometry), Some(mut column)) = (current.geometry, current.column.take()) else { return };
    if column.samples == geometry.rows {
        return;
    }
    report(AnomalyKind::ColumnIncomplete);
    current.damaged_columns = current.damaged_columns.saturating_add(1);
    let missing = match column.level {
        Level::Reset => MISSING,
        Level::Signal => 0,
    };
    for _ in column.samples..geometry.rows {
        if let Some(place) = memory.get_mut(column.position) {
            *place = missing;
        }
        column.position = column.position.wrapping_add_signed(column.step);
    }
}

/// Returns the region that the corners span, limited to the sensor; `None` if there is nothing to collect.
fn region_of(
    current: &Current,
    array: &PixelArray,
    memory: usize,
    report: &mut impl FnMut(AnomalyKind),
) -> Option<Region> {
    let [x0, x0_low, y0, y0_low, x1, x1_low, y1, y1_low] = current.corners;
    if current.corner_bytes != CORNER_BYTES {
        return None;
    }
    let [x, y, last_x, last_y] = [[x0, x0_low], [y0, y0_low], [x1, x1_low], [y1, y1_low]].map(u16::from_be_bytes);
    let (width, height) = array.size();
    if last_x >= width || last_y >= height {
        report(AnomalyKind::FrameOutOfRange);
    }
    let (last_x, last_y) = (last_x.min(width.saturating_sub(1)), last_y.min(height.saturating_sub(1)));
    if last_x < x || last_y < y {
        report(AnomalyKind::FrameOutOfRange);
        return None;
    }
    let region = Region { x, y, width: last_x - x + 1, height: last_y - y + 1 };
    if usize::from(region.width) * usize::from(region.height) > memory {
        // Without memory, frames are not wanted, and this is not a fault.
        if memory > 0 {
            report(AnomalyKind::FrameTooLarge);
        }
        return None;
    }
    Some(region)
}
