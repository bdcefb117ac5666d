//! The finding on a lens or a board that changed within the recordings.

use crate::quality::drift::{Change, Changed, Drift};
use crate::quality::verdict::board_statement::with_sigma;
use crate::quality::verdict::{Cause, Finding, Severity};
use crate::task::input::Input;

/// A part of the change is named if it is at least this number of standard deviations.
const NAMED: f64 = 4.0;

/// Returns the finding on `drift`. It is a failure if a camera before or after the change is farther than `good` (px) from the result.
pub(in crate::calibrate) fn finding_on(inputs: &[Input], drift: &Drift, good: f64) -> Finding {
    let name = inputs.get(drift.recording).map_or_else(|| "the next recording".to_owned(), |input| name(input, inputs));
    let from = match drift.t {
        Some(t) if inputs.len() > 1 => format!("from {t:.1} s of {name} on"),
        Some(t) => format!("from {t:.1} s on"),
        None => format!("in {name} and later recordings"),
    };
    let from = if drift.t.is_none() && drift.recording + 1 == inputs.len() { format!("in {name}") } else { from };
    let changes = match drift.changed {
        Changed::Lens => of_lens(drift),
        Changed::Board => of_board(drift),
    };
    let (cause, advice) = match (drift.changed, drift.t) {
        (Changed::Lens, Some(_)) => {
            (Cause::LensChanged, "was the lens refocused, or are these two cameras? Calibrate from each part alone")
        }
        (Changed::Lens, None) => (
            Cause::LensChanged,
            "was the lens refocused, or are these two cameras? Calibrate from each recording alone",
        ),
        (Changed::Board, _) => (
            Cause::BoardChanged,
            "was the board mounted again or replaced? Calibrate from recordings of one board alone",
        ),
    };
    Finding {
        cause,
        severity: if drift.distance > good { Severity::Failure } else { Severity::Warning },
        reason: format!("{from} {}", changes.join(" and ")),
        advice: advice.into(),
    }
}

/// Returns the name of `input` without its folders, or with them if another one has the same name.
fn name(input: &Input, inputs: &[Input]) -> String {
    let short = input.short_name();
    if inputs.iter().filter(|other| other.short_name() == short).count() > 1 { input.name() } else { short }
}

/// Describes the changes of the lens; the most significant one if none is certain.
fn of_lens(drift: &Drift) -> Vec<String> {
    let focal_length = drift.focal_length.map(|change| {
        let word = if change.value > 0.0 { "longer" } else { "shorter" };
        let percent = with_sigma(1e2 * change.value.abs(), 1e2 * change.sigma);
        (change, format!("the focal length is {percent} % {word}"))
    });
    let along = |change: Option<Change>, [positive, negative]: [&str; 2]| {
        let change = change?;
        let word = if change.value > 0.0 { positive } else { negative };
        let text = format!("the principal point is {} px further {word}", with_sigma(change.value.abs(), change.sigma));
        Some((change, text))
    };
    let [x, y] = drift.principal_point;
    named([focal_length, along(x, ["right", "left"]), along(y, ["down", "up"])])
}

/// Describes the changes of the board; the most significant one if none is certain.
fn of_board(drift: &Drift) -> Vec<String> {
    let ratio = drift.print_ratio.map(|change| {
        let (longer, shorter) = if change.value > 0.0 { ("x", "y") } else { ("y", "x") };
        let percent = with_sigma(1e2 * change.value.abs(), 1e2 * change.sigma);
        (change, format!("the print is {percent} % longer along {longer}, relative to {shorter}"))
    });
    let bend = |change: Option<Change>, axis: &str| {
        change.map(|change| {
            let side = if change.value > 0.0 { "further from" } else { "nearer to" };
            let bend = with_sigma(1e3 * change.value.abs(), 1e3 * change.sigma);
            (
                change,
                format!("the middle of the board is {bend} mm {side} the camera than before, by a bend along {axis}"),
            )
        })
    };
    let [x, y] = drift.bend;
    named([ratio, bend(x, "x"), bend(y, "y")])
}

fn named(changes: [Option<(Change, String)>; 3]) -> Vec<String> {
    let deviations = |change: &Change| change.value.abs() / change.sigma.max(f64::MIN_POSITIVE);
    let changes: Vec<(Change, String)> = changes.into_iter().flatten().collect();
    let most = changes.iter().map(|(change, _)| deviations(change)).fold(0.0, f64::max);
    let certain = |(change, _): &(Change, String)| deviations(change) >= NAMED.min(most);
    changes.into_iter().filter(certain).map(|(_, text)| text).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drift(changed: Changed) -> Drift {
        Drift {
            changed,
            recording: 0,
            t: Some(3.1),
            significance: 20.0,
            focal_length: None,
            principal_point: [None; 2],
            print_ratio: None,
            bend: [None; 2],
            distance: 0.2,
            step: Vec::new(),
        }
    }

    #[test]
    fn a_change_is_named_with_its_moment_and_size() {
        let change = |value, sigma| Some(Change { value, sigma });
        let lens = Drift {
            focal_length: change(0.005, 2.5e-4),
            principal_point: [change(0.1, 0.2), change(-3.0, 0.25)],
            ..drift(Changed::Lens)
        };
        let finding = finding_on(&[], &lens, 0.1);
        assert_eq!(
            finding.reason,
            "from 3.1 s on the focal length is 0.500 ± 0.025 % longer and the principal point is 3.00 ± 0.25 px further up"
        );
        assert_eq!((finding.cause, finding.severity), (Cause::LensChanged, Severity::Failure));
        assert_eq!(finding_on(&[], &lens, 0.3).severity, Severity::Warning);
        let board = Drift { bend: [change(-6e-3, 2e-4), change(1e-4, 2e-4)], ..drift(Changed::Board) };
        let finding = finding_on(&[], &board, 0.1);
        assert!(finding.reason.contains("6.00 ± 0.20 mm nearer to the camera"), "{}", finding.reason);
        assert!(!finding.reason.contains("along y"), "{}", finding.reason);
        assert_eq!(finding.cause, Cause::BoardChanged);
    }
}
