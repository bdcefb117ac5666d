//! The result of a calibration.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;

use super::interval_choice::IntervalChoice;
use super::mounted::SecondCamera;
use super::other_intervals::FollowedInterval;
use crate::inertial::calibration::InertialCalibration;
use crate::picture_calibration::calibration::{PictureCalibration, PictureReport};
use crate::picture_calibration::joint::JointReport;
use crate::quality::cross_check::CrossCheckOutcome;
use crate::quality::verdict::Verdict;
use crate::quality::{EventQuality, Quality};
use evcal_detection::circles::compact_frame::CompactFrame;
use evcal_detection::circles::reference_frame::{PointObservation, ReferenceFrame};
use evcal_detection::detection::DetectionReport;
use evcal_geometry::lens::covered_region::CoveredRegion;
use evcal_solve::initial::model_choice::ModelChoice;
use evcal_solve::initial::{InitialModel, PosedFrame};
use evcal_solve::solve::event_sample::EventSample;
use evcal_solve::solve::refinement::Refined;
use evcal_solve::solve::residual_statistics::{Measured, ResidualStatistics};
use evcal_solve::trajectory::segment::SegmentReport;
use event_recordings::Files;
use event_recordings::pass::RecordingReport;

/// A calibrated camera, with the data and statistics of all stages.
pub struct Calibrated {
    /// Sensor size in pixels.
    pub sensor: Sensor,
    /// For each input the time of its first event, circle or picture in the file (s).
    pub starts: Vec<f64>,
    /// Contents of each recording.
    pub recordings: Vec<RecordingReport>,
    /// Statistics of the choice of the camera model, if it was automatic.
    pub model_choice: Option<ModelChoice>,
    /// Uncertainty and coverage.
    pub quality: Quality,
    /// The verdict.
    pub verdict: Verdict,
    /// Data from which the camera was calibrated.
    pub evidence: Evidence,
    /// The IMU, if requested.
    pub inertial: Option<InertialCalibration>,
}

impl Calibrated {
    /// Returns the files of the devices that are not among the inputs of the camera.
    pub fn device_files(&self) -> impl Iterator<Item = &Files> {
        let cameras = self.events().map(|events| events.second_cameras.iter().map(|camera| &camera.source_files));
        cameras.into_iter().flatten().chain(self.inertial.iter().map(|inertial| &inertial.source_files))
    }
}

/// Data from which a camera was calibrated.
pub enum Evidence {
    /// Events along trajectories, or circles that a detector found in events.
    Events(Box<EventCalibration>),
    /// The camera's own pictures alone, each with a separate pose.
    Pictures(Box<PictureCalibration>),
}

/// The camera's own pictures, calibrated separately, and their dots along the trajectories of the events.
pub struct OwnPictures {
    /// The lens.
    pub camera: Camera<f64>,
    /// Standard deviation of each of its parameters.
    pub sigma: Vec<f64>,
    /// Centres of dots for each trajectory, at times on the clock of the events.
    pub points: Vec<Vec<PointObservation>>,
    /// Statistics of their assignment to the trajectories.
    pub report: JointReport,
}

/// Largest number of events of [`EventCalibration::sample`].
pub const SAMPLE: usize = 500_000;

/// A calibration along trajectories.
pub struct EventCalibration {
    /// Sections 1 to 4 of method.md.
    pub detection: DetectionReport,
    /// All reference frames in the joint solve, including those that later stages rejected.
    pub frames: Vec<ReferenceFrame>,
    /// Windows outside the joint solve.
    pub other_windows: Vec<CompactFrame>,
    /// Choice of the seconds of a long recording; `None` if all of them are in the joint solve.
    pub choice: Option<IntervalChoice>,
    /// The poses along intervals outside the joint solve.
    pub followed: Vec<FollowedInterval>,
    /// Section 5: start of the joint solve.
    pub initial: InitialModel,
    /// Section 6.
    pub segments: SegmentReport,
    /// An even sample of at most [`SAMPLE`] events, enough for figures of the result.
    pub sample: EventSample,
    /// Segments whose spline could not be fitted.
    pub segments_without_spline: usize,
    /// The kind of observations of the joint solve.
    pub measured: Measured,
    /// Sections 8 to 11: camera, event biases and trajectories.
    pub refined: Refined,
    /// Quality measures in addition to [`Calibrated::quality`].
    pub quality: EventQuality,
    /// Cross-check with the camera's own pictures; `None` if the recordings contain none.
    pub cross_check: Option<CrossCheckOutcome>,
    /// Statistics of the joint solve of pictures and events, if there was one.
    pub joint: Option<JointReport>,
    /// Other cameras on the same mount, in the order of the request.
    pub second_cameras: Vec<SecondCamera>,
    /// The camera's own pictures, if they are used as pictures of a second camera.
    pub own_pictures: Option<OwnPictures>,
}

impl Calibrated {
    /// Returns model and serial number of the camera, if the recordings contain them and agree.
    pub fn camera_name(&self) -> Option<&str> {
        let first = self.recordings.first()?.camera_name.as_deref()?;
        self.recordings.iter().all(|recording| recording.camera_name.as_deref() == Some(first)).then_some(first)
    }

    /// Returns the date and time of the first recording, if the recording contains them.
    pub fn recorded(&self) -> Option<&str> {
        self.recordings.first()?.began.as_deref()
    }

    /// Returns the lens.
    pub fn camera(&self) -> &Camera<f64> {
        match &self.evidence {
            Evidence::Events(events) => &events.refined.state.camera,
            Evidence::Pictures(pictures) => &pictures.camera,
        }
    }

    /// Returns the standard deviation of each parameter of the camera, in the order of [`Camera::parameters`].
    pub fn sigma(&self) -> Vec<f64> {
        self.quality.uncertainty.sigma()
    }

    /// Returns statistics of the distances of the observations from their predicted positions.
    pub fn residuals(&self) -> ResidualStatistics {
        match &self.evidence {
            Evidence::Events(events) => events.refined.residuals,
            Evidence::Pictures(pictures) => pictures.residuals(),
        }
    }

    /// Returns the kind of distance that the residuals measure.
    pub fn measured(&self) -> Measured {
        match &self.evidence {
            Evidence::Events(events) => events.measured,
            Evidence::Pictures(pictures) => pictures.measured,
        }
    }

    /// Returns the first camera.
    pub fn initial(&self) -> &InitialModel {
        match &self.evidence {
            Evidence::Events(events) => &events.initial,
            Evidence::Pictures(pictures) => &pictures.initial,
        }
    }

    /// Returns all windows or pictures in which the board was found, including those that later stages rejected.
    pub fn frames(&self) -> &[ReferenceFrame] {
        match &self.evidence {
            Evidence::Events(events) => &events.frames,
            Evidence::Pictures(pictures) => &pictures.frames,
        }
    }

    /// Returns the used frames of [`Calibrated::frames`] with their poses.
    pub fn posed(&self) -> impl Iterator<Item = (&PosedFrame, &ReferenceFrame)> + Clone {
        let posed = match &self.evidence {
            Evidence::Events(events) => &events.initial.frames,
            Evidence::Pictures(pictures) => &pictures.posed,
        };
        posed.iter().filter_map(|posed| Some((posed, self.frames().get(posed.frame)?)))
    }

    /// Returns the region in which the frames of the calibration show circles of the board.
    pub fn covered_region(&self) -> CoveredRegion {
        let circles = self.posed().flat_map(|(_, frame)| &frame.circles);
        CoveredRegion::around_circles(circles.map(|circle| (circle.center, circle.radius.unwrap_or(0.0))), self.sensor)
    }

    /// Returns the best estimate of `T_world_camera` at a frame: from the trajectory, if there is one.
    pub fn best_pose(&self, posed: &PosedFrame, frame: &ReferenceFrame) -> Isometry3<f64> {
        match &self.evidence {
            Evidence::Events(events) => events.pose(frame.recording, frame.t()).unwrap_or(posed.pose),
            Evidence::Pictures(_) => posed.pose,
        }
    }

    /// Returns the calibration along trajectories, if it is one.
    pub fn events(&self) -> Option<&EventCalibration> {
        match &self.evidence {
            Evidence::Events(events) => Some(events),
            Evidence::Pictures(_) => None,
        }
    }

    /// Returns the counts of the camera's own pictures; `None` without pictures.
    pub fn picture_report(&self) -> Option<&PictureReport> {
        match &self.evidence {
            Evidence::Events(events) => events.cross_check.as_ref().map(CrossCheckOutcome::report),
            Evidence::Pictures(pictures) => Some(&pictures.report),
        }
    }
}

impl EventCalibration {
    /// Returns `T_world_camera` at time `t` of a recording (s from its start); `None` outside all trajectories.
    pub fn pose(&self, recording: usize, t: f64) -> Option<Isometry3<f64>> {
        let of_recording = self.refined.state.trajectories.iter().filter(|one| one.recording == recording);
        of_recording.filter_map(|trajectory| trajectory.pose(t)).next()
    }
}
