//! The result of a calibration, as stored in `calibration.json`.

use std::collections::BTreeMap;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::calibrate::calibrated::{Calibrated, EventCalibration, Evidence};
use crate::calibrate::interval_choice::IntervalChoice;
use crate::picture_calibration::calibration::{PictureReport, PictureSummary};
use crate::picture_calibration::joint::JointReport;
use crate::quality::coverage::Coverage;
use crate::quality::cross_check::{Comparison, CrossCheckOutcome};
use crate::quality::drift::Drift;
use crate::quality::misfit::Misfit;
use crate::quality::residual_map::ResidualPattern;
use crate::quality::split_half::{HeldOutResidual, SplitHalf};
use crate::quality::uncertainty::BiasSigma;
use crate::quality::uncertainty::parts::ProjectionParts;
use crate::quality::verdict::Verdict;
use crate::quality::{EventQuality, ObservedRadius, Quality};
use crate::result::inertial_result::InertialResult;
use crate::result::printed_board::PrintedBoard;
use crate::result::second_camera_result::SecondCameraResult;
use evcal_core::event::Polarity;
use evcal_core::sensor::Sensor;
use evcal_detection::detection::DetectionReport;
use evcal_files::remedy::Words;
use evcal_geometry::board::Board;
use evcal_geometry::lens::camera_file::{CameraDescription, LATEST_VERSION, Parameters};
use evcal_solve::initial::InitialReport;
use evcal_solve::initial::model_choice::ModelChoice;
use evcal_solve::solve::refinement::RoundReport;
use evcal_solve::solve::residual_statistics::Measured;
use evcal_solve::solve::residual_statistics::ResidualStatistics;
use evcal_solve::solve::rows::burst::BurstLength;
use evcal_solve::solve::rows::event_bias::bias::{Bias, Biases};
use evcal_solve::solve::rows::event_bias::{EventBias, EventKind, SPEED_RANGE_COUNT};
use evcal_solve::trajectory::segment::SegmentReport;
use event_recordings::pass::RecordingReport;

/// Value of `format` in every calibration file.
const FORMAT: &str = "evcal-calibration";

/// All results of a calibration. The order of the fields is the order in the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibrationFile {
    /// Always `evcal-calibration`.
    pub format: String,
    /// Version of this layout, [`LATEST_VERSION`].
    pub version: u32,
    /// Version of the program.
    pub program: String,
    /// Model and serial number of the camera; absent if the recordings do not contain them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_name: Option<String>,
    /// Time of the first recording, as the recording states it; absent if it does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded: Option<String>,
    /// Command line that repeats the calibration; absent if no program made it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub command: Option<String>,
    /// Files that the camera was calibrated from, with their checksums; empty for a device.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub input_files: Vec<InputFile>,
    /// Position of pixel (0, 0).
    pub pixel_convention: String,
    /// Size of the sensor.
    pub sensor: Sensor,
    /// The lens.
    pub camera: CameraDescription,
    /// The verdict, with its findings.
    pub verdict: Verdict<String>,
    /// Standard deviation of each lens parameter.
    pub sigma: CameraDescription,
    /// Uncertainty of the result.
    pub uncertainty: UncertaintySummary,
    /// Coverage of the sensor, and distribution of the poses.
    pub coverage: Coverage,
    /// Comparison of two halves that were calibrated separately; absent if the recordings are too short, and for pictures alone.
    pub split_half: Option<SplitHalfSummary>,
    /// A change of the lens or the board within the recordings; absent if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drift: Option<Drift>,
    /// Systematic residuals over the sensor; absent for pictures alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub residual_pattern: Option<ResidualPattern>,
    /// Difference between the lens model and the lens; absent if the residuals do not contradict the model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub misfit: Option<MisfitSummary>,
    /// The circles' radius from the events.
    pub observed_radius: Option<ObservedRadius>,
    /// The lens before the joint solve.
    pub initial_camera: CameraDescription,
    /// Corners (px) of the convex region of the sensor in which the board was seen.
    pub covered_region: Vec<[f64; 2]>,
    /// The board, as on the command line.
    pub board: String,
    /// The estimated board; absent for pictures alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub printed_board: Option<PrintedBoard>,
    /// Event classes and their biases; empty if the input consists of circle centres.
    pub event_classes: Vec<EventClass>,
    /// Distances of the observations from their predicted positions.
    pub residuals: Residuals,
    /// Trajectory segments.
    pub segments: Vec<SegmentSummary>,
    /// Chosen seconds of long recordings in the joint solve; absent if it includes everything.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chosen_seconds: Option<IntervalChoice>,
    /// Result from the camera's own frames; absent if the recordings contain none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<FramesResult>,
    /// Statistics of the joint solve of frames and events; absent without such a solve.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub joint_frames: Option<JointReport>,
    /// The IMU, if requested.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inertial: Option<InertialResult>,
    /// Other cameras on the same mount, if requested.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub second_cameras: Vec<SecondCameraResult>,
    /// Reports of all stages.
    pub stages: StageReports,
}

/// A file that a camera was calibrated from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct InputFile {
    /// Path as it was given.
    pub path: String,
    /// Size in bytes.
    pub bytes: u64,
    /// SHA-256 of the content, in hexadecimal digits.
    pub sha256: String,
}

/// Result from the camera's own pictures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FramesResult {
    /// They were calibrated and compared with the events.
    CrossCheck(Box<Comparison>),
    /// The pictures yielded no camera, or a camera that cannot be compared.
    #[serde(alias = "silent")]
    Failed(FailedFrames),
    /// The calibration is from pictures alone.
    Only(Box<PictureSummary>),
}

/// Reason why the camera's own pictures yield no result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FailedFrames {
    /// The reason, with a remedy.
    pub reason: String,
    /// Number of pictures that were used, and of the rejected ones by reason.
    pub report: Box<PictureReport>,
}

/// Reports of all stages, with the numbers of inputs that they got, kept and dropped. Stages that a calibration from
/// pictures alone does not have are absent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageReports {
    /// Contents of each recording.
    pub recordings: Vec<RecordingReport>,
    /// Sections 1 to 4 of method.md.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detection: Option<DetectionReport>,
    /// Section 5.
    pub initial: InitialReport,
    /// Statistics of the choice of the camera model, if it was automatic.
    pub model_choice: Option<ModelChoice>,
    /// Sections 6 to 11.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub trajectory: Option<TrajectoryStages>,
}

/// Reports of the stages along trajectories.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrajectoryStages {
    /// Section 6.
    pub segments: SegmentReport,
    /// Segments whose spline could not be fitted.
    pub segments_without_spline: usize,
    /// Sections 8 to 11, one entry per round.
    pub rounds: Vec<RoundReport>,
}

/// One event class: polarity, rank in the burst, and length of the burst.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EventClass {
    /// Darker or brighter.
    pub polarity: ClassPolarity,
    /// Rank in the burst, 0 for the first event; the last rank includes all later ones.
    pub rank: u8,
    /// Number of events of the burst.
    pub burst_length: BurstLength,
    /// Biases of the distance from the edge, under the names of [`Bias::name`].
    #[serde(flatten, serialize_with = "write_biases", deserialize_with = "read_biases")]
    pub biases: Biases<f64>,
    /// Spread in pixels, for each of the ranges of normal speed.
    pub sigma: [f64; SPEED_RANGE_COUNT],
    /// Standard deviations of the biases, in the order of [`Bias::ALL`]; zero for fixed ones.
    pub standard_deviations: Biases<f64>,
}

/// Polarity of an event class.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ClassPolarity {
    /// Darker.
    Off,
    /// Brighter.
    On,
}

impl EventClass {
    /// Returns all classes with their biases and standard deviations; empty if the input consists of circle centres.
    fn of_calibration(events: &EventCalibration) -> Vec<Self> {
        if events.measured == Measured::CircleCentres {
            return Vec::new();
        }
        Self::all(&events.refined.state.bias, &events.quality.bias_sigma)
    }

    /// Returns all classes with their biases and standard deviations.
    fn all(bias: &EventBias, sigma: &BiasSigma) -> Vec<Self> {
        bias.iter()
            .zip(sigma)
            .enumerate()
            .map(|(class, (bias, sigma))| {
                let EventKind { polarity, place } = EventKind::of_class(class);
                Self {
                    polarity: match polarity {
                        Polarity::Off => ClassPolarity::Off,
                        Polarity::On => ClassPolarity::On,
                    },
                    rank: place.rank,
                    burst_length: place.length,
                    biases: bias.biases,
                    sigma: bias.sigma,
                    standard_deviations: *sigma,
                }
            })
            .collect()
    }
}

/// Writes each bias under its name.
fn write_biases<S: Serializer>(biases: &Biases<f64>, serializer: S) -> Result<S::Ok, S::Error> {
    /// Their order in the file.
    const LAYOUT: [Bias; Bias::COUNT] = [
        Bias::Offset,
        Bias::Curvature,
        Bias::Latency,
        Bias::Bend,
        Bias::CornerLatency,
        Bias::CurvatureLatency,
        Bias::Memory,
    ];
    serializer.collect_map(LAYOUT.map(|bias| (bias.name(), biases[bias])))
}

fn read_biases<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Biases<f64>, D::Error> {
    let values = BTreeMap::<String, f64>::deserialize(deserializer)?;
    match Bias::ALL.iter().find(|bias| !values.contains_key(bias.name())) {
        Some(missing) => Err(D::Error::missing_field(missing.name())),
        None => Ok(Biases::from_fn(|bias| values.get(bias.name()).copied().unwrap_or_default())),
    }
}

/// Residuals of the observations of the final solve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Residuals {
    /// The kind of distance.
    pub measure: Measured,
    /// Number of observations.
    pub count: usize,
    /// Root mean square in pixels.
    pub rms: f64,
    /// Median of the absolute value in pixels.
    pub median: f64,
}

/// Uncertainty of a result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UncertaintySummary {
    /// Covariance of the lens parameters, in the order of the model.
    pub covariance: Vec<Vec<f64>>,
    /// Variance divided by the variance if all observations were independent.
    pub inflation: f64,
    /// Number of independent observations that would determine the camera as well.
    pub effective_observations: f64,
    /// Number of blocks of time from which the inflation was estimated.
    pub blocks: usize,
    /// Expected root mean square error of the projection over the sensor (px).
    pub projection_rms: f64,
    /// 95 % bound of that error (px).
    pub projection_rms_95: f64,
    /// Greatest standard deviation of the projection (px).
    pub projection_max: f64,
    /// The pixel where it is greatest.
    pub projection_max_at: [f64; 2],
    /// Contribution of each cause to `projection_rms` (px); absent for pictures alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub projection_parts: Option<ProjectionParts>,
}

impl UncertaintySummary {
    fn new(quality: &Quality, events: Option<&EventQuality>) -> Self {
        let Quality { uncertainty, projection, .. } = quality;
        Self {
            covariance: uncertainty.covariance.row_iter().map(|row| row.iter().copied().collect()).collect(),
            inflation: uncertainty.inflation,
            effective_observations: uncertainty.effective_observations(),
            blocks: uncertainty.blocks,
            projection_rms: projection.rms,
            projection_rms_95: projection.rms_95,
            projection_max: projection.max,
            projection_max_at: projection.max_at,
            projection_parts: events.map(|events| events.projection_parts),
        }
    }
}

/// Two calibrations, each from one half of the observations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SplitHalfSummary {
    /// The two cameras.
    pub cameras: [CameraDescription; 2],
    /// Root mean square difference of their projections (px).
    pub difference_rms: f64,
    /// Greatest difference (px).
    pub difference_max: f64,
    /// The expected root mean square difference (px).
    pub expected_rms: f64,
    /// 95 % bound of the difference if the uncertainties are right (px).
    pub bound: f64,
    /// Residuals of each half with the camera of the other.
    pub held_out: HeldOutResidual,
}

impl From<&SplitHalf> for SplitHalfSummary {
    fn from(halves: &SplitHalf) -> Self {
        Self {
            cameras: halves.cameras.clone(),
            difference_rms: halves.difference.rms,
            difference_max: halves.difference.max,
            expected_rms: halves.expected_rms,
            bound: halves.bound,
            held_out: halves.held_out,
        }
    }
}

/// Difference between the lens model and the lens.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MisfitSummary {
    /// Error of the projection over the sensor that the model causes (rms, px). It is included in the reported uncertainty.
    pub rms: f64,
    /// Name of a model that follows the lens better, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub better_model: Option<String>,
}

impl From<&Misfit> for MisfitSummary {
    fn from(misfit: &Misfit) -> Self {
        let better_model = misfit.better.as_ref().map(|better| better.kind.name().to_owned());
        Self { rms: misfit.rms, better_model }
    }
}

/// One trajectory segment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SegmentSummary {
    /// Index of the recording.
    pub recording: usize,
    /// Start in seconds since the recording's first event.
    pub start: f64,
    /// End.
    pub end: f64,
    /// Number of control points.
    pub control_points: usize,
    /// Number of observations.
    pub observations: usize,
}

impl CalibrationFile {
    /// Returns the result of `calibrated` with `board`; its advice is in the words `say`. `command` and `input_files` are left empty.
    pub fn new(calibrated: &Calibrated, board: &Board, say: &Words) -> Self {
        let camera = calibrated.camera();
        let names = camera.kind().parameter_names();
        let quality = &calibrated.quality;
        let events = calibrated.events();
        let sigma = Parameters::new(names.iter().copied().zip(quality.uncertainty.sigma()));
        Self {
            format: FORMAT.to_owned(),
            version: LATEST_VERSION,
            program: crate::VERSION.to_owned(),
            camera_name: calibrated.camera_name().map(str::to_owned),
            recorded: calibrated.recorded().map(str::to_owned),
            command: None,
            input_files: Vec::new(),
            pixel_convention: "pixel (0, 0) is the centre of the top-left pixel (OpenCV, ROS)".to_owned(),
            sensor: calibrated.sensor,
            camera: CameraDescription::new(camera),
            verdict: calibrated.verdict.worded(say),
            uncertainty: UncertaintySummary::new(quality, events.map(|events| &events.quality)),
            coverage: quality.coverage.clone(),
            split_half: events.and_then(|events| events.quality.split_half.as_ref().map(SplitHalfSummary::from)),
            drift: events.and_then(|events| events.quality.drift.clone()),
            residual_pattern: events.map(|events| events.quality.residuals.pattern),
            misfit: events.and_then(|events| events.quality.misfit.as_ref().map(MisfitSummary::from)),
            observed_radius: events.and_then(|events| events.quality.radius),
            sigma: CameraDescription { model: camera.kind().name().to_owned(), parameters: sigma },
            initial_camera: CameraDescription::new(&calibrated.initial().camera),
            covered_region: calibrated.covered_region().corners().iter().map(|&corner| corner.into()).collect(),
            board: board.to_string(),
            printed_board: events.map(|events| PrintedBoard::new(&events.quality.board)),
            event_classes: events.map_or_else(Vec::new, EventClass::of_calibration),
            residuals: Residuals::new(calibrated),
            segments: events.map_or_else(Vec::new, SegmentSummary::of_calibration),
            chosen_seconds: events.and_then(|events| events.choice.clone()),
            frames: FramesResult::new(calibrated),
            joint_frames: events.and_then(|events| events.joint.clone()),
            inertial: calibrated.inertial.as_ref().map(InertialResult::new),
            second_cameras: events
                .map_or_else(Vec::new, |events| events.second_cameras.iter().map(SecondCameraResult::new).collect()),
            stages: StageReports::new(calibrated),
        }
    }
}

impl FramesResult {
    fn new(calibrated: &Calibrated) -> Option<Self> {
        match &calibrated.evidence {
            Evidence::Events(events) => events.cross_check.as_ref().map(|outcome| match outcome {
                CrossCheckOutcome::Compared(cross_check) => Self::CrossCheck(Box::new(cross_check.comparison.clone())),
                CrossCheckOutcome::Failed(failure) => {
                    Self::Failed(FailedFrames { reason: failure.to_string(), report: failure.report.clone() })
                }
            }),
            Evidence::Pictures(pictures) => Some(Self::Only(Box::new(pictures.summary()))),
        }
    }
}

impl StageReports {
    fn new(calibrated: &Calibrated) -> Self {
        let events = calibrated.events();
        Self {
            recordings: calibrated.recordings.clone(),
            detection: events.map(|events| events.detection.clone()),
            initial: calibrated.initial().report.clone(),
            model_choice: calibrated.model_choice.clone(),
            trajectory: events.map(|events| TrajectoryStages {
                segments: events.segments.clone(),
                segments_without_spline: events.segments_without_spline,
                rounds: events.refined.rounds.clone(),
            }),
        }
    }
}

impl Residuals {
    fn new(calibrated: &Calibrated) -> Self {
        let ResidualStatistics { count, rms, median } = calibrated.residuals();
        Self { measure: calibrated.measured(), count, rms, median }
    }
}

impl SegmentSummary {
    fn of_calibration(events: &EventCalibration) -> Vec<Self> {
        let segments = events.refined.state.trajectories.iter().zip(&events.refined.problem.segments);
        segments
            .map(|(trajectory, observations)| Self {
                recording: trajectory.recording,
                start: trajectory.start(),
                end: trajectory.end(),
                control_points: trajectory.control_point_count(),
                observations: observations.events.len() + observations.points.len(),
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evcal_solve::solve::rows::event_bias::{CLASS_COUNT, unknown};

    #[test]
    fn each_bias_of_a_class_is_written_and_read_under_its_name() {
        let mut bias = unknown(0.3);
        bias[1].biases = Biases::from_fn(|bias| bias.index() as f64);
        let classes = EventClass::all(&bias, &[Biases::default(); CLASS_COUNT]);
        let written = serde_json::to_value(&classes[1]).unwrap();
        for bias in Bias::ALL {
            assert_eq!(written[bias.name()], bias.index() as f64);
        }
        assert_eq!(written["sigma"][0], 0.3);
        let read: EventClass = serde_json::from_value(written).unwrap();
        assert_eq!(read, classes[1]);
    }
}
