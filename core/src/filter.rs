//! A cheap filter for every event before it costs a place in a window: hot pixels, refractory pixels,
//! background activity.
//!
//! In this order, each optional:
//!
//! - **Hot pixels.** A pixel with more than [`hot_events`](FilterSettings::hot_events) events in a period is
//!   hot for the rest of the period and all of the next.
//! - **Refractory.** An event less than [`refractory_us`](FilterSettings::refractory_us) after one of its pixel
//!   that was not dropped so (either polarity) is dropped.
//! - **Background activity.** An event is dropped unless one of the 3×3 pixels around it, or of the cells they
//!   are in, gave an event less than [`background_us`](FilterSettings::background_us) before (after Delbruck,
//!   *Frame-free dynamic digital vision*, 2008, on a coarser grid).
//!
//! A time for every pixel would be more memory than a microcontroller has, so both memories have the size
//! that the caller gives:
//!
//! - `CELLS` times, two bytes each, for square cells as small as fit: 5655 cells for 346×260 make them 4×4.
//! - `SLOTS` pixels, eight bytes each, shared by all: with as many slots as pixels, hot and refractory
//!   pixels are found exactly; with fewer, a slot follows one of its pixels at a time, an active one
//!   before a quiet one, and events of the others pass. A slot never makes an event of another pixel fall.
//!
//! An event costs some tens of instructions. Nothing here panics.

mod background;
mod pixels;
#[cfg(test)]
mod tests;

use core::fmt;

use background::CellGrid;
use pixels::{PixelFilter, Slot};

use crate::event::Event;
use crate::sensor::Sensor;

/// Settings of the filter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FilterSettings {
    /// Most events of one pixel in a period; 0 turns the hot-pixel filter off.
    /// Default: 30, with the default period 300 events a second.
    pub hot_events: u16,
    /// The period in microseconds, 1 to 300 000.
    /// Default: 100 000.
    pub hot_period_us: u32,
    /// Refractory time of a pixel in microseconds, resolved to 16, at most the period; 0 turns the filter off.
    /// Default: 0.
    pub refractory_us: u32,
    /// How old the event of a neighbour may be, in microseconds, resolved to 64; 0 turns the filter off, 2 s is
    /// the most.
    /// Default: 2000.
    pub background_us: u32,
}

impl Default for FilterSettings {
    fn default() -> Self {
        Self { hot_events: 30, hot_period_us: 100_000, refractory_us: 0, background_us: 2000 }
    }
}

/// What becomes of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum EventFate {
    /// It passes.
    Keep,
    /// It lies outside the sensor.
    Outside,
    /// Its pixel is hot.
    Hot,
    /// Its pixel gave another just before.
    Refractory,
    /// It has no neighbour.
    Background,
}

/// Events by what became of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FilterCounts {
    /// Passed.
    pub kept: u32,
    /// Outside the sensor.
    pub outside: u32,
    /// Of hot pixels.
    pub hot: u32,
    /// Too soon after another of their pixel.
    pub refractory: u32,
    /// Without a neighbour.
    pub background: u32,
}

/// The memory of a filter. Its initial value is all zeros, so that a static of it costs no flash.
#[derive(Debug)]
pub struct FilterStorage<const CELLS: usize, const SLOTS: usize> {
    cells: [u16; CELLS],
    slots: [Slot; SLOTS],
}

impl<const CELLS: usize, const SLOTS: usize> FilterStorage<CELLS, SLOTS> {
    /// Empty. `SLOTS` must be a power of two (checked when compiled).
    pub const fn new() -> Self {
        const { assert!(SLOTS.is_power_of_two(), "SLOTS must be a power of two") };
        Self { cells: [0; CELLS], slots: [Slot::EMPTY; SLOTS] }
    }
}

impl<const CELLS: usize, const SLOTS: usize> Default for FilterStorage<CELLS, SLOTS> {
    fn default() -> Self {
        Self::new()
    }
}

/// The storage is too small for the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum StorageTooSmall {
    /// Even cells of 64×64 pixels are more than `CELLS`.
    Cells,
    /// There are more than 65 536 pixels a slot.
    Slots,
}

impl fmt::Display for StorageTooSmall {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Cells => "the filter has too few cells for the sensor: give it more CELLS",
            Self::Slots => "the filter has too few slots for the sensor: give it more SLOTS",
        })
    }
}

impl core::error::Error for StorageTooSmall {}

/// Judges event after event.
///
/// ```
/// use evcal_core::sensor::Sensor;
/// use evcal_core::event::{Event, Polarity};
/// use evcal_core::filter::{EventFilter, FilterSettings, FilterStorage, EventFate};
///
/// let mut storage = FilterStorage::<5655, 1024>::new();
/// let sensor = Sensor { width: 346, height: 260 };
/// let mut filter = EventFilter::new(sensor, FilterSettings::default(), &mut storage)?;
/// let event = |t, x, y| Event { t, x, y, polarity: Polarity::On };
/// assert_eq!(filter.judge(&event(0, 100, 100)), EventFate::Background);
/// assert_eq!(filter.judge(&event(500, 101, 100)), EventFate::Keep);
/// assert_eq!(filter.judge(&event(600, 346, 100)), EventFate::Outside);
/// assert_eq!(filter.counts().background, 1);
/// # Ok::<(), evcal_core::filter::StorageTooSmall>(())
/// ```
#[derive(Debug)]
pub struct EventFilter<'a, const CELLS: usize, const SLOTS: usize> {
    sensor: Sensor,
    pixels: PixelFilter<'a, SLOTS>,
    cells: CellGrid<'a, CELLS>,
    /// Time of the first event, once there was one: the memories count from there.
    origin_us: Option<i64>,
    counts: FilterCounts,
}

impl<'a, const CELLS: usize, const SLOTS: usize> EventFilter<'a, CELLS, SLOTS> {
    /// A filter that has seen nothing yet. What `storage` held is forgotten.
    ///
    /// # Errors
    /// If the storage is too small for the sensor.
    pub fn new(
        sensor: Sensor,
        settings: FilterSettings,
        storage: &'a mut FilterStorage<CELLS, SLOTS>,
    ) -> Result<Self, StorageTooSmall> {
        Ok(Self {
            sensor,
            pixels: PixelFilter::new(sensor, &settings, &mut storage.slots).ok_or(StorageTooSmall::Slots)?,
            cells: CellGrid::new(sensor, settings.background_us, &mut storage.cells).ok_or(StorageTooSmall::Cells)?,
            origin_us: None,
            counts: FilterCounts::default(),
        })
    }

    /// What becomes of the next event. Events come in order of time.
    #[inline]
    pub fn judge(&mut self, event: &Event) -> EventFate {
        let fate = self.fate(event);
        let count = match fate {
            EventFate::Keep => &mut self.counts.kept,
            EventFate::Outside => &mut self.counts.outside,
            EventFate::Hot => &mut self.counts.hot,
            EventFate::Refractory => &mut self.counts.refractory,
            EventFate::Background => &mut self.counts.background,
        };
        *count = count.saturating_add(1);
        fate
    }

    /// What was judged so far.
    pub const fn counts(&self) -> &FilterCounts {
        &self.counts
    }

    /// Width and height of a cell of the background filter, in pixels.
    pub const fn cell_size(&self) -> u16 {
        self.cells.cell_size()
    }

    #[inline]
    fn fate(&mut self, event: &Event) -> EventFate {
        if event.x >= self.sensor.width || event.y >= self.sensor.height {
            return EventFate::Outside;
        }
        let elapsed_us = event.t.saturating_sub(*self.origin_us.get_or_insert(event.t));
        match self.pixels.fate(event.x, event.y, elapsed_us) {
            EventFate::Keep if self.cells.supports(event.x, event.y, elapsed_us) => EventFate::Keep,
            EventFate::Keep => EventFate::Background,
            dropped => dropped,
        }
    }
}
