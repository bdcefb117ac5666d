//! A limit on the events of windows that are kept, so that long recordings do not fill the memory.

use crate::circles::compact_frame::CompactFrame;
use crate::circles::reference_frame::SeenIn;

/// Largest number of pixels that are kept, four bytes each. Half a minute of a DAVIS346 is below it.
const MOST: usize = 12_000_000;

/// Number of windows above which far fewer pixels are kept, enough to show the events of some windows. Only a part of such a long
/// recording is in the joint solve, and its first camera does not need these pixels.
const MANY_WINDOWS: usize = 12_000;
/// Largest number of pixels that are kept of such a recording.
const MOST_OF_MANY: usize = 1_000_000;

/// State of the limit.
#[derive(Clone, Copy, Debug)]
pub(super) struct KeptPixels {
    /// One of this number of windows keeps its events.
    every: usize,
    /// Number of windows that were checked.
    windows: usize,
    pixels: usize,
}

impl Default for KeptPixels {
    fn default() -> Self {
        Self { every: 1, windows: 0, pixels: 0 }
    }
}

impl KeptPixels {
    /// Drops the events of windows, evenly over the recording, until at most [`MOST`] are left. `found` are all windows so far;
    /// since the last call, windows were appended, or it was emptied.
    pub(super) fn limit(&mut self, found: &mut [CompactFrame]) {
        if found.len() < self.windows {
            *self = Self::default();
        }
        self.limit_to(if found.len() > MANY_WINDOWS { MOST_OF_MANY } else { MOST }, found);
    }

    fn limit_to(&mut self, most: usize, found: &mut [CompactFrame]) {
        for (index, found) in found.iter_mut().enumerate().skip(self.windows) {
            if !index.is_multiple_of(self.every) {
                pass(found);
            }
            self.pixels += count(found);
        }
        self.windows = found.len();
        while self.pixels > most && self.every < found.len() {
            self.every *= 2;
            self.pixels = 0;
            for (index, found) in found.iter_mut().enumerate() {
                if !index.is_multiple_of(self.every) {
                    pass(found);
                }
                self.pixels += count(found);
            }
        }
    }
}

fn pass(frame: &mut CompactFrame) {
    if matches!(frame.seen_in, SeenIn::Events(_) | SeenIn::Reconstruction(_)) {
        frame.seen_in = SeenIn::PassedEvents;
    }
}

fn count(frame: &CompactFrame) -> usize {
    match &frame.seen_in {
        SeenIn::Events(pixels) => pixels.len(),
        // The size of a picture is counted in units of four bytes, too.
        SeenIn::Reconstruction(picture) => picture.pixels.len() / 4,
        SeenIn::PassedEvents | SeenIn::Circles | SeenIn::Picture => 0,
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::event::{Event, Polarity};

    use super::*;
    use crate::circles::event_pixel::EventPixel;
    use crate::circles::reference_frame::ReferenceFrame;

    fn window(index: usize) -> CompactFrame {
        let pixel = EventPixel::new(&Event { t: 0, x: 3, y: 4, polarity: Polarity::On });
        let (start, end) = (index as f64, index as f64 + 0.5);
        let seen_in = SeenIn::Events(vec![pixel; 100]);
        ReferenceFrame { recording: 0, start, end, circles: Vec::new(), seen_in }.into()
    }

    #[test]
    fn kept_events_are_spread_evenly_over_all_windows() {
        let (mut found, mut kept) = (Vec::new(), KeptPixels::default());
        for index in 0..1000 {
            found.push(window(index));
            if index % 7 == 0 {
                kept.limit_to(2000, &mut found);
                assert!(found.iter().map(count).sum::<usize>() <= 2000);
            }
        }
        kept.limit_to(2000, &mut found);
        let with: Vec<usize> = (0..1000).filter(|&index| count(&found[index]) > 0).collect();
        assert!((10..=20).contains(&with.len()), "{with:?}");
        assert!(with.windows(2).all(|pair| pair[1] - pair[0] == 64), "{with:?}");
        assert!(found.into_iter().all(|frame| ReferenceFrame::from(frame).is_from_events()));
    }
}
