#![doc = include_str!("../README.md")]
//!
//! Time is divided into slices of 25 ms, which limit the memory, and slices into ticks of 50 µs, at which poses are
//! computed; each pixel is evaluated at the ticks that it needs.

// These lints hold because no input may cause a panic, and because only the program prints, never a library.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable, clippy::get_unwrap)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

use std::collections::BTreeSet;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use self::arbiter::Bus;
use self::motion::Motion;
use self::rays::Rays;
use self::row::{BadPixels, Row, STEPPING, Slice, Stage, TICK};
use self::scene::Scene;
use self::view::View;
use evcal_geometry::board::Board;
use evcal_geometry::numerics::random::uniform;
use evcal_geometry::timed_pose::TimedPose;

mod arbiter;
mod clock;
pub mod davis;
pub mod dots;
mod edge_profile;
pub mod effects;
pub mod folder;
pub mod frame;
pub mod frame_camera;
pub mod inertia;
pub mod inertial_truth;
pub mod lens;
pub mod light;
pub mod motion;
pub mod motion_capture;
pub mod mount;
mod pixel;
pub mod presets;
pub mod rays;
pub mod recording;
mod row;
pub mod scene;
pub mod second_camera;
pub mod sensor;
mod settings;
pub mod smudges;
pub mod surroundings;
pub mod truth;
pub mod view;

#[cfg(test)]
mod tests;

pub use settings::{SimulationError, SimulationSettings};

/// Number of ticks in a slice.
const SLICE_TICKS: usize = 500;

/// Number of events by polarity.
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
    stage: Stage,
    /// The scene and lens of the frames, if they differ from the scene and lens of the events.
    frame_stage: Option<Stage>,
    motion: Motion,
    settings: SimulationSettings,
}

impl Simulation {
    /// Creates the simulation of a camera with the given `rays` in front of `board`.
    pub fn new(rays: Rays, board: Board, settings: SimulationSettings) -> Result<Self, SimulationError> {
        settings.check()?;
        if board.circles().is_none() && !settings.scene.dots.are_circles() {
            return Err(SimulationError::NoDots(settings.scene.dots.name()));
        }
        let motion = Motion::new(&settings.motion, &board, &rays, settings.duration, settings.seed)
            .ok_or(SimulationError::NoFieldOfView)?;
        let scene = Scene::new(board, settings.scene, settings.sensor.point_spread);
        let stage = Stage { rays, scene, sensor: settings.sensor.clone(), stepping: STEPPING };
        Ok(Self { stage, frame_stage: None, motion, settings })
    }

    /// Uses different `rays` for the frames than for the events. No real camera does that, so a calibration should
    /// notice it.
    pub fn with_frame_rays(mut self, rays: Rays) -> Self {
        self.frame_stage = Some(Stage { rays, ..self.stage.clone() });
        self
    }

    /// Returns the simulation of a second camera with these `rays`, fixed to the first at `T_first_second`, with pixels
    /// of the same kind and its own `seed`.
    pub fn second(&self, rays: Rays, first_second: Isometry3<f64>, seed: u64) -> Self {
        Self {
            stage: Stage { rays, ..self.stage.clone() },
            frame_stage: None,
            motion: self.motion.carrying(first_second),
            settings: SimulationSettings { seed, ..self.settings.clone() },
        }
    }

    /// Returns the settings.
    pub fn settings(&self) -> &SimulationSettings {
        &self.settings
    }

    /// Returns the rays of the sensor.
    pub fn rays(&self) -> &Rays {
        &self.stage.rays
    }

    /// Returns the board and its surroundings.
    pub fn scene(&self) -> &Scene {
        &self.stage.scene
    }

    /// Returns the motion of the camera.
    pub fn motion(&self) -> &Motion {
        &self.motion
    }

    /// Returns `T_world_camera` at `t` seconds.
    pub fn pose(&self, t: f64) -> Isometry3<f64> {
        self.motion.pose(t)
    }

    /// Returns the poses at `rate` hertz, from 0 to the end of the recording.
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

    /// Returns the number of slices, which is the number of calls that [`Simulation::run`] makes to its sink.
    pub fn slice_count(&self) -> usize {
        self.tick_count().div_ceil(SLICE_TICKS)
    }

    /// Simulates and passes the events of each slice of 25 ms to `sink`, in order of time; without an arbiter, events
    /// of the same microsecond are in the order of y, then x. An error of the sink ends the simulation.
    pub fn run<E>(&self, sink: impl FnMut(&[Event]) -> Result<(), E>) -> Result<EventCounts, E> {
        self.run_along(|t| self.motion.pose(t), sink)
    }

    /// Simulates like [`Simulation::run`] with another motion of the camera: `pose` returns `T_world_camera` at any
    /// time in seconds, up to 0.1 ms before and after the current slice. It may depend on the events of earlier slices,
    /// like the hand of a person who watches them.
    pub fn run_along<E>(
        &self,
        pose: impl Fn(f64) -> Isometry3<f64>,
        mut sink: impl FnMut(&[Event]) -> Result<(), E>,
    ) -> Result<EventCounts, E> {
        let mut rows = self.rows(&pose(0.0));
        let mut bus = self.settings.sensor.arbiter.map(Bus::new);
        let mut counts = EventCounts::default();
        let mut events: Vec<Event> = Vec::new();
        let ticks = self.tick_count();
        for first in (0..ticks).step_by(SLICE_TICKS) {
            let last = (first + SLICE_TICKS).min(ticks);
            let slice = Slice::new(&pose, self.scene(), self.rays(), first, last);
            rows.par_iter_mut().for_each(|row| row.advance(&self.stage, &slice));
            for row in &mut rows {
                events.append(&mut row.events);
            }
            events.sort_unstable_by_key(|event| (event.t, event.y, event.x, event.polarity));
            // Requests later than the slice are processed with the next one.
            let end = if last == ticks { i64::MAX } else { (last as f64 * TICK) as i64 };
            let ready = events.partition_point(|event| event.t < end);
            let later = events.split_off(ready);
            if let Some(bus) = &mut bus {
                bus.read(&mut events);
            }
            if let Some(scan) = self.settings.sensor.scan {
                wait_for_scan(&mut events, scan);
            }
            let on = events.iter().map(|event| event.polarity.index() as u64).sum::<u64>();
            counts.on += on;
            counts.off += events.len() as u64 - on;
            sink(&events)?;
            events = later;
        }
        Ok(counts)
    }

    fn rows(&self, first: &Isometry3<f64>) -> Vec<Row> {
        let bad = BadPixels { hot: self.hot_pixels(), dead_columns: self.dead_columns() };
        let view = View::new(first);
        (0..self.rays().sensor().height).map(|y| Row::new(&self.stage, &view, y, &bad, self.settings.seed)).collect()
    }

    fn hot_pixels(&self) -> BTreeSet<(u16, u16)> {
        let Sensor { width, height } = self.rays().sensor();
        let mut rng = ChaCha8Rng::seed_from_u64(self.settings.seed);
        rng.set_stream(HOT_PIXEL_STREAM);
        let mut draw = |size: u16| ((uniform(&mut rng) * f64::from(size)) as u16).min(size.saturating_sub(1));
        (0..self.settings.sensor.hot_pixels).map(|_| (draw(width), draw(height))).collect()
    }

    fn dead_columns(&self) -> BTreeSet<u16> {
        let width = self.rays().sensor().width;
        let mut rng = ChaCha8Rng::seed_from_u64(self.settings.seed);
        rng.set_stream(DEAD_COLUMN_STREAM);
        (0..self.settings.sensor.dead_columns).map(|_| (uniform(&mut rng) * f64::from(width)) as u16).collect()
    }
}

/// Sets the time of each event to the first scan that is not before it. Scans are `interval` seconds apart.
fn wait_for_scan(events: &mut [Event], interval: f64) {
    let interval = ((1e6 * interval).round() as i64).max(1);
    for event in events {
        event.t += (-event.t).rem_euclid(interval);
    }
}

/// Stream of random numbers for the positions of hot pixels; rows of pixels use the streams from 0.
const HOT_PIXEL_STREAM: u64 = u64::MAX - 1;
/// Stream of random numbers for the positions of dead columns.
const DEAD_COLUMN_STREAM: u64 = u64::MAX - 6;
