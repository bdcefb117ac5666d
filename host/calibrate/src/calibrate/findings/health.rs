//! Findings on light, lens and pixels for the verdict.

use crate::quality::verdict::{Cause, Finding, Severity};
use evcal_detection::detection::focus::EdgeWidth;
use evcal_detection::diagnosis::bad_pixels::BadPixels;
use evcal_detection::diagnosis::disorder::Disorder;
use evcal_detection::diagnosis::double_edges::DoubleEdges;
use evcal_detection::diagnosis::flicker::Flicker;
use evcal_detection::diagnosis::lost_events::LostEvents;
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

/// Returns the findings on all recordings, each kind once: the worst case.
pub(in crate::calibrate) fn findings_on(recordings: &[Health]) -> Vec<Finding> {
    let all = || recordings.iter();
    // Coarse times make equal events of different ones.
    let fine = || all().filter(|health| health.coarse_times.is_none());
    let mut findings: Vec<Finding> = Vec::new();
    findings.extend(worst(all().filter_map(|health| health.flicker), |flicker| flicker.share));
    if all().any(|health| health.always_full) {
        findings.push(always_full());
    }
    findings.extend(worst(fine().filter_map(|health| health.pixels.repeated), |repeated| repeated.share));
    findings.extend(all().find_map(|health| health.double_edges).map(Finding::from));
    findings.extend(all().filter_map(|health| health.lost_events).find(LostEvents::is_certain).map(Finding::from));
    findings.extend(worst(all().filter_map(|health| health.disorder), |disorder| disorder.share));
    findings.extend(all().find_map(|health| health.coarse_times).map(Finding::from));
    findings.extend(all().find_map(|health| health.pixels.rounded).map(Finding::from));
    findings.extend(worst(all().filter_map(|health| health.pixels.hot), |hot| hot.share));
    findings.extend(all().find_map(|health| health.pixels.silent.as_ref()).map(Finding::from));
    let blurred = all().filter_map(|health| health.edges).filter(EdgeWidth::is_blurred);
    findings.extend(worst(blurred, |edges| edges.pixels));
    findings
}

/// Returns the finding on the symptom with the largest `strength`.
fn worst<S: Copy + Into<Finding>>(symptoms: impl Iterator<Item = S>, strength: impl Fn(&S) -> f64) -> Option<Finding> {
    symptoms.max_by(|a, b| strength(a).total_cmp(&strength(b))).map(Into::into)
}

fn always_full() -> Finding {
    Finding::new(
        Cause::Saturated,
        Severity::Failure,
        "the camera sent events at its maximum rate all the time: their times are late by an unknown amount".to_owned(),
        "does the light flicker? Use daylight or a lamp on direct current; or raise the contrast thresholds of its pixels",
    )
}

#[cfg(test)]
mod tests {
    use evcal_detection::diagnosis::bad_pixels::{HotPixels, Repetition};
    use evcal_detection::diagnosis::rounded::Rounded;
    use evcal_detection::diagnosis::silent_lines::SilentLines;

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
        let pixels = BadPixels {
            hot: Some(HotPixels { count: 5, share: 0.3 }),
            silent: Some(dead.clone()),
            ..BadPixels::default()
        };
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
