//! The residuals of the joint solve, by position on the sensor and by event class.

use evcal_geometry::board::Board;
use maud::{Markup, html};

use super::chart::{Chart, Color, SensorMap, Series, round_down, usual_largest};
use super::number::{count, signed, with_sigma};
use super::page::{Section, scrolling};
use super::palette::Palette;
use super::words::{Words, words};
use evcal_calibrate::calibrate::calibrated::{Calibrated, EventCalibration, Evidence};
use evcal_calibrate::quality::residual_map::histogram::{BIN_COUNT, BOUND, ClassResiduals};
use evcal_calibrate::quality::residual_map::{ResidualMap, ResidualPattern};
use evcal_core::event::Polarity;
use evcal_solve::solve::residual_statistics::Measured;
use evcal_solve::solve::rows::burst::{BurstLength, RANK_COUNT};
use evcal_solve::solve::rows::event_bias::bias::Bias;
use evcal_solve::solve::rows::event_bias::{CLASS_COUNT, EventKind};

const RANKS: [&str; RANK_COUNT] = ["first", "second", "third", "later"];

/// Returns the residuals by position and by event class.
pub fn section(calibrated: &Calibrated, board: &Board) -> Option<Section> {
    let content = match &calibrated.evidence {
        Evidence::Events(events) => of_events(calibrated, events, words(board)),
        Evidence::Pictures(_) => in_words(calibrated, words(board)),
    };
    Some(Section { id: "residuals", title: "Residuals", folded: true, content })
}

fn in_words(calibrated: &Calibrated, words: Words) -> Markup {
    let statistics = calibrated.residuals();
    html! {
        p {
            "A residual is "
            @match calibrated.measured() {
                Measured::EventEdges => { "the distance of an event from the projected edge of its " (words.part) "." }
                Measured::CircleCentres | Measured::Corners => { "the distance of a detected " (words.point) " from its projection." }
            }
            " The median is " (signed(statistics.median, 3)) " px, the root mean square " (signed(statistics.rms, 3)) " px."
        }
    }
}

fn of_events(calibrated: &Calibrated, calibration: &EventCalibration, words: Words) -> Markup {
    let map = &calibration.quality.residuals;
    let (classes, by_rank) = (&calibration.quality.classes, &calibration.quality.ranks);
    let (off, on) = by_rank.split_at(RANK_COUNT);
    let highest = by_rank.iter().flat_map(|class| (0..BIN_COUNT).map(|bin| density(class, bin))).fold(0.1, f64::max);
    html! {
        (in_words(calibrated, words))
        @if map.cells.iter().any(|cell| cell.count > 0) { (by_position(calibrated, map, words)) }
        @if calibration.measured == Measured::EventEdges {
            h3 { "By event class" }
            p {
                "A passing edge triggers a burst of events at a pixel. OFF (darker) and ON (brighter) events of each rank in bursts of each "
                "length have their own bias, which the calibration estimates. The curves should be narrow, symmetric and centred on 0."
            }
            div.pair {
                figure { (histogram(off, "OFF", highest).render()) figcaption { "Residuals of OFF events, by rank in the burst." } }
                figure { (histogram(on, "ON", highest).render()) figcaption { "Residuals of ON events, by rank in the burst." } }
            }
            (scrolling("Event classes", &class_table(calibration, classes)))
            p.faint { "Offsets apply to a straight, slow edge and are positive outside the " (words.part) "; latencies are relative to the mean of all first OFF events of bursts." }
        }
    }
}

/// Returns the map of the displacements; empty if no cell has enough observations.
pub fn displacement_map(calibrated: &Calibrated) -> Markup {
    let Some(events) = calibrated.events() else { return html! {} };
    let map = &events.quality.residuals;
    let shifts: Vec<_> =
        map.places().zip(&map.cells).filter_map(|(place, cell)| Some((place, cell.displacement?))).collect();
    if shifts.is_empty() {
        return html! {};
    }
    let longest = shifts.iter().map(|(_, displacement)| displacement.shift.norm()).fold(0.0, f64::max);
    let usual = usual_largest(shifts.iter().map(|(_, displacement)| displacement.shift.norm()));
    let enlarged = round_down(0.9 * map.cell[0].min(map.cell[1]) / usual.max(1e-9));
    let arrows = shifts.iter().map(|([left, top, right, bottom], displacement)| {
        let along = displacement.shift * enlarged;
        ([0.5 * (left + right) - 0.5 * along.x, 0.5 * (top + bottom) - 0.5 * along.y], along.into())
    });
    let sizes = SensorMap {
        description: format!(
            "Map of the sensor: mean displacement of the observations in each cell, up to {longest:.3} px."
        ),
        sensor: calibrated.sensor,
        cells: map
            .places()
            .zip(&map.cells)
            .map(|(place, cell)| (place, cell.displacement.map(|displacement| displacement.shift.norm())))
            .collect(),
        palette: Palette::Error,
        unit: "px",
        arrows: arrows.collect(),
        contours: false,
    };
    html! {
        figure {
            (sizes.render())
            figcaption {
                "Residuals: mean displacement of the observations in each cell from their projection; arrows are enlarged " (format!("{enlarged}"))
                " times. If neighbouring arrows agree, the camera model does not fit the lens there."
            }
        }
    }
}

fn by_position(calibrated: &Calibrated, map: &ResidualMap, words: Words) -> Markup {
    let rms = SensorMap {
        description: "Map of the sensor: root mean square residual in each cell.".to_owned(),
        sensor: calibrated.sensor,
        cells: map
            .places()
            .zip(&map.cells)
            .map(|(place, cell)| (place, (cell.count > 0).then_some(cell.rms)))
            .collect(),
        palette: Palette::Error,
        unit: "px",
        arrows: Vec::new(),
        contours: false,
    };
    html! {
        h3 { "By position on the sensor" }
        (pattern_in_words(&map.pattern, words.parts))
        div.pair {
            figure {
                (rms.render())
                figcaption { "Root mean square of the residuals in each cell." }
            }
        }
    }
}

fn pattern_in_words(pattern: &ResidualPattern, parts: &str) -> Markup {
    let ResidualPattern { cells, shift, shift_ratio, outward, outward_ratio } = *pattern;
    html! {
        @if cells == 0 {
            p { "No cell of the sensor has enough observations to distinguish a pattern from noise." }
        } @else {
            p {
                "The mean displacements of the cells (map at the top) are " strong { (format!("{shift_ratio:.1} times")) } " as large as from noise alone: 1 is noise, "
                "1.5 and more a pattern. Without the noise they are " (signed(shift, 3)) " px (rms)."
                @if outward_ratio > 0.0 {
                    " The edges of the " (parts) " are displaced inwards or outwards " (format!("{outward_ratio:.1}")) " times as far as from noise alone; without the noise "
                    (signed(outward, 3)) " px. This is an error of the event biases, not of the camera model."
                }
            }
        }
    }
}

/// Width of a bin (px).
const BIN: f64 = 2.0 * BOUND / BIN_COUNT as f64;

/// Returns the share of the events of a class in a bin, per pixel.
fn density(class: &ClassResiduals, bin: usize) -> f64 {
    class.bins.get(bin).map_or(0.0, |&count| count as f64 / class.count.max(1) as f64 / BIN)
}

/// Returns one curve per rank. `highest` is the end of the y axis, the same for both polarities.
fn histogram(ranks: &[ClassResiduals], polarity: &str, highest: f64) -> Chart<'static> {
    let series: Vec<Series> = ranks
        .iter()
        .zip(RANKS)
        .zip(Color::ALL)
        .filter(|((class, _), _)| class.count > 0)
        .map(|((class, rank), color)| {
            let steps = (0..BIN_COUNT).flat_map(|bin| {
                let left = bin as f64 * BIN - BOUND;
                [(left, density(class, bin)), (left + BIN, density(class, bin))]
            });
            Series { name: format!("{rank} event"), color, curves: vec![steps.collect()], points: Vec::new() }
        })
        .collect();
    Chart {
        description: format!("Histogram of the residuals of {polarity} events, one curve per rank in the burst."),
        x_label: "residual (px), outwards positive",
        y_label: "share per px",
        x: -BOUND..BOUND,
        y: 0.0..1.05 * highest,
        series,
    }
}

fn class_table(calibration: &EventCalibration, classes: &[ClassResiduals; CLASS_COUNT]) -> Markup {
    let bias = &calibration.refined.state.bias;
    html! {
        table.short.classes {
            thead { tr {
                th scope="col" { "class" }
                th.number scope="col" { "events" }
                th.number scope="col" { "rms (px)" }
                th.number scope="col" { "mean (px)" }
                th.number scope="col" { "offset (px)" }
                th.number scope="col" { "± σ" }
                th.number scope="col" { "latency (ms)" }
                th.number scope="col" { "± σ" }
            } }
            tbody {
                @for (index, (class, bias)) in classes.iter().zip(bias).enumerate().filter(|(_, (class, _))| class.count > 0) {
                    @let sigma = calibration.quality.bias_sigma.get(index).copied().unwrap_or_default();
                    @let (offset, offset_sigma) = with_sigma(bias.biases[Bias::Offset], sigma[Bias::Offset]);
                    @let (latency, latency_sigma) = with_sigma(1e3 * bias.biases[Bias::Latency], 1e3 * sigma[Bias::Latency]);
                    tr {
                        th scope="row" { (class_name(index)) }
                        td.number { (count(class.count as u64)) }
                        td.number { (signed(class.rms, 3)) }
                        td.number { (signed(class.mean, 3)) }
                        td.number { (offset) }
                        td.number { (offset_sigma) }
                        td.number { (latency) }
                        td.number { (latency_sigma) }
                    }
                }
            }
        }
    }
}

/// Returns the name of an event class.
fn class_name(class: usize) -> String {
    let EventKind { polarity, place } = EventKind::of_class(class);
    let polarity = match polarity {
        Polarity::Off => "OFF",
        Polarity::On => "ON",
    };
    let rank = RANKS.get(usize::from(place.rank)).copied().unwrap_or_default();
    let length = match place.length {
        BurstLength::FiveOrMore => "five or more",
        BurstLength::Four => "four",
        BurstLength::Three => "three",
        BurstLength::OneOrTwo => "one or two",
    };
    format!("{polarity}, {rank} of {length}")
}
