//! Two halves of the recordings, calibrated separately.

use maud::{Markup, html};

use super::chart::{SensorMap, round_down};
use super::number::signed;
use super::page::{Section, scrolling};
use super::palette::Palette;
use super::trusted_places::difference_cells;
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::quality::split_half::SplitHalf;

/// Returns the differences of the halves; `None` for a calibration from pictures alone, whose uncertainty comes from leaving pictures out.
pub fn section(calibrated: &Calibrated) -> Option<Section> {
    let content = match &calibrated.events()?.quality.split_half {
        Some(halves) => compared(calibrated, halves),
        None => {
            html! { p { "The recordings are too short to be split into halves, so the uncertainty could not be tested." } }
        }
    };
    Some(Section {
        id: "halves",
        title: "Test of the uncertainty: two halves of the recording",
        folded: false,
        content,
    })
}

fn compared(calibrated: &Calibrated, halves: &SplitHalf) -> Markup {
    let (difference, held_out) = (&halves.difference, halves.held_out);
    html! {
        p {
            "Alternating slices of time form two halves, which are calibrated separately. The two cameras differ by "
            strong { (signed(difference.rms, 3)) " px" } " over the sensor (rms; at most " (signed(difference.max, 3)) " px). From the uncertainty one expects "
            (signed(halves.expected_rms, 3)) " px, and in 95 of 100 cases no more than " (signed(halves.bound, 3)) " px: "
            @if halves.consistent() { "the uncertainty is plausible." } @else { "the uncertainty is too small, or the lens changed." }
            " The residual of a half is " (signed(held_out.rms, 4)) " px with the camera of the other half, and " (signed(held_out.own_rms, 4))
            " px with its own."
        }
        div.pair {
            figure {
                (map(calibrated, halves).render())
                figcaption { "Difference of the two projections, with the rotation between the two cameras removed. Grey: no observations. Arrows point from the first half to the second" (format!(", enlarged {} times.", enlargement(calibrated, halves))) }
            }
            div {
                (scrolling("Parameters of the halves", &parameters(calibrated, halves)))
                p.faint { "σ is for the whole recording; for a half it is about 1.4 times as large." }
            }
        }
    }
}

/// Distance between arrows in points of the grid.
const STEP: usize = 5;

/// Returns the factor by which arrows are longer than the differences.
fn enlargement(calibrated: &Calibrated, halves: &SplitHalf) -> f64 {
    let difference = &halves.difference;
    let room = STEP as f64 * f64::from(calibrated.sensor.width) / f64::from(difference.columns.max(1));
    // Differences in the corners can be many times larger than elsewhere.
    let longest = difference.max.min(3.0 * difference.rms);
    round_down(0.9 * room / longest.max(1e-9))
}

fn map(calibrated: &Calibrated, halves: &SplitHalf) -> SensorMap {
    let difference = &halves.difference;
    let columns = usize::from(difference.columns);
    let (cells, largest) = difference_cells(calibrated, difference);
    let enlarged = enlargement(calibrated, halves);
    let drawn = |index: usize| index % columns.max(1) % STEP == STEP / 2 && index / columns.max(1) % STEP == STEP / 2;
    let arrows = difference.grid.iter().enumerate().filter(|(index, _)| drawn(*index)).filter_map(|(_, point)| {
        let along = point.difference?.map(|part| part * enlarged);
        Some(([point.pixel[0] - 0.5 * along[0], point.pixel[1] - 0.5 * along[1]], along))
    });
    SensorMap {
        description: format!(
            "Map of the sensor: difference of the projections of two halves, up to {largest:.3} px in regions with observations."
        ),
        sensor: calibrated.sensor,
        cells,
        palette: Palette::Error,
        unit: "px",
        arrows: arrows.collect(),
        contours: false,
    }
}

fn parameters(calibrated: &Calibrated, halves: &SplitHalf) -> Markup {
    let [first, second] = &halves.cameras;
    let sigma = calibrated.quality.uncertainty.sigma();
    let names = calibrated.camera().kind().parameter_names();
    html! {
        table.short {
            thead { tr {
                th scope="col" { "parameter" }
                th.number scope="col" { "first half" }
                th.number scope="col" { "second half" }
                th.number scope="col" { "σ" }
            } }
            tbody {
                @for (name, &sigma) in names.iter().zip(&sigma) {
                    @let value = |half: &evcal_geometry::lens::camera_file::CameraDescription| half.parameters.get(name).map(|value| super::number::with_sigma(value, sigma));
                    tr {
                        th scope="row" { code { (name) } }
                        @for half in [first, second] { td.number { @if let Some((value, _)) = value(half) { (value) } } }
                        td.number { @if let Some((_, sigma)) = value(first) { (sigma) } }
                    }
                }
            }
        }
    }
}
