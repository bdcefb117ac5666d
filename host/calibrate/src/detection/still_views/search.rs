//! The board in views of a camera at rest.

use std::convert::Infallible;

use evcal_geometry::board::{Board, SquareBoard};
use evcal_squares::crossing::fit_corners;
use evcal_squares::found_point::FoundPoint;
use evcal_squares::picture::Picture;
use event_recordings::pictures::{GreyImage, NoImage, TimedImage};
use nalgebra::Vector2;

use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame, SeenIn};
use crate::detection::pictures::search::{PictureSearch, PictureSearchReport};
use crate::settings::Settings;

/// The board in the views of all recordings.
#[derive(Debug)]
pub struct FoundInViews {
    /// The views with the board, in order of recording and time.
    pub frames: Vec<ReferenceFrame>,
    /// What the views held.
    pub report: PictureSearchReport,
}

/// Looks for `board` in `views`, which are one list for each recording. If it is in less than half of them, it is looked for in their
/// negatives too: dark dots may blink as bright ones may.
pub fn search_views(board: &Board, settings: &Settings, views: &[Vec<TimedImage>]) -> FoundInViews {
    let found = search(board, settings, views, TimedImage::clone);
    if found.frames.len() * 2 >= views.iter().map(Vec::len).sum() {
        return found;
    }
    let other = search(board, settings, views, negative);
    if other.report.board_dots > found.report.board_dots { other } else { found }
}

fn search(
    board: &Board,
    settings: &Settings,
    views: &[Vec<TimedImage>],
    picture: impl Fn(&TimedImage) -> TimedImage,
) -> FoundInViews {
    let fewest = settings.detection.fewest_circles(&board.lattice());
    let mut search = PictureSearch::new(board, fewest, settings.frames.max_radius);
    for (number, views) in views.iter().enumerate() {
        let hand_on = |visit: &mut dyn FnMut(TimedImage)| {
            views.iter().map(&picture).for_each(visit);
            Ok(None)
        };
        let Ok(_) = search.search::<Infallible>(number, Some(0), hand_on);
    }
    let (mut frames, report) = search.finish();
    for frame in &mut frames {
        let of_recording = views.get(frame.recording).map_or(&[][..], Vec::as_slice);
        let shown = of_recording.iter().find(|view| (view.exposure.0 as f64 * 1e-6 - frame.start).abs() < 1e-6);
        if let Some(Ok(image)) = shown.map(|view| &view.image) {
            if let Board::Squares(SquareBoard::Checkerboard(board)) = board {
                refine(frame, image, board.columns.into());
            }
            frame.seen_in = SeenIn::Reconstruction(image.clone());
        }
    }
    FoundInViews { frames, report }
}

/// Fits the corners of a checkerboard.
fn refine(frame: &mut ReferenceFrame, image: &GreyImage, columns: usize) {
    let Some(picture) = Picture::from_bytes(image.width(), image.height(), &image.pixels) else { return };
    let corner =
        |circle: &ObservedCircle| FoundPoint { index: circle.index, pixel: circle.center.cast::<f32>().into() };
    let mut corners: Vec<FoundPoint> = frame.circles.iter().map(corner).collect();
    fit_corners(&picture, &mut corners, columns);
    for (circle, corner) in frame.circles.iter_mut().zip(&corners) {
        circle.center = Vector2::from(corner.pixel).cast();
    }
}

fn negative(view: &TimedImage) -> TimedImage {
    let image = view.image.as_ref().map_err(|reason| *reason).and_then(|image| {
        let pixels = image.pixels.iter().map(|grey| 255 - grey).collect();
        GreyImage::new(image.width(), image.height(), pixels).ok_or(NoImage::NotGrey)
    });
    TimedImage { image, ..view.clone() }
}
