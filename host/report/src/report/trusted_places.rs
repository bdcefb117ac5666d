//! Uncertainty of the result over the sensor.

use maud::{Markup, html};

use super::chart::{SensorMap, cells_of_grid, round_up};
use super::number::{percent, signed};
use super::page::Section;
use super::palette::Palette;
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::trust::uncertainty::parts::ProjectionParts;

/// Returns the coverage and the uncertainty of the projection.
pub fn section(calibrated: &Calibrated) -> Option<Section> {
    let projection = &calibrated.trust.projection;
    let coverage = &calibrated.trust.coverage;
    let content = html! {
        p {
            "How far the image of a point may be off, if the same camera were calibrated again and again: one standard deviation, σ, is " (signed(projection.rms, 3))
            " px over the sensor (rms). The figure at the top, " (signed(projection.rms_95, 3)) " px, is what 95 of 100 calibrations stay below. Where the board was never seen, no data supports the "
            "result, however small the number: it relies on the lens model alone."
        }
        @if let Some(events) = calibrated.events() { (parts(&events.trust.projection_parts)) }
        div.pair {
            figure {
                (uncertainty(calibrated).render())
                figcaption {
                    "Standard deviation of the projection, far away and with the camera's rotation removed. Grey: not backed by observations."
                }
            }
            figure {
                (seen(calibrated).render())
                figcaption { "Observations in each cell of the sensor; " (percent(coverage.covered)) " of the cells saw enough." }
            }
        }
    };
    Some(Section { id: "trust", title: "Where it can be trusted", content })
}

/// Describes the contributions to σ.
fn parts(parts: &ProjectionParts) -> Markup {
    let ProjectionParts { noise, between_parts, event_model, focal_lengths, misfit } = *parts;
    html! {
        p {
            "σ has several parts, whose squares add up: " (signed(noise, 4)) " px from the noise of single events, " (signed(between_parts, 4))
            " px from what events of one moment share and what changes during the recording, " (signed(event_model, 4))
            " px from what the model of the events does not follow, " (signed(focal_lengths, 4))
            " px from the lower limit set for the σ of the focal lengths, and " (signed(misfit, 4)) " px from what the lens model does not follow."
        }
    }
}

fn uncertainty(calibrated: &Calibrated) -> SensorMap {
    let projection = &calibrated.trust.projection;
    let coverage = &calibrated.trust.coverage;
    let value = |pixel: [f64; 2], sigma: Option<f64>| sigma.filter(|_| coverage.backs(pixel, calibrated.sensor));
    let points: Vec<_> = projection.grid.iter().map(|point| (point.pixel, value(point.pixel, point.sigma))).collect();
    let most = points.iter().filter_map(|point| point.1).fold(0.0, f64::max);
    SensorMap {
        description: format!(
            "Map of the sensor: standard deviation of the projection, up to {most:.3} px where observations back it."
        ),
        sensor: calibrated.sensor,
        cells: cells_of_grid(&points, usize::from(projection.columns), usize::from(projection.rows)),
        range: 0.0..round_up(most),
        palette: Palette::Error,
        unit: "px",
        arrows: Vec::new(),
    }
}

fn seen(calibrated: &Calibrated) -> SensorMap {
    let coverage = &calibrated.trust.coverage;
    let (columns, rows) = (coverage.columns.max(1), coverage.rows.max(1));
    let (width, height) = (f64::from(calibrated.sensor.width), f64::from(calibrated.sensor.height));
    let most = coverage.counts.iter().max().copied().unwrap_or(0);
    let cells = coverage.counts.iter().enumerate().map(|(index, &count)| {
        let at = |step: usize, size: f64, count: usize| size * step as f64 / count as f64 - 0.5;
        let (column, row) = (index % columns, index / columns);
        let place = [
            at(column, width, columns),
            at(row, height, rows),
            at(column + 1, width, columns),
            at(row + 1, height, rows),
        ];
        (place, (count > 0).then_some(count as f64))
    });
    SensorMap {
        description: format!("Map of the sensor: number of observations in each cell, up to {most}."),
        sensor: calibrated.sensor,
        cells: cells.collect(),
        range: 0.0..round_up(most.max(1) as f64),
        palette: Palette::Amount,
        unit: "observations",
        arrows: Vec::new(),
    }
}
