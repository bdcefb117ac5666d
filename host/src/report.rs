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
mod mount_axes;
mod number;
mod numbers;
mod overview;
mod page;
mod palette;
mod picture_examples;
mod provenance;
mod rectification;
mod residuals;
mod second_camera;
mod stages;
mod to_copy;
mod trajectory;
mod trusted_places;

use rayon::prelude::*;

use self::page::Section;
use crate::calibrate::Task;
use crate::calibrate::calibrated::Calibrated;

/// Sections that are made at the same time.
const TOGETHER: usize = 6;

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
    let board = task.board;
    let sections: [&(dyn Fn() -> Option<Section> + Sync); 13] = [
        &|| numbers::section(calibrated, board),
        &|| trusted_places::section(calibrated),
        &|| board_places::section(calibrated, board),
        &|| halves::section(calibrated),
        &|| residuals::section(calibrated),
        &|| camera_pictures::section(calibrated, task),
        &|| example_frames::section(calibrated, board),
        &|| accumulation::section(calibrated, task),
        &|| trajectory::section(calibrated),
        &|| inertial::section(calibrated),
        &|| second_camera::section(calibrated),
        &|| stages::section(calibrated),
        &|| provenance::section(calibrated, task, files),
    ];
    let mut made: Vec<Option<Section>> = Vec::new();
    for group in sections.chunks(TOGETHER) {
        made.par_extend(group.par_iter().map(|section| section()));
        progress(made.len() as f64 / sections.len() as f64);
    }
    page::page(&overview::title(calibrated), &overview::head(calibrated, task), made.into_iter().flatten().collect())
}
