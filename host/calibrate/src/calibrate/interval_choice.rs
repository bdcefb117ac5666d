//! Choice of the seconds of long recordings for the joint solve.
//!
//! The joint solve is limited to a number of seconds with the board. A longer recording is divided into that number of
//! parts. In each part the second is chosen that adds most information about the camera to the seconds chosen in the
//! other parts. The seconds are therefore spread over the whole recording, so that slow drifts are detected. The
//! information of a second is computed from its windows with a provisional camera. It depends on the board's position
//! on the sensor, distance and tilt, and on the number of windows, which is small if the board hardly moves.

use std::collections::BTreeSet;
use std::fmt;
use std::ops::Range;

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::task::Task;
use evcal_detection::circles::compact_frame::CompactFrame;
use evcal_detection::circles::reference_frame::ObservedCircle;
use evcal_geometry::board::Board;
use evcal_solve::initial::information::{Information, ProjectionMeasure, prior, view_information};
use evcal_solve::initial::model_choice::ModelRequest;
use evcal_solve::initial::provisional::{provisional_camera, provisional_pose};

/// Largest number of windows from which the provisional camera is computed.
const VIEWS: usize = 400;
/// Number of windows per second that are evaluated.
const WINDOWS_OF_SECOND: usize = 8;
/// Number of passes over the parts; in each, every part chooses its second again, given the choices of the others.
const SWEEPS: usize = 2;
/// Models of the provisional camera if no model is requested.
const LIKELY: [ModelKind; 2] = [ModelKind::Radtan, ModelKind::KannalaBrandt];

/// A second of a recording in the joint solve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChosenSecond {
    /// Number of the recording.
    pub recording: usize,
    /// Its start in seconds since the start of the recording.
    pub start: f64,
    /// Relative increase of the projection's variance without this second, as estimated from windows; `None` if it is
    /// not known.
    pub gain: Option<f64>,
}

/// Choice of seconds from recordings that are longer than the joint solve allows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct IntervalChoice {
    /// Number of seconds with the board.
    pub seconds: usize,
    /// The chosen seconds, in order of recording and time.
    pub chosen: Vec<ChosenSecond>,
}

impl fmt::Display for IntervalChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the board was in view for {} s: the camera comes from the {} s with the most information about it, the trajectory from all",
            self.seconds,
            self.chosen.len()
        )
    }
}

/// The chosen seconds, for look-ups.
pub(super) struct ChosenSeconds(BTreeSet<(usize, i64)>);

impl ChosenSeconds {
    pub(super) fn new(choice: &IntervalChoice) -> Self {
        Self(choice.chosen.iter().map(|second| (second.recording, second.start as i64)).collect())
    }

    /// Returns `true` if the second number `second` of `recording` was chosen.
    pub(super) fn has(&self, recording: usize, second: i64) -> bool {
        self.0.contains(&(recording, second))
    }
}

/// Returns the number of the second that contains time `t` (s).
pub(super) fn second_of(t: f64) -> i64 {
    t.floor() as i64
}

/// A second in which the board was seen.
struct Second {
    recording: usize,
    number: i64,
    frames: Range<usize>,
}

/// Chooses from `frames`, which are in order of recording and time; `None` if the joint solve allows all of them.
pub(super) fn choose_intervals(frames: &[CompactFrame], task: &Task, sensor: Sensor) -> Option<IntervalChoice> {
    let seconds = seconds(frames);
    let room = (task.settings.refinement.most_seconds as usize).max(1);
    if seconds.len() <= room {
        return None;
    }
    let parts: Vec<Range<usize>> =
        (0..room).map(|part| part * seconds.len() / room..(part + 1) * seconds.len() / room).collect();
    let information = SecondInformation::new(frames, &seconds, task, sensor);
    let (chosen, gains) = match &information {
        Some(information) => information.choose(&parts),
        None => (parts.iter().map(|part| (part.start + part.end) / 2).collect(), vec![None; parts.len()]),
    };
    let second = |(index, gain): (usize, Option<f64>)| {
        seconds.get(index).map(|second| ChosenSecond { recording: second.recording, start: second.number as f64, gain })
    };
    Some(IntervalChoice { seconds: seconds.len(), chosen: chosen.into_iter().zip(gains).filter_map(second).collect() })
}

fn seconds(frames: &[CompactFrame]) -> Vec<Second> {
    let key = |frame: &CompactFrame| (frame.recording, second_of(frame.t()));
    let mut end = 0;
    let of_group = |group: &[CompactFrame]| {
        let start = end;
        end += group.len();
        let (recording, number) = group.first().map(key)?;
        Some(Second { recording, number, frames: start..end })
    };
    frames.chunk_by(|a, b| key(a) == key(b)).filter_map(of_group).collect()
}

/// Information of every second about the camera.
struct SecondInformation {
    measure: ProjectionMeasure,
    prior: Information,
    seconds: Vec<Information>,
}

impl SecondInformation {
    /// Returns `None` if the windows do not yield a camera.
    fn new(frames: &[CompactFrame], seconds: &[Second], task: &Task, sensor: Sensor) -> Option<Self> {
        let settings = &task.settings.initial;
        let views: Vec<Vec<ObservedCircle>> =
            frames.iter().step_by(frames.len().div_ceil(VIEWS).max(1)).map(CompactFrame::observed).collect();
        let views: Vec<&[ObservedCircle]> = views.iter().map(Vec::as_slice).collect();
        let models = match task.model() {
            ModelRequest::Given(kind) => vec![kind],
            ModelRequest::Auto | ModelRequest::Usual => LIKELY.to_vec(),
        };
        let camera =
            models.into_iter().find_map(|kind| provisional_camera(&views, task.board, sensor, kind, settings))?;
        let of_second = |second: &Second| {
            let frames = frames.get(second.frames.clone()).unwrap_or_default();
            let step = frames.len().div_ceil(WINDOWS_OF_SECOND).max(1);
            let thinned = frames.iter().step_by(step);
            let sum = thinned.filter_map(|frame| information(&camera, frame, task.board));
            sum.fold(Information::zeros(), |sum, one| sum + one) * step as f64
        };
        Some(Self {
            measure: ProjectionMeasure::new(&camera, sensor)?,
            prior: prior(&camera),
            seconds: seconds.par_iter().map(of_second).collect(),
        })
    }

    fn variance(&self, information: &Information) -> f64 {
        self.measure.sigma(information).map_or(f64::INFINITY, |sigma| sigma * sigma)
    }

    fn of(&self, second: usize) -> Information {
        self.seconds.get(second).copied().unwrap_or_default()
    }

    /// Chooses a second from each of the `parts`. Returns the choices and the gain of each, given the others.
    fn choose(&self, parts: &[Range<usize>]) -> (Vec<usize>, Vec<Option<f64>>) {
        let mut chosen: Vec<usize> = parts.iter().map(|part| (part.start + part.end) / 2).collect();
        let mut sum = chosen.iter().fold(self.prior, |sum, &second| sum + self.of(second));
        for _ in 0..SWEEPS {
            for (part, chosen) in parts.iter().zip(&mut chosen) {
                let others = sum - self.of(*chosen);
                let with = |second: usize| self.variance(&(others + self.of(second)));
                let best = part.clone().min_by(|&a, &b| with(a).total_cmp(&with(b)));
                *chosen = best.unwrap_or(*chosen);
                sum = others + self.of(*chosen);
            }
        }
        let all = self.variance(&sum);
        let gain = |&second: &usize| {
            let gain = self.variance(&(sum - self.of(second))) / all - 1.0;
            gain.is_finite().then_some(gain.max(0.0))
        };
        let gains = chosen.iter().map(gain).collect();
        (chosen, gains)
    }
}

/// Returns the information of one window about `camera`.
fn information(camera: &Camera<f64>, frame: &CompactFrame, board: &Board) -> Option<Information> {
    let circles = frame.observed();
    let pose = provisional_pose(camera, &circles, board)?;
    view_information(camera, &pose, circles.iter().map(|circle| board.point(circle.index)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns seconds with these amounts of information about fx and cx.
    fn information_of_seconds(amounts: &[[f64; 2]]) -> SecondInformation {
        let camera = Camera::from_parameters(ModelKind::Radtan4, &[330.0, 330.0, 173.0, 130.0, -0.3, 0.1, 0.0, 0.0]);
        let camera = camera.unwrap();
        let second = |[focal, middle]: &[f64; 2]| {
            let mut information = Information::zeros();
            information[(0, 0)] = *focal;
            information[(2, 2)] = *middle;
            information
        };
        SecondInformation {
            measure: ProjectionMeasure::new(&camera, Sensor::new(346, 260)).unwrap(),
            prior: prior(&camera),
            seconds: amounts.iter().map(second).collect(),
        }
    }

    #[test]
    fn each_part_yields_the_second_with_most_additional_information() {
        // The last part has to choose between much information about a well-known parameter and a little about one that no other
        // part determines.
        let information =
            information_of_seconds(&[[100.0, 0.0], [900.0, 0.0], [10.0, 0.0], [800.0, 0.0], [500.0, 0.0], [1.0, 60.0]]);
        let (chosen, gains) = information.choose(&[0..2, 2..4, 4..6]);
        assert_eq!(chosen, [1, 3, 5]);
        let gains: Vec<f64> = gains.into_iter().map(Option::unwrap).collect();
        assert!(gains[2] > gains[0] && gains[0] > gains[1] && gains[1] > 0.0, "{gains:?}");
    }

    #[test]
    fn only_seconds_with_the_board_count() {
        use evcal_detection::circles::reference_frame::{ReferenceFrame, SeenIn};
        let frame = |recording: usize, t: f64| {
            let (start, end) = (t - 0.002, t + 0.002);
            let frame = ReferenceFrame { recording, start, end, circles: Vec::new(), seen_in: SeenIn::PassedEvents };
            CompactFrame::from(frame)
        };
        let frames = [frame(0, 0.5), frame(0, 0.999), frame(0, 1.001), frame(0, 7.5), frame(1, 7.6)];
        let found: Vec<_> =
            seconds(&frames).into_iter().map(|second| (second.recording, second.number, second.frames)).collect();
        assert_eq!(found, [(0, 0, 0..2), (0, 1, 2..3), (0, 7, 3..4), (1, 7, 4..5)]);
        let chosen = ChosenSecond { recording: 1, start: 7.0, gain: None };
        let chosen = ChosenSeconds::new(&IntervalChoice { seconds: 4, chosen: vec![chosen] });
        assert!(chosen.has(1, second_of(7.999)) && !chosen.has(0, 7) && !chosen.has(1, 8));
    }
}
