//! Hand-like motion of a camera before the board, smooth and known at any time.
//!
//! The motion is written in what the camera sees: where in the image the board's middle is, how
//! far away and how tilted and turned it is. Each of these six is a sum of two sinusoids with
//! frequencies and phases from the seed, bounded so that the circles stay in view while they reach
//! every edge of the sensor. A tremor of the hand comes on top. How fast the sinusoids run is set
//! such that the board's mean speed in the image is the stated one.

use evcal_core::sensor::Sensor;
use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::clock::{Interval, Ramps};
use super::rays::{Ray, Rays};
use super::view::View;
use crate::board::Board;
use crate::numerics::random::{uniform, uniform_in};

/// How the camera moves.
///
/// | preset | mean image speed |
/// |---|---|
/// | [`MotionSettings::slow`] | 150 px/s |
/// | [`MotionSettings::fast`] | 350 px/s |
/// | [`MotionSettings::interrupted`], [`MotionSettings::paused`] | 350 px/s while the camera moves |
/// | [`MotionSettings::blur`] | 700 px/s |
/// | [`MotionSettings::violent`] | 850 px/s, with jerks |
/// | [`MotionSettings::far`], [`MotionSettings::head_on`], [`MotionSettings::corner`] | 350 px/s |
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionSettings {
    /// Mean speed in the image of the board's points in view, in pixels per second, while the
    /// camera moves.
    pub mean_speed: f64,
    /// Relative rise and fall of the speed within two seconds, 0 to 0.9.
    pub speed_variation: f64,
    /// Size of the circle area relative to the shorter side of the image, from farthest to nearest
    /// (0.6 and 1: 0.6 m to 1 m for a lens of 330 px and a board of 0.45 m).
    pub fill: [f64; 2],
    /// Factor on the distance from the board.
    pub distance_scale: f64,
    /// Greatest angle between the line of sight and the board's normal, in degrees, below 80.
    pub tilt: f64,
    /// Greatest turn about the line of sight from `roll_offset` to each side, in degrees.
    pub roll: f64,
    /// Mean turn about the line of sight, in degrees.
    pub roll_offset: f64,
    /// How far the circle area may leave the image, as a share of the half field of view.
    pub overshoot: f64,
    /// Where in the image the board's middle is on average, right and down from the middle of the image, as
    /// a share of the half field of view.
    pub aim: [f64; 2],
    /// How much of the room that the image leaves the board's middle uses, 0 to 1.
    pub reach: f64,
    /// Amplitude of the tremor in degrees.
    pub tremor: f64,
    /// Spans in which the camera is held still; 0.2 s of slowing down and speeding up around them.
    pub pauses: Vec<Interval>,
    /// Spans in which the camera looks away; 0.8 s of turning around them.
    pub absences: Vec<Interval>,
}

impl MotionSettings {
    /// Slow sweeps: 150 px/s.
    pub fn slow() -> Self {
        Self {
            mean_speed: 150.0,
            speed_variation: 0.4,
            fill: [0.6, 1.0],
            distance_scale: 1.0,
            tilt: 45.0,
            roll: 50.0,
            roll_offset: 0.0,
            overshoot: 0.1,
            aim: [0.0, 0.0],
            reach: 1.0,
            tremor: 0.06,
            pauses: Vec::new(),
            absences: Vec::new(),
        }
    }

    /// Quick sweeps: 350 px/s.
    pub fn fast() -> Self {
        Self { mean_speed: 350.0, tremor: 0.1, ..Self::slow() }
    }

    /// Quick sweeps of 350 px/s with a pause in every three seconds, and a look away in every three
    /// seconds, up to `duration` seconds.
    pub fn interrupted(duration: f64) -> Self {
        let spans = |first: f64| {
            let starts = (0..).map(move |round| first + INTERRUPTION_PERIOD * f64::from(round));
            let starts = starts.take_while(|start| *start < duration);
            starts.map(|start| Interval { start, end: start + INTERRUPTION_LENGTH }).collect()
        };
        Self { pauses: spans(FIRST_PAUSE), absences: spans(FIRST_ABSENCE), ..Self::fast() }
    }

    /// Quick sweeps of 350 px/s with one pause of two seconds in the middle of `duration` seconds.
    pub fn paused(duration: f64) -> Self {
        let middle = 0.5 * duration;
        Self { pauses: vec![Interval { start: middle - 1.0, end: middle + 1.0 }], ..Self::fast() }
    }

    /// Quick sweeps two and a half times as far away: the board fills a third of the image.
    pub fn far() -> Self {
        Self { distance_scale: 2.6, ..Self::fast() }
    }

    /// Quick sweeps in which the board is hardly tilted.
    pub fn head_on() -> Self {
        Self { tilt: 8.0, ..Self::fast() }
    }

    /// Quick motion in the upper left corner of the image only.
    pub fn corner() -> Self {
        Self { fill: [0.35, 0.45], aim: [-0.45, -0.45], reach: 0.15, ..Self::fast() }
    }

    /// Sweeps that blur every picture: 700 px/s.
    pub fn blur() -> Self {
        Self { mean_speed: 700.0, tremor: 0.15, ..Self::slow() }
    }

    /// Shaking: 850 px/s on average, several times as fast at times, and a strong tremor.
    pub fn violent() -> Self {
        Self { mean_speed: 850.0, speed_variation: 0.55, tremor: 1.5, ..Self::slow() }
    }
}

/// Time from one pause, or one look away, to the next in seconds.
const INTERRUPTION_PERIOD: f64 = 3.0;
/// Length of a pause or a look away in seconds, without its ramps.
const INTERRUPTION_LENGTH: f64 = 0.3;
const FIRST_PAUSE: f64 = 0.6;
const FIRST_ABSENCE: f64 = 2.0;
const PAUSE_RAMP: f64 = 0.2;
const ABSENCE_RAMP: f64 = 0.8;
/// Frequency of the rise and fall of the speed in hertz.
const VARIATION_FREQUENCY: f64 = 0.5;
/// Columns and rows of the cells of the sensor in which image speeds are measured.
pub const SPEED_GRID: (u16, u16) = (18, 14);

/// A sum of two sinusoids, between -1 and 1.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Wave {
    parts: [(f64, f64, f64); 2],
}

impl Wave {
    fn new(frequency: f64, rng: &mut ChaCha8Rng) -> Self {
        let base = frequency * uniform_in(rng, 0.85, 1.15);
        let overtone = base * uniform_in(rng, 2.1, 2.9);
        Self { parts: [(0.75, base, uniform(rng)), (0.25, overtone, uniform(rng))] }
    }

    fn at(&self, phase: f64) -> f64 {
        let part = |&(amplitude, frequency, offset): &(f64, f64, f64)| {
            amplitude * libm::sin(std::f64::consts::TAU * (frequency * phase + offset))
        };
        self.parts.iter().map(part).sum()
    }
}

/// The motion of a camera, a function of time.
#[derive(Clone, Debug)]
pub struct Motion {
    settings: MotionSettings,
    middle: Vector3<f64>,
    half_size: Vector2<f64>,
    center: Vector2<f64>,
    half_view: Vector2<f64>,
    aim: [Wave; 2],
    distance: Wave,
    tilt: [Wave; 2],
    roll: Wave,
    tremor: [Wave; 3],
    /// Cycles of the fundamental waves per second.
    pace: f64,
    pauses: Ramps,
    absences: Ramps,
    /// Where a second camera is on the one that is moved: `T_first_second`.
    mount: Option<Isometry3<f64>>,
}

impl Motion {
    /// Motion before `board` of a camera with these `rays`, for a recording of `duration` seconds
    /// (over which the mean speed is set). Fails when the lens has no usable field of view.
    pub fn new(settings: &MotionSettings, board: &Board, rays: &Rays, duration: f64, seed: u64) -> Option<Self> {
        let (center, half_view) = field_of_view(rays)?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(MOTION_STREAM);
        let middle = board.middle();
        let half_size = (0..board.circle_count())
            .map(|index| (board.circle_center(index) - middle).abs())
            .fold(Vector2::zeros(), |half: Vector2<f64>, offset| half.sup(&offset))
            .add_scalar(board.radius);
        let mut wave = |frequency: f64| Wave::new(frequency, &mut rng);
        let mut motion = Self {
            settings: settings.clone(),
            middle: middle.push(0.0),
            half_size,
            center,
            half_view,
            aim: [wave(1.0), wave(0.77)],
            distance: wave(0.31),
            tilt: [wave(0.43), wave(0.57)],
            roll: wave(0.23),
            tremor: [wave(8.0), wave(9.0), wave(7.0)],
            pace: 0.5,
            pauses: Ramps::new(&settings.pauses, PAUSE_RAMP),
            absences: Ramps::new(&settings.absences, ABSENCE_RAMP),
            mount: None,
        };
        // Speed grows with the pace but for the tremor, and a short recording sees another part of
        // the path at another pace: a few rounds settle both.
        for _ in 0..8 {
            let speed = motion.mean_speed(board, rays, duration);
            if speed <= 0.0 {
                break;
            }
            motion.pace = (motion.pace * settings.mean_speed / speed).clamp(1e-3, 20.0);
        }
        Some(motion)
    }

    /// The motion of a second camera that is carried along, at `T_first_second`.
    pub fn carrying(&self, first_second: Isometry3<f64>) -> Self {
        Self { mount: Some(first_second), ..self.clone() }
    }

    /// How the camera moves.
    pub fn settings(&self) -> &MotionSettings {
        &self.settings
    }

    /// `T_world_camera` at `t` seconds: metres, board in the plane z = 0, camera at z < 0.
    pub fn pose(&self, t: f64) -> Isometry3<f64> {
        let moved = self.moved(t);
        self.mount.map_or(moved, |mount| moved * mount)
    }

    /// The pose of the camera that the hand moves.
    fn moved(&self, t: f64) -> Isometry3<f64> {
        let active = t - self.pauses.integral(t);
        let omega = std::f64::consts::TAU * VARIATION_FREQUENCY;
        let varied = active - self.settings.speed_variation / omega * libm::cos(omega * active);
        let phase = self.pace * varied;

        let [farthest, nearest] = self.settings.fill;
        let fill = 0.5 * (farthest + nearest) + 0.5 * (nearest - farthest) * self.distance.at(phase);
        let size = self.half_size.max();
        let distance = self.settings.distance_scale * size / libm::tan(fill * self.half_view.min());

        let roll = (self.settings.roll_offset + self.settings.roll * self.roll.at(phase)).to_radians();
        let (sine, cosine) = libm::sincos(roll);
        let extent = Vector2::new(
            libm::hypot(self.half_size.x * cosine, self.half_size.y * sine),
            libm::hypot(self.half_size.x * sine, self.half_size.y * cosine),
        );
        let aim = |axis: usize| {
            let room = self.half_view[axis] * (1.0 + self.settings.overshoot) - libm::atan(extent[axis] / distance);
            // A smooth max(room, 0).
            let amplitude = 0.5 * (room + libm::hypot(room, 0.02));
            let middle = self.center[axis] + self.settings.aim[axis] * self.half_view[axis];
            middle + self.settings.reach * amplitude * self.aim[axis].at(phase)
        };
        let away = self.half_view.x * 2.0 + 2.0 * libm::atan(self.half_size.norm() / distance) + 0.2;
        let azimuth = aim(0) + self.absences.level(t) * away.min(2.6);
        let elevation = aim(1);

        let tilt = Vector3::new(self.tilt[0].at(phase), self.tilt[1].at(phase), 0.0)
            * (self.settings.tilt.to_radians() * std::f64::consts::FRAC_1_SQRT_2);
        let tremor = Vector3::from_fn(|axis, _| self.settings.tremor.to_radians() * self.tremor[axis].at(active));

        let line_of_sight = Rotation3::new(tremor)
            * Rotation3::from_axis_angle(&Vector3::y_axis(), azimuth)
            * Rotation3::from_axis_angle(&Vector3::x_axis(), -elevation);
        let board_turn = Rotation3::from_axis_angle(&Vector3::z_axis(), roll) * Rotation3::new(tilt);
        let rotation = line_of_sight * board_turn;
        let translation = line_of_sight * Vector3::new(0.0, 0.0, distance) - rotation * self.middle;
        Isometry3::from_parts(Translation3::from(translation), UnitQuaternion::from_rotation_matrix(&rotation))
            .inverse()
    }

    /// Mean speed in pixels per second of the board's points in view, over the time in which the
    /// camera neither pauses nor looks away. Zero when the board is never in view.
    pub fn mean_speed(&self, board: &Board, rays: &Rays, duration: f64) -> f64 {
        const TIMES: u32 = 300;
        let (mut sum, mut count) = (0.0, 0u32);
        for step in 0..TIMES {
            let t = duration * (f64::from(step) + 0.5) / f64::from(TIMES);
            if self.pauses.level(t) > 0.0 || self.absences.level(t) > 0.0 {
                continue;
            }
            for (point, speed) in image_speeds(|t| self.pose(t), rays, t).into_iter().flatten() {
                let offset = point - board.middle();
                if offset.x.abs() < self.half_size.x && offset.y.abs() < self.half_size.y {
                    sum += speed;
                    count += 1;
                }
            }
        }
        if count == 0 { 0.0 } else { sum / f64::from(count) }
    }
}

/// How fast the board plane passes the image at time `t`, in pixels per second, and at which of its points, where `pose` is
/// `T_world_camera`: in the middle of each cell of [`SPEED_GRID`], row by row. `None` where a pixel does not look at the
/// plane.
pub fn image_speeds(pose: impl Fn(f64) -> Isometry3<f64>, rays: &Rays, t: f64) -> Vec<Option<(Vector2<f64>, f64)>> {
    const STEP: f64 = 1e-4;
    let before = View::new(&pose(t - STEP));
    let after = View::new(&pose(t + STEP));
    let (columns, rows) = SPEED_GRID;
    let speed = |ray: &Ray| {
        let from = before.gaze(ray)?;
        let to = after.gaze(ray)?;
        let motion = before.jacobian(ray, &from).try_inverse()? * (to.point - from.point);
        Some((from.point, motion.norm() / (2.0 * STEP)))
    };
    rays.grid(columns, rows).map(|ray| speed(ray?)).collect()
}

/// The stream of random numbers that draws the motion; rows of pixels use the streams from 0.
const MOTION_STREAM: u64 = u64::MAX;

/// Azimuth and elevation of the middle of the field of view, and half its width and height, in
/// radians, along the sensor's middle row and column.
fn field_of_view(rays: &Rays) -> Option<(Vector2<f64>, Vector2<f64>)> {
    let Sensor { width, height } = rays.sensor();
    let azimuths =
        (0..width).filter_map(|x| rays.get(x, height / 2)).map(|ray| libm::atan2(ray.bearing.x, ray.bearing.z));
    let elevations = (0..height)
        .filter_map(|y| rays.get(width / 2, y))
        .map(|ray| libm::atan2(ray.bearing.y, libm::hypot(ray.bearing.x, ray.bearing.z)));
    let (left, right) = range(azimuths);
    let (top, bottom) = range(elevations);
    let half = 0.5 * Vector2::new(right - left, bottom - top);
    // Beyond this half angle a flat board cannot fill the image; the motion need not either.
    const WIDEST: f64 = 1.2;
    (half.x > 0.01 && half.y > 0.01)
        .then(|| (0.5 * Vector2::new(right + left, bottom + top), half.map(|angle| angle.min(WIDEST))))
}

fn range(angles: impl Iterator<Item = f64>) -> (f64, f64) {
    angles.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), angle| (low.min(angle), high.max(angle)))
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::simulate::tests::{board, kannala_brandt, radtan};

    const SIZE: Sensor = Sensor::new(346, 260);

    fn presets() -> [(MotionSettings, f64); 3] {
        [(MotionSettings::slow(), 150.0), (MotionSettings::fast(), 350.0), (MotionSettings::blur(), 700.0)]
    }

    #[test]
    fn presets_keep_their_speed_and_the_board_in_view() {
        let board = board();
        for (camera, nearest, farthest) in [(radtan(), 0.5, 1.1), (kannala_brandt(), 0.25, 0.6)] {
            let rays = Rays::new(&camera, SIZE);
            for (settings, speed) in presets() {
                let duration = 10.0;
                let motion = Motion::new(&settings, &board, &rays, duration, 4).unwrap();
                let mean = motion.mean_speed(&board, &rays, duration);
                assert!((mean - speed).abs() < 0.02 * speed, "{mean} px/s, not {speed}");
                let (mut seen, mut all) = (0, 0);
                let mut cells = [false; 48];
                let mut steepest = 0.0f64;
                for step in 0..1000 {
                    let pose = motion.pose(f64::from(step) * 0.01);
                    steepest = steepest.max((pose.rotation * Vector3::z()).z.acos().to_degrees());
                    let distance = (pose.translation.vector - motion.middle).norm();
                    assert!((nearest..farthest).contains(&distance), "{distance} m");
                    assert!(pose.translation.z < 0.0);
                    for index in 0..board.circle_count() {
                        let center = board.circle_center(index);
                        let point = pose.inverse() * Point3::new(center.x, center.y, 0.0);
                        all += 1;
                        let pixel = camera.project(&point.coords).filter(|pixel| {
                            (0.0..346.0).contains(&pixel.x) && (0.0..260.0).contains(&pixel.y) && point.z > 0.0
                        });
                        if let Some(pixel) = pixel {
                            seen += 1;
                            cells[(pixel.y / 260.0 * 6.0) as usize * 8 + (pixel.x / 346.0 * 8.0) as usize] = true;
                        }
                    }
                }
                assert!(f64::from(seen) > 0.85 * f64::from(all), "{seen} of {all} circles in view");
                assert!(cells.iter().filter(|cell| **cell).count() >= 46, "{cells:?}");
                println!("{speed} px/s: {seen} of {all} circles, steepest line of sight {steepest:.0} deg");
            }
        }
    }

    #[test]
    fn the_tilt_stays_within_its_limit() {
        let board = board();
        let rays = Rays::new(&radtan(), SIZE);
        let settings = MotionSettings { tremor: 0.0, ..MotionSettings::fast() };
        let motion = Motion::new(&settings, &board, &rays, 20.0, 9).unwrap();
        let angles = (0..2000).map(|step| {
            let pose = motion.pose(f64::from(step) * 0.01);
            // The line of sight that the tilt is measured from goes to the middle of the board.
            let sight = (motion.middle - pose.translation.vector).normalize();
            sight.z.acos().to_degrees()
        });
        let steepest = angles.fold(0.0, f64::max);
        assert!(steepest < 45.0 && steepest > 30.0, "{steepest}");
    }

    #[test]
    fn a_pause_is_still_and_an_absence_sees_nothing() {
        let board = board();
        let camera = radtan();
        let rays = Rays::new(&camera, SIZE);
        let settings = MotionSettings {
            pauses: vec![Interval { start: 1.0, end: 1.5 }],
            absences: vec![Interval { start: 4.0, end: 4.5 }],
            ..MotionSettings::fast()
        };
        let motion = Motion::new(&settings, &board, &rays, 6.0, 4).unwrap();
        let still = motion.pose(1.0);
        for step in 0..=50 {
            let pose = motion.pose(1.0 + 0.01 * f64::from(step));
            assert!((pose.translation.vector - still.translation.vector).norm() < 1e-12);
            assert!(pose.rotation.angle_to(&still.rotation) < 1e-12);
        }
        assert!((motion.pose(0.79).translation.vector - motion.pose(0.81).translation.vector).norm() > 1e-4);
        for step in 0..=50 {
            let view = View::new(&motion.pose(4.0 + 0.01 * f64::from(step)));
            let seen = rays.grid(40, 30).flatten().filter_map(|ray| view.gaze(ray)).filter(|gaze| {
                let offset = gaze.point - board.middle();
                offset.x.abs() < 0.27 && offset.y.abs() < 0.3
            });
            assert_eq!(seen.count(), 0);
        }
    }

    #[test]
    fn the_motion_is_smooth() {
        let board = board();
        let rays = Rays::new(&kannala_brandt(), SIZE);
        let settings = MotionSettings {
            pauses: vec![Interval { start: 0.5, end: 0.8 }],
            absences: vec![Interval { start: 2.0, end: 2.1 }],
            ..MotionSettings::blur()
        };
        let motion = Motion::new(&settings, &board, &rays, 3.0, 1).unwrap();
        let h = 1e-4;
        let position = |t: f64| motion.pose(t).translation.vector;
        let acceleration = |t: f64| (position(t + h) - 2.0 * position(t) + position(t - h)) / (h * h);
        // A jump of position, velocity or acceleration would stand out between samples 0.1 ms apart.
        for step in 10..30_000 {
            let t = f64::from(step) * 1e-4;
            let change = (acceleration(t + 1e-4) - acceleration(t)).norm();
            assert!(change < 5.0, "{change} m/s² at {t}");
        }
    }

    #[test]
    fn other_seeds_move_otherwise() {
        let rays = Rays::new(&radtan(), SIZE);
        let pose = |seed: u64| Motion::new(&MotionSettings::fast(), &board(), &rays, 2.0, seed).unwrap().pose(1.0);
        assert_eq!(pose(1), pose(1));
        assert!((pose(1).translation.vector - pose(2).translation.vector).norm() > 1e-3);
    }
}
