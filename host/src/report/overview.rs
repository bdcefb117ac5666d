//! What the page begins with: the verdict, its reasons, and the figures behind it.

use maud::{Markup, html};

use super::number::{count, percent, signed};
use super::page::figure;
use crate::calibrate::Task;
use crate::calibrate::calibrated::Calibrated;
use crate::calibrate::input::Input;
use crate::trust::verdict::{Finding, Grade, Severity};
use evcal_core::sensor::Sensor;

/// What a browser's window and a printed page are called.
pub fn title(calibrated: &Calibrated) -> String {
    let name = calibrated.camera_name().unwrap_or("Camera");
    let date = calibrated.recorded().map_or_else(String::new, |recorded| format!(", {recorded}"));
    format!("{name}{date}: {} calibration", calibrated.camera().kind().name())
}

/// The head of the page.
pub fn head(calibrated: &Calibrated, task: &Task) -> Markup {
    let Sensor { width, height } = calibrated.sensor;
    let verdict = &calibrated.verdict;
    let class = match verdict.grade {
        Grade::Good => "good",
        Grade::Usable => "usable",
        Grade::NotGood => "not-good",
    };
    html! {
        h1 { "Calibration of " (calibrated.camera_name().unwrap_or("a camera")) }
        p.faint {
            "Camera model " (calibrated.camera().kind().name()) " on a sensor of " (width) " × " (height) " pixels. Recorded "
            @if let Some(date) = calibrated.recorded() { (date) " in " } @else { "in " }
            (task.inputs.iter().map(Input::name).collect::<Vec<_>>().join(", ")) "."
        }
        div.verdict.(class) {
            p.sentence { (verdict.sentence) }
            @if !verdict.findings.is_empty() { (findings(&verdict.findings)) }
        }
        (figures(calibrated))
    }
}

fn findings(findings: &[Finding]) -> Markup {
    html! {
        ul.findings {
            @for finding in findings {
                li {
                    strong { (severity(finding.severity)) ": " } (capital(&finding.reason)) ". "
                    em { "What to do: " } (finding.advice) "."
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

/// The text with a capital letter in front, unless it begins with a name such as fx.
pub fn capital(text: &str) -> String {
    let first = text.split([' ', ',']).next().unwrap_or_default();
    let name = first.len() == 2 && (first.starts_with('f') || first.ends_with(|last: char| last.is_ascii_digit()));
    let mut letters = text.chars();
    match letters.next() {
        Some(first) if !name => first.to_uppercase().chain(letters).collect(),
        _ => text.to_owned(),
    }
}

fn figures(calibrated: &Calibrated) -> Markup {
    let trust = &calibrated.trust;
    let projection = &trust.projection;
    let residuals = calibrated.residuals();
    html! {
        dl.figures {
            (figure("Projection known to", &format!("{} px", signed(projection.rms_95, 3)), "over the sensor, with 95 % confidence"))
            (figure("Worst place", &format!("{} px", signed(projection.max, 3)), &format!("σ at pixel ({:.0}, {:.0})", projection.max_at[0], projection.max_at[1])))
            (figure("Sensor covered", &percent(trust.coverage.covered), "of its cells saw enough"))
            @if let Some(halves) = calibrated.events().and_then(|events| events.trust.split_half.as_ref()) {
                (figure(
                    "Two halves differ by",
                    &format!("{} px", signed(halves.difference.rms, 3)),
                    &format!("{}, up to {} px is expected", if halves.consistent() { "as they should" } else { "too much" }, signed(halves.bound, 3)),
                ))
            }
            (figure("Residual", &format!("{} px", signed(residuals.rms, 3)), "rms distance from the model"))
            (figure("Observations", &count(residuals.count as u64), &format!("worth {} independent ones", count(trust.uncertainty.effective_observations() as u64))))
        }
    }
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
