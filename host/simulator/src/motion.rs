//! Hand-like motion of a camera in front of the board, smooth and defined at any time.
//!
//! The motion is defined in terms of the image: the position of the board's middle, its distance, its tilt and its
//! rotation. Each of these six is a sum of two sinusoids with frequencies and phases from the seed, bounded so that the
//! print stays in view while it reaches every edge of the sensor. A tremor of the hand is added. The frequency of the
//! sinusoids is chosen such that the board's mean speed in the image has the required value. A degenerate motion, for
//! example one without rotation, has the same positions of the board in the image, but its rotation is determined by a
//! [`Turning`].

mod settings;
mod turning;

pub use settings::MotionSettings;
pub use turning::Turning;

use evcal_core::sensor::Sensor;
use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::clock::Ramps;
use super::rays::{Ray, Rays};
use super::view::View;
use evcal_geometry::board::Board;
use evcal_geometry::numerics::random::{uniform, uniform_in};

const PAUSE_RAMP: f64 = 0.2;
const ABSENCE_RAMP: f64 = 0.8;
/// Frequency of the speed variation in hertz.
const VARIATION_FREQUENCY: f64 = 0.5;
/// Columns and rows of the cells of the sensor in which image speeds are measured.
pub const SPEED_GRID: (u16, u16) = (18, 14);

#[derive(Clone, Copy, Debug, PartialEq)]
struct Sinusoid {
    amplitude: f64,
    frequency: f64,
    /// Phase at the start, in cycles, 0 to 1.
    offset: f64,
}

/// A sum of two sinusoids, between -1 and 1.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Wave {
    parts: [Sinusoid; 2],
}

impl Wave {
    fn new(frequency: f64, rng: &mut ChaCha8Rng) -> Self {
        let base = frequency * uniform_in(rng, 0.85, 1.15);
        let overtone = base * uniform_in(rng, 2.1, 2.9);
        let mut part = |amplitude, frequency| Sinusoid { amplitude, frequency, offset: uniform(rng) };
        Self { parts: [part(0.75, base), part(0.25, overtone)] }
    }

    fn at(&self, phase: f64) -> f64 {
        let part = |&Sinusoid { amplitude, frequency, offset }: &Sinusoid| {
            amplitude * libm::sin(std::f64::consts::TAU * (frequency * phase + offset))
        };
        self.parts.iter().map(part).sum()
    }
}

/// The motion of a camera as a function of time.
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
    /// Cycles of the fundamental sinusoids per second.
    pace: f64,
    pauses: Ramps,
    absences: Ramps,
    /// Pose of a second camera on the moving one: `T_first_second`.
    mount: Option<Isometry3<f64>>,
}

impl Motion {
    /// Creates the motion in front of `board` of a camera with these `rays`, for a recording of `duration` seconds
    /// (over which the mean speed is set). Returns `None` if the lens has no usable field of view.
    pub fn new(settings: &MotionSettings, board: &Board, rays: &Rays, duration: f64, seed: u64) -> Option<Self> {
        let (center, half_view) = field_of_view(rays)?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(MOTION_STREAM);
        let middle = board.middle();
        let half_size = match board {
            Board::Circles(board) => (0..board.circle_count())
                .map(|index| (board.circle_center(index) - middle).abs())
                .fold(Vector2::zeros(), |half: Vector2<f64>, offset| half.sup(&offset))
                .add_scalar(board.radius),
            Board::Squares(board) => {
                let bounds = board.bounds();
                0.5 * (Vector2::from(bounds.high) - Vector2::from(bounds.low))
            }
        };
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
        // The speed is not exactly proportional to the pace, because of the tremor, and because the pace of a short
        // recording determines how much of the path the camera covers. A few iterations converge.
        for _ in 0..8 {
            let speed = motion.mean_speed(board, rays, duration);
            if speed <= 0.0 {
                break;
            }
            motion.pace = (motion.pace * settings.mean_speed / speed).clamp(1e-3, 20.0);
        }
        Some(motion)
    }

    /// Returns the motion of a second camera that is fixed to the first at `T_first_second`.
    pub fn carrying(&self, first_second: Isometry3<f64>) -> Self {
        Self { mount: Some(first_second), ..self.clone() }
    }

    /// Returns the settings.
    pub fn settings(&self) -> &MotionSettings {
        &self.settings
    }

    /// Returns `T_world_camera` at `t` seconds: metres, board in the plane z = 0, camera at z < 0.
    pub fn pose(&self, t: f64) -> Isometry3<f64> {
        let moved = self.moved(t);
        self.mount.map_or(moved, |mount| moved * mount)
    }

    /// Returns the pose of the camera that the hand moves.
    fn moved(&self, t: f64) -> Isometry3<f64> {
        let active = t - self.pauses.integral(t);
        let omega = std::f64::consts::TAU * VARIATION_FREQUENCY;
        let varied = active - self.settings.speed_variation / omega * libm::cos(omega * active);
        let phase = self.pace * self.settings.period.map_or(varied, |period| to_and_fro(varied, period));

        let [farthest, nearest] = self.settings.fill;
        let fill = 0.5 * (farthest + nearest) + 0.5 * (nearest - farthest) * self.distance.at(phase);
        let size = self.half_size.max();
        let distance = self.settings.distance_scale * size / libm::tan(fill * self.half_view.min());

        let own_turn =
            self.settings.turning.rotation(active, [self.tilt[0], self.tilt[1], self.roll].map(|wave| wave.at(phase)));
        let roll = match own_turn {
            Some(turn) => libm::atan2(turn[(1, 0)], turn[(0, 0)]),
            None => (self.settings.roll_offset + self.settings.roll * self.roll.at(phase)).to_radians(),
        };
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
        let rotation = own_turn.unwrap_or(line_of_sight * board_turn);
        let translation = line_of_sight * Vector3::new(0.0, 0.0, distance) - rotation * self.middle;
        Isometry3::from_parts(Translation3::from(translation), UnitQuaternion::from_rotation_matrix(&rotation))
            .inverse()
    }

    /// Returns the mean speed in pixels per second of the board's points in view, over the time in which the camera
    /// neither pauses nor looks away. Zero if the board is never in view.
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

/// Returns a time that runs back and forth with this `period`, as fast as `t` in the middle of each sweep.
fn to_and_fro(t: f64, period: f64) -> f64 {
    let omega = std::f64::consts::TAU / period;
    libm::sin(omega * t) / omega
}

/// For the pixel in the middle of each cell of [`SPEED_GRID`], row by row, returns the point of the board plane that
/// the pixel sees at time `t` and the image speed of the plane there, in pixels per second. `pose` returns
/// `T_world_camera`. `None` for a pixel that does not see the plane.
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

/// Stream of random numbers for the motion; rows of pixels use the streams from 0.
const MOTION_STREAM: u64 = u64::MAX;

/// Returns azimuth and elevation of the middle of the field of view, and half its width and height, in radians, along
/// the sensor's middle row and column.
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
    // Beyond this half angle a flat board cannot fill the image, so the motion need not do so either.
    const WIDEST: f64 = 1.2;
    (half.x > 0.01 && half.y > 0.01)
        .then(|| (0.5 * Vector2::new(right + left, bottom + top), half.map(|angle| angle.min(WIDEST))))
}

fn range(angles: impl Iterator<Item = f64>) -> (f64, f64) {
    angles.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), angle| (low.min(angle), high.max(angle)))
}

#[cfg(test)]
mod tests;
