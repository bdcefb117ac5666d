//! `report.html`: one file that says in words, numbers and pictures how good a calibration is.
//!
//! It needs nothing beside it: style, plots (SVG) and pictures (PNG) are part of it, and nothing is loaded. Each
//! section is a function from the calibration to a piece of the page.

mod accumulation;
mod board_places;
mod camera_pictures;
mod chart;
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
mod trajectory;
mod trusted_places;

use crate::calibrate::Task;
use crate::calibrate::calibrated::Calibrated;

/// The report of `calibrated`, which came from `task`, as HTML.
pub fn report(calibrated: &Calibrated, task: &Task) -> String {
    let sections = [
        numbers::section(calibrated),
        trusted_places::section(calibrated),
        board_places::section(calibrated, task.board),
        halves::section(calibrated),
        residuals::section(calibrated),
        camera_pictures::section(calibrated, task),
        example_frames::section(calibrated, task.board),
        accumulation::section(calibrated, task),
        trajectory::section(calibrated),
        inertial::section(calibrated),
        stages::section(calibrated),
        provenance::section(calibrated, task),
    ];
    page::page(&overview::head(calibrated), sections.into_iter().flatten().collect())
}
