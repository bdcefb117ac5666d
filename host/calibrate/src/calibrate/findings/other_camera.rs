//! Detection of recordings, and of parts of recordings, from another camera.

use std::collections::BTreeMap;

use crate::advice::Advice;
use crate::quality::verdict::{Cause, Finding, Severity};
use crate::task::input::Input;
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_solve::initial::InitialModel;

/// Recordings with fewer reference frames are not checked.
const FEWEST: usize = 20;
/// A recording does not fit the camera if less than this share of its reference frames fits.
const FITS: f64 = 0.2;
/// A recording is of the camera if more than this share of its reference frames fits.
const OWN: f64 = 0.5;
/// Shortest part of a recording that is checked, in whole seconds.
const SHORTEST: usize = 2;

/// Counts of the reference frames of a recording (`found`) and of those among them that fit the first camera
/// (`fitting`).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Count {
    found: usize,
    fitting: usize,
}

impl Count {
    fn share(self) -> f64 {
        self.fitting as f64 / self.found.max(1) as f64
    }
}

/// A part of a recording from the second `start` up to the second `end`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Part {
    start: usize,
    end: usize,
    count: Count,
}

/// Returns a failure for each recording or part of a recording in which hardly any frame fits the first camera, while
/// frames of another recording, or of the rest of this one, do.
pub(in crate::calibrate) fn findings_on(
    inputs: &[Input],
    frames: &[ReferenceFrame],
    initial: &InitialModel,
) -> Vec<Finding> {
    // The counts of each second of each recording.
    let mut seconds: Vec<BTreeMap<usize, Count>> = vec![BTreeMap::new(); inputs.len()];
    let mut count = |frame: &ReferenceFrame, fits: bool| {
        if let Some(seconds) = seconds.get_mut(frame.recording) {
            let count = seconds.entry(frame.start.max(0.0) as usize).or_default();
            count.found += usize::from(!fits);
            count.fitting += usize::from(fits);
        }
    };
    frames.iter().for_each(|frame| count(frame, false));
    initial.frames.iter().filter_map(|posed| frames.get(posed.frame)).for_each(|frame| count(frame, true));
    let counts: Vec<Count> = seconds.iter().map(|seconds| sum(seconds.values())).collect();
    let foreign = foreign(&counts);
    let whole = foreign
        .iter()
        .filter_map(|(place, count)| Some((inputs.get(*place)?.short_name(), count)))
        .map(|(name, count)| finding(&name, count, "the other recordings", &format!("Calibrate without {name}")));
    let parts = seconds.iter().enumerate().filter(|(place, _)| foreign.iter().all(|(other, _)| other != place));
    let parts = parts.filter_map(|(place, seconds)| Some((inputs.get(place)?.short_name(), foreign_part(seconds)?)));
    let parts = parts.map(|(name, Part { start, end, count })| {
        finding(&format!("{name} from {start} s to {end} s"), &count, "the rest", "Calibrate without this part")
    });
    whole.chain(parts).collect()
}

fn finding(name: &str, Count { found, fitting }: &Count, others: &str, remedy: &str) -> Finding {
    Finding {
        cause: Cause::OtherCamera,
        severity: Severity::Failure,
        reason: format!("only {fitting} of the {found} reference frames of {name} fit the camera of {others}"),
        advice: Advice::Plain(format!("is it of another camera, or was the lens refocused? {remedy}")),
    }
}

fn sum<'a>(counts: impl IntoIterator<Item = &'a Count>) -> Count {
    counts.into_iter().fold(Count::default(), |sum, count| Count {
        found: sum.found + count.found,
        fitting: sum.fitting + count.fitting,
    })
}

/// Returns the longest part of a recording that does not fit, if the rest does. `seconds` are the seconds with reference frames.
fn foreign_part(seconds: &BTreeMap<usize, Count>) -> Option<Part> {
    let fits = |count: &Count| count.share() >= FITS;
    let seconds: Vec<(usize, Count)> = seconds.iter().map(|(second, count)| (*second, *count)).collect();
    let own = sum(seconds.iter().map(|(_, count)| count).filter(|count| fits(count)));
    let part = |run: &[(usize, Count)]| {
        let ((start, _), (last, _)) = (run.first()?, run.last()?);
        Some(Part { start: *start, end: last + 1, count: sum(run.iter().map(|(_, count)| count)) })
    };
    let runs = seconds.chunk_by(|(_, a), (_, b)| fits(a) == fits(b));
    let unfit = runs.filter(|run| run.len() >= SHORTEST && run.iter().all(|(_, count)| !fits(count))).filter_map(part);
    let longest = unfit.filter(|part| part.count.found >= SHORTEST * FEWEST).max_by_key(|part| part.count.found);
    longest.filter(|_| own.found >= FEWEST && own.share() > OWN)
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
    fn a_recording_is_of_another_camera_if_only_other_recordings_fit() {
        let places = |counts: &[(usize, usize)]| {
            let counts: Vec<Count> = counts.iter().map(|&(found, fitting)| Count { found, fitting }).collect();
            foreign(&counts).into_iter().map(|(place, _)| place).collect::<Vec<_>>()
        };
        assert_eq!(places(&[(400, 390), (300, 5)]), [1]);
        assert_eq!(places(&[(300, 0), (400, 300), (19, 0)]), [0]);
        // No other camera is detected if all recordings fit poorly, if there is only one, or if a recording fits
        // partly.
        for counts in [&[(400, 60), (300, 5)][..], &[(400, 390)], &[(400, 390), (300, 100)]] {
            assert!(places(counts).is_empty(), "{counts:?}");
        }
    }

    #[test]
    fn a_part_is_of_another_camera_if_only_the_rest_of_the_recording_fits() {
        let part = |counts: &[(usize, usize)]| {
            let seconds = counts.iter().map(|&(found, fitting)| Count { found, fitting }).enumerate();
            foreign_part(&seconds.collect()).map(|part| (part.start, part.end))
        };
        assert_eq!(part(&[(100, 2), (90, 0), (100, 95), (100, 99)]), Some((0, 2)));
        assert_eq!(part(&[(100, 95), (90, 0), (100, 3), (100, 99)]), Some((1, 3)));
        // No other camera is detected if only one second does not fit, if these seconds have few frames, or if the rest
        // fits poorly.
        assert_eq!(part(&[(100, 95), (90, 0), (100, 99)]), None);
        assert_eq!(part(&[(100, 95), (10, 0), (10, 0), (100, 99)]), None);
        assert_eq!(part(&[(100, 30), (90, 0), (100, 3), (100, 35)]), None);
        assert_eq!(part(&[]), None);
    }
}
