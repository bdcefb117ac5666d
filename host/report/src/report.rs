//! `report.html`: one page that shows in words, numbers and pictures how good a calibration is.
//!
//! The page contains its style, plots (SVG) and pictures (PNG), and loads nothing. Each module makes one section of it from the
//! calibration. Sections with tables and settings begin folded, below the pictures.

mod accumulation;
mod at_a_glance;
mod board_places;
mod camera_pictures;
mod chart;
mod device;
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
mod scene;
mod second_camera;
mod stages;
mod to_copy;
mod trajectory;
mod trusted_places;
mod words;

use rayon::prelude::*;

use self::page::Section;
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::result::calibration_file::InputFile;
use evcal_calibrate::task::Task;

use crate::output::input_files::input_files;

/// Number of sections that are made in parallel.
const TOGETHER: usize = 6;

/// A file in the folder of the report.
pub struct ResultFile {
    /// Its path relative to the report's folder, with `/` between folders.
    pub name: String,
    /// Its size in bytes.
    pub length: u64,
}

/// Returns the report of `calibrated`, the result of `task`, as HTML that lists `files`. It calls `progress` with the
/// share that is done, 0 to 1.
pub fn report(calibrated: &Calibrated, task: &Task, files: &[ResultFile], progress: &mut dyn FnMut(f64)) -> String {
    let sections = sections(calibrated, task, progress);
    // A report cannot name files that have changed.
    sections.finish(&input_files(calibrated, task).unwrap_or_default(), files)
}

/// The sections that do not depend on the written files.
pub struct Sections<'a> {
    calibrated: &'a Calibrated,
    task: &'a Task<'a>,
    made: Vec<Option<Section>>,
}

/// Makes the sections that take time; [`Sections::finish`] adds the others.
pub fn sections<'a>(calibrated: &'a Calibrated, task: &'a Task, progress: &mut dyn FnMut(f64)) -> Sections<'a> {
    let board = task.board;
    let sections: [&(dyn Fn() -> Option<Section> + Sync); 13] = [
        &|| at_a_glance::section(calibrated, board),
        &|| numbers::section(calibrated, board),
        &|| accumulation::section(calibrated, task),
        &|| trusted_places::section(calibrated),
        &|| board_places::section(calibrated, board),
        &|| halves::section(calibrated),
        &|| camera_pictures::section(calibrated, task),
        &|| inertial::section(calibrated),
        &|| second_camera::section(calibrated),
        &|| example_frames::section(calibrated, board),
        &|| residuals::section(calibrated, board),
        &|| trajectory::section(calibrated, board),
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
    /// Returns the report, with the calibration's `inputs` and the `files` in its folder.
    pub fn finish(self, inputs: &[InputFile], files: &[ResultFile]) -> String {
        let Self { calibrated, task, made } = self;
        let origin = [provenance::section(calibrated, task, inputs), provenance::settings(task, files)];
        let sections = made.into_iter().chain(origin).flatten().collect();
        page::page(&overview::title(calibrated), &overview::head(calibrated, task), sections)
    }
}
