//! Search for the board in the pictures of a recording.

use std::collections::BTreeMap;

use evcal_core::grid::{GridCandidate, GridOptions};
use evcal_squares::found_point::FoundPoint;
use evcal_squares::picture::Picture;
use nalgebra::Vector2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::dark_spots::{DarkSpot, dark_spots};
use super::dot::{Dot, NoDot, Surroundings, measure};
use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame, SeenIn};
use crate::detection::board_finder::{BoardFinder, within_capacity};
use crate::detection::no_board::NoBoard;
use crate::detection::square_finder::SquareFinder;
use evcal_geometry::board::{Board, CircleBoard};
use evcal_geometry::numerics::statistics::median;
use event_recordings::pictures::{GreyImage, TimedImage};

/// Bytes of the pictures with the board that are kept, so that they need not be read again: 700 of 346×260 pixels.
const MOST_KEPT: usize = 64 << 20;
/// Number of pictures that are searched together.
const PICTURES_TOGETHER: usize = 64;
/// Largest blur of the dots' edges (median of a picture), as the standard deviation of a Gaussian (px).
const MOST_BLURRED: f64 = 2.5;

/// Smallest scatter of the paper's grey levels in pictures made of events. White is about 200 of 255 levels, which
/// corresponds to some tens of events.
const LEAST_SCATTER: f64 = 8.0;
/// Width of a dot's edge in pictures made of events (px). If the border of the image cuts the paper around a dot, the
/// dot is summed only up to this distance from its rim.
const EDGE: f64 = 1.5;

/// Odds that the position of the board on the lattice must have in pictures made of events. Two dots that are missing
/// within the image are enough, because the camera does not depend on this position.
const ODDS_AT_REST: f64 = 500.0;

/// Origin of pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MadeOf {
    /// Light, in a camera's own frames.
    Light,
    /// Numbers of events of a board that blinks in front of a camera at rest.
    Events,
}

/// Statistics of the pictures of all recordings.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PictureSearchReport {
    /// Pictures searched.
    pub frames: u64,
    /// Pictures that were not searched, because fewer are enough.
    #[serde(default)]
    pub passed_over: u64,
    /// Pictures in which the board was found.
    pub with_board: u64,
    /// Pictures without a board or unusable, by reason.
    pub refused: BTreeMap<NoBoard, u64>,
    /// Dots measured in all pictures.
    pub dots: u64,
    /// Dark spots that could not be measured, by reason.
    pub dots_refused: BTreeMap<NoDot, u64>,
    /// Dots of the boards found.
    pub board_dots: u64,
    /// Median blur of the dots' edges in the pictures with the board, as the standard deviation of a
    /// Gaussian (px).
    pub blur: f64,
    /// Pictures whose recording contains no exposure times.
    pub without_exposure: u64,
    /// Parts that could not be read, as sentences.
    pub notes: Vec<String>,
}

/// The board in the pictures of all recordings.
pub struct FoundInPictures {
    /// The boards, in the order of the pictures.
    pub frames: Vec<ReferenceFrame>,
    /// For each frame its picture.
    pub pictures: Vec<BoardPicture>,
    /// Statistics of the search.
    pub report: PictureSearchReport,
}

/// A picture with the board.
pub struct BoardPicture {
    /// Its number in the recording.
    pub(super) number: usize,
    /// The picture itself; `None` if pictures of [`MOST_KEPT`] bytes were kept already.
    pub(super) kept: Option<TimedImage>,
    /// Where it is dark at the dots of the board.
    pub(super) spots: Vec<DarkSpot>,
}

/// Result for one picture.
struct Searched {
    board: Result<SeenBoard, NoBoard>,
    dots: u64,
    dots_refused: Vec<NoDot>,
}

/// The board in one picture.
struct SeenBoard {
    /// Its dots or corners.
    points: Vec<SeenPoint>,
    /// The dark spots of its dots.
    spots: Vec<DarkSpot>,
    /// Median blur of the dots' edges (px).
    blur: Option<f64>,
}

/// A dot or corner of the board in a picture.
struct SeenPoint {
    index: usize,
    /// Position, in pixels of the picture.
    place: Vector2<f64>,
    /// Radius of a dot (px).
    radius: Option<f64>,
}

/// Searches the pictures of recordings for the board.
pub struct PictureSearch<'a> {
    target: Target<'a>,
    /// Length of the intervals in each of which only the first picture is searched (µs); 0 to search all pictures.
    interval: i64,
    frames: Vec<ReferenceFrame>,
    /// For each frame its picture.
    pictures: Vec<BoardPicture>,
    /// Bytes that may still be kept of the pictures.
    free_bytes: usize,
    blurs: Vec<f64>,
    report: PictureSearchReport,
}

/// Target of the search.
enum Target<'a> {
    Circles(CircleTarget<'a>),
    Squares(SquareFinder),
}

struct CircleTarget<'a> {
    board: &'a CircleBoard,
    made_of: MadeOf,
    /// Largest radius of a dot (px).
    largest_radius: f64,
    /// Fewest circles of a board.
    fewest: usize,
}

impl<'a> PictureSearch<'a> {
    /// Creates a search for `board` in pictures that are `made_of` light or events; of a board of circles, at least `fewest` must be
    /// visible, with radii up to `largest_radius` (px).
    pub fn new(board: &'a Board, made_of: MadeOf, fewest: usize, largest_radius: f64) -> Self {
        let target = match board {
            Board::Circles(board) => Target::Circles(CircleTarget { board, made_of, largest_radius, fewest }),
            Board::Squares(board) => Target::Squares(SquareFinder::new(board)),
        };
        let report = PictureSearchReport::default();
        Self {
            target,
            interval: 0,
            frames: Vec::new(),
            pictures: Vec::new(),
            free_bytes: MOST_KEPT,
            blurs: Vec::new(),
            report,
        }
    }

    /// Limits the search to the first picture in each `interval` (µs).
    pub fn in_intervals_of(self, interval: i64) -> Self {
        Self { interval, ..self }
    }

    /// Searches the pictures of recording number `number`, which `hand_on` passes in order of time. Their times are relative to
    /// `start` (µs on the recording's clock), or to the exposure of the first picture. `hand_on` returns a sentence
    /// about a part that could not be read.
    ///
    /// Returns the start of the times.
    ///
    /// # Errors
    /// Errors of `hand_on`.
    pub fn search<E>(
        &mut self,
        number: usize,
        start: Option<i64>,
        hand_on: impl FnOnce(&mut dyn FnMut(TimedImage)) -> Result<Option<String>, E>,
    ) -> Result<i64, E> {
        let mut waiting: Vec<(usize, TimedImage)> = Vec::new();
        let mut origin = start;
        let mut searched = None;
        let mut pictures = 0;
        let note = hand_on(&mut |image| {
            let of_picture = pictures;
            pictures += 1;
            let from = *origin.get_or_insert(image.exposure.0);
            let interval = image.exposure.0.saturating_sub(from).checked_div(self.interval);
            if interval.is_some() && interval == searched {
                self.report.passed_over += 1;
                return;
            }
            searched = interval;
            waiting.push((of_picture, image));
            if waiting.len() >= PICTURES_TOGETHER {
                self.search_pictures(std::mem::take(&mut waiting), number, from);
            }
        })?;
        let origin = origin.unwrap_or(0);
        self.search_pictures(waiting, number, origin);
        self.report.notes.extend(note);
        Ok(origin)
    }

    fn search_pictures(&mut self, pictures: Vec<(usize, TimedImage)>, number: usize, start: i64) {
        let searched: Vec<Searched> = match &self.target {
            Target::Circles(target) => pictures
                .par_iter()
                .map_init(
                    || BoardFinder::new(target.board.pattern),
                    |finder, (_, picture)| target.search(picture, finder),
                )
                .collect(),
            Target::Squares(finder) => {
                pictures.par_iter().map(|(_, picture)| search_squares(picture, finder)).collect()
            }
        };
        for ((of_picture, picture), searched) in pictures.into_iter().zip(searched) {
            self.report.frames += 1;
            self.report.dots += searched.dots;
            for reason in searched.dots_refused {
                *self.report.dots_refused.entry(reason).or_default() += 1;
            }
            match searched.board {
                Ok(SeenBoard { points: dots, spots, blur }) => {
                    self.report.with_board += 1;
                    self.report.board_dots += dots.len() as u64;
                    self.report.without_exposure += u64::from(!picture.exposure_known);
                    self.blurs.extend(blur);
                    self.frames.push(reference_frame(&picture, dots, number, start));
                    let bytes = picture.image.as_ref().map_or(0, |image| image.pixels.len());
                    let rest = self.free_bytes.checked_sub(bytes);
                    self.free_bytes = rest.unwrap_or(0);
                    self.pictures.push(BoardPicture { number: of_picture, kept: rest.map(|_| picture), spots });
                }
                Err(reason) => *self.report.refused.entry(reason).or_default() += 1,
            }
        }
    }

    /// Takes frames in which another program found the board as pictures of recording number `number`.
    pub fn take(&mut self, number: usize, frames: &[ReferenceFrame]) {
        for (of_picture, frame) in frames.iter().enumerate() {
            self.report.frames += 1;
            self.report.with_board += 1;
            self.report.dots += frame.circles.len() as u64;
            self.report.board_dots += frame.circles.len() as u64;
            self.frames.push(ReferenceFrame { recording: number, ..frame.clone() });
            self.pictures.push(BoardPicture { number: of_picture, kept: None, spots: Vec::new() });
        }
    }

    /// Returns the pictures with the board in their order, and the report.
    pub fn finish(mut self) -> FoundInPictures {
        self.report.blur = median(&mut self.blurs, f64::total_cmp).unwrap_or(0.0);
        FoundInPictures { frames: self.frames, pictures: self.pictures, report: self.report }
    }
}

impl CircleTarget<'_> {
    fn search(&self, picture: &TimedImage, finder: &mut BoardFinder<f32>) -> Searched {
        let image = match &picture.image {
            Ok(image) => image,
            Err(reason) => return Searched { board: Err((*reason).into()), dots: 0, dots_refused: Vec::new() },
        };
        let Some(grey) = Picture::from_bytes(image.width(), image.height(), &image.pixels) else {
            return Searched { board: Err(NoBoard::NotGrey), dots: 0, dots_refused: Vec::new() };
        };
        let spots = dark_spots(image, self.largest_radius);
        let spots: Vec<(DarkSpot, Result<Dot, NoDot>)> =
            spots.into_iter().map(|spot| (spot, self.measure(&grey, &spot))).collect();
        let dots_refused: Vec<NoDot> = spots.iter().filter_map(|(_, dot)| dot.err()).collect();
        let dots = (spots.len() - dots_refused.len()) as u64;
        Searched { board: self.find_board(image, &spots, finder), dots, dots_refused }
    }

    fn measure(&self, image: &Picture, spot: &DarkSpot) -> Result<Dot, NoDot> {
        let wide = Surroundings::on(self.board);
        match self.made_of {
            MadeOf::Light => measure(image, spot, &wide),
            MadeOf::Events => {
                let wide = Surroundings { least_scatter: LEAST_SCATTER, ..wide };
                let inner = wide.inner.min(1.0 + EDGE / spot.half_axes().1);
                match measure(image, spot, &wide) {
                    Err(NoDot::CutByBorder) => measure(image, spot, &Surroundings { inner, ..wide }),
                    measured => measured,
                }
            }
        }
    }

    /// Finds the board. In pictures made of events, dots that cannot be measured also help to find its position.
    fn find_board(
        &self,
        image: &GreyImage,
        spots: &[(DarkSpot, Result<Dot, NoDot>)],
        finder: &mut BoardFinder<f32>,
    ) -> Result<SeenBoard, NoBoard> {
        if spots.iter().all(|(_, dot)| dot.is_err()) {
            return Err(NoBoard::NoDots);
        }
        let is_at_rest = self.made_of == MadeOf::Events;
        let spots = spots.iter().filter(|(_, dot)| is_at_rest || dot.is_ok());
        let (candidates, dots): (Vec<GridCandidate<f32>>, Vec<_>) = spots
            .map(|(spot, dot)| {
                let dot = dot.as_ref().ok();
                let (center, radius) = dot.map_or((spot.center, spot.radius()), |dot| (dot.center, dot.radius));
                (GridCandidate { center: center.cast(), radius: radius as f32 }, dot.map(|dot| (spot, dot)))
            })
            .unzip();
        let options = GridOptions {
            minimum_circles: self.fewest,
            ..GridOptions::new(&self.board.pattern, (image.width() as f64, image.height() as f64))
        };
        let options = match self.made_of {
            MadeOf::Light => options,
            MadeOf::Events => GridOptions { independent_misses: true, minimum_odds: ODDS_AT_REST, ..options },
        };
        let placed = finder.find(within_capacity(&candidates), &options)?;
        let placed = placed.iter().filter_map(|placed| {
            let (spot, dot) = (*dots.get(placed.candidate)?)?;
            Some((placed.index, spot, dot))
        });
        let placed: Vec<(usize, &DarkSpot, &Dot)> = placed.collect();
        if placed.len() < self.fewest {
            return Err(NoBoard::TooFewOfBoard);
        }
        let mut blurs: Vec<f64> = placed.iter().map(|(.., dot)| dot.blur).collect();
        let blur = median(&mut blurs, f64::total_cmp);
        if blur.is_some_and(|blur| blur > MOST_BLURRED) {
            return Err(NoBoard::Blurred);
        }
        let spots = placed.iter().map(|(_, spot, _)| **spot).collect();
        let points =
            placed.into_iter().map(|(index, _, dot)| SeenPoint { index, place: dot.center, radius: Some(dot.radius) });
        Ok(SeenBoard { points: points.collect(), spots, blur })
    }
}

/// Searches a picture for the points of a board of squares.
fn search_squares(picture: &TimedImage, finder: &SquareFinder) -> Searched {
    let board = picture.image.as_ref().map_err(|reason| NoBoard::from(*reason)).and_then(|image| {
        let grey = Picture::from_bytes(image.width(), image.height(), &image.pixels).ok_or(NoBoard::NotGrey)?;
        let found = finder.find(std::slice::from_ref(&grey), None)?;
        let seen = |point: &FoundPoint| SeenPoint {
            index: point.index,
            place: Vector2::from(point.pixel).cast(),
            radius: None,
        };
        Ok(SeenBoard { points: found.points.iter().map(seen).collect(), spots: Vec::new(), blur: None })
    });
    let dots = board.as_ref().map_or(0, |board| board.points.len() as u64);
    Searched { board, dots, dots_refused: Vec::new() }
}

/// Returns the reference frame of recording `number` with these points; its times are relative to `start` (µs).
fn reference_frame(picture: &TimedImage, points: Vec<SeenPoint>, number: usize, start: i64) -> ReferenceFrame {
    let seconds = |t: i64| t.saturating_sub(start) as f64 * 1e-6;
    let (start, end) = (seconds(picture.exposure.0), seconds(picture.exposure.1));
    let position = Vector2::new(f64::from(picture.position.0), f64::from(picture.position.1));
    let circle = |point: SeenPoint| ObservedCircle {
        index: point.index,
        t: 0.5 * (start + end),
        center: point.place + position,
        radius: point.radius,
        velocity: None,
    };
    let circles = points.into_iter().map(circle).collect();
    ReferenceFrame { recording: number, start, end, circles, seen_in: SeenIn::Picture }
}

#[cfg(test)]
mod tests {
    use event_recordings::pictures::NoImage;

    use super::*;
    use evcal_geometry::board::sheet::{BoardSheet, Dot as PrintedDot, Page, board_sheet};
    use evcal_geometry::board::squares::raster::Rectangle;
    use nalgebra::{Rotation3, Vector3};

    #[test]
    fn the_first_picture_of_each_interval_is_searched() {
        let board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        let report_of = |interval: i64, start: Option<i64>| {
            let mut search = PictureSearch::new(&board, MadeOf::Light, 10, 40.0).in_intervals_of(interval);
            let hand_on = |visit: &mut dyn FnMut(TimedImage)| {
                for t in [700, 1100, 1690, 1710, 2300, 6900] {
                    let image = Err(NoImage::NotGrey);
                    visit(TimedImage { exposure: (t, t), exposure_known: true, position: (0, 0), image });
                }
                Ok::<_, std::convert::Infallible>(None)
            };
            let _ = search.search(0, start, hand_on);
            let report = search.finish().report;
            (report.frames, report.passed_over)
        };
        assert_eq!(report_of(1000, None), (3, 3));
        assert_eq!(report_of(1000, Some(0)), (4, 2));
        assert_eq!(report_of(0, None), (6, 0));
    }

    /// Returns the sheet with a board as a camera with f = 330 px sees it, tilted by `tilt`, with or without the QR code.
    fn picture_of(sheet: &BoardSheet, with_code: bool, tilt: [f64; 3]) -> GreyImage {
        let rotation = Rotation3::from_euler_angles(tilt[0], tilt[1], tilt[2]);
        let middle = Vector3::new(0.5 * sheet.size[0], 0.5 * sheet.size[1], 0.0);
        // The sheet fills the picture.
        let distance = 330.0 * sheet.size[1] / 250.0;
        let brightness = |x: f64, y: f64| {
            let ray = rotation.inverse() * Vector3::new((x - 172.5) / 330.0, (y - 129.5) / 330.0, 1.0);
            let eye = middle - rotation.inverse() * Vector3::new(0.0, 0.0, distance);
            let at = eye - ray * (eye.z / ray.z);
            let in_dot = |dot: &PrintedDot| (at.x - dot.center[0]).hypot(at.y - dot.center[1]) < dot.radius;
            let in_module = |dark: &Rectangle| {
                (dark.low[0]..dark.high[0]).contains(&at.x) && (dark.low[1]..dark.high[1]).contains(&at.y)
            };
            let is_dark = sheet.dots.iter().any(in_dot) || with_code && sheet.code.iter().any(in_module);
            if is_dark { 30.0 } else { 200.0 }
        };
        const PARTS: usize = 4;
        let part = |index: usize| (index as f64 + 0.5) / PARTS as f64 - 0.5;
        let pixel = |index: usize| {
            let (x, y) = ((index % 346) as f64, (index / 346) as f64);
            let parts = (0..PARTS * PARTS).map(|index| brightness(x + part(index % PARTS), y + part(index / PARTS)));
            (parts.sum::<f64>() / (PARTS * PARTS) as f64) as u8
        };
        GreyImage::new(346, 260, (0..346 * 260).map(pixel).collect()).unwrap()
    }

    /// The QR code on a printed sheet is as large as a dot of some boards. The same dots are found with it and without it.
    #[test]
    fn the_code_on_a_sheet_is_not_taken_for_a_dot() {
        for text in ["acircles:9x4:23mm:r7.3mm", "circles:7x5:30mm:r8mm", "acircles:5x7:19mm:r6mm"] {
            let board: Board = text.parse().unwrap();
            let page = Page { paper: "a4".parse().unwrap(), margin: 10.0, typed: "--board " };
            let sheet = board_sheet(&board, &page).unwrap();
            let found = |with_code: bool| {
                let mut search = PictureSearch::new(&board, MadeOf::Light, board.point_count(), 40.0);
                let hand_on = |visit: &mut dyn FnMut(TimedImage)| {
                    for (tilt, t) in
                        [[0.0, 0.0, 0.0], [0.3, -0.2, 0.1], [-0.25, 0.3, -0.2], [0.1, 0.35, 0.3]].into_iter().zip(0..)
                    {
                        let image = Ok(picture_of(&sheet, with_code, tilt));
                        visit(TimedImage { exposure: (t, t), exposure_known: true, position: (0, 0), image });
                    }
                    Ok::<_, std::convert::Infallible>(None)
                };
                let _ = search.search(0, None, hand_on);
                let frames = search.finish().frames;
                let places = |frame: &ReferenceFrame| -> Vec<(usize, Vector2<f64>)> {
                    frame.circles.iter().map(|circle| (circle.index, circle.center)).collect()
                };
                frames.iter().map(places).collect::<Vec<_>>()
            };
            let (with, without) = (found(true), found(false));
            assert!(with.len() >= 2 && with == without, "{text}: {} of 4 with, {} without", with.len(), without.len());
        }
    }
}
