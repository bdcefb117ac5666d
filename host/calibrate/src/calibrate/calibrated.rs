//! What a calibration gives.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;

use super::mounted::SecondCamera;
use super::other_stretches::FollowedStretch;
use super::stretch_choice::StretchChoice;
use crate::circles::compact_frame::CompactFrame;
use crate::circles::reference_frame::{PointObservation, ReferenceFrame};
use crate::detection::DetectionReport;
use crate::inertial::calibration::InertialCalibration;
use crate::initial::model_choice::ModelChoice;
use crate::initial::{InitialModel, PosedFrame};
use crate::picture_calibration::calibration::{PictureCalibration, PictureReport};
use crate::picture_calibration::joint::JointReport;
use crate::solve::event_sample::EventSample;
use crate::solve::refinement::Refined;
use crate::solve::residual_statistics::{Measured, ResidualStatistics};
use crate::trajectory::segment::SegmentReport;
use crate::trust::verdict::Verdict;
use crate::trust::witness::WitnessOutcome;
use crate::trust::{EventTrust, Trust};
use evcal_geometry::lens::covered_region::CoveredRegion;
use event_recordings::pass::RecordingReport;

/// A calibrated camera and how it came about.
pub struct Calibrated {
    /// Sensor size in pixels.
    pub sensor: Sensor,
    /// For each input the time of its first event, circle or picture in the file (s).
    pub starts: Vec<f64>,
    /// What each recording held.
    pub recordings: Vec<RecordingReport>,
    /// How the camera model was chosen, where that was left to the program.
    pub model_choice: Option<ModelChoice>,
    /// How sure the result is, and what was seen.
    pub trust: Trust,
    /// Whether it is good.
    pub verdict: Verdict,
    /// What the camera was calibrated from.
    pub evidence: Evidence,
}

/// What a camera was calibrated from.
pub enum Evidence {
    /// Events, or circles that a detector found in them, along trajectories.
    Events(Box<EventCalibration>),
    /// The camera's own pictures alone, each with a pose of its own.
    Pictures(Box<PictureCalibration>),
}

/// The camera's own pictures, calibrated apart, and their dots along the trajectories of the events.
pub struct OwnPictures {
    /// The lens.
    pub camera: Camera<f64>,
    /// Standard deviation of each of its parameters.
    pub sigma: Vec<f64>,
    /// Centres of dots for each trajectory, at times of the events.
    pub points: Vec<Vec<PointObservation>>,
    /// How they came about.
    pub report: JointReport,
}

/// Most events of [`EventCalibration::sample`].
pub const SAMPLE: usize = 1_000_000;

/// A calibration along trajectories.
pub struct EventCalibration {
    /// Sections 1 to 4 of method.md.
    pub detection: DetectionReport,
    /// All reference frames found that the joint solve had room for, also those that fell away later.
    pub frames: Vec<ReferenceFrame>,
    /// Those that it had no room for.
    pub other_windows: Vec<CompactFrame>,
    /// What it took of long recordings; `None` where there was room for all.
    pub choice: Option<StretchChoice>,
    /// The poses along stretches that it did not take.
    pub followed: Vec<FollowedStretch>,
    /// Section 5: what the joint solve started from.
    pub initial: InitialModel,
    /// Section 6.
    pub segments: SegmentReport,
    /// An even sample of the events, [`SAMPLE`] of them at most: enough for pictures of the result.
    pub sample: EventSample,
    /// Segments whose spline could not be fitted.
    pub segments_without_spline: usize,
    /// What the joint solve observed.
    pub measured: Measured,
    /// Sections 8 to 11: camera, event biases and trajectories.
    pub refined: Refined,
    /// What speaks for and against it, beside [`Calibrated::trust`].
    pub trust: EventTrust,
    /// What the camera's own pictures say of it; `None` where the recordings have none.
    pub witness: Option<WitnessOutcome>,
    /// How pictures and events were solved together, if they were.
    pub joint: Option<JointReport>,
    /// The inertial unit, where it was asked for.
    pub inertial: Option<InertialCalibration>,
    /// Other cameras on the same mount, in the order in which they were asked for.
    pub second_cameras: Vec<SecondCamera>,
    /// The camera's own pictures, where they are to be taken for those of a second camera.
    pub own_pictures: Option<OwnPictures>,
}

impl Calibrated {
    /// Model and serial number of the camera, if the recordings tell them, and all the same.
    pub fn camera_name(&self) -> Option<&str> {
        let first = self.recordings.first()?.camera_name.as_deref()?;
        self.recordings.iter().all(|recording| recording.camera_name.as_deref() == Some(first)).then_some(first)
    }

    /// When the first recording was made, if it tells that.
    pub fn recorded(&self) -> Option<&str> {
        self.recordings.first()?.began.as_deref()
    }

    /// The lens.
    pub fn camera(&self) -> &Camera<f64> {
        match &self.evidence {
            Evidence::Events(events) => &events.refined.state.camera,
            Evidence::Pictures(pictures) => &pictures.camera,
        }
    }

    /// Standard deviation of each parameter of the camera, in the order of [`Camera::parameters`].
    pub fn sigma(&self) -> Vec<f64> {
        self.trust.uncertainty.sigma()
    }

    /// How far the observations are from where the result puts them.
    pub fn residuals(&self) -> ResidualStatistics {
        match &self.evidence {
            Evidence::Events(events) => events.refined.residuals,
            Evidence::Pictures(pictures) => pictures.residuals(),
        }
    }

    /// What the residuals are distances of.
    pub fn measured(&self) -> Measured {
        match &self.evidence {
            Evidence::Events(events) => events.measured,
            Evidence::Pictures(pictures) => pictures.measured,
        }
    }

    /// The first camera.
    pub fn initial(&self) -> &InitialModel {
        match &self.evidence {
            Evidence::Events(events) => &events.initial,
            Evidence::Pictures(pictures) => &pictures.initial,
        }
    }

    /// All windows or pictures in which the board was found, also those that fell away later.
    pub fn frames(&self) -> &[ReferenceFrame] {
        match &self.evidence {
            Evidence::Events(events) => &events.frames,
            Evidence::Pictures(pictures) => &pictures.frames,
        }
    }

    /// Those of [`Calibrated::frames`] that were used, with their poses.
    pub fn posed(&self) -> impl Iterator<Item = (&PosedFrame, &ReferenceFrame)> + Clone {
        let posed = match &self.evidence {
            Evidence::Events(events) => &events.initial.frames,
            Evidence::Pictures(pictures) => &pictures.posed,
        };
        posed.iter().filter_map(|posed| Some((posed, self.frames().get(posed.frame)?)))
    }

    /// Where the board's circles were seen in the frames that the calibration used.
    pub fn covered_region(&self) -> CoveredRegion {
        let circles = self.posed().flat_map(|(_, frame)| &frame.circles);
        CoveredRegion::around_circles(circles.map(|circle| (circle.center, circle.radius.unwrap_or(0.0))), self.sensor)
    }

    /// The best estimate of `T_world_camera` at a frame: that of the trajectory, where there is one.
    pub fn best_pose(&self, posed: &PosedFrame, frame: &ReferenceFrame) -> Isometry3<f64> {
        match &self.evidence {
            Evidence::Events(events) => events.pose(frame.recording, frame.t()).unwrap_or(posed.pose),
            Evidence::Pictures(_) => posed.pose,
        }
    }

    /// The calibration along trajectories, if it is one.
    pub fn events(&self) -> Option<&EventCalibration> {
        match &self.evidence {
            Evidence::Events(events) => Some(events),
            Evidence::Pictures(_) => None,
        }
    }

    /// What became of the camera's own pictures; `None` where there are none.
    pub fn picture_report(&self) -> Option<&PictureReport> {
        match &self.evidence {
            Evidence::Events(events) => events.witness.as_ref().map(WitnessOutcome::report),
            Evidence::Pictures(pictures) => Some(&pictures.report),
        }
    }
}

impl EventCalibration {
    /// `T_world_camera` at time `t` of a recording (s from its start); `None` where there is no trajectory.
    pub fn pose(&self, recording: usize, t: f64) -> Option<Isometry3<f64>> {
        let of_recording = self.refined.state.trajectories.iter().filter(|one| one.recording == recording);
        of_recording.filter_map(|trajectory| trajectory.pose(t)).next()
    }
}
