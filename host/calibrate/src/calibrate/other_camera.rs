//! Recordings that are not of the camera of the others.

use super::input::Input;
use crate::advice::Advice;
use crate::circles::reference_frame::ReferenceFrame;
use crate::initial::InitialModel;
use crate::trust::verdict::{Cause, Finding, Severity};

/// Recordings with fewer reference frames tell too little.
const FEWEST: usize = 20;
/// A recording does not fit the camera when a smaller share of its reference frames does.
const FITS: f64 = 0.2;
/// The camera is that of a recording when a larger share of its reference frames fits.
const OWN: f64 = 0.5;

/// How many reference frames a recording has, and how many of them fit the first camera.
#[derive(Clone, Copy, Debug, Default)]
struct Count {
    found: usize,
    fitting: usize,
}

impl Count {
    fn share(self) -> f64 {
        self.fitting as f64 / self.found.max(1) as f64
    }
}

/// A failure for each recording of which hardly a frame fits the first camera, where the frames of another one do.
pub(super) fn findings_on(inputs: &[Input], frames: &[ReferenceFrame], initial: &InitialModel) -> Vec<Finding> {
    let mut counts = vec![Count::default(); inputs.len()];
    for frame in frames {
        if let Some(count) = counts.get_mut(frame.recording) {
            count.found += 1;
        }
    }
    for frame in initial.frames.iter().filter_map(|posed| frames.get(posed.frame)) {
        if let Some(count) = counts.get_mut(frame.recording) {
            count.fitting += 1;
        }
    }
    foreign(&counts)
        .into_iter()
        .filter_map(|(place, Count { found, fitting })| Some((inputs.get(place)?.short_name(), found, fitting)))
        .map(|(name, found, fitting)| Finding {
            cause: Cause::OtherCamera,
            severity: Severity::Failure,
            reason: format!(
                "only {fitting} of the {found} reference frames of {name} fit the camera of the other recordings"
            ),
            advice: Advice::Plain(format!("is it of another camera, or was the lens turned? Calibrate without {name}")),
        })
        .collect()
}

/// Places of the recordings that do not fit.
fn foreign(counts: &[Count]) -> Vec<(usize, Count)> {
    if !counts.iter().any(|count| count.found >= FEWEST && count.share() > OWN) {
        return Vec::new();
    }
    counts.iter().copied().enumerate().filter(|(_, count)| count.found >= FEWEST && count.share() < FITS).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_is_foreign_when_another_fits_and_it_does_not() {
        let places = |counts: &[(usize, usize)]| {
            let counts: Vec<Count> = counts.iter().map(|&(found, fitting)| Count { found, fitting }).collect();
            foreign(&counts).into_iter().map(|(place, _)| place).collect::<Vec<_>>()
        };
        assert_eq!(places(&[(400, 390), (300, 5)]), [1]);
        assert_eq!(places(&[(300, 0), (400, 300), (19, 0)]), [0]);
        // All are hard, or one is short: no camera is told from another.
        for counts in [&[(400, 60), (300, 5)][..], &[(400, 390)], &[(400, 390), (300, 100)]] {
            assert!(places(counts).is_empty(), "{counts:?}");
        }
    }
}
