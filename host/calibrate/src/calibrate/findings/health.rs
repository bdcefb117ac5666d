//! Findings on light, lens and pixels for the verdict.

use crate::check::silent::silent_advice;
use crate::quality::verdict::{Cause, Finding, Severity};
use evcal_detection::detection::focus::EdgeWidth;
use evcal_detection::diagnosis::bad_pixels::{BadPixels, Repetition};
use evcal_detection::diagnosis::disorder::Disorder;
use evcal_detection::diagnosis::double_edges::DoubleEdges;
use evcal_detection::diagnosis::flicker::Flicker;
use evcal_detection::diagnosis::lost_events::LostEvents;
use evcal_detection::diagnosis::rounded::Rounded;
use evcal_detection::diagnosis::silent_lines::SilentLines;
use evcal_detection::diagnosis::time_steps::CoarseTimes;

/// Quality of a recording.
#[derive(Clone, Debug, Default)]
pub(in crate::calibrate) struct Health {
    pub(in crate::calibrate) flicker: Option<Flicker>,
    /// `true` if the event rate is constant over the whole recording.
    pub(in crate::calibrate) always_full: bool,
    pub(in crate::calibrate) pixels: BadPixels,
    pub(in crate::calibrate) double_edges: Option<DoubleEdges>,
    pub(in crate::calibrate) lost_events: Option<LostEvents>,
    pub(in crate::calibrate) disorder: Option<Disorder>,
    pub(in crate::calibrate) coarse_times: Option<CoarseTimes>,
    /// Width of the sharpest circles' edges.
    pub(in crate::calibrate) edges: Option<EdgeWidth>,
}

/// Flicker with a larger share of events in alternating bursts of ON and OFF is a warning, because areas without edges
/// then send so many events that the readout saturates.
const STRONG_FLICKER: f64 = 0.75;
/// Hot pixels are reported if they send more than this share of the events.
const MANY_HOT: f64 = 0.02;

/// Returns the findings on all recordings, each kind once: the worst case.
pub(in crate::calibrate) fn findings_on(recordings: &[Health]) -> Vec<Finding> {
    let flicker = recordings.iter().filter_map(|health| health.flicker).max_by(|a, b| a.share.total_cmp(&b.share));
    let hottest = recordings.iter().map(|health| &health.pixels).max_by(|a, b| a.hot_share.total_cmp(&b.hot_share));
    // Coarse times make equal events of different ones.
    let fine = recordings.iter().filter(|health| health.coarse_times.is_none());
    let repeated = fine.filter_map(|health| health.pixels.repeated);
    let most_repeated = repeated.max_by(|a, b| a.share.total_cmp(&b.share));
    let widths = recordings.iter().filter_map(|health| health.edges);
    let widest = widths.max_by(|a, b| a.pixels.total_cmp(&b.pixels));
    let mut findings = Vec::from_iter(flicker.map(flickering));
    if recordings.iter().any(|health| health.always_full) {
        findings.push(always_full());
    }
    findings.extend(most_repeated.map(repeating));
    findings.extend(recordings.iter().find_map(|health| health.double_edges).map(doubled));
    findings.extend(recordings.iter().filter_map(|health| health.lost_events).find(LostEvents::is_certain).map(lost));
    let disorders = recordings.iter().filter_map(|health| health.disorder);
    findings.extend(disorders.max_by(|a, b| a.share.total_cmp(&b.share)).map(out_of_order));
    findings.extend(recordings.iter().find_map(|health| health.coarse_times).map(too_coarse));
    findings.extend(recordings.iter().find_map(|health| health.pixels.rounded).map(already_undistorted));
    findings.extend(hottest.and_then(hot));
    findings.extend(recordings.iter().find_map(|health| health.pixels.silent.as_ref()).map(silent));
    findings.extend(widest.and_then(out_of_focus));
    findings
}

fn flickering(Flicker { frequency, share, fills_readout }: Flicker) -> Finding {
    let advice = "use daylight or a lamp on direct current".into();
    if fills_readout {
        let reason = format!(
            "the light flickers at {frequency} Hz or more and makes more events than the camera can send: their times are late"
        );
        return Finding { cause: Cause::Flicker, severity: Severity::Failure, reason, advice };
    }
    Finding {
        cause: Cause::Flicker,
        severity: if share > STRONG_FLICKER { Severity::Warning } else { Severity::Note },
        reason: format!(
            "the light flickers at {frequency} Hz, and the event rate varies with it by {:.0} %",
            100.0 * share
        ),
        advice,
    }
}

fn always_full() -> Finding {
    Finding {
        cause: Cause::Saturated,
        severity: Severity::Failure,
        reason: "the camera sent events at its maximum rate all the time: their times are late by an unknown amount".to_owned(),
        advice: "does the light flicker? Use daylight or a lamp on direct current; or raise the contrast thresholds of its pixels".into(),
    }
}

fn doubled(edges: DoubleEdges) -> Finding {
    Finding {
        // A camera between two cameras fits none of them.
        cause: Cause::DoubleEdges,
        severity: Severity::Failure,
        reason: edges.to_string(),
        advice: DoubleEdges::ADVICE.into(),
    }
}

fn lost(lost: LostEvents) -> Finding {
    Finding {
        // The uncertainty includes what they change.
        cause: Cause::LostEvents,
        severity: Severity::Warning,
        reason: lost.to_string(),
        advice: LostEvents::ADVICE.into(),
    }
}

fn out_of_order(disorder: Disorder) -> Finding {
    Finding {
        cause: Cause::OutOfOrder,
        severity: Severity::Warning,
        reason: disorder.to_string(),
        advice: Disorder::ADVICE.into(),
    }
}

fn already_undistorted(rounded: Rounded) -> Finding {
    Finding {
        // Remaining distortion does not come from the lens.
        cause: Cause::Undistorted,
        severity: Severity::Failure,
        reason: rounded.to_string(),
        advice: Rounded::ADVICE.into(),
    }
}

fn too_coarse(times: CoarseTimes) -> Finding {
    Finding {
        cause: Cause::CoarseTimes,
        severity: Severity::Warning,
        reason: times.to_string(),
        advice: CoarseTimes::ADVICE.into(),
    }
}

fn repeating(repeated: Repetition) -> Finding {
    Finding {
        // The same evidence counted twice makes σ too small.
        cause: Cause::RepeatedEvents,
        severity: Severity::Warning,
        reason: repeated.to_string(),
        advice: Repetition::ADVICE.into(),
    }
}

fn hot(pixels: &BadPixels) -> Option<Finding> {
    (pixels.hot_share > MANY_HOT).then(|| Finding {
        cause: Cause::HotPixels,
        severity: Severity::Note,
        reason: format!("{} hot pixels send {:.0} % of all events", pixels.hot, 100.0 * pixels.hot_share),
        advice: "raise the contrast thresholds of the camera's pixels".into(),
    })
}

/// A silent area of at least this share of the sensor is a warning.
const LARGE_AREA: f64 = 0.2;

fn silent(lines: &SilentLines) -> Finding {
    let is_large = lines.silent_area() >= LARGE_AREA;
    let (cause, severity) = match lines {
        SilentLines::SmallerSensor { .. } => (Cause::OtherSensorSize, Severity::Failure),
        SilentLines::Scaled { .. } => (Cause::Scaled, Severity::Failure),
        // A single silent line may be broken.
        SilentLines::CountedFromOne { columns, rows } => {
            (Cause::CountedFromOne, if *columns && *rows { Severity::Failure } else { Severity::Warning })
        }
        SilentLines::Region { .. } | SilentLines::Corner { .. } if is_large => (Cause::SilentArea, Severity::Warning),
        SilentLines::Region { .. } | SilentLines::Corner { .. } => (Cause::SilentArea, Severity::Note),
        SilentLines::Lines { columns, .. } if columns.is_empty() => (Cause::DeadRows, Severity::Note),
        SilentLines::Lines { .. } => (Cause::DeadColumns, Severity::Note),
    };
    Finding { cause, severity, reason: lines.to_string(), advice: silent_advice(lines) }
}

fn out_of_focus(edges: EdgeWidth) -> Option<Finding> {
    edges.is_blurred().then(|| Finding {
        cause: Cause::Defocused,
        severity: Severity::Warning,
        reason: format!("the circles' edges are blurred over {:.1} px", edges.pixels),
        advice: "focus the lens on the distance of the board, and clean it".into(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn causes(recordings: &[Health]) -> Vec<(Cause, Severity)> {
        findings_on(recordings).iter().map(|finding| (finding.cause, finding.severity)).collect()
    }

    #[test]
    fn the_worst_of_all_recordings_is_reported_once() {
        let calm = Health { edges: Some(EdgeWidth { pixels: 1.0, radii: 0.3 }), ..Health::default() };
        assert_eq!(causes(&[]), []);
        assert_eq!(causes(&[calm.clone(), calm.clone()]), []);
        let flickers = |share: f64| Health {
            flicker: Some(Flicker { frequency: 100.0, share, fills_readout: share > 0.95 }),
            ..calm.clone()
        };
        assert_eq!(causes(&[flickers(0.1), calm.clone()]), [(Cause::Flicker, Severity::Note)]);
        assert_eq!(causes(&[flickers(0.1), flickers(0.9)]), [(Cause::Flicker, Severity::Warning)]);
        assert_eq!(causes(&[flickers(1.0)]), [(Cause::Flicker, Severity::Failure)]);
        let full = Health { always_full: true, ..calm.clone() };
        assert_eq!(causes(&[full]), [(Cause::Saturated, Severity::Failure)]);
        let dead = SilentLines::Lines { columns: vec![7], rows: Vec::new() };
        let pixels = BadPixels { hot: 5, hot_share: 0.3, silent: Some(dead.clone()), ..BadPixels::default() };
        let bad = Health { pixels, edges: Some(EdgeWidth { pixels: 4.0, radii: 0.3 }), ..calm };
        let found = causes(&[bad.clone(), bad]);
        assert_eq!(
            found.iter().map(|(cause, _)| *cause).collect::<Vec<_>>(),
            [Cause::HotPixels, Cause::DeadColumns, Cause::Defocused]
        );
        let twice = |share: f64| Health {
            pixels: BadPixels { repeated: Some(Repetition { share }), ..BadPixels::default() },
            ..Health::default()
        };
        assert_eq!(causes(&[twice(0.1), twice(0.5), Health::default()]), [(Cause::RepeatedEvents, Severity::Warning)]);
        let doubled = Health { double_edges: Some(DoubleEdges { percent: 5.0 }), ..Health::default() };
        assert_eq!(causes(&[Health::default(), doubled]), [(Cause::DoubleEdges, Severity::Failure)]);
        let disorder = Disorder { share: 0.9, largest: 30_000 };
        let disordered = Health { disorder: Some(disorder), ..Health::default() };
        assert_eq!(causes(&[Health::default(), disordered]), [(Cause::OutOfOrder, Severity::Warning)]);
        let pixels = BadPixels { rounded: Some(Rounded { empty: 0.1 }), ..BadPixels::default() };
        let rounded = Health { pixels, ..Health::default() };
        assert_eq!(causes(&[rounded, Health::default()]), [(Cause::Undistorted, Severity::Failure)]);
        let coarse_times = Some(CoarseTimes::Steps { step_ms: 1.0, events: 650.0 });
        // They are the cause of repeated events.
        let coarse = Health { coarse_times, ..twice(0.4) };
        assert_eq!(causes(&[Health::default(), coarse]), [(Cause::CoarseTimes, Severity::Warning)]);
        assert!(findings_on(&[twice(0.1), twice(0.5)]).iter().all(|finding| finding.reason.starts_with("50 %")));
    }
}
