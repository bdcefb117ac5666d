//! Reference frames as the sensor saw them, and without the distortion of the lens.

use evcal_core::event::Polarity;
use evcal_core::sensor::Sensor;
use evcal_core::undistortion::IdealCamera;
use maud::{Markup, html};
use nalgebra::Vector2;
use rayon::prelude::*;

use super::page::Section;
use super::rectification::{distorted, ideal_camera, projected};
use crate::report::drawing::{BEYOND, OFF, ON, Picture, WHITE};
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_detection::circles::reference_frame::{ReferenceFrame, SeenIn};
use evcal_geometry::board::Board;
use evcal_solve::initial::PosedFrame;

/// Width limit of a picture in its own pixels, for the size of the file.
const WIDEST: u16 = 800;

/// Returns the frames that can be drawn, the one with the smallest error first.
fn ranked(calibrated: &Calibrated) -> Vec<(&PosedFrame, &ReferenceFrame)> {
    let mut ranked: Vec<_> = calibrated.posed().filter(|(_, frame)| frame.is_shown()).collect();
    ranked.sort_by(|a, b| a.0.rms.total_cmp(&b.0.rms));
    ranked
}

/// Draws the frame with the smallest error as the sensor saw it; empty if no frame can be drawn.
pub fn best_frame(calibrated: &Calibrated, board: &Board) -> Markup {
    let Some(&(posed, frame)) = ranked(calibrated).first() else { return html! {} };
    let seen = as_seen(calibrated, board, posed, frame);
    let description = "The best frame as the sensor saw it, with the board where the calibration projects it.";
    html! {
        (picture_figure(&seen, description, &html! {
            "The best frame. Green: the board, projected by the calibration; it should coincide with the edges. " (colors(frame))
        }))
    }
}

/// Explains the colours of a picture of `frame`.
fn colors(frame: &ReferenceFrame) -> Markup {
    html! {
        @if matches!(frame.seen_in, SeenIn::Reconstruction(_)) {
            "Grey: an image reconstructed from events. Black: detected corners or dots, joined by magenta lines along the rows."
        } @else {
            i.swatch.on {} "ON and " i.swatch.off {} "OFF events. Black: detected circles, joined by magenta lines along the rows."
        }
    }
}

/// Returns the frames with the smallest, the middle and the largest error.
pub fn section(calibrated: &Calibrated, board: &Board) -> Option<Section> {
    let ranked = ranked(calibrated);
    let &best = ranked.first()?;
    let mut examples = vec![("Best", best)];
    if let [_, middle @ .., last] = ranked.as_slice() {
        examples.extend(middle.get(middle.len() / 2).map(|&frame| ("Middle", frame)));
        examples.push(("Worst", *last));
    }
    let ideal = ideal_camera(calibrated.camera(), calibrated.sensor);
    let draw = |index: usize, (name, (posed, frame)): (&'static str, (&PosedFrame, &'_ ReferenceFrame))| {
        let pictures = html! {
            // The top of the page shows the best frame as seen.
            @if index > 0 { (seen_figure(calibrated, board, posed, frame)) }
            (rectified_figure(calibrated, board, &ideal, posed, frame))
        };
        (name, frame.t(), frame.recording, pictures)
    };
    let examples: Vec<_> = examples.into_par_iter().enumerate().map(|(index, example)| draw(index, example)).collect();
    let content = html! {
        p {
            "Frames of the calibration, ranked by the error of the initial model. " (colors(best.1))
            " Green: the board, projected by the calibration; it should coincide with the edges. The pictures without the distortion of the lens "
            "should have straight magenta lines. The best frame as seen is at the top of the page."
        }
        @for (name, t, recording, pictures) in examples {
            h3 { (name) (format!(" frame, {t:.3} s")) @if calibrated.starts.len() > 1 { " of recording " (recording + 1) } }
            div.pair { (pictures) }
        }
    };
    Some(Section { id: "frames", title: "Example frames", folded: true, content })
}

/// Returns the number of picture pixels along each side of a sensor pixel: a whole number, or the picture shows every second pixel.
pub fn scale(sensor: Sensor) -> f64 {
    match WIDEST / sensor.width.max(1) {
        0 => 0.5,
        scale => f64::from(scale.min(4)),
    }
}

fn seen_figure(calibrated: &Calibrated, board: &Board, posed: &PosedFrame, frame: &ReferenceFrame) -> Markup {
    let seen = as_seen(calibrated, board, posed, frame);
    figure(&seen, "A frame as the sensor saw it, with the board.", "As the sensor saw it.")
}

fn rectified_figure(
    calibrated: &Calibrated,
    board: &Board,
    ideal: &IdealCamera<f64>,
    posed: &PosedFrame,
    frame: &ReferenceFrame,
) -> Markup {
    let (camera, sensor) = (calibrated.camera(), calibrated.sensor);
    let pose = calibrated.best_pose(posed, frame);
    let raster = Raster::new(sensor, frame);
    let mut rectified = Picture::of_sensor(sensor, scale(sensor), |place| {
        distorted(camera, ideal, place).map_or(BEYOND, |pixel| raster.color(pixel))
    });
    let place = |pixel: Vector2<f64>| ideal.of_pixel(camera, &pixel);
    rectified.board(frame, board, |point| projected(ideal, &pose.inverse_transform_point(point)), place);
    figure(&rectified, "A frame without the distortion of the lens, with the board.", "Without distortion.")
}

/// Draws a frame with the detected circles or corners, and the board as the calibration projects it.
fn as_seen(calibrated: &Calibrated, board: &Board, posed: &PosedFrame, frame: &ReferenceFrame) -> Picture {
    let (camera, sensor) = (calibrated.camera(), calibrated.sensor);
    let pose = calibrated.best_pose(posed, frame);
    let raster = Raster::new(sensor, frame);
    let mut seen = Picture::of_sensor(sensor, scale(sensor), |place| raster.color(place));
    seen.board(frame, board, |point| camera.project(&pose.inverse_transform_point(point).coords), Some);
    seen
}

/// Returns a picture with its caption and its `description` for screen readers.
pub fn figure(picture: &Picture, description: &str, caption: &str) -> Markup {
    picture_figure(picture, description, &html! { (caption) })
}

fn picture_figure(picture: &Picture, description: &str, caption: &Markup) -> Markup {
    use base64::prelude::{BASE64_STANDARD, Engine};
    html! {
        @match picture.to_png() {
            Ok(png) => figure {
                img alt=(description) width=(picture.width) height=(picture.height)
                    src=(format!("data:image/png;base64,{}", BASE64_STANDARD.encode(png)));
                figcaption { (caption) }
            },
            Err(error) => p { "A picture could not be written: " (error) },
        }
    }
}

/// The colour of each pixel of the sensor.
struct Raster {
    sensor: Sensor,
    colors: Vec<[u8; 3]>,
}

impl Raster {
    fn new(sensor: Sensor, frame: &ReferenceFrame) -> Self {
        if let SeenIn::Reconstruction(picture) = &frame.seen_in {
            return Self { sensor, colors: picture.pixels.iter().map(|&grey| [grey; 3]).collect() };
        }
        let mut colors = vec![WHITE; usize::from(sensor.width) * usize::from(sensor.height)];
        let pixels = frame.events().unwrap_or_default();
        for pixel in pixels.iter().filter(|pixel| pixel.x() < sensor.width) {
            if let Some(color) =
                colors.get_mut(usize::from(pixel.y()) * usize::from(sensor.width) + usize::from(pixel.x()))
            {
                *color = if pixel.polarity() == Polarity::On { ON } else { OFF };
            }
        }
        Self { sensor, colors }
    }

    fn color(&self, pixel: Vector2<f64>) -> [u8; 3] {
        let (column, row) = (pixel.x.round(), pixel.y.round());
        if !(column >= 0.0 && row >= 0.0 && column < f64::from(self.sensor.width)) {
            return BEYOND;
        }
        self.colors.get(row as usize * usize::from(self.sensor.width) + column as usize).copied().unwrap_or(BEYOND)
    }
}
