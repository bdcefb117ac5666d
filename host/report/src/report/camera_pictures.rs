//! Results from the camera's own pictures.

use maud::{Markup, html};

use super::chart::{SensorMap, cells_of_grid, round_up};
use super::number::{count, signed, with_sigma};
use super::overview::capital;
use super::page::{Section, scrolling};
use super::palette::Palette;
use super::picture_examples;
use evcal_calibrate::calibrate::Task;
use evcal_calibrate::calibrate::calibrated::{Calibrated, EventCalibration, Evidence};
use evcal_calibrate::picture_calibration::calibration::{PictureReport, PictureSource};
use evcal_calibrate::trust::witness::{Comparison, PictureWitness, WitnessOutcome};

/// Returns the cross-check with frames and examples, if the recordings contain pictures.
pub fn section(calibrated: &Calibrated, task: &Task) -> Option<Section> {
    let report = calibrated.picture_report()?;
    if report.source == PictureSource::StillViews {
        return Some(of_views(report));
    }
    let content = html! {
        @match &calibrated.evidence {
            Evidence::Events(events) => (beside_events(calibrated, events)),
            Evidence::Pictures(_) => p { "This calibration is from the camera's frames alone; events were not used." },
        }
        (counts(report))
        (picture_examples::pictures(calibrated, task))
    };
    Some(Section { id: "camera-frames", title: "The camera's own frames", content })
}

fn of_views(report: &PictureReport) -> Section {
    let content = html! {
        p {
            "The board blinked before a camera at rest. Every view is a picture: the pixels on what blinks sent many events, the others few. "
            "The corners or dots found in them are solved together with a pose for each view, as those of ordinary pictures are."
        }
        (counts(report))
    };
    Section { id: "views", title: "Views of a board that blinks", content }
}

fn beside_events(calibrated: &Calibrated, events: &EventCalibration) -> Markup {
    html! {
        @match &events.witness {
            Some(WitnessOutcome::Witness(witness)) => (witnessed(calibrated, witness)),
            Some(WitnessOutcome::Failed(failure)) => p { "The recording has frames, but no calibration could be made of them: " (failure) "." },
            None => {}
        }
        @if let Some(joint) = &events.joint {
            p {
                "Frames and events were then solved together: " (count(joint.dots as u64)) " dots of " (count(joint.frames as u64))
                " frames, whose clock is " (signed(1e3 * joint.time_offset, 3)) " ± " (signed(1e3 * joint.time_offset_sigma, 3))
                " ms from that of the events."
            }
        }
    }
}

fn counts(report: &PictureReport) -> Markup {
    let (detection, pictures) = (&report.detection, report.source);
    let refused: Vec<String> =
        detection.refused.iter().map(|(reason, number)| format!("{} {reason}", count(*number))).collect();
    html! {
        p {
            "Of " (count(detection.frames)) " " (pictures) " " (count(detection.with_board)) " show the board and " (count(report.used as u64))
            " were used to calibrate from " (pictures)
            @if !refused.is_empty() { " (not: " (refused.join(", ")) ")" }
            "."
            @if detection.blur > 0.0 { " The edges of their dots are blurred by " (signed(detection.blur, 2)) " px." }
        }
        @for note in &detection.notes { p { (note) } }
    }
}

fn witnessed(calibrated: &Calibrated, witness: &PictureWitness) -> Markup {
    let PictureWitness { comparison, difference } = witness;
    let points: Vec<_> =
        difference.grid.iter().map(|point| (point.pixel, point.difference.map(|[x, y]| x.hypot(y)))).collect();
    let map = SensorMap {
        description: format!(
            "Map of the sensor: difference of the projections from frames and from events, up to {:.3} px.",
            difference.max
        ),
        sensor: calibrated.sensor,
        cells: cells_of_grid(&points, usize::from(difference.columns), usize::from(difference.rows)),
        range: 0.0..round_up(difference.max),
        palette: Palette::Error,
        unit: "px",
        arrows: Vec::new(),
    };
    html! {
        p { strong { (capital(&comparison.sentence)) "." } }
        p {
            "They look through the same lens with the same pixels, but share neither light nor method with the events: a second, independent calibration. Both differ by "
            (signed(comparison.difference_rms, 3)) " px over the sensor; by their uncertainties one expects " (signed(comparison.expected.rms, 3)) " px ("
            (signed(comparison.expected.events, 3)) " px from the events, " (signed(comparison.expected.frames, 3)) " px from the frames)."
        }
        div.pair {
            figure {
                (map.render())
                figcaption { "Difference of the projections from frames and from events, with the rotation between the two cameras removed." }
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
                th.number scope="col" { "± σ" }
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
