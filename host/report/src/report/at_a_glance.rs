//! The three pictures that show best whether a calibration is good: a frame, the uncertainty and the residuals.

use maud::html;

use super::example_frames::best_frame;
use super::page::Section;
use super::residuals::displacement_map;
use super::trusted_places::uncertainty_map;
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_geometry::board::Board;

/// Returns the pictures that this calibration has; the uncertainty is always among them.
pub fn section(calibrated: &Calibrated, board: &Board) -> Option<Section> {
    let content = html! {
        div.trio {
            (best_frame(calibrated, board))
            (uncertainty_map(calibrated))
            (displacement_map(calibrated))
        }
    };
    Some(Section { id: "glance", title: "The result in pictures", folded: false, content })
}
