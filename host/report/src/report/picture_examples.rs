//! Pictures of the camera: one with and without distortion, and the mean of many on the board.

use maud::{Markup, html};
use nalgebra::{Isometry3, Point3, Vector2};
use rayon::prelude::*;

use super::accumulation::BoardFrame;
use super::example_frames::{figure, scale};
use super::number::count;
use super::rectification::{distorted, ideal_camera, projected};
use crate::report::drawing::{BEYOND, Picture};
use evcal_calibrate::calibrate::calibrated::{Calibrated, Evidence};
use evcal_calibrate::task::Task;
use evcal_calibrate::task::input::Input;
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_geometry::board::Board;
use event_recordings::pictures::{GreyImage, TimedImage};

/// Limit of the pictures whose mean is shown on the board.
const MOST_PICTURES: usize = 16;
/// Columns of the picture of the board, about as many as the board has on the sensor.
const BOARD_COLUMNS: u16 = 400;
/// A picture belongs to a reference frame if their times differ by less than this (s).
const SAME_TIME: f64 = 1e-3;

/// A picture with its pose.
struct Shown {
    image: GreyImage,
    position: Vector2<f64>,
    /// `T_world_camera` at the midpoint of the exposure.
    pose: Isometry3<f64>,
}

/// Returns the examples; empty if no picture has a pose.
pub fn pictures(calibrated: &Calibrated, task: &Task) -> Markup {
    let (shown, used) = pictures_with_pose(calibrated, task);
    let Some(example) = shown.get(shown.len() / 2) else { return html! {} };
    let (camera, sensor) = (calibrated.camera(), calibrated.sensor);
    let ideal = ideal_camera(camera, sensor);
    let grey = |pixel: Vector2<f64>| example.grey(pixel).map_or(BEYOND, |grey| [grey.round() as u8; 3]);
    let mut seen = Picture::of_sensor(sensor, scale(sensor), grey);
    let in_camera = |point: &Point3<f64>| example.pose.inverse_transform_point(point);
    seen.edges(task.board, |point| camera.project(&in_camera(point).coords));
    let mut rectified =
        Picture::of_sensor(sensor, scale(sensor), |place| distorted(camera, &ideal, place).map_or(BEYOND, grey));
    rectified.edges(task.board, |point| projected(&ideal, &in_camera(point)));
    let together = carried(calibrated, task.board, &shown);
    html! {
        div.trio {
            (figure(&seen, "A frame of the camera with the edges of the board.", "A frame of the camera. Green: the board, projected by the calibration."))
            (figure(&rectified, "The same frame without the distortion of the lens.", "The same frame without distortion."))
            (figure(&together, "The mean of many frames on the board.", &format!("The mean of {} of the {} frames with a pose, each projected onto the board by the calibration: sharp if both agree.", shown.len(), count(used as u64))))
        }
    }
}

/// Returns at most [`MOST_PICTURES`] pictures with a pose, evenly chosen, and the number of all pictures with a pose.
fn pictures_with_pose(calibrated: &Calibrated, task: &Task) -> (Vec<Shown>, usize) {
    let (mut shown, mut used, mut every) = (Vec::new(), 0_usize, 1);
    visit_with_pose(calibrated, task, |picture, pose| {
        if let (0, Ok(image)) = (used % every, picture.image) {
            let position = Vector2::new(f64::from(picture.position.0), f64::from(picture.position.1));
            shown.push(Shown { image, position, pose });
        }
        used += 1;
        if shown.len() > MOST_PICTURES {
            every *= 2;
            let mut is_even = false;
            shown.retain(|_| {
                is_even = !is_even;
                is_even
            });
        }
    });
    (shown, used)
}

/// Calls `visit` for each readable picture of the recordings that has a pose.
fn visit_with_pose(calibrated: &Calibrated, task: &Task, mut visit: impl FnMut(TimedImage, Isometry3<f64>)) {
    for (number, (input, &start)) in task.inputs.iter().zip(&calibrated.starts).enumerate() {
        let Input::Events(recording) = input else { continue };
        if !recording.may_contain_frames() {
            continue;
        }
        let _ = recording.visit_frames(|picture| {
            let middle = 0.5 * (picture.exposure.0 as f64 + picture.exposure.1 as f64);
            if let (Ok(_), Some(pose)) = (&picture.image, pose_at(calibrated, number, middle * 1e-6 - start)) {
                visit(picture, pose);
            }
        });
    }
}

/// Returns `T_world_camera` at `t` seconds from the start of a recording.
fn pose_at(calibrated: &Calibrated, recording: usize, t: f64) -> Option<Isometry3<f64>> {
    match &calibrated.evidence {
        Evidence::Events(events) => {
            let offset = events.joint.as_ref().map_or(0.0, |joint| joint.time_offset);
            events.pose(recording, t + offset)
        }
        Evidence::Pictures(_) => {
            let same = |frame: &ReferenceFrame| frame.recording == recording && (frame.t() - t).abs() < SAME_TIME;
            calibrated.posed().find(|(_, frame)| same(frame)).map(|(posed, _)| posed.pose)
        }
    }
}

impl Shown {
    /// Interpolates the grey value at a position on the sensor.
    fn grey(&self, pixel: Vector2<f64>) -> Option<f64> {
        let place = pixel - self.position;
        if !(place.x >= 0.0 && place.y >= 0.0) {
            return None;
        }
        // The conversion rounds down without the function call that `floor` needs on older processors.
        let (column, row) = (place.x as usize, place.y as usize);
        let (right_share, lower_share) = (place.x - column as f64, place.y - row as f64);
        let value = |column: usize, row: usize| self.image.get(column, row).map(f64::from);
        let upper = value(column, row)? * (1.0 - right_share) + value(column + 1, row)? * right_share;
        let lower = value(column, row + 1)? * (1.0 - right_share) + value(column + 1, row + 1)? * right_share;
        Some(upper * (1.0 - lower_share) + lower * lower_share)
    }
}

/// Returns the mean of `shown` on the board.
fn carried(calibrated: &Calibrated, board: &Board, shown: &[Shown]) -> Picture {
    let frame = BoardFrame::new(board, BOARD_COLUMNS);
    let camera = calibrated.camera();
    let (width, height) = (usize::from(frame.size.width), usize::from(frame.size.height));
    let mut means = vec![None; width * height];
    means.par_iter_mut().enumerate().for_each(|(index, mean)| {
        let point = frame.point(Vector2::new((index % width.max(1)) as f64, (index / width.max(1)) as f64));
        let point = Point3::new(point.x, point.y, 0.0);
        let seen = shown.iter().filter_map(|shown| {
            let pixel = camera.project(&shown.pose.inverse_transform_point(&point).coords)?;
            shown.grey(pixel)
        });
        let (sum, count) = seen.fold((0.0, 0), |(sum, count), grey| (sum + grey, count + 1));
        *mean = (count > 0).then(|| sum / f64::from(count));
    });
    Picture::of_sensor(frame.size, 1.0, |place| {
        let index = place.y.round().max(0.0) as usize * width + place.x.round().max(0.0) as usize;
        means.get(index).copied().flatten().map_or(BEYOND, |grey: f64| [grey.round() as u8; 3])
    })
}
