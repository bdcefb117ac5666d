//! Recognition of the board in a recording, for users who did not name it, or named another one.

use std::fmt;

use evcal_core::sensor::Sensor;
use evcal_files::remedy::{Remedy, Words};
use evcal_geometry::board::SquareBoard;
use evcal_geometry::board::squares::family::Dictionary;
use evcal_geometry::board::squares::{Charuco, TagGrid};
use evcal_squares::picture::Picture;
use evcal_squares::recognition::{RecognisedBoard, recognise};
use evcal_squares::reconstruction::{Moment, Reconstruction, ReconstructionOptions};
use event_recordings::{Recording, RecordingError};

use super::layout::{LONGEST, RecognisedLayout, find_layout, read_beginning};
use crate::detection::no_board::MIRRORED_ADVICE;
use crate::detection::settings::DetectionSettings;

/// Time between the pictures in which boards of squares are recognised (µs).
const INTERVAL: u32 = 100_000;
/// Largest number of moments whose pictures are searched.
const MOST_MOMENTS: usize = 10;
/// Largest error of the measured ratio of a tag to its gap or square.
const MEASURED: f64 = 0.03;

/// A board that was recognised. Its size is not known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Recognised {
    /// A board of circles.
    Circles(RecognisedLayout),
    /// A board of squares.
    Squares(RecognisedBoard),
}

impl Recognised {
    /// Returns `true` if the image, or the print, is mirrored.
    pub fn is_mirrored(&self) -> bool {
        matches!(self, Self::Squares(found) if found.is_mirrored)
    }

    /// Names the lengths that the user has to measure, or what is wrong with a mirrored board.
    pub fn to_do(&self) -> String {
        match self {
            Self::Squares(_) if self.is_mirrored() => MIRRORED_ADVICE.to_owned(),
            Self::Circles(layout) => format!("{}, and give both", layout.to_measure()),
            Self::Squares(found) => {
                // The ratio of both lengths is only estimated.
                let measure = match found.board {
                    SquareBoard::Checkerboard(_) => "the side of a square, and give it",
                    SquareBoard::Charuco(_) => "the sides of a square and of a marker, and give both",
                    SquareBoard::Tags(_) => {
                        "the side of a tag with its dark border and the gap to the next, and give the side, and the gap divided by it"
                    }
                };
                format!("measure {measure}")
            }
        }
    }

    /// Returns the board in a size of its own, as users write it.
    pub fn example(&self) -> String {
        match self {
            Self::Circles(layout) => layout.example(),
            Self::Squares(found) => found.board.to_string(),
        }
    }
}

impl Remedy for Recognised {
    fn remedy(&self, say: &Words) -> Option<String> {
        (!self.is_mirrored()).then(|| format!("for example {}", say.board.with(self.example())))
    }
}

impl fmt::Display for Recognised {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Circles(layout) => layout.fmt(f),
            Self::Squares(found) => {
                let RecognisedBoard { board, fitting, moments, .. } = found;
                let mirrored = if found.is_mirrored { ", mirrored" } else { "" };
                write!(f, "{}{mirrored}, which fits {fitting} of {moments} pictures", kind_of(board))?;
                if found.has_unknown_markers {
                    write!(
                        f,
                        " (its light squares contain markers of an unknown dictionary, and its corners are those of a checkerboard)"
                    )?;
                }
                Ok(())
            }
        }
    }
}

/// Describes a board without its size.
fn kind_of(board: &SquareBoard) -> String {
    match board {
        SquareBoard::Checkerboard(board) => {
            format!("a checkerboard of {} x {} inner corners", board.rows, board.columns)
        }
        SquareBoard::Tags(grid) => {
            let kind = if grid.corner_squares { "an AprilGrid" } else { "a grid" };
            format!("{kind} of {} x {} tags of {}", grid.rows, grid.columns, grid.dictionary)
        }
        SquareBoard::Charuco(board) => {
            format!("a ChArUco board of {} x {} squares with tags of {}", board.rows, board.columns, board.dictionary)
        }
    }
}

/// Searches the first seconds of a recording for any board; `None` if there is none, or if it is not clear.
///
/// # Errors
/// [`RecordingError`] if the recording cannot be read.
pub fn find_board(
    recording: &Recording,
    sensor: Sensor,
    settings: &DetectionSettings,
) -> Result<Option<Recognised>, RecordingError> {
    if let Some(squares) = find_squares(recording, sensor)? {
        return Ok(Some(Recognised::Squares(squares)));
    }
    Ok(find_layout(recording, sensor, settings)?.map(Recognised::Circles))
}

/// The pictures of at most [`MOST_MOMENTS`] moments, evenly spaced. Before the number of all moments is known, it also contains those
/// that would be taken of more moments.
#[derive(Default)]
struct Sample {
    count: usize,
    /// The pictures of a moment, and its number.
    moments: Vec<(usize, Vec<Picture>)>,
}

impl Sample {
    fn add(&mut self, block: Vec<Moment>) {
        let last = (LONGEST as usize / INTERVAL as usize + 1).div_ceil(MOST_MOMENTS);
        for moment in block {
            self.moments.push((self.count, moment.pictures));
            self.count += 1;
            let step = self.step();
            self.moments.retain(|(number, _)| (step..=last.max(step)).any(|step| number % step == 0));
        }
    }

    /// Returns the distance of the moments that are taken.
    fn step(&self) -> usize {
        self.count.div_ceil(MOST_MOMENTS).max(1)
    }

    fn taken(self) -> Vec<Vec<Picture>> {
        let step = self.step();
        self.moments.into_iter().filter(|(number, _)| number % step == 0).map(|(_, pictures)| pictures).collect()
    }
}

/// Searches the first seconds of a recording for any board of squares.
///
/// # Errors
/// [`RecordingError`] if the recording cannot be read.
pub fn find_squares(recording: &Recording, sensor: Sensor) -> Result<Option<RecognisedBoard>, RecordingError> {
    let options = ReconstructionOptions { interval: INTERVAL, ..ReconstructionOptions::new(sensor) };
    let mut reconstruction = Reconstruction::new(options);
    let mut sample = Sample::default();
    read_beginning(recording, &mut |events| reconstruction.push(events, |block| sample.add(block)))?;
    reconstruction.finish(|block| sample.add(block));
    Ok(recognise(&sample.taken()))
}

/// Returns a recognised board with the lengths of `stated`; `None` if `stated` has other lengths. A stated ratio of two lengths is kept
/// if it is near the measured one, and a stated dictionary if it contains the tags.
pub(in crate::detection) fn in_lengths_of(found: &SquareBoard, stated: &SquareBoard) -> Option<SquareBoard> {
    match (found, stated) {
        (SquareBoard::Checkerboard(_), SquareBoard::Checkerboard(stated)) => Some(found.with_length(stated.square)),
        (SquareBoard::Checkerboard(_), SquareBoard::Charuco(stated)) => Some(found.with_length(stated.square)),
        (SquareBoard::Tags(grid), SquareBoard::Tags(stated)) => {
            let is_near = (grid.spacing - stated.spacing).abs() < MEASURED;
            let spacing = if is_near { stated.spacing } else { grid.spacing };
            let dictionary = or_larger(grid.dictionary, stated.dictionary);
            Some(SquareBoard::Tags(TagGrid { tag: stated.tag, spacing, dictionary, ..*grid }))
        }
        (SquareBoard::Charuco(board), SquareBoard::Charuco(stated)) => {
            let ratio = board.marker / board.square;
            let is_near = (ratio - stated.marker / stated.square).abs() < MEASURED;
            let marker = if is_near { stated.marker } else { ratio * stated.square };
            let dictionary = or_larger(board.dictionary, stated.dictionary);
            Some(SquareBoard::Charuco(Charuco { square: stated.square, marker, dictionary, ..*board }))
        }
        _ => None,
    }
}

/// Returns the `stated` dictionary if it contains the tags of the one that was `found`, which is the smallest with the tags of the
/// board; otherwise the one that was found.
fn or_larger(found: Dictionary, stated: Dictionary) -> Dictionary {
    if stated.family == found.family && stated.tags >= found.tags { stated } else { found }
}

/// Returns `true` if a recognised board is the stated one; the ratio of its lengths was only measured.
pub(in crate::detection) fn is_same(found: &SquareBoard, stated: &SquareBoard) -> bool {
    match (found, stated) {
        (SquareBoard::Checkerboard(a), SquareBoard::Checkerboard(b)) => {
            [a.rows, a.columns] == [b.rows, b.columns] || [a.rows, a.columns] == [b.columns, b.rows]
        }
        (SquareBoard::Tags(a), SquareBoard::Tags(b)) => {
            (a.spacing - b.spacing).abs() < MEASURED
                && a.dictionary.family == b.dictionary.family
                && *a == TagGrid { tag: a.tag, spacing: a.spacing, dictionary: a.dictionary, ..*b }
        }
        (SquareBoard::Charuco(a), SquareBoard::Charuco(b)) => {
            (a.marker / a.square - b.marker / b.square).abs() < MEASURED
                && a.dictionary.family == b.dictionary.family
                && *a == Charuco { square: a.square, marker: a.marker, dictionary: a.dictionary, ..*b }
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All 41 moments of four seconds were kept until the end, 450 MB with a sensor of 1280 x 720.
    #[test]
    fn the_moments_of_a_sample_are_evenly_spaced_and_few_others_wait() {
        for count in 0..50 {
            let (mut sample, mut most) = (Sample::default(), 0);
            for t in 0..count {
                let picture = Picture::new(1, 1, vec![t as f32]).unwrap();
                sample.add(vec![Moment { t, pictures: vec![picture] }]);
                most = most.max(sample.moments.len());
            }
            let step = (count as usize).div_ceil(MOST_MOMENTS).max(1);
            let expected: Vec<f32> = (0..count).step_by(step).map(|t| t as f32).collect();
            let taken: Vec<f32> = sample.taken().iter().map(|pictures| pictures[0].values()[0]).collect();
            assert_eq!(taken, expected);
            assert!(most <= 2 * MOST_MOMENTS, "{most}");
        }
    }
}
