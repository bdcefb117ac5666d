//! Boards of squares: pictures made of events, and the board in each of them.
//!
//! A square board has too few events on each edge of a short window to be found in one. So the events become pictures of log intensity
//! (`evcal_squares::reconstruction`), one every [`INTERVAL`] with several time constants, and the board is looked for in all of a moment.

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use evcal_geometry::board::SquareBoard;
use evcal_squares::reconstruction::{Moment, Reconstruction, ReconstructionOptions};
use nalgebra::Vector2;
use rayon::prelude::*;

use super::no_board::NoBoard;
use super::report::DetectionReport;
use super::square_finder::{Points, SquareFinder};
use crate::circles::compact_frame::CompactFrame;
use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame, SeenIn};

/// Time from one picture to the next (s).
pub const INTERVAL: f64 = 0.02;
/// Moments that are searched in one go.
const TOGETHER: usize = 16;

/// Searches the events of a recording, batch by batch, for a board of squares.
pub struct SquareStage {
    reconstruction: Reconstruction,
    finder: SquareFinder,
    recording: usize,
    waiting: Vec<Moment>,
    frames: Vec<CompactFrame>,
    /// Where the points of the board were found last, and when (s).
    last: Option<(f64, Points)>,
    report: DetectionReport,
}

impl SquareStage {
    /// Looks for `board` in recording number `recording`.
    pub fn new(board: &SquareBoard, sensor: Sensor, recording: usize) -> Self {
        let interval = (INTERVAL * 1e6) as u32;
        let options = ReconstructionOptions { interval, ..ReconstructionOptions::new(sensor) };
        Self {
            reconstruction: Reconstruction::new(options),
            finder: SquareFinder::new(board),
            recording,
            waiting: Vec::new(),
            frames: Vec::new(),
            last: None,
            report: DetectionReport::default(),
        }
    }

    /// Takes the next events in time order; their times count from the start of the recording in microseconds.
    pub fn push(&mut self, events: &[Event]) {
        self.report.count_events(events);
        let waiting = &mut self.waiting;
        self.reconstruction.push(events, |moment| waiting.push(moment));
        if self.waiting.len() >= TOGETHER {
            self.search();
        }
    }

    /// The frames with the board in order of time, and the report.
    pub fn finish(mut self) -> (Vec<CompactFrame>, DetectionReport) {
        let waiting = &mut self.waiting;
        self.reconstruction.finish(|moment| waiting.push(moment));
        self.search();
        (self.frames, self.report)
    }

    fn search(&mut self) {
        let moments = std::mem::take(&mut self.waiting);
        let found: Vec<Result<Points, NoBoard>> =
            moments.par_iter().map(|moment| self.finder.find(&moment.pictures, None)).collect();
        for (moment, found) in moments.iter().zip(found) {
            self.report.windows += 1;
            let t = moment.t as f64 * 1e-6;
            let near = self.last.take().filter(|(before, _)| t - before < LONGEST_PREDICTION);
            // What alone could be in several places, or was missed, is where it was a moment before.
            let found = match (found, &near) {
                (Err(_), Some((_, points))) => {
                    let found = self.finder.find(&moment.pictures, Some(points));
                    self.report.found_by_neighbours += u64::from(found.is_ok());
                    found
                }
                (found, _) => found,
            };
            match found {
                Ok(points) => {
                    self.report.found += 1;
                    self.report.board_circles += points.len() as u64;
                    self.frames.push(self.frame(t, &points).into());
                    self.last = Some((t, points));
                }
                Err(reason) => {
                    *self.report.grids_refused.entry(reason).or_default() += 1;
                    self.last = near;
                }
            }
        }
    }

    fn frame(&self, t: f64, points: &Points) -> ReferenceFrame {
        let circle = |point: &evcal_squares::found_point::FoundPoint| ObservedCircle {
            index: point.index,
            t,
            center: Vector2::from(point.pixel).cast(),
            radius: None,
            velocity: None,
        };
        let half = 0.5 * INTERVAL;
        ReferenceFrame {
            recording: self.recording,
            start: t - half,
            end: t + half,
            circles: points.iter().map(circle).collect(),
            seen_in: SeenIn::PassedEvents,
        }
    }
}

/// Longest time over which the last place of the board tells where it is (s).
const LONGEST_PREDICTION: f64 = 0.05;
