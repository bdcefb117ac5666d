//! Detection of recordings from another camera.

use super::input::Input;
use crate::advice::Advice;
use crate::circles::reference_frame::ReferenceFrame;
use crate::initial::InitialModel;
use crate::trust::verdict::{Cause, Finding, Severity};

/// Recordings with fewer reference frames are not checked.
const FEWEST: usize = 20;
/// Share of its reference frames that fit below which a recording does not fit the camera.
const FITS: f64 = 0.2;
/// Share of its reference frames that fit above which a recording is of the camera.
const OWN: f64 = 0.5;

/// Number of reference frames of a recording, and of those that fit the first camera.
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

/// Returns a failure for each recording of which hardly a frame fits the first camera, if frames of another recording do.
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
            advice: Advice::Plain(format!(
                "is it of another camera, or was the lens refocused? Calibrate without {name}"
            )),
        })
        .collect()
}

/// Returns the indices of the recordings that do not fit.
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
    fn a_recording_is_of_another_camera_if_another_fits_and_it_does_not() {
        let places = |counts: &[(usize, usize)]| {
            let counts: Vec<Count> = counts.iter().map(|&(found, fitting)| Count { found, fitting }).collect();
            foreign(&counts).into_iter().map(|(place, _)| place).collect::<Vec<_>>()
        };
        assert_eq!(places(&[(400, 390), (300, 5)]), [1]);
        assert_eq!(places(&[(300, 0), (400, 300), (19, 0)]), [0]);
        // All are difficult, or one is short: no other camera is detected.
        for counts in [&[(400, 60), (300, 5)][..], &[(400, 390)], &[(400, 390), (300, 100)]] {
            assert!(places(counts).is_empty(), "{counts:?}");
        }
    }
}
