//! Comparison of two halves of the recordings that were calibrated separately.

use maud::{Markup, html};

use super::chart::{SensorMap, cells_of_grid, round_down, round_up};
use super::number::signed;
use super::page::{Section, scrolling};
use super::palette::Palette;
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::trust::split_half::SplitHalf;

/// Returns the section on the difference of the halves. Returns `None` for a calibration from pictures alone, in which
/// each picture has its own pose: its uncertainty is determined by leaving pictures out.
pub fn section(calibrated: &Calibrated) -> Option<Section> {
    let content = match &calibrated.events()?.trust.split_half {
        Some(halves) => compared(calibrated, halves),
        None => {
            html! { p { "The recordings are too short to be halved: the stated uncertainty could not be put to the test." } }
        }
    };
    Some(Section { id: "halves", title: "Two halves against each other", content })
}

fn compared(calibrated: &Calibrated, halves: &SplitHalf) -> Markup {
    let (difference, held_out) = (&halves.difference, halves.held_out);
    html! {
        p {
            "Every other slice of time makes one half, the rest the other; each is calibrated by itself. The two cameras differ by "
            strong { (signed(difference.rms, 3)) " px" } " over the sensor (at most " (signed(difference.max, 3)) " px). By the stated uncertainty one expects "
            (signed(halves.expected_rms, 3)) " px, and in 95 of 100 cases no more than " (signed(halves.bound, 3)) " px: "
            @if halves.consistent() { "the stated uncertainty is plausible." } @else { "the stated uncertainty is too small, or the lens changed." }
        }
        p {
            "Each half's camera explains the other half, which it has not seen, to " (signed(held_out.rms, 4)) " px; that half's own camera to "
            (signed(held_out.own_rms, 4)) " px."
        }
        div.pair {
            figure {
                (map(calibrated, halves).render())
                figcaption { "Difference of the two halves' projections, with the rotation between the two cameras removed; arrows point from the first to the second." (format!(" They are enlarged {} times.", enlargement(calibrated, halves))) }
            }
            div {
                (scrolling("Parameters of the halves", &parameters(calibrated, halves)))
                p.faint { "σ is that of the whole; a half has about 1.4 times as much." }
            }
        }
    }
}

/// Number of grid points between arrows.
const STEP: usize = 5;

/// Returns the ratio of the arrows to the differences.
fn enlargement(calibrated: &Calibrated, halves: &SplitHalf) -> f64 {
    let difference = &halves.difference;
    let room = STEP as f64 * f64::from(calibrated.sensor.width) / f64::from(difference.columns.max(1));
    // The differences in the corners may be many times larger than elsewhere.
    let longest = difference.max.min(3.0 * difference.rms);
    round_down(0.9 * room / longest.max(1e-9))
}

fn map(calibrated: &Calibrated, halves: &SplitHalf) -> SensorMap {
    let difference = &halves.difference;
    let (columns, rows) = (usize::from(difference.columns), usize::from(difference.rows));
    let points: Vec<_> =
        difference.grid.iter().map(|point| (point.pixel, point.difference.map(|[x, y]| x.hypot(y)))).collect();
    let enlarged = enlargement(calibrated, halves);
    let drawn = |index: usize| index % columns.max(1) % STEP == STEP / 2 && index / columns.max(1) % STEP == STEP / 2;
    let arrows = difference.grid.iter().enumerate().filter(|(index, _)| drawn(*index)).filter_map(|(_, point)| {
        let along = point.difference?.map(|part| part * enlarged);
        Some(([point.pixel[0] - 0.5 * along[0], point.pixel[1] - 0.5 * along[1]], along))
    });
    SensorMap {
        description: format!(
            "Map of the sensor: difference of the projections of two halves, up to {:.3} px.",
            difference.max
        ),
        sensor: calibrated.sensor,
        cells: cells_of_grid(&points, columns, rows),
        range: 0.0..round_up(difference.max),
        palette: Palette::Error,
        unit: "px",
        arrows: arrows.collect(),
    }
}

fn parameters(calibrated: &Calibrated, halves: &SplitHalf) -> Markup {
    let [first, second] = &halves.cameras;
    let sigma = calibrated.trust.uncertainty.sigma();
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
