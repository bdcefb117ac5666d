//! The result of a calibration, as it is written to `calibration.json` and read from it.

use std::collections::BTreeMap;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::advice::Wording;
use crate::calibrate::calibrated::{Calibrated, EventCalibration, Evidence};
use crate::calibrate::stretch_choice::StretchChoice;
use crate::detection::DetectionReport;
use crate::initial::InitialReport;
use crate::initial::model_choice::ModelChoice;
use crate::picture_calibration::calibration::{PictureReport, PictureSummary};
use crate::picture_calibration::joint::JointReport;
use crate::result::inertial_result::InertialResult;
use crate::result::printed_board::PrintedBoard;
use crate::result::second_camera_result::SecondCameraResult;
use crate::solve::burst::BurstLength;
use crate::solve::event_bias::bias::{Bias, Biases};
use crate::solve::event_bias::{EventBias, EventKind, SPEED_RANGE_COUNT};
use crate::solve::refinement::RoundReport;
use crate::solve::residual_statistics::Measured;
use crate::solve::residual_statistics::ResidualStatistics;
use crate::trajectory::segment::SegmentReport;
use crate::trust::coverage::Coverage;
use crate::trust::misfit::Misfit;
use crate::trust::residual_map::ResidualPattern;
use crate::trust::split_half::{HeldOutResidual, SplitHalf};
use crate::trust::uncertainty::BiasSigma;
use crate::trust::uncertainty::parts::ProjectionParts;
use crate::trust::verdict::Verdict;
use crate::trust::witness::{Comparison, WitnessOutcome};
use crate::trust::{EventTrust, ObservedRadius, Trust};
use evcal_core::event::Polarity;
use evcal_core::sensor::Sensor;
use evcal_geometry::board::Board;
use evcal_geometry::lens::camera_file::{CameraDescription, LATEST_VERSION, Parameters};
use event_recordings::pass::RecordingReport;

/// What `format` says in every calibration file.
const FORMAT: &str = "evcal-calibration";

/// Everything that a calibration found out. Field order is the order in the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibrationFile {
    /// Always `evcal-calibration`.
    pub format: String,
    /// Version of this layout, [`LATEST_VERSION`].
    pub version: u32,
    /// Version of the program.
    pub program: String,
    /// Model and serial number of the camera; absent where the recordings do not tell them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_name: Option<String>,
    /// When the first recording was made, as it tells that; absent where it does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded: Option<String>,
    /// Command line that repeats the calibration; absent if no program made it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub command: Option<String>,
    /// Files that the camera was calibrated from, with their checksums; empty for a device.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub input_files: Vec<InputFile>,
    /// Where pixel (0, 0) is.
    pub pixel_convention: String,
    /// Size of the sensor.
    pub sensor: Sensor,
    /// The lens.
    pub camera: CameraDescription,
    /// Whether it is good, and why.
    pub verdict: Verdict<String>,
    /// Standard deviation of each lens parameter.
    pub sigma: CameraDescription,
    /// How sure the result is.
    pub uncertainty: UncertaintySummary,
    /// Where on the sensor and from where the board was seen.
    pub coverage: Coverage,
    /// Two halves of the recordings calibrated apart; absent where they are too short, and for pictures alone.
    pub split_half: Option<SplitHalfSummary>,
    /// Whether residuals stay in the same places of the image; absent for pictures alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub residual_pattern: Option<ResidualPattern>,
    /// How far the lens model is from the lens; absent when the residuals say nothing against it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub misfit: Option<MisfitSummary>,
    /// The circles' radius as the events see it.
    pub observed_radius: Option<ObservedRadius>,
    /// The lens before the joint solve.
    pub initial_camera: CameraDescription,
    /// Corners (px) of the convex region of the sensor in which the board was seen.
    pub covered_region: Vec<[f64; 2]>,
    /// The board, as on the command line.
    pub board: String,
    /// The board as it was estimated; absent for pictures alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub printed_board: Option<PrintedBoard>,
    /// Event classes and their biases; empty when the input is circle centres.
    pub event_classes: Vec<EventClass>,
    /// How far the observations are from where the result puts them.
    pub residuals: Residuals,
    /// Trajectory segments.
    pub segments: Vec<SegmentSummary>,
    /// Which seconds of recordings the joint solve took that are longer than it has room for; absent where it took all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chosen_seconds: Option<StretchChoice>,
    /// What the camera's own frames say; absent where the recordings have none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<FramesResult>,
    /// How frames and events were solved together; absent where they were not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub joint_frames: Option<JointReport>,
    /// The inertial unit, where it was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inertial: Option<InertialResult>,
    /// Other cameras on the same mount, where they were asked for.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub second_cameras: Vec<SecondCameraResult>,
    /// What every stage took in and gave out.
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

/// What the camera's own pictures say.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FramesResult {
    /// They were calibrated and compared with the events.
    Witness(Box<Comparison>),
    /// They gave no camera, or none that can be compared.
    #[serde(alias = "silent")]
    Failed(FailedFrames),
    /// The calibration is from them alone.
    Only(Box<PictureSummary>),
}

/// Why the camera's own pictures say nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FailedFrames {
    /// In words, with what to do.
    pub reason: String,
    /// What became of them.
    pub report: Box<PictureReport>,
}

/// What every stage took in and gave out. Stages that a calibration from pictures alone does not have are
/// absent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageReports {
    /// What each recording held.
    pub recordings: Vec<RecordingReport>,
    /// Sections 1 to 4 of method.md.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detection: Option<DetectionReport>,
    /// Section 5.
    pub initial: InitialReport,
    /// How the camera model was chosen, where that was left to the program.
    pub model_choice: Option<ModelChoice>,
    /// Sections 6 to 11.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub trajectory: Option<TrajectoryStages>,
}

/// What the stages along trajectories took in and gave out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrajectoryStages {
    /// Section 6.
    pub segments: SegmentReport,
    /// Segments whose spline could not be fitted.
    pub segments_without_spline: usize,
    /// Sections 8 to 11, one entry a round.
    pub rounds: Vec<RoundReport>,
}

/// One event class: polarity, rank in the burst, and length of the burst.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EventClass {
    /// Darker or brighter.
    pub polarity: ClassPolarity,
    /// Rank in the burst, 0 for the first event; the last rank stands for all later ones.
    pub rank: u8,
    /// How many events the burst has.
    pub burst_length: BurstLength,
    /// What shifts its events from the edge, under the names of [`Bias::name`].
    #[serde(flatten, serialize_with = "write_biases", deserialize_with = "read_biases")]
    pub biases: Biases<f64>,
    /// Spread in pixels, for each of the ranges of normal speed.
    pub sigma: [f64; SPEED_RANGE_COUNT],
    /// Standard deviations of the biases, in the order of [`Bias::ALL`]; zero where one is held.
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
    /// All classes with their biases and standard deviations; none where the input is circle centres.
    fn of_calibration(events: &EventCalibration) -> Vec<Self> {
        if events.measured == Measured::CircleCentres {
            return Vec::new();
        }
        Self::all(&events.refined.state.bias, &events.trust.bias_sigma)
    }

    /// All classes with their biases and standard deviations.
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

/// Residuals of the observations that the final solve used.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Residuals {
    /// What is measured.
    pub measure: Measured,
    /// Number of observations.
    pub count: usize,
    /// Root mean square in pixels.
    pub rms: f64,
    /// Median of the absolute value in pixels.
    pub median: f64,
}

/// How sure a result is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UncertaintySummary {
    /// Covariance of the lens parameters, in the order of the model.
    pub covariance: Vec<Vec<f64>>,
    /// Variance over what it would be if all observations were independent.
    pub inflation: f64,
    /// Independent observations that would determine the camera as well.
    pub effective_observations: f64,
    /// Blocks of time that the inflation was found with.
    pub blocks: usize,
    /// Expected root mean square error of the projection over the sensor (px).
    pub projection_rms: f64,
    /// What it stays below with a probability of 95 % (px).
    pub projection_rms_95: f64,
    /// Greatest standard deviation of the projection (px).
    pub projection_max: f64,
    /// The pixel where it is greatest.
    pub projection_max_at: [f64; 2],
    /// What each cause adds to `projection_rms` (px); absent for pictures alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub projection_parts: Option<ProjectionParts>,
}

impl UncertaintySummary {
    fn new(trust: &Trust, events: Option<&EventTrust>) -> Self {
        let Trust { uncertainty, projection, .. } = trust;
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

/// Two calibrations from one half of the observations each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SplitHalfSummary {
    /// The two cameras.
    pub cameras: [CameraDescription; 2],
    /// Root mean square difference of their projections (px).
    pub difference_rms: f64,
    /// Greatest difference (px).
    pub difference_max: f64,
    /// The root mean square difference to expect (px).
    pub expected_rms: f64,
    /// What it stays below in 95 of 100 cases if the uncertainties are right (px).
    pub bound: f64,
    /// How well each half's camera explains the other half.
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

/// How far the lens model is from the lens.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MisfitSummary {
    /// Error of the projection over the sensor that the model brings (rms, px). It is part of the stated uncertainty.
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
    /// Recording it belongs to.
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
    /// The result of `calibrated`, seen on `board`, with advice as `wording` has it; without `command` and `input_files`.
    pub fn new(calibrated: &Calibrated, board: &Board, wording: Wording) -> Self {
        let camera = calibrated.camera();
        let names = camera.kind().parameter_names();
        let trust = &calibrated.trust;
        let events = calibrated.events();
        let sigma = Parameters::new(names.iter().copied().zip(trust.uncertainty.sigma()));
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
            verdict: calibrated.verdict.worded(wording),
            uncertainty: UncertaintySummary::new(trust, events.map(|events| &events.trust)),
            coverage: trust.coverage.clone(),
            split_half: events.and_then(|events| events.trust.split_half.as_ref().map(SplitHalfSummary::from)),
            residual_pattern: events.map(|events| events.trust.residuals.pattern),
            misfit: events.and_then(|events| events.trust.misfit.as_ref().map(MisfitSummary::from)),
            observed_radius: events.and_then(|events| events.trust.radius),
            sigma: CameraDescription { model: camera.kind().name().to_owned(), parameters: sigma },
            initial_camera: CameraDescription::new(&calibrated.initial().camera),
            covered_region: calibrated.covered_region().corners().iter().map(|&corner| corner.into()).collect(),
            board: board.to_string(),
            printed_board: events.map(|events| PrintedBoard::new(&events.trust.board)),
            event_classes: events.map_or_else(Vec::new, EventClass::of_calibration),
            residuals: Residuals::new(calibrated),
            segments: events.map_or_else(Vec::new, SegmentSummary::of_calibration),
            chosen_seconds: events.and_then(|events| events.choice.clone()),
            frames: FramesResult::new(calibrated),
            joint_frames: events.and_then(|events| events.joint.clone()),
            inertial: events.and_then(|events| events.inertial.as_ref()).map(InertialResult::new),
            second_cameras: events
                .map_or_else(Vec::new, |events| events.second_cameras.iter().map(SecondCameraResult::new).collect()),
            stages: StageReports::new(calibrated),
        }
    }
}

impl FramesResult {
    fn new(calibrated: &Calibrated) -> Option<Self> {
        match &calibrated.evidence {
            Evidence::Events(events) => events.witness.as_ref().map(|outcome| match outcome {
                WitnessOutcome::Witness(witness) => Self::Witness(Box::new(witness.comparison.clone())),
                WitnessOutcome::Failed(failure) => {
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
    use crate::solve::event_bias::{CLASS_COUNT, unknown};

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
