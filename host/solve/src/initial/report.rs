//! Statistics of the initial model, and the reasons of a failure.

use std::collections::BTreeMap;
use std::fmt;

use evcal_files::remedies;
use serde::{Deserialize, Serialize};

/// Reasons why a reference frame is not part of the initial model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DropReason {
    /// Fewer circles than [`super::InitialSettings::min_circles`].
    TooFewCircles,
    /// The circles appear mirrored.
    Mirrored,
    /// Rotation gate: the direction of the rows contradicts the neighbouring frames.
    RowsTurned,
    /// PnP found no pose.
    NoPose,
    /// Too few points agree with the best pose.
    TooFewInliers,
    /// The camera would be behind the board.
    BehindBoard,
    /// The points are too far from their projections.
    LargeError,
    /// Velocity gate: the pose does not follow from the neighbouring frames.
    PoseJumps,
    /// Cross-validation: too few circles were confirmed by events.
    Unconfirmed,
}

impl DropReason {
    /// Returns the step that drops frames for this reason.
    pub fn step(self) -> Step {
        match self {
            Self::TooFewCircles => Step::Circles,
            Self::Mirrored | Self::RowsTurned => Step::RotationGate,
            Self::NoPose | Self::TooFewInliers | Self::BehindBoard | Self::LargeError => Step::Pose,
            Self::PoseJumps => Step::VelocityGate,
            Self::Unconfirmed => Step::CrossValidation,
        }
    }
}

impl fmt::Display for DropReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::TooFewCircles => "too few points",
            Self::Mirrored => "mirrored board",
            Self::RowsTurned => "rows turned too fast",
            Self::NoPose => "no pose",
            Self::TooFewInliers => "too few points agree with the pose",
            Self::BehindBoard => "camera behind the board",
            Self::LargeError => "points far from their projections",
            Self::PoseJumps => "pose jumps",
            Self::Unconfirmed => "too few circles confirmed by events",
        })
    }
}

/// Steps that drop frames, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Step {
    /// Enough circles.
    Circles,
    /// Rotation gate.
    RotationGate,
    /// Pose of each frame.
    Pose,
    /// Velocity gate.
    VelocityGate,
    /// Feature cross-validation.
    CrossValidation,
}

/// A frame that is not part of the initial model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DroppedFrame {
    /// Index of the frame in the input.
    pub frame: usize,
    /// The reason.
    pub reason: DropReason,
}

/// Counts of circles in the frames that are kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ValidationCounts {
    /// Circles of the frames that reached the cross-validation, or that are kept without events to check them.
    pub seen: usize,
    /// Circles that do not agree with their frame's pose.
    pub outliers: usize,
    /// Circles whose rim is not wholly on the sensor.
    pub outside_sensor: usize,
    /// Circles without enough events of both polarities near their rim.
    pub too_few_events: usize,
    /// Circles whose events disagree with the projection.
    pub disagree: usize,
    /// Circles that the grid stage had missed.
    pub added: usize,
    /// Circles in the result.
    pub used: usize,
}

/// Statistics of OpenCV's calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OpencvStart {
    /// Number of views that it got, and number of views left after the worst were removed.
    pub views: (usize, usize),
    /// Its root mean square error in pixels; `None` if it failed.
    pub rms: Option<f64>,
    /// Reason of its failure, or why its result was not used.
    pub failure: Option<String>,
}

/// Statistics of the initial model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct InitialReport {
    /// Number of input frames.
    pub frames_in: usize,
    /// Number of frames in the model.
    pub frames_out: usize,
    /// The other frames, ordered by index.
    pub dropped: Vec<DroppedFrame>,
    /// Counts of circles.
    pub circles: ValidationCounts,
    /// Number of frames of a symmetric board whose circles were renumbered by a rotation of the board.
    pub turned: usize,
    /// Number of circles whose time differs from their frame's but whose velocity is unknown.
    pub without_velocity: usize,
    /// OpenCV's calibration; `None` if the camera did not start from it.
    pub opencv: Option<OpencvStart>,
    /// `true` if the camera started from the native estimate instead of OpenCV's.
    pub native_start: bool,
    /// Number of views in the last bundle refinement.
    pub bundle_views: usize,
    /// Number of steps of the last bundle refinement.
    pub bundle_steps: usize,
    /// Root mean square distance between circles and their projections over all frames, in pixels.
    pub rms: f64,
}

impl InitialReport {
    /// Returns the number of frames that each step dropped, by reason, in the order of the steps.
    pub fn dropped_by_step(&self) -> BTreeMap<Step, BTreeMap<DropReason, usize>> {
        let mut steps: BTreeMap<Step, BTreeMap<DropReason, usize>> = BTreeMap::new();
        for dropped in &self.dropped {
            *steps.entry(dropped.reason.step()).or_default().entry(dropped.reason).or_default() += 1;
        }
        steps
    }

    /// Returns the number of dropped frames for each reason, most frequent first.
    pub fn dropped_by_reason(&self) -> Vec<(DropReason, usize)> {
        let mut counts: BTreeMap<DropReason, usize> = BTreeMap::new();
        for dropped in &self.dropped {
            *counts.entry(dropped.reason).or_default() += 1;
        }
        let mut counts: Vec<_> = counts.into_iter().collect();
        counts.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(&b.0)));
        counts
    }

    /// Returns the reasons for dropped frames in words, most frequent first.
    pub fn reasons(&self) -> String {
        let words: Vec<String> =
            self.dropped_by_reason().iter().map(|(reason, count)| format!("{reason}: {count}")).collect();
        if words.is_empty() { "none was dropped".to_owned() } else { words.join(", ") }
    }
}

/// Reasons why there is no initial model, with remedies.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum InitialError {
    /// Too few frames are left.
    #[error(
        "only {left} of {found} frames with the board can be used, {needed} are needed ({reasons}): record longer, \
         or move the board more slowly and keep it wholly in view"
    )]
    TooFewFrames {
        /// Number of input frames.
        found: usize,
        /// Number of remaining frames.
        left: usize,
        /// Number of required frames.
        needed: usize,
        /// Reasons why the others were dropped.
        reasons: String,
    },
    /// Most frames show the board mirrored.
    #[error(
        "the board is seen mirrored in {mirrored} of {found} frames: the sensor's image is flipped, or the board is \
         described with the wrong layout; flip x in the recording or correct the board"
    )]
    Mirrored {
        /// Number of frames with a mirrored board.
        mirrored: usize,
        /// Number of input frames.
        found: usize,
    },
    /// No start yielded a camera, or its refinement diverged.
    #[error(
        "no camera fits the {views} selected views ({reason}): check rows, columns and spacing of the board, and \
         the camera model"
    )]
    NoCamera {
        /// Number of views that were tried.
        views: usize,
        /// The reason.
        reason: String,
    },
    /// The views do not determine the focal length.
    #[error(
        "the views are too much alike: the focal length is known to {percent:.0} % only; tilt the board by 20 to 50 \
         degrees to all sides and vary its distance"
    )]
    ViewsAlike {
        /// Standard deviation of the focal length in percent of it.
        percent: f64,
    },
}

remedies! { InitialError, say;
    Self::Mirrored { .. } => "flip x in the recording or correct {}", say.board;
    Self::NoCamera { .. } => "check {} and {}", say.board, say.model;
}
