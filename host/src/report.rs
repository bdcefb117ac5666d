//! `report.html`: one file that says in words, numbers and pictures how good a calibration is.
//!
//! It needs nothing beside it: style, plots (SVG) and pictures (PNG) are part of it, and nothing is loaded. Each
//! section is a function from the calibration to a piece of the page.

mod accumulation;
mod board_places;
mod camera_pictures;
mod chart;
mod distortion;
pub mod drawing;
mod example_frames;
mod halves;
mod inertial;
mod inertial_axes;
mod number;
mod numbers;
mod overview;
mod page;
mod palette;
mod picture_examples;
mod provenance;
mod rectification;
mod residuals;
mod stages;
mod to_copy;
mod trajectory;
mod trusted_places;

use crate::calibrate::Task;
use crate::calibrate::calibrated::Calibrated;

/// Sections of the report.
const SECTIONS: f64 = 12.0;

/// A file beside the report.
pub struct ResultFile {
    /// Its path from the report's folder, with `/` between folders.
    pub name: String,
    /// Its size in bytes.
    pub length: u64,
}

/// The report of `calibrated`, which came from `task`, as HTML, to be put beside `files`. `progress` is told which part of
/// it is done, 0 to 1.
pub fn report(calibrated: &Calibrated, task: &Task, files: &[ResultFile], progress: &mut dyn FnMut(f64)) -> String {
    let mut done = 0.0;
    let mut step = |section| {
        done += 1.0;
        progress(done / SECTIONS);
        section
    };
    let sections = [
        step(numbers::section(calibrated, task.board)),
        step(trusted_places::section(calibrated)),
        step(board_places::section(calibrated, task.board)),
        step(halves::section(calibrated)),
        step(residuals::section(calibrated)),
        step(camera_pictures::section(calibrated, task)),
        step(example_frames::section(calibrated, task.board)),
        step(accumulation::section(calibrated, task)),
        step(trajectory::section(calibrated)),
        step(inertial::section(calibrated)),
        step(stages::section(calibrated)),
        step(provenance::section(calibrated, task, files)),
    ];
    page::page(
        &overview::title(calibrated),
        &overview::head(calibrated, task),
        sections.into_iter().flatten().collect(),
    )
}
