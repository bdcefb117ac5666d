//! The uncertainty of the projection over the sensor.

use maud::{Markup, html};

use super::chart::{Cell, SensorMap, cells_of_grid};
use super::number::{percent, signed};
use super::page::Section;
use super::palette::Palette;
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::quality::uncertainty::parts::ProjectionParts;
use evcal_geometry::lens::projection_difference::ProjectionDifference;

/// Returns the uncertainty of the projection in words.
pub fn section(calibrated: &Calibrated) -> Option<Section> {
    let projection = &calibrated.quality.projection;
    let content = html! {
        p {
            "If the same camera were calibrated many times, the image of a distant point would vary by " (signed(projection.rms, 3))
            " px: one standard deviation (σ), rms over the sensor. In 95 of 100 calibrations the rms error is below the figure at the top. In regions without observations (grey in the map at the top) the result depends on the lens model alone, and may "
            "be wrong by more than σ."
        }
        @if let Some(events) = calibrated.events() { (parts(&events.quality.projection_parts)) }
    };
    Some(Section { id: "trust", title: "Uncertainty of the projection", folded: false, content })
}

/// Returns the map of the uncertainty.
pub fn uncertainty_map(calibrated: &Calibrated) -> Markup {
    html! {
        figure {
            (uncertainty(calibrated).render())
            figcaption {
                "Error of the projection of distant points that 95 of 100 calibrations do not exceed (2σ), with the rotation of the camera removed. Grey: no "
                "observations support the result."
            }
        }
    }
}

/// Returns the map of the observations.
pub fn observation_map(calibrated: &Calibrated) -> Markup {
    html! {
        figure {
            (seen(calibrated).render())
            figcaption { "Observations per cell of the sensor; " (percent(calibrated.quality.coverage.covered)) " of the cells have enough." }
        }
    }
}

/// Returns the contributions to σ.
fn parts(parts: &ProjectionParts) -> Markup {
    let ProjectionParts { noise, between_parts, event_model, focal_lengths, misfit } = *parts;
    html! {
        p {
            "σ² is the sum of the squares of: " (signed(noise, 4)) " px (noise of single events), " (signed(between_parts, 4))
            " px (errors that events of one moment share, and changes during the recording), " (signed(event_model, 4))
            " px (errors of the event model), " (signed(focal_lengths, 4)) " px (lower limit for σ of the focal lengths), " (signed(misfit, 4))
            " px (errors of the lens model)."
        }
    }
}

/// Returns a map of the sizes of the differences on the sensor as cells, and the largest of them (px). Cells have no
/// value if no observations support the calibration there.
pub fn difference_cells(calibrated: &Calibrated, difference: &ProjectionDifference) -> (Vec<Cell>, f64) {
    let coverage = &calibrated.quality.coverage;
    let size = |pixel, difference: Option<[f64; 2]>| {
        difference.filter(|_| coverage.has_observations_near(pixel, calibrated.sensor)).map(|[x, y]| x.hypot(y))
    };
    let points: Vec<_> =
        difference.grid.iter().map(|point| (point.pixel, size(point.pixel, point.difference))).collect();
    let largest = points.iter().filter_map(|point| point.1).fold(0.0, f64::max);
    (cells_of_grid(&points, usize::from(difference.columns), usize::from(difference.rows)), largest)
}

fn uncertainty(calibrated: &Calibrated) -> SensorMap {
    let projection = &calibrated.quality.projection;
    let coverage = &calibrated.quality.coverage;
    let value = |pixel: [f64; 2], sigma: Option<f64>| {
        sigma.filter(|_| coverage.has_observations_near(pixel, calibrated.sensor)).map(|sigma| 2.0 * sigma)
    };
    let points: Vec<_> = projection.grid.iter().map(|point| (point.pixel, value(point.pixel, point.sigma))).collect();
    let most = points.iter().filter_map(|point| point.1).fold(0.0, f64::max);
    SensorMap {
        description: format!(
            "Map of the sensor: error of the projection with 95 % confidence, up to {most:.3} px in regions with observations."
        ),
        sensor: calibrated.sensor,
        cells: cells_of_grid(&points, usize::from(projection.columns), usize::from(projection.rows)),
        palette: Palette::Error,
        unit: "px",
        arrows: Vec::new(),
        contours: true,
    }
}

fn seen(calibrated: &Calibrated) -> SensorMap {
    let coverage = &calibrated.quality.coverage;
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
        palette: Palette::Amount,
        unit: "observations",
        arrows: Vec::new(),
        contours: false,
    }
}
