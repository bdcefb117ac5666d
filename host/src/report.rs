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

/// Parts of the work that are told, beside those of the section that reads all events again.
const PARTS: f64 = 12.0;
/// Parts of that section.
const ACCUMULATION_PARTS: f64 = 4.0;

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
    let mut step = |section, parts: f64| {
        done += parts / (PARTS + ACCUMULATION_PARTS);
        progress(done);
        section
    };
    let mut sections = vec![
        step(numbers::section(calibrated, task.board), 1.0),
        step(trusted_places::section(calibrated), 1.0),
        step(board_places::section(calibrated, task.board), 1.0),
        step(halves::section(calibrated), 1.0),
        step(residuals::section(calibrated), 1.0),
        step(camera_pictures::section(calibrated, task), 1.0),
        step(example_frames::section(calibrated, task.board), 1.0),
    ];
    let mut before = 0.0;
    let accumulation = accumulation::section(calibrated, task, &mut |share| {
        step(None, ACCUMULATION_PARTS * (share - before));
        before = share;
    });
    sections.extend([
        accumulation,
        step(trajectory::section(calibrated), 1.0),
        step(inertial::section(calibrated), 1.0),
        step(stages::section(calibrated), 1.0),
        step(provenance::section(calibrated, task, files), 1.0),
    ]);
    page::page(
        &overview::title(calibrated),
        &overview::head(calibrated, task),
        sections.into_iter().flatten().collect(),
    )
}
