//! `report.html`: one file that describes the quality of a calibration in words, numbers and pictures.
//!
//! It is self-contained: style, plots (SVG) and pictures (PNG) are part of it, and nothing is loaded. Each section is a
//! function from the calibration to a part of the page.

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
use evcal_calibrate::calibrate::Task;
use evcal_calibrate::calibrate::calibrated::Calibrated;

/// Number of sections that are computed at the same time.
const TOGETHER: usize = 6;

/// A file next to the report.
pub struct ResultFile {
    /// Its path relative to the report's folder, with `/` between folders.
    pub name: String,
    /// Its size in bytes.
    pub length: u64,
}

/// Returns the report of `calibrated`, the result of `task`, as HTML, to be stored next to `files`. `progress` is
/// called with the finished fraction, 0 to 1.
pub fn report(calibrated: &Calibrated, task: &Task, files: &[ResultFile], progress: &mut dyn FnMut(f64)) -> String {
    sections(calibrated, task, progress).beside(files)
}

/// A report without the list of the files next to it.
pub struct Sections<'a> {
    calibrated: &'a Calibrated,
    task: &'a Task<'a>,
    made: Vec<Option<Section>>,
}

/// Computes the time-consuming parts of a report; see [`report`].
pub fn sections<'a>(calibrated: &'a Calibrated, task: &'a Task, progress: &mut dyn FnMut(f64)) -> Sections<'a> {
    let board = task.board;
    let sections: [&(dyn Fn() -> Option<Section> + Sync); 12] = [
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
    ];
    let mut made: Vec<Option<Section>> = Vec::new();
    for group in sections.chunks(TOGETHER) {
        made.par_extend(group.par_iter().map(|section| section()));
        progress(made.len() as f64 / sections.len() as f64);
    }
    Sections { calibrated, task, made }
}

impl Sections<'_> {
    /// Completes the report with the list of these files.
    pub fn beside(self, files: &[ResultFile]) -> String {
        let Self { calibrated, task, made } = self;
        let sections = made.into_iter().chain([provenance::section(calibrated, task, files)]).flatten().collect();
        page::page(&overview::title(calibrated), &overview::head(calibrated, task), sections)
    }
}
