//! The top of the page: the verdict, its reasons, and the main figures.

use maud::{Markup, html};

use super::number::{count, percent, signed};
use super::page::figure;
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::quality::verdict::{Finding, Grade, SMALLEST_COVERAGE, Severity, VerdictSettings};
use evcal_calibrate::result::device_verdicts::{DeviceVerdict, device_verdicts};
use evcal_calibrate::task::Task;
use evcal_calibrate::task::input::Input;
use evcal_core::sensor::Sensor;
use evcal_files::remedy::Words;
use evcal_solve::solve::residual_statistics::Measured;

/// Returns the title of the page.
pub fn title(calibrated: &Calibrated) -> String {
    let name = calibrated.camera_name().unwrap_or("Camera");
    let date = calibrated.recorded().map_or_else(String::new, |recorded| format!(", {recorded}"));
    format!("{name}{date}: {} calibration", calibrated.camera().kind().name())
}

/// Returns the top of the page.
pub fn head(calibrated: &Calibrated, task: &Task) -> Markup {
    let Sensor { width, height } = calibrated.sensor;
    let verdict = &calibrated.verdict;
    let others = device_verdicts(calibrated);
    html! {
        h1 { "Calibration of " (calibrated.camera_name().unwrap_or("a camera")) }
        p.faint {
            "Camera model " (calibrated.camera().kind().name()) ", " (width) " × " (height) " pixels, from "
            span.path { (task.inputs.iter().map(Input::name).collect::<Vec<_>>().join(", ")) }
            @if let Some(date) = calibrated.recorded() { ", recorded on " (date) }
            "."
        }
        div.verdict.(class(verdict.grade)) {
            p.sentence { @if !others.is_empty() { "Camera: " } (verdict.sentence) }
            @if let (true, Some(first)) = (verdict.grade != Grade::Good, verdict.findings.first()) {
                p.first { strong { "Do this first: " } (first.advice.worded(task.words)) "." }
            }
            @if !verdict.findings.is_empty() { (findings(&verdict.findings, task.words)) }
        }
        @for DeviceVerdict { about, grade, sentence } in &others {
            div.verdict.(class(*grade)) { p.sentence { (about) ": " (sentence) } }
        }
        (figures(calibrated, &task.settings.verdict))
    }
}

fn class(grade: Grade) -> &'static str {
    match grade {
        Grade::Good => "good",
        Grade::Usable => "usable",
        Grade::NotGood => "not-good",
    }
}

fn findings(findings: &[Finding], say: &Words) -> Markup {
    html! {
        ul.findings {
            @for finding in findings {
                li {
                    strong { (severity(finding.severity)) ": " } (capital(&finding.reason)) ". "
                    em { "What to do: " } (finding.advice.worded(say)) "."
                }
            }
        }
    }
}

fn severity(severity: Severity) -> &'static str {
    match severity {
        Severity::Note => "Note",
        Severity::Warning => "Warning",
        Severity::Failure => "Failure",
    }
}

/// Capitalises the first letter, unless the text begins with the name of a parameter such as fx.
pub fn capital(text: &str) -> String {
    let first = text.split([' ', ',']).next().unwrap_or_default();
    let name = first.len() == 2 && (first.starts_with('f') || first.ends_with(|last: char| last.is_ascii_digit()));
    let mut letters = text.chars();
    match letters.next() {
        Some(first) if !name => first.to_uppercase().chain(letters).collect(),
        _ => text.to_owned(),
    }
}

fn figures(calibrated: &Calibrated, settings: &VerdictSettings) -> Markup {
    let quality = &calibrated.quality;
    let projection = &quality.projection;
    let residuals = calibrated.residuals();
    html! {
        dl.figures {
            (figure("Expected projection error", &format!("{} px", signed(projection.rms_95, 3)), &format!("or less over the sensor (rms), in 95 of 100 cases; good: up to {} px", settings.good)))
            @if let Some((pixel, sigma)) = largest_uncertainty(calibrated) {
                (figure("Largest projection error", &format!("{} px", signed(2.0 * sigma, 3)), &format!("or less where the board was seen: at pixel ({:.0}, {:.0}), in 95 of 100 cases (2σ)", pixel[0], pixel[1])))
            }
            (figure("Sensor covered", &percent(quality.coverage.covered), &format!("of its cells have enough observations; good: {} or more", percent(SMALLEST_COVERAGE))))
            @if let Some(halves) = calibrated.events().and_then(|events| events.quality.split_half.as_ref()) {
                (figure(
                    "Two halves differ by",
                    &format!("{} px", signed(halves.difference.rms, 3)),
                    &format!("{}; expected: up to {} px", if halves.consistent() { "consistent" } else { "too much" }, signed(halves.bound, 3)),
                ))
            }
            (figure("Residual", &format!("{} px", signed(residuals.rms, 3)), &format!("rms {}", typical_residual(calibrated.measured()))))
            (figure("Observations", &count(residuals.count as u64), &format!("worth {} independent ones", count(quality.uncertainty.effective_observations() as u64))))
        }
    }
}

/// Returns typical residuals; the values are from the simulated recordings of docs/accuracy.md.
fn typical_residual(measured: Measured) -> &'static str {
    match measured {
        Measured::EventEdges => "of single events; typical: 0.1 to 0.3 px",
        Measured::CircleCentres => "of circle centres; typical: below 0.3 px",
        Measured::Corners => "of corners; typical: below 0.3 px",
    }
}

/// Returns the pixel with the largest σ of the projection among those with observations, and that σ (px).
fn largest_uncertainty(calibrated: &Calibrated) -> Option<([f64; 2], f64)> {
    let grid = calibrated.quality.projection.grid.iter();
    let supported =
        grid.filter(|point| calibrated.quality.coverage.has_observations_near(point.pixel, calibrated.sensor));
    supported.filter_map(|point| Some((point.pixel, point.sigma?))).max_by(|a, b| a.1.total_cmp(&b.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentences_are_capitalised_but_names_of_parameters_are_not() {
        assert_eq!(capital("the board was far"), "The board was far");
        assert_eq!(capital("fx and fy differ"), "fx and fy differ");
        assert_eq!(capital("p1, k3 are uncertain"), "p1, k3 are uncertain");
        assert_eq!(capital("in corners"), "In corners");
        assert_eq!(capital("a pattern is left"), "A pattern is left");
        assert_eq!(capital(""), "");
    }
}
