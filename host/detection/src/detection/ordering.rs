//! Ordering of circles from an external detector by their positions on the board.

use evcal_core::grid::{GridCandidate, GridOptions};
use evcal_core::pattern::Pattern;
use evcal_core::sensor::Sensor;
use rayon::prelude::*;

use super::DetectionReport;
use super::board_finder::BoardFinder;
use super::no_board::NoBoard;
use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame, SeenIn, UnorderedFrame};

/// Orders the circles of frames from an external detector. Frames without a board are dropped, and the report contains
/// the reasons. Without a sensor size, the extent of the circles is used.
pub fn order_frames(
    frames: &[UnorderedFrame],
    pattern: &Pattern,
    sensor: Option<Sensor>,
) -> (Vec<ReferenceFrame>, DetectionReport) {
    let circles = || frames.iter().flat_map(|frame| &frame.circles);
    let extent = || {
        circles().fold((1.0_f64, 1.0_f64), |size, circle| (size.0.max(circle.center.x), size.1.max(circle.center.y)))
    };
    let size = sensor.map_or_else(extent, |sensor| (sensor.width.into(), sensor.height.into()));
    let options = GridOptions::new(pattern, size);
    let ordered: Vec<Result<ReferenceFrame, NoBoard>> = frames
        .par_iter()
        .map_init(|| BoardFinder::new(*pattern), |finder, frame| order_frame(frame, finder, &options))
        .collect();
    let mut report = DetectionReport { windows: frames.len() as u64, ..DetectionReport::default() };
    report.circles = circles().count() as u64;
    let mut found = Vec::new();
    for frame in ordered {
        match frame {
            Ok(frame) => {
                report.found += 1;
                report.board_circles += frame.circles.len() as u64;
                found.push(frame);
            }
            Err(reason) => *report.grids_refused.entry(reason).or_default() += 1,
        }
    }
    (found, report)
}

fn order_frame(
    frame: &UnorderedFrame,
    finder: &mut BoardFinder<f64>,
    options: &GridOptions,
) -> Result<ReferenceFrame, NoBoard> {
    let candidates: Vec<GridCandidate<f64>> = frame
        .circles
        .iter()
        .map(|circle| GridCandidate { center: circle.center, radius: circle.radius.unwrap_or(0.0) })
        .collect();
    let placed = finder.find(&candidates, options)?;
    let circles = placed.iter().filter_map(|placed| {
        let circle = frame.circles.get(placed.candidate)?;
        Some(ObservedCircle {
            index: placed.index,
            t: circle.t,
            center: circle.center,
            radius: circle.radius,
            velocity: circle.velocity,
        })
    });
    let circles = circles.collect();
    Ok(ReferenceFrame { recording: 0, start: frame.start, end: frame.end, circles, seen_in: SeenIn::Circles })
}
