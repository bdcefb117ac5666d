//! The camera's own pictures: their calibration compared with the calibration from events, and examples.

use maud::{Markup, html};

use super::chart::SensorMap;
use super::number::{count, signed, with_sigma};
use super::overview::capital;
use super::page::{Section, scrolling};
use super::palette::Palette;
use super::picture_examples;
use super::trusted_places::difference_cells;
use super::words::words;
use evcal_calibrate::calibrate::calibrated::{Calibrated, EventCalibration, Evidence};
use evcal_calibrate::picture_calibration::calibration::{PictureReport, PictureSource};
use evcal_calibrate::quality::cross_check::{Comparison, CrossCheckOutcome, PictureCrossCheck};
use evcal_calibrate::task::Task;

/// Returns the comparison and examples; `None` if the recordings contain no pictures.
pub fn section(calibrated: &Calibrated, task: &Task) -> Option<Section> {
    let report = calibrated.picture_report()?;
    if report.source == PictureSource::StillViews {
        return Some(of_views(report, words(task.board).parts));
    }
    let content = html! {
        @match &calibrated.evidence {
            Evidence::Events(events) => (with_events(calibrated, events, words(task.board).points)),
            Evidence::Pictures(_) => p { "This calibration uses the camera's frames only, no events." },
        }
        (counts(report, words(task.board).parts))
        (picture_examples::pictures(calibrated, task))
    };
    Some(Section { id: "camera-frames", title: "Comparison with the camera's frames", folded: false, content })
}

fn of_views(report: &PictureReport, parts: &str) -> Section {
    let content = html! {
        p {
            "The board blinked in front of a camera at rest. Each view is an image: the pixels on the blinking parts have many events, the others few. "
            "The calibration estimates a pose for each view, as from ordinary images."
        }
        (counts(report, parts))
    };
    Section { id: "views", title: "Views of a blinking board", folded: false, content }
}

fn with_events(calibrated: &Calibrated, events: &EventCalibration, points: &str) -> Markup {
    html! {
        @match &events.cross_check {
            Some(CrossCheckOutcome::Compared(cross_check)) => (compared(calibrated, cross_check)),
            Some(CrossCheckOutcome::Failed(failure)) => p { "The frames of the recording could not be calibrated: " (failure) "." },
            None => {}
        }
        @if let Some(joint) = &events.joint {
            p {
                "Frames and events were then solved jointly: " (count(joint.dots as u64)) " " (points) " in " (count(joint.frames as u64))
                " frames, with a clock offset of " (signed(1e3 * joint.time_offset, 3)) " ± " (signed(1e3 * joint.time_offset_sigma, 3))
                " ms to the events."
            }
        }
    }
}

fn counts(report: &PictureReport, parts: &str) -> Markup {
    let (detection, pictures) = (&report.detection, report.source);
    let refused: Vec<String> =
        detection.refused.iter().map(|(reason, number)| format!("{reason}: {}", count(*number))).collect();
    html! {
        p {
            (count(detection.with_board)) " of " (count(detection.frames)) " " (pictures) " show the board; their calibration used " (count(report.used as u64))
            @if !refused.is_empty() { " (rejected: " (refused.join(", ")) ")" }
            "."
            @if detection.blur > 0.0 { " The edges of the " (parts) " are blurred by " (signed(detection.blur, 2)) " px." }
        }
        @for note in &detection.notes { p { (note) } }
    }
}

fn compared(calibrated: &Calibrated, cross_check: &PictureCrossCheck) -> Markup {
    let PictureCrossCheck { comparison, difference } = cross_check;
    let (cells, largest) = difference_cells(calibrated, difference);
    let map = SensorMap {
        description: format!(
            "Map of the sensor: difference of the projections from frames and from events, up to {largest:.3} px in regions with observations."
        ),
        sensor: calibrated.sensor,
        cells,
        palette: Palette::Error,
        unit: "px",
        arrows: Vec::new(),
        contours: false,
    };
    html! {
        p { strong { (capital(&comparison.sentence)) "." } }
        p {
            "Frames and events have the same lens and pixels, but neither the light nor the method in common, so the frames are an independent check. The two "
            "calibrations differ by " (signed(comparison.difference_rms, 3)) " px over the sensor (rms); from their uncertainties one expects "
            (signed(comparison.expected.rms, 3)) " px (" (signed(comparison.expected.events, 3)) " px from the events, "
            (signed(comparison.expected.frames, 3)) " px from the frames)."
        }
        div.pair {
            figure {
                (map.render())
                figcaption { "Difference of the projections from frames and from events, with the rotation between the two cameras removed. Grey: no observations." }
            }
            (scrolling("Parameters from events and from frames", &parameters(comparison)))
        }
    }
}

fn parameters(comparison: &Comparison) -> Markup {
    html! {
        table.short {
            thead { tr {
                th scope="col" { "parameter" }
                th.number scope="col" { "events" }
                th.number scope="col" { "frames" }
                th.number scope="col" { "σ of frames" }
                th.number scope="col" { "difference / σ" }
            } }
            tbody {
                @for parameter in &comparison.parameters {
                    @let (frames, sigma) = with_sigma(parameter.frames, parameter.frames_sigma);
                    @let (events, _) = with_sigma(parameter.events, parameter.frames_sigma);
                    tr {
                        th scope="row" { code { (parameter.name) } }
                        td.number { (events) }
                        td.number { (frames) }
                        td.number { (sigma) }
                        td.number {
                            @if parameter.difference_sigma > 0.0 {
                                (signed((parameter.frames - parameter.events) / parameter.difference_sigma, 1))
                            }
                        }
                    }
                }
            }
        }
    }
}
