//! The beginning of the page: the verdict, its reasons, and the figures behind it.

use maud::{Markup, html};

use super::number::{count, percent, signed};
use super::page::figure;
use evcal_calibrate::advice::Wording;
use evcal_calibrate::calibrate::Task;
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::calibrate::input::Input;
use evcal_calibrate::result::beside::{VerdictBeside, verdicts_beside};
use evcal_calibrate::solve::residual_statistics::Measured;
use evcal_calibrate::trust::verdict::{Finding, Grade, SMALLEST_COVERAGE, Severity, VerdictSettings};
use evcal_core::sensor::Sensor;

/// Returns the title of the browser window and of the printed page.
pub fn title(calibrated: &Calibrated) -> String {
    let name = calibrated.camera_name().unwrap_or("Camera");
    let date = calibrated.recorded().map_or_else(String::new, |recorded| format!(", {recorded}"));
    format!("{name}{date}: {} calibration", calibrated.camera().kind().name())
}

/// Returns the head of the page.
pub fn head(calibrated: &Calibrated, task: &Task) -> Markup {
    let Sensor { width, height } = calibrated.sensor;
    let verdict = &calibrated.verdict;
    let beside = verdicts_beside(calibrated);
    html! {
        h1 { "Calibration of " (calibrated.camera_name().unwrap_or("a camera")) }
        p.faint {
            "Camera model " (calibrated.camera().kind().name()) " on a sensor of " (width) " × " (height) " pixels, from "
            span.path { (task.inputs.iter().map(Input::name).collect::<Vec<_>>().join(", ")) }
            @if let Some(date) = calibrated.recorded() { ", recorded " (date) }
            "."
        }
        div.verdict.(class(verdict.grade)) {
            p.sentence { @if !beside.is_empty() { "Camera: " } (verdict.sentence) }
            @if let (true, Some(first)) = (verdict.grade != Grade::Good, verdict.findings.first()) {
                p.first { strong { "Do this first: " } ((task.wording)(&first.advice)) "." }
            }
            @if !verdict.findings.is_empty() { (findings(&verdict.findings, task.wording)) }
        }
        @for VerdictBeside { about, grade, sentence } in &beside {
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

fn findings(findings: &[Finding], wording: Wording) -> Markup {
    html! {
        ul.findings {
            @for finding in findings {
                li {
                    strong { (severity(finding.severity)) ": " } (capital(&finding.reason)) ". "
                    em { "What to do: " } (wording(&finding.advice)) "."
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

/// Returns the text with a capital letter at the start, unless it begins with a name such as fx.
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
    let trust = &calibrated.trust;
    let projection = &trust.projection;
    let residuals = calibrated.residuals();
    html! {
        dl.figures {
            (figure("Expected projection error", &format!("{} px", signed(projection.rms_95, 3)), &format!("or less over the sensor, in 95 of 100 cases; good is up to {} px", settings.good)))
            @if let Some((pixel, sigma)) = worst_place(calibrated) {
                (figure("Worst place seen", &format!("{} px", signed(2.0 * sigma, 3)), &format!("or less at pixel ({:.0}, {:.0}), in 95 of 100 cases (2σ)", pixel[0], pixel[1])))
            }
            (figure("Sensor covered", &percent(trust.coverage.covered), &format!("of its cells saw enough; good is from {}", percent(SMALLEST_COVERAGE))))
            @if let Some(halves) = calibrated.events().and_then(|events| events.trust.split_half.as_ref()) {
                (figure(
                    "Two halves differ by",
                    &format!("{} px", signed(halves.difference.rms, 3)),
                    &format!("{}, up to {} px is expected", if halves.consistent() { "as they should" } else { "too much" }, signed(halves.bound, 3)),
                ))
            }
            (figure("Residual", &format!("{} px", signed(residuals.rms, 3)), &format!("rms {}", typical_residual(calibrated.measured()))))
            (figure("Observations", &count(residuals.count as u64), &format!("worth {} independent ones", count(trust.uncertainty.effective_observations() as u64))))
        }
    }
}

/// Returns typical residuals, those of the simulated sessions in docs/accuracy.md.
fn typical_residual(measured: Measured) -> &'static str {
    match measured {
        Measured::EventEdges => "over single events; 0.1 to 0.3 px is usual",
        Measured::CircleCentres => "over circle centres; below 0.3 px is usual",
        Measured::Corners => "over corners; below 0.3 px is usual",
    }
}

/// Returns the pixel with the most uncertain projection, of those with observations, and σ there.
fn worst_place(calibrated: &Calibrated) -> Option<([f64; 2], f64)> {
    let grid = calibrated.trust.projection.grid.iter();
    let backed = grid.filter(|point| calibrated.trust.coverage.backs(point.pixel, calibrated.sensor));
    backed.filter_map(|point| Some((point.pixel, point.sigma?))).max_by(|a, b| a.1.total_cmp(&b.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentences_begin_with_a_capital_letter_but_names_stay() {
        assert_eq!(capital("the board was far"), "The board was far");
        assert_eq!(capital("fx and fy differ"), "fx and fy differ");
        assert_eq!(capital("p1, k3 cannot be told"), "p1, k3 cannot be told");
        assert_eq!(capital("in corners"), "In corners");
        assert_eq!(capital("a pattern is left"), "A pattern is left");
        assert_eq!(capital(""), "");
    }
}
