//! Simulated recordings.

use std::sync::atomic::Ordering;

use evcal_geometry::board::Board;
use evcal_simulator::lens::usual_lens;
use evcal_simulator::presets::{LightPreset, MotionPreset};
use evcal_simulator::rays::Rays;
use evcal_simulator::recording::DAVIS346_SENSOR;
use evcal_simulator::scene::SceneSettings;
use evcal_simulator::{Simulation, SimulationSettings};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::camera::Camera;
use crate::events::{append, to_array};
use crate::failed;
use crate::interrupt::interruptible;

/// Returns the element of `all` with this name.
fn named<T: Copy>(all: &[T], name: impl Fn(T) -> &'static str, wanted: &str, what: &str) -> PyResult<T> {
    all.iter().copied().find(|one| name(*one) == wanted).ok_or_else(|| {
        let names: Vec<&str> = all.iter().map(|one| name(*one)).collect();
        PyValueError::new_err(format!("{what} is one of {}, not {wanted:?}", names.join(", ")))
    })
}

/// Simulate an event camera that is moved in front of a board.
///
/// camera: its lens and sensor; without it a DAVIS346 with a lens of about 60 degrees, horizontally. duration in seconds. motion:
/// "slow", "fast", "violent", "blur", "interrupted", "paused", "far", "head-on", "corner", or a degenerate motion: "slide",
/// "one-axis", "even-turn", "little-turns", "to-and-fro". light: "default", "low" or "ideal". The same arguments give the same events.
///
/// Returns the events, as an array like the one from read, and the camera.
#[pyfunction]
#[pyo3(signature = (camera=None, *, board="acircles:9x4:55mm:r17.5mm", duration=6.0, motion="slow", light="default", seed=1))]
pub fn simulate<'py>(
    py: Python<'py>,
    camera: Option<&Bound<'py, Camera>>,
    board: &str,
    duration: f64,
    motion: &str,
    light: &str,
    seed: u64,
) -> PyResult<(Bound<'py, PyAny>, Camera)> {
    let board: Board =
        board.parse().map_err(|error: evcal_geometry::board::BoardError| PyValueError::new_err(error.to_string()))?;
    let (lens, sensor) = match camera.map(Bound::get) {
        Some(camera) => (*camera.lens(), camera.size()),
        None => (usual_lens(DAVIS346_SENSOR).map_err(failed)?, DAVIS346_SENSOR),
    };
    let motion = named(MotionPreset::ALL, MotionPreset::name, motion, "motion")?;
    let light = named(LightPreset::ALL, LightPreset::name, light, "light")?;
    let settings = SimulationSettings {
        duration,
        seed,
        scene: SceneSettings::default(),
        sensor: light.sensor(),
        motion: motion.settings(duration),
    };
    let bytes = interruptible(py, |stop| {
        let simulation = Simulation::new(Rays::new(&lens, sensor), board, settings)?;
        let mut bytes = Vec::new();
        // Only a signal ends it early; its exception is then raised.
        let _ = simulation.run(|events| {
            append(&mut bytes, events);
            if stop.load(Ordering::Relaxed) { Err(()) } else { Ok(()) }
        });
        Ok(bytes)
    })?;
    let bytes = bytes.map_err(|error: evcal_simulator::SimulationError| failed(error))?;
    Ok((to_array(py, bytes)?, Camera::of(lens, sensor, None)))
}
