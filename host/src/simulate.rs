//! An event camera that looks at a printed circle grid while a hand moves it.
//!
//! Radiance comes from exact rendering of the board ([`scene`]) along a smooth motion known at any
//! time ([`motion`]), through any lens given by its bearings ([`rays`]); every pixel turns it into
//! events by a low-pass, log thresholds with mismatch, reset, leak and noise ([`pixel`],
//! [`sensor`]); a bus puts the events in a row ([`arbiter`]). The same settings and seed give the
//! same events on any number of threads: rows of pixels are independent and each has its own
//! stream of random numbers.
//!
//! Time runs in slices that bound the memory, slices in ticks at which poses are known. A pixel
//! looks only at the ticks it needs: few while no edge is near, and where an edge passes so many
//! that it moves a fifth of a pixel in between.

use std::collections::BTreeSet;

use evcal_core::event::Event;
use nalgebra::Isometry3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use self::arbiter::Bus;
use self::motion::{Motion, MotionSettings, SPEED_GRID};
use self::pixel::{Pixel, RowOutput};
use self::random::uniform;
use self::rays::Rays;
use self::scene::{Sample, Scene, SceneSettings, View};
use self::sensor::SensorModel;
use crate::board::Board;
use crate::tum::TimedPose;

pub mod arbiter;
pub mod clock;
pub mod motion;
pub mod pixel;
pub mod random;
pub mod rays;
pub mod scene;
pub mod sensor;
pub mod truth;

/// Time between two ticks, in microseconds.
const TICK: f64 = 50.0;
/// Ticks in a slice.
const SLICE_TICKS: usize = 500;
/// Distance in pixels up to which the pixel's linear map is trusted to tell how far an edge is.
const TRUSTED_DISTANCE: f64 = 30.0;
/// What the linear map and the sampled speeds may be wrong by, as a factor on a skip.
const SKIP_SAFETY: f64 = 0.75;

/// What to simulate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulationSettings {
    /// Length of the recording in seconds, rounded to 50 µs.
    pub duration: f64,
    /// Seed of all that is random.
    pub seed: u64,
    /// Radiances and size of the sheet.
    pub scene: SceneSettings,
    /// Pixels.
    pub sensor: SensorModel,
    /// How the camera moves.
    pub motion: MotionSettings,
}

/// Why a simulation cannot be set up.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimulationError {
    /// The lens sees nothing along the middle row or column.
    #[error("the camera model has no bearing for most of the sensor: check its parameters and the sensor size")]
    NoFieldOfView,
    /// A setting is outside its range.
    #[error("simulation setting {name} is {value}; it must be {range}")]
    Setting {
        /// Path of the setting.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
}

/// How many events came out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EventCounts {
    /// OFF events.
    pub off: u64,
    /// ON events.
    pub on: u64,
}

/// A simulation ready to run.
#[derive(Clone, Debug)]
pub struct Simulation {
    rays: Rays,
    scene: Scene,
    motion: Motion,
    settings: SimulationSettings,
    stepping: Stepping,
}

#[derive(Clone, Copy, Debug)]
struct Stepping {
    /// Distance in pixels that an edge moves between two looks of a pixel that sees it.
    step: f64,
    /// Longest time between two looks of a pixel that sees an edge, in ticks.
    longest_step: usize,
    /// Longest time between two looks of a pixel far from any edge, in ticks.
    longest_skip: usize,
}

/// How finely pixels look, unless a test looks closer.
const STEPPING: Stepping = Stepping { step: 0.2, longest_step: 40, longest_skip: 160 };

impl Simulation {
    /// A camera with the given `rays` before `board`.
    pub fn new(rays: Rays, board: Board, settings: SimulationSettings) -> Result<Self, SimulationError> {
        settings.check()?;
        let motion = Motion::new(&settings.motion, &board, &rays, settings.duration, settings.seed)
            .ok_or(SimulationError::NoFieldOfView)?;
        let scene = Scene::new(board, settings.scene, settings.sensor.point_spread);
        Ok(Self { rays, scene, motion, settings, stepping: STEPPING })
    }

    /// What is simulated.
    pub fn settings(&self) -> &SimulationSettings {
        &self.settings
    }

    /// The rays of the sensor.
    pub fn rays(&self) -> &Rays {
        &self.rays
    }

    /// The board and its surroundings.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The motion of the camera.
    pub fn motion(&self) -> &Motion {
        &self.motion
    }

    /// `T_world_camera` at `t` seconds.
    pub fn pose(&self, t: f64) -> Isometry3<f64> {
        self.motion.pose(t)
    }

    /// The poses at `rate` hertz, from 0 to the end of the recording.
    pub fn trajectory(&self, rate: f64) -> Vec<TimedPose> {
        let count = (self.settings.duration * rate).floor() as usize;
        (0..=count)
            .map(|index| {
                let t = index as f64 / rate;
                TimedPose { t, pose: self.motion.pose(t) }
            })
            .collect()
    }

    fn tick_count(&self) -> usize {
        (self.settings.duration * 1e6 / TICK).round() as usize
    }

    /// Number of slices, which is how often [`Simulation::run`] calls its sink.
    pub fn slice_count(&self) -> usize {
        self.tick_count().div_ceil(SLICE_TICKS)
    }

    /// Simulates and hands the events of each slice of 25 ms to `sink`, in the order of their
    /// times; without an arbiter events of one microsecond are in the order of y, then x. An error
    /// of the sink ends the simulation.
    pub fn run<E>(&self, mut sink: impl FnMut(&[Event]) -> Result<(), E>) -> Result<EventCounts, E> {
        let mut rows = self.rows();
        let mut bus = self.settings.sensor.arbiter.map(Bus::new);
        let mut counts = EventCounts::default();
        let mut events: Vec<Event> = Vec::new();
        let ticks = self.tick_count();
        for first in (0..ticks).step_by(SLICE_TICKS) {
            let last = (first + SLICE_TICKS).min(ticks);
            let slice = Slice::new(&self.motion, &self.rays, first, last);
            rows.par_iter_mut().for_each(|row| row.advance(self, &slice));
            for row in &mut rows {
                events.append(&mut row.events);
            }
            events.sort_unstable_by_key(|event| (event.t, event.y, event.x, event.polarity));
            // Requests later than the slice wait for those of the next one.
            let end = if last == ticks { i64::MAX } else { (last as f64 * TICK) as i64 };
            let ready = events.partition_point(|event| event.t < end);
            let later = events.split_off(ready);
            if let Some(bus) = &mut bus {
                bus.read(&mut events);
            }
            let on = events.iter().map(|event| event.polarity.index() as u64).sum::<u64>();
            counts.on += on;
            counts.off += events.len() as u64 - on;
            sink(&events)?;
            events = later;
        }
        Ok(counts)
    }

    fn rows(&self) -> Vec<Row> {
        let (width, height) = (self.rays.width(), self.rays.height());
        let sensor = &self.settings.sensor;
        let hot = self.hot_pixels();
        let view = View::new(&self.motion.pose(0.0));
        let center = (0.5 * (f64::from(width) - 1.0), 0.5 * (f64::from(height) - 1.0));
        let corner = center.0 * center.0 + center.1 * center.1;
        let row = |y: u16| {
            let mut rng = ChaCha8Rng::seed_from_u64(self.settings.seed);
            rng.set_stream(u64::from(y));
            let sites = (0..width).map(|x| {
                let (dx, dy) = (f64::from(x) - center.0, f64::from(y) - center.1);
                let gain = 1.0 - sensor.vignette * (dx * dx + dy * dy) / corner.max(1.0);
                let sample = self.look(&view, x, y);
                let pixel = Pixel::new((x, y), sensor, gain, hot.contains(&(x, y)), sample.radiance, &mut rng);
                Site { pixel, edge: sample.edge, speed: f64::INFINITY }
            });
            let sites = sites.collect();
            Row { y, sites, rng, events: Vec::new() }
        };
        (0..height).map(row).collect()
    }

    fn hot_pixels(&self) -> BTreeSet<(u16, u16)> {
        let (width, height) = (self.rays.width(), self.rays.height());
        let mut rng = ChaCha8Rng::seed_from_u64(self.settings.seed);
        rng.set_stream(HOT_PIXEL_STREAM);
        let mut draw = |size: u16| ((uniform(&mut rng) * f64::from(size)) as u16).min(size.saturating_sub(1));
        (0..self.settings.sensor.hot_pixels).map(|_| (draw(width), draw(height))).collect()
    }

    #[inline]
    fn look(&self, view: &View, x: u16, y: u16) -> Sample {
        match self.rays.get(x, y) {
            Some(ray) => self.scene.sample(view, ray),
            None => Sample { radiance: self.settings.scene.background, edge: f64::NEG_INFINITY },
        }
    }
}

/// The stream of random numbers that places the hot pixels; rows of pixels use the streams from 0.
const HOT_PIXEL_STREAM: u64 = u64::MAX - 1;

/// The views at all ticks of a slice, its first and last tick included.
struct Slice {
    first_tick: usize,
    views: Vec<View>,
    /// Bounds of the image speed in the cells of [`SPEED_GRID`], in pixels per tick.
    speeds: Vec<f64>,
}

impl Slice {
    fn new(motion: &Motion, rays: &Rays, first: usize, last: usize) -> Self {
        const LOOKS: usize = 5;
        let seconds = |tick: usize| tick as f64 * TICK * 1e-6;
        let views = (first..=last).map(|tick| View::new(&motion.pose(seconds(tick)))).collect();
        let mut fastest: Vec<f64> = Vec::new();
        for look in 0..=LOOKS {
            let speeds = motion.image_speeds(rays, seconds(first + (last - first) * look / LOOKS));
            fastest.resize(speeds.len(), 0.0);
            for (fastest, speed) in fastest.iter_mut().zip(speeds) {
                *fastest = speed.map_or(*fastest, |(_, speed)| fastest.max(speed * TICK * 1e-6));
            }
        }
        // A cell takes the greatest speed of its neighbours too: speed varies within cells.
        let (columns, rows) = (usize::from(SPEED_GRID.0), usize::from(SPEED_GRID.1));
        let around = |cell: usize| {
            let (column, row) = (cell % columns, cell / columns);
            (row.saturating_sub(1)..=(row + 1).min(rows - 1))
                .flat_map(|row| {
                    (column.saturating_sub(1)..=(column + 1).min(columns - 1)).map(move |column| (row, column))
                })
                .filter_map(|(row, column)| fastest.get(row * columns + column))
                .fold(1e-9, |most: f64, &speed| most.max(speed))
        };
        let speeds = (0..columns * rows).map(around).collect();
        Self { first_tick: first, views, speeds }
    }

    /// Bound of the image speed at pixel (x, y), in pixels per tick.
    fn speed(&self, rays: &Rays, x: u16, y: u16) -> f64 {
        let cell =
            |position: u16, size: u16, cells: u16| usize::from(position) * usize::from(cells) / usize::from(size);
        let (columns, rows) = SPEED_GRID;
        let index = cell(y, rays.height(), rows) * usize::from(columns) + cell(x, rays.width(), columns);
        self.speeds.get(index).copied().unwrap_or(1.0)
    }

    fn time(&self, index: usize) -> f64 {
        (self.first_tick + index) as f64 * TICK
    }
}

/// A pixel and what it saw last.
#[derive(Clone, Debug)]
struct Site {
    pixel: Pixel,
    /// Signed distance of the nearest edge in pixels.
    edge: f64,
    /// How fast the edge moved, in pixels per tick.
    speed: f64,
}

impl Site {
    /// Ticks until the next look.
    fn step(&self, reach: f64, fastest: f64, stepping: Stepping) -> usize {
        let distance = self.edge.abs();
        if distance > reach {
            let clear = distance.min(TRUSTED_DISTANCE) - reach;
            let skip = ((clear * SKIP_SAFETY).max(stepping.step) / fastest) as usize;
            skip.clamp(1, stepping.longest_skip)
        } else {
            ((stepping.step / self.speed.min(fastest)) as usize).clamp(1, stepping.longest_step)
        }
    }
}

/// A row of pixels.
#[derive(Clone, Debug)]
struct Row {
    y: u16,
    sites: Vec<Site>,
    rng: ChaCha8Rng,
    events: Vec<Event>,
}

impl Row {
    fn advance(&mut self, simulation: &Simulation, slice: &Slice) {
        let sensor = &simulation.settings.sensor;
        let reach = simulation.scene.reach();
        let last = slice.views.len().saturating_sub(1);
        let mut out = RowOutput { rng: &mut self.rng, events: &mut self.events };
        for (x, site) in self.sites.iter_mut().enumerate() {
            let x = x as u16;
            let fastest = slice.speed(&simulation.rays, x, self.y);
            let mut index = 0;
            let mut previous_step = usize::MAX;
            while index < last {
                let step = site.step(reach, fastest, simulation.stepping).min(previous_step.saturating_mul(2));
                let next = (index + step).min(last);
                let Some(view) = slice.views.get(next) else { break };
                let sample = simulation.look(view, x, self.y);
                site.pixel.see(sensor, slice.time(index), slice.time(next), sample.radiance, &mut out);
                let seen = site.edge.abs() <= reach && sample.edge.abs() <= reach;
                site.speed = if seen { (sample.edge - site.edge).abs() / (next - index) as f64 } else { f64::INFINITY };
                previous_step = if seen { next - index } else { usize::MAX };
                site.edge = sample.edge;
                index = next;
            }
            site.pixel.make_noise(sensor, slice.time(last), &mut out);
        }
    }
}

impl SimulationSettings {
    fn check(&self) -> Result<(), SimulationError> {
        let Self { duration, scene, sensor, motion, .. } = self;
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let not_negative = |value: f64| value >= 0.0 && value.is_finite();
        let share = |value: f64| (0.0..1.0).contains(&value);
        let [farthest, nearest] = motion.fill;
        let [slowest, fastest] = sensor.hot_rate;
        let photoreceptor = sensor.photoreceptor.map_or((1.0, 1.0), |low_pass| (low_pass.bandwidth, low_pass.offset));
        let arbiter =
            sensor.arbiter.unwrap_or(sensor::Arbiter { latency: 0.0, jitter: 0.0, event_time: 0.0, row_time: 0.0 });
        const POSITIVE: &str = "above 0";
        const NOT_NEGATIVE: &str = "0 or above";
        const SHARE: &str = "at least 0 and below 1";
        let checks = [
            ("duration", *duration, *duration > 0.0 && *duration <= 1e5, "above 0 and at most 100000 s"),
            ("scene.white", scene.white, positive(scene.white), POSITIVE),
            ("scene.black", scene.black, positive(scene.black), POSITIVE),
            ("scene.background", scene.background, positive(scene.background), POSITIVE),
            ("scene.margin", scene.margin, not_negative(scene.margin), NOT_NEGATIVE),
            ("sensor.point_spread", sensor.point_spread, positive(sensor.point_spread), POSITIVE),
            ("sensor.threshold_on", sensor.threshold_on, sensor.threshold_on >= 0.05, "0.05 or above"),
            ("sensor.threshold_off", sensor.threshold_off, sensor.threshold_off >= 0.05, "0.05 or above"),
            (
                "sensor.threshold_mismatch",
                sensor.threshold_mismatch,
                not_negative(sensor.threshold_mismatch),
                NOT_NEGATIVE,
            ),
            ("sensor.threshold_jitter", sensor.threshold_jitter, not_negative(sensor.threshold_jitter), NOT_NEGATIVE),
            ("sensor.photoreceptor.bandwidth", photoreceptor.0, positive(photoreceptor.0), POSITIVE),
            ("sensor.photoreceptor.offset", photoreceptor.1, not_negative(photoreceptor.1), NOT_NEGATIVE),
            ("sensor.refractory", sensor.refractory, not_negative(sensor.refractory), NOT_NEGATIVE),
            ("sensor.dark", sensor.dark, not_negative(sensor.dark), NOT_NEGATIVE),
            ("sensor.vignette", sensor.vignette, share(sensor.vignette), SHARE),
            ("sensor.leak_rate", sensor.leak_rate, not_negative(sensor.leak_rate), NOT_NEGATIVE),
            ("sensor.noise_rate", sensor.noise_rate, (0.0..=1e4).contains(&sensor.noise_rate), "from 0 to 10000 Hz"),
            ("sensor.noise_spread", sensor.noise_spread, (0.0..=1.0).contains(&sensor.noise_spread), "from 0 to 1"),
            (
                "sensor.hot_rate",
                slowest,
                (0.0..=1e4).contains(&slowest) && slowest <= fastest,
                "from 0 to the upper rate",
            ),
            ("sensor.hot_rate", fastest, (0.0..=1e4).contains(&fastest), "from the lower rate to 10000 Hz"),
            ("sensor.arbiter.latency", arbiter.latency, not_negative(arbiter.latency), NOT_NEGATIVE),
            ("sensor.arbiter.jitter", arbiter.jitter, not_negative(arbiter.jitter), NOT_NEGATIVE),
            ("sensor.arbiter.event_time", arbiter.event_time, not_negative(arbiter.event_time), NOT_NEGATIVE),
            ("sensor.arbiter.row_time", arbiter.row_time, not_negative(arbiter.row_time), NOT_NEGATIVE),
            ("motion.mean_speed", motion.mean_speed, positive(motion.mean_speed), POSITIVE),
            (
                "motion.speed_variation",
                motion.speed_variation,
                (0.0..=0.9).contains(&motion.speed_variation),
                "from 0 to 0.9",
            ),
            ("motion.fill", farthest, farthest > 0.01 && farthest <= nearest, "above 0.01 and at most the nearest"),
            ("motion.fill", nearest, nearest <= 1.2, "at most 1.2"),
            ("motion.distance_scale", motion.distance_scale, positive(motion.distance_scale), POSITIVE),
            ("motion.tilt", motion.tilt, (0.0..80.0).contains(&motion.tilt), "at least 0 and below 80 degrees"),
            ("motion.roll", motion.roll, not_negative(motion.roll), NOT_NEGATIVE),
            ("motion.roll_offset", motion.roll_offset, motion.roll_offset.is_finite(), "a number"),
            ("motion.overshoot", motion.overshoot, (-1.0..=1.0).contains(&motion.overshoot), "from -1 to 1"),
            ("motion.tremor", motion.tremor, (0.0..=5.0).contains(&motion.tremor), "from 0 to 5 degrees"),
        ];
        for (name, value, right, range) in checks {
            if !right {
                return Err(SimulationError::Setting { name, value, range });
            }
        }
        for (name, spans) in [("motion.pauses", &motion.pauses), ("motion.absences", &motion.absences)] {
            if let Some(span) =
                spans.iter().find(|span| !(span.start.is_finite() && span.end.is_finite() && span.start <= span.end))
            {
                return Err(SimulationError::Setting {
                    name,
                    value: span.end,
                    range: "a start and an end not before it",
                });
            }
        }
        Ok(())
    }
}
