//! Search for the board in views of a camera at rest.

use std::convert::Infallible;

use evcal_geometry::board::{Board, SquareBoard};
use evcal_squares::crossing::fit_corners;
use evcal_squares::found_point::FoundPoint;
use evcal_squares::picture::Picture;
use evcal_squares::recognition::{RecognisedBoard, recognise};
use event_recordings::pictures::{GreyImage, NoImage, TimedImage};
use nalgebra::Vector2;

use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame, SeenIn};
use crate::detection::pictures::search::{FoundInPictures, MadeOf, PictureSearch, PictureSearchReport};
use crate::detection::pictures::settings::PictureSettings;
use crate::detection::settings::DetectionSettings;
use crate::detection::still_views::StillView;

/// White in a picture.
const WHITE: f32 = 255.0;

/// The board in the views of all recordings.
#[derive(Debug)]
pub struct FoundInViews {
    /// The views with the board, in order of recording and time.
    pub frames: Vec<ReferenceFrame>,
    /// Statistics of the search.
    pub report: PictureSearchReport,
}

/// Smoothing of the pictures of dots (standard deviation of a Gaussian in px). The detector expects dots with blurred edges, and the pixels of
/// a view are nearly all black or white.
const SMOOTHING: f32 = 0.8;
/// Pictures of dots with a side below this (px) are enlarged, so that small dots have enough pixels.
const SMALL: usize = 200;
/// Factor of this enlargement.
const ENLARGED: usize = 2;
/// If the board is found in at least this share of the views, the remaining kinds of pictures are not searched.
const MOST: f64 = 0.9;

/// Searches `views`, a list for each recording, for `board`.
///
/// Four kinds of pictures are searched one after the other. Either the paper or the print may blink, so the numbers of
/// events and their negatives are searched. Both may blink in turn, so the changes and their negatives are searched,
/// too. If little light is enough for a pixel to send all its events, the blinking squares appear larger and the
/// squares between them no longer touch. Therefore, if a board of squares is not found, the bright squares are made
/// smaller.
pub fn search_views(
    board: &Board,
    settings: &DetectionSettings,
    pictures: &PictureSettings,
    views: &[Vec<StillView>],
) -> FoundInViews {
    let variant: fn(&Picture) -> Picture = match board {
        Board::Circles(_) => smooth,
        Board::Squares(_) => Picture::darkest_neighbours,
    };
    let count = views.iter().map(Vec::len).sum::<usize>() as f64;
    let kinds: [fn(&StillView) -> TimedImage; 4] = [
        |view| view.counts.clone(),
        |view| changed(&view.counts, negative),
        |view| view.changes.clone(),
        |view| changed(&view.changes, negative),
    ];
    let mut best: Option<FoundInViews> = None;
    for kind in kinds {
        let shown: Vec<Vec<TimedImage>> = views.iter().map(|views| views.iter().map(kind).collect()).collect();
        let found = search_twice(board, settings, pictures, &shown, variant);
        if best.as_ref().is_none_or(|best| found.report.board_dots > best.report.board_dots) {
            best = Some(found);
        }
        if best.as_ref().is_some_and(|best| best.frames.len() as f64 >= MOST * count) {
            break;
        }
    }
    best.unwrap_or(FoundInViews { frames: Vec::new(), report: PictureSearchReport::default() })
}

/// Returns the board of squares in most of the views; `None` if there is none, or if it is not clear.
pub fn recognise_views(views: &[StillView]) -> Option<RecognisedBoard> {
    let pictures = |view: &StillView| -> Vec<Picture> {
        let images = [&view.counts, &view.changes].into_iter().filter_map(|image| image.image.as_ref().ok());
        let positives = images.filter_map(|image| Picture::from_bytes(image.width(), image.height(), &image.pixels));
        positives
            .flat_map(|picture| [negative(&picture), picture])
            .flat_map(|picture| [picture.darkest_neighbours(), picture])
            .collect()
    };
    recognise(&views.iter().map(pictures).collect::<Vec<_>>())
}

/// Searches the pictures for the board, and applies `variant` to the pictures in which it is not found and searches them again.
fn search_twice(
    board: &Board,
    settings: &DetectionSettings,
    pictures: &PictureSettings,
    views: &[Vec<TimedImage>],
    variant: fn(&Picture) -> Picture,
) -> FoundInViews {
    let mut found = search(board, settings, pictures, views, Picture::clone);
    let is_found = |number: usize, view: &TimedImage| {
        found.frames.iter().any(|frame| frame.recording == number && starts(frame, view))
    };
    let missing: Vec<Vec<TimedImage>> = views
        .iter()
        .enumerate()
        .map(|(number, views)| views.iter().filter(|view| !is_found(number, view)).cloned().collect())
        .collect();
    let others = search(board, settings, pictures, &missing, variant);
    found.report.with_board += others.report.with_board;
    found.report.board_dots += others.report.board_dots;
    found.report.refused = others.report.refused;
    found.frames.extend(others.frames);
    found.frames.sort_by(|a, b| a.recording.cmp(&b.recording).then(a.start.total_cmp(&b.start)));
    found
}

/// Returns `true` if the frame belongs to this view.
fn starts(frame: &ReferenceFrame, view: &TimedImage) -> bool {
    (view.exposure.0 as f64 * 1e-6 - frame.start).abs() < 1e-6
}

fn smooth(picture: &Picture) -> Picture {
    picture.blurred(SMOOTHING)
}

fn negative(picture: &Picture) -> Picture {
    picture.map(|grey| WHITE - grey)
}

/// Returns the picture of a view after `variant` was applied.
fn changed(view: &TimedImage, variant: impl Fn(&Picture) -> Picture) -> TimedImage {
    let image = view.image.as_ref().map_err(|reason| *reason).and_then(|image| {
        let picture = Picture::from_bytes(image.width(), image.height(), &image.pixels).ok_or(NoImage::NotGrey)?;
        let picture = variant(&picture);
        let pixels = picture.values().iter().map(|grey| grey.round().clamp(0.0, WHITE) as u8).collect();
        GreyImage::new(picture.width(), picture.height(), pixels).ok_or(NoImage::NotGrey)
    });
    TimedImage { image, ..view.clone() }
}

fn search(
    board: &Board,
    settings: &DetectionSettings,
    pictures: &PictureSettings,
    views: &[Vec<TimedImage>],
    variant: fn(&Picture) -> Picture,
) -> FoundInViews {
    let fewest = settings.fewest_circles(&board.lattice());
    let is_small = |view: &TimedImage| view.image.as_ref().is_ok_and(|image| image.width().min(image.height()) < SMALL);
    let factor = if board.circles().is_some() && views.iter().flatten().any(is_small) { ENLARGED } else { 1 };
    let scale = factor as f64;
    let mut search = PictureSearch::new(board, MadeOf::Events, fewest, scale * pictures.max_radius);
    for (number, views) in views.iter().enumerate() {
        let hand_on = |visit: &mut dyn FnMut(TimedImage)| {
            let enlarged = |picture: &Picture| variant(picture).enlarged(factor);
            views.iter().map(|view| changed(view, enlarged)).for_each(visit);
            Ok(None)
        };
        let Ok(_) = search.search::<Infallible>(number, Some(0), hand_on);
    }
    let FoundInPictures { mut frames, report, .. } = search.finish();
    for frame in &mut frames {
        for circle in frame.circles.iter_mut().filter(|_| factor > 1) {
            circle.center = (circle.center + Vector2::repeat(0.5)) / scale - Vector2::repeat(0.5);
            circle.radius = circle.radius.map(|radius| radius / scale);
        }
        let of_recording = views.get(frame.recording).map_or(&[][..], Vec::as_slice);
        let shown = of_recording.iter().find(|view| starts(frame, view));
        if let Some(Ok(image)) = shown.map(|view| &view.image) {
            if let Board::Squares(SquareBoard::Checkerboard(board)) = board {
                refine(frame, image, board.columns.into());
            }
            frame.seen_in = SeenIn::Reconstruction(image.clone());
        }
    }
    FoundInViews { frames, report }
}

/// Fits the corners of a checkerboard to the picture.
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
