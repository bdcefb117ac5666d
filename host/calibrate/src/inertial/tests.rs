//! Circles and samples of a known motion: parameters that it determines are found within their σ, and the others are reported.

use evcal_core::camera::{Camera, MAX_PARAMETERS, ModelKind};
use evcal_core::spline::rotation::exp;
use nalgebra::{DMatrix, Isometry3, Matrix3, Vector2, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::parameters::{GYROSCOPE_DELAY, InertialParameters, POSITION};
use super::prediction::{accelerometer, gyroscope};
use super::*;
use crate::quality::verdict::{Cause, Grade};
use evcal_detection::circles::reference_frame::PointObservation;
use evcal_geometry::board::shape::{BoardShape, CircleArea};
use evcal_geometry::numerics::random::{normal, uniform_in};
use evcal_geometry::timed_pose::TimedPose;
use evcal_solve::solve::observation::SegmentObservations;
use evcal_solve::solve::residual_statistics::ResidualStatistics;
use evcal_solve::solve::rows::board_edge::BoardEdges;
use evcal_solve::solve::rows::event_bias::bias::Biases;
use evcal_solve::solve::rows::event_bias::{CLASS_COUNT, unknown};
use evcal_solve::solve::{BOARD_PARAMETERS, FreeParameters, HUBER, ITERATIONS, Problem, ResidualMeasure, State};
use evcal_solve::trajectory::RotationSpline;
use evcal_solve::trajectory::fit::{TrajectoryShape, fit};

const SECONDS: f64 = 12.0;
/// Circle frames per second.
const FRAMES: f64 = 100.0;
/// Samples per second.
const SAMPLES: f64 = 250.0;
/// Scatter of a circle's centre (px).
const PIXEL: f64 = 0.1;
/// Scatter of the gyroscope (rad/s).
const GYROSCOPE: f64 = 3e-3;
/// Scatter of the accelerometer (m/s²).
const ACCELEROMETER: f64 = 0.05;

/// A smooth function that does not repeat, approximately between −1 and 1.
struct Wave([(f64, f64); 3]);

impl Wave {
    fn new(random: &mut ChaCha8Rng) -> Self {
        Self(
            [0.35, 0.8, 1.6]
                .map(|f| (std::f64::consts::TAU * f * uniform_in(random, 0.8, 1.25), uniform_in(random, 0.0, 6.3))),
        )
    }

    fn at(&self, t: f64) -> f64 {
        self.0
            .iter()
            .zip([0.5, 0.35, 0.25])
            .map(|((frequency, phase), size)| size * (frequency * t + phase).sin())
            .sum()
    }
}

/// `T_world_camera` in front of the board: moved by up to 0.15 m, and rotated by `turn`.
fn motion(seed: u64, turn: impl Fn(&[Wave; 3], f64) -> Vector3<f64>) -> impl Fn(f64) -> Isometry3<f64> {
    motion_within(0.15, seed, turn)
}

/// The same, moved by up to `reach` metres.
fn motion_within(
    reach: f64,
    seed: u64,
    turn: impl Fn(&[Wave; 3], f64) -> Vector3<f64>,
) -> impl Fn(f64) -> Isometry3<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let [turns, places] = [0, 1].map(|_| [0; 3].map(|_| Wave::new(&mut random)));
    move |t| {
        let place = Vector3::new(places[0].at(t), places[1].at(t), places[2].at(t)) * reach;
        Isometry3::from_parts((place - Vector3::z() * 0.7).into(), exp(&turn(&turns, t)))
    }
}

/// Rotations of this size about the three axes (rad).
fn turned(sizes: [f64; 3]) -> impl Fn(&[Wave; 3], f64) -> Vector3<f64> {
    move |waves, t| Vector3::from_fn(|axis, _| sizes[axis] * waves[axis].at(t))
}

fn camera() -> Camera<f64> {
    Camera::from_parameters(ModelKind::Radtan4, &[330.0, 330.0, 172.5, 129.5, 0.0, 0.0, 0.0, 0.0]).unwrap()
}

/// An IMU next to the camera.
fn unit() -> InertialParameters {
    InertialParameters {
        rotation: exp(&Vector3::new(0.02, -0.01, 0.015)),
        position: Vector3::new(0.003, -0.002, -0.02),
        gyroscope_delay: 2.9e-3,
        accelerometer_delay: 1.9e-3,
        gyroscope_bias: Vector3::new(0.02, -0.01, 0.005),
        accelerometer_bias: Vector3::new(0.1, -0.2, 0.05),
        accelerometer_matrix: Matrix3::new(1.01, 0.0, 0.0, 0.005, 0.99, 0.0, -0.01, 0.005, 1.005),
        ..InertialParameters::perfect(Vector3::new(0.3, 9.7, 1.0).normalize() * STANDARD_GRAVITY, 0.5 * SECONDS)
    }
}

/// Circles and samples along a motion.
struct Bench {
    refined: Refined,
    uncertainty: Uncertainty,
    samples: Vec<Sample>,
}

impl Bench {
    fn new(seed: u64, pose: impl Fn(f64) -> Isometry3<f64>) -> Self {
        Self::with_nominal_size(1.0, seed, pose)
    }

    /// A board whose nominal size is `nominal` times the true one.
    fn with_nominal_size(nominal: f64, seed: u64, pose: impl Fn(f64) -> Isometry3<f64>) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(1000 + seed);
        let poses: Vec<TimedPose> = (0..=(200.0 * SECONDS) as usize)
            .map(|index| index as f64 / 200.0)
            .map(|t| TimedPose { t, pose: pose(t) })
            .collect();
        let seen = |timed: &TimedPose| {
            let place = timed.pose.translation.vector * nominal;
            TimedPose { pose: Isometry3::from_parts(place.into(), timed.pose.rotation), ..*timed }
        };
        let seen: Vec<TimedPose> = poses.iter().map(seen).collect();
        let shape = TrajectoryShape { degree: 3, rotation: RotationSpline::Quaternion, knot_spacing: 0.015 };
        let trajectory = fit(0, &seen, 0.0, SECONDS, &shape).unwrap();
        let moved = fit(0, &poses, 0.0, SECONDS, &shape).unwrap();
        let smooth = solve::smooth_trajectories(&[moved], 0.01).unwrap().remove(0);
        let centers: Vec<[f64; 2]> =
            (0..36).map(|index| [0.05 * f64::from(index % 9) - 0.2, 0.05 * f64::from(index / 9) - 0.075]).collect();
        let mut points = Vec::new();
        for index in 1..(FRAMES * SECONDS) as usize {
            let t = index as f64 / FRAMES;
            for (circle, &[x, y]) in centers.iter().enumerate() {
                let point = pose(t).inverse_transform_point(&[x, y, 0.0].into());
                let pixel = camera().project(&point.coords).unwrap();
                let noise = Vector2::from_fn(|_, _| PIXEL * normal(&mut random));
                points.push(PointObservation { t, pixel: pixel + noise, circle });
            }
        }
        let unit = unit();
        let mut noisy = |value: Vector3<f64>, size: f64| value + Vector3::from_fn(|_, _| size * normal(&mut random));
        let sample = |index: usize| {
            let t = 0.01 + index as f64 / SAMPLES;
            Some(Sample {
                t,
                acceleration: noisy(accelerometer(&smooth, &unit, t)?.value, ACCELEROMETER),
                angular_velocity: noisy(gyroscope(&smooth, &unit, t)?.value, GYROSCOPE),
            })
        };
        let samples = (0..(SAMPLES * (SECONDS - 0.02)) as usize).filter_map(sample).collect();
        let problem = Problem {
            sensor: (346, 260).into(),
            edges: BoardEdges::Rims(Vec::new()),
            points: centers.iter().map(|center| center.map(|along| along * nominal)).collect(),
            area: CircleArea { middle: [0.0; 2], half: [0.2, 0.075] },
            mean_scale: 1.0,
            point_sigma: PIXEL,
            associated_latencies: [0.0; CLASS_COUNT],
            segments: vec![SegmentObservations { points, ..Default::default() }],
            stiffness: Vec::new(),
            free: FreeParameters {
                intrinsics: std::array::from_fn::<_, MAX_PARAMETERS, _>(|index| index < 4),
                board: [false; BOARD_PARAMETERS],
                biases: [Biases::default(); CLASS_COUNT],
            },
            residual: ResidualMeasure::Pixel,
            huber: HUBER,
            iterations: ITERATIONS,
        };
        let state = State {
            camera: camera(),
            board: BoardShape { print_ratio: 1.0, bend: [0.0; 2], radius: 0.0175 },
            bias: unknown(0.3),
            trajectories: vec![trajectory],
        };
        let sigma: [f64; 8] = [0.05, 0.05, 0.05, 0.05, 1e-3, 1e-3, 1e-4, 1e-4];
        Self {
            refined: Refined {
                state,
                problem,
                residuals: ResidualStatistics::default(),
                events: Vec::new(),
                left_out: Vec::new(),
                rounds: Vec::new(),
            },
            uncertainty: Uncertainty {
                covariance: DMatrix::from_diagonal(&sigma.map(|one| one * one).to_vec().into()),
                systematic: DMatrix::zeros(sigma.len(), sigma.len()),
                systematic_scale: 0.0,
                inflation: 1.0,
                observations: 1,
                blocks: 1,
            },
            samples,
        }
    }

    fn calibrated(&self, fixed: Option<&FixedIntrinsics>) -> Result<InertialCalibration, InertialError> {
        self.calibrated_without(fixed, Vec::new())
    }

    /// Calibrates a recording with `lost` parts.
    fn calibrated_without(
        &self,
        fixed: Option<&FixedIntrinsics>,
        lost: Vec<String>,
    ) -> Result<InertialCalibration, InertialError> {
        let recorded = RecordedSamples { recording: 0, samples: self.samples.clone(), start: 0.0, lost };
        let settings = InertialSettings { gravity: STANDARD_GRAVITY, ..InertialSettings::default() };
        calibrate_unit(vec![recorded], &self.refined, &self.uncertainty, fixed, &settings)
    }
}

const STANDARD_GRAVITY: f64 = evcal_geometry::numerics::gravity::STANDARD_GRAVITY;

#[test]
fn a_full_motion_has_no_findings() {
    for seed in 1..=4 {
        let found = Bench::new(seed, motion(seed, turned([0.45, 0.5, 0.45]))).calibrated(None).unwrap();
        assert_eq!(found.findings, [], "seed {seed}");
        let error = found.parameters.position - unit().position;
        let sigma = Vector3::from_fn(|axis, _| found.sigma(POSITION + axis));
        assert!(error.component_div(&sigma).amax() < 4.5 && sigma.amax() < 2e-3, "seed {seed}: {error} ± {sigma}");
        assert!(found.parameters.rotation.angle_to(&unit().rotation) < 5e-3, "seed {seed}");
    }
}

fn causes(found: &InertialCalibration) -> Vec<Cause> {
    found.findings.iter().map(|finding| finding.cause).collect()
}

fn grade(found: &InertialCalibration) -> Grade {
    Grade::of(found.findings.iter().map(|finding| finding.severity))
}

/// Lost samples must be reported.
#[test]
fn lost_samples_are_reported() {
    let bench = Bench::new(1, motion(1, turned([0.45, 0.5, 0.45])));
    let what = "IMU samples from here on: a.aedat4, byte 12".to_owned();
    let found = bench.calibrated_without(None, vec![what.clone()]).unwrap();
    assert_eq!(causes(&found), [Cause::DamagedSamples]);
    assert_eq!(grade(&found), Grade::Good);
    let finding = found.findings[0].to_string();
    assert!(finding.contains("damaged") && finding.contains("a.aedat4, byte 12"), "{finding}");
}

/// Drivers that read several samples at once give all of them one timestamp.
#[test]
fn samples_that_share_timestamps_are_used_and_leave_the_delay_open() {
    let mut bench = Bench::new(1, motion(1, turned([0.45, 0.5, 0.45])));
    let own = bench.calibrated(None).unwrap();
    let all = bench.samples.clone();
    for size in [2, 4, 8] {
        bench.samples = all.clone();
        for group in bench.samples.chunks_mut(size) {
            // The driver stamps a group when it has read it.
            let stamp = group.last().map_or(0.0, |last| last.t) + 1e-3;
            group.iter_mut().for_each(|sample| sample.t = stamp);
        }
        let found = bench.calibrated(None).unwrap();
        assert_eq!((causes(&found), found.used), (vec![Cause::SharedTimestamps], own.used), "{size}");
        assert!(found.findings[0].reason.starts_with(&size.to_string()), "{}", found.findings[0]);
        assert_eq!(grade(&found), Grade::Usable);
        let delay = found.parameters.gyroscope_delay;
        assert!((delay - own.parameters.gyroscope_delay - 1e-3).abs() < 1e-4, "{size}: {delay}");
        // Whichever of its samples a timestamp belongs to.
        assert!(found.sigma(GYROSCOPE_DELAY) >= size as f64 / SAMPLES);
        let moved = found.parameters.position - own.parameters.position;
        assert!(moved.norm() < 1e-3 && found.parameters.rotation.angle_to(&own.parameters.rotation) < 2e-3, "{moved}");
    }
}

#[test]
fn a_degenerate_motion_is_refused_or_flagged() {
    let refused = |turn: &dyn Fn(&[Wave; 3], f64) -> Vector3<f64>, words: &str| {
        let error = Bench::new(5, motion(5, turn)).calibrated(None).err().map(|error| error.to_string());
        assert!(error.as_ref().is_some_and(|error| error.contains(words)), "wanted {words:?}: {error:?}");
    };
    refused(&|_, _| Vector3::zeros(), "rotated by only 0.0 °/s");
    for (axis, name) in ["x axis", "y axis", "z axis"].into_iter().enumerate() {
        let only = move |waves: &[Wave; 3], t: f64| Vector3::ith(axis, 0.6 * waves[axis].at(t));
        refused(&only, &format!("about one axis only, its {name}"));
    }
    refused(&|_, t| Vector3::y() * (0.3 * t - 1.8) * 0.2, "rotated by 3.4 °/s all the time");
}

/// At 20 samples per second, the readings miss the motion between the samples, so the recording is rejected because of
/// its rate.
#[test]
fn samples_that_come_too_slowly_are_refused_by_their_rate() {
    let mut bench = Bench::new(1, motion(1, turned([0.45, 0.5, 0.45])));
    let every = |samples: &[Sample], step: usize| samples.iter().step_by(step).copied().collect::<Vec<_>>();
    let all = bench.samples.clone();
    for (step, rate) in [(10, "25"), (12, "21")] {
        bench.samples = every(&all, step);
        let error = bench.calibrated(None).unwrap_err().to_string();
        assert!(error.contains(&format!("has {rate} samples per second")), "{error}");
    }
    bench.samples = every(&all, 5);
    let found = bench.calibrated(None).unwrap();
    let error = found.parameters.position - unit().position;
    let sigma = Vector3::from_fn(|axis, _| found.sigma(POSITION + axis));
    assert!(error.component_div(&sigma).amax() < 4.5, "{error} ± {sigma}");
}

#[test]
fn little_tilt_and_motion_do_not_determine_the_scale_of_the_accelerometer() {
    let found = Bench::new(6, motion_within(0.0, 6, turned([0.12; 3]))).calibrated(None).unwrap();
    assert!(causes(&found).contains(&Cause::AccelerometerNotMeasured), "{:?}", found.findings);
    assert!(!found.is_measured(parameters::ACCELEROMETER_MATRIX..parameters::ACCELEROMETER_MATRIX + 6));
}

/// Quick motion determines the scale of the accelerometer without tilt, but hardly separates gravity from its bias.
#[test]
fn a_camera_that_was_hardly_tilted_is_reported() {
    let found = Bench::new(9, motion(9, turned([0.12; 3]))).calibrated(None).unwrap();
    assert!(causes(&found).contains(&Cause::HardlyTilted), "{:?}", found.findings);
    let (tilt, sigma) =
        (found.tilt, (0..3).map(|axis| found.sigma(parameters::ACCELEROMETER_BIAS + axis)).fold(0.0, f64::max));
    // 0.12 rad about each of two axes at most, relative to the mean of the motion.
    assert!((0.08..0.2).contains(&tilt), "{tilt}");
    let error = (found.parameters.accelerometer_bias - unit().accelerometer_bias).amax();
    assert!(error < 4.5 * sigma, "{error} ± {sigma}");
}

/// A focal length that is fixed slightly too long moves the IMU away; σ includes this if the σ of the focal length is known.
#[test]
fn the_uncertainty_of_fixed_intrinsics_is_part_of_sigma() {
    let mut bench = Bench::new(7, motion(7, turned([0.45, 0.5, 0.45])));
    let off = 2e-3;
    let (true_camera, mut parameters) = (camera(), camera().parameters());
    parameters.iter_mut().take(2).for_each(|focal| *focal *= 1.0 + off);
    let long = Camera::from_parameters(ModelKind::Radtan4, &parameters).unwrap();
    let mut covariance = DMatrix::zeros(8, 8);
    covariance.view_mut((0, 0), (2, 2)).fill((330.0 * off).powi(2));
    let fixed = |camera, covariance| {
        let found = bench.calibrated(Some(&FixedIntrinsics { camera, covariance })).unwrap();
        assert_eq!(found.fixed, Some(camera));
        found
    };
    let [right, wrong, known] = [fixed(true_camera, None), fixed(long, None), fixed(long, Some(covariance.clone()))];
    let place = POSITION + 2;
    let error = |found: &InertialCalibration| (found.parameters.position.z - unit().position.z).abs();
    assert!(error(&right) < 4.5 * right.sigma(place), "{} ± {}", error(&right), right.sigma(place));
    let shift = (wrong.parameters.position.z - right.parameters.position.z).abs();
    assert!(shift > 5.0 * wrong.sigma(place), "{shift} ± {}", wrong.sigma(place));
    assert_eq!(known.parameters.position, wrong.parameters.position);
    let share = (known.sigma(place).powi(2) - wrong.sigma(place).powi(2)).sqrt();
    assert!((share / shift - 1.0).abs() < 0.1, "{share} {shift}");
    assert!(causes(&wrong).contains(&Cause::OtherCamera), "{:?}", wrong.findings);
    // The same error of estimated intrinsics, if it is common to all events.
    let free = bench.calibrated(None).unwrap();
    bench.uncertainty.systematic = covariance;
    let common = bench.calibrated(None).unwrap();
    assert_eq!(common.parameters, free.parameters);
    let share = (common.sigma(place).powi(2) - free.sigma(place).powi(2)).sqrt();
    assert!((share / shift - 1.0).abs() < 0.1, "{share} {shift}");
}

#[test]
fn a_board_of_another_size_than_nominal_is_reported() {
    let found = Bench::with_nominal_size(1.01, 8, motion(8, turned([0.45, 0.5, 0.45]))).calibrated(None).unwrap();
    assert_eq!(causes(&found), [Cause::BoardSpacing]);
    let (scale, sigma) = (found.parameters.board_scale, found.sigma(parameters::BOARD_SCALE));
    assert!((scale - 1.0 / 1.01).abs() < 3e-3 && sigma < 3.5e-3, "{scale} ± {sigma}");
}
