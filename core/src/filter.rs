//! A fast per-event filter ahead of the windows: hot pixels, refractory pixels, background activity.
//!
//! The stages run in this order; each is optional:
//!
//! - **Hot pixels.** A pixel with more than [`hot_events`](FilterSettings::hot_events) events in a period is
//!   hot for the rest of the period and all of the next.
//! - **Refractory.** An event (of either polarity) is dropped if it comes less than
//!   [`refractory_us`](FilterSettings::refractory_us) after the last event of its pixel that was not dropped as
//!   refractory.
//! - **Background activity.** An event is dropped unless a cell that contains its pixel or one of the eight pixels
//!   around it had an event less than [`background_us`](FilterSettings::background_us) before (after Delbruck,
//!   *Frame-free dynamic digital vision*, 2008, on a coarser grid).
//!
//! One timestamp for every pixel would exceed the memory of a microcontroller, so the caller chooses the size of both
//! memories:
//!
//! - `CELLS` timestamps of two bytes each, one per square cell. The cells are as small as `CELLS` allows: for 346×260
//!   pixels, 5655 cells of 4×4 pixels.
//! - `SLOTS` entries of eight bytes each, shared by all pixels. With as many slots as pixels, hot and refractory pixels
//!   are found exactly. With fewer, a slot tracks one of its pixels at a time, preferably an active one, and events of
//!   its other pixels pass. A slot never causes the events of another pixel to be dropped.
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
    /// Largest number of events of one pixel in a period; 0 turns the hot-pixel filter off.
    /// Default: 30, which with the default period is 300 events per second.
    pub hot_events: u16,
    /// The period in microseconds, 1 to 300 000.
    /// Default: 100 000.
    pub hot_period_us: u32,
    /// Refractory time of a pixel in microseconds, with a resolution of 16, at most the period; 0 turns the filter off.
    /// Default: 0.
    pub refractory_us: u32,
    /// Largest age of a neighbour's event in microseconds, with a resolution of 64, at most 2 s; 0 turns the filter
    /// off.
    /// Default: 2000.
    pub background_us: u32,
}

impl Default for FilterSettings {
    fn default() -> Self {
        Self { hot_events: 30, hot_period_us: 100_000, refractory_us: 0, background_us: 2000 }
    }
}

/// Result of the filter for one event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum EventFate {
    /// The event passes.
    Keep,
    /// The event lies outside the sensor.
    Outside,
    /// The event's pixel is hot.
    Hot,
    /// The event came too soon after the previous event of its pixel.
    Refractory,
    /// No neighbouring pixel had a recent event.
    Background,
}

/// Number of events by result.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FilterCounts {
    /// Events that passed.
    pub kept: u32,
    /// Events outside the sensor.
    pub outside: u32,
    /// Events of hot pixels.
    pub hot: u32,
    /// Events too soon after the previous event of their pixel.
    pub refractory: u32,
    /// Events without a recent event in the neighbourhood.
    pub background: u32,
}

/// The memory of a filter. Its initial value is all zeros, so a static of this type takes no flash.
#[derive(Debug)]
pub struct FilterStorage<const CELLS: usize, const SLOTS: usize> {
    cells: [u16; CELLS],
    slots: [Slot; SLOTS],
}

impl<const CELLS: usize, const SLOTS: usize> FilterStorage<CELLS, SLOTS> {
    /// Creates empty storage. `SLOTS` must be a power of two (checked at compile time).
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
    /// The sensor has more than `CELLS` cells, even with the largest cells of 64×64 pixels.
    Cells,
    /// More than 65 536 pixels share a slot.
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

/// Decides for each event whether it passes.
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
    /// Time of the first event, from which both memories count; `None` before it.
    origin_us: Option<i64>,
    counts: FilterCounts,
}

impl<'a, const CELLS: usize, const SLOTS: usize> EventFilter<'a, CELLS, SLOTS> {
    /// Creates a filter and clears `storage`.
    ///
    /// # Errors
    /// Returns an error if the storage is too small for the sensor.
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

    /// Decides whether the next event passes. Events must come in order of time.
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

    /// Returns the number of events so far, by result.
    pub const fn counts(&self) -> &FilterCounts {
        &self.counts
    }

    /// Returns the width and height of a cell of the background filter, in pixels.
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
