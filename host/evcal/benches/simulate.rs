//! How fast the simulator is: time for 0.1 s of a 346 × 260 recording, on one thread and on all.

use std::convert::Infallible;

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use evcal_simulator::motion::MotionSettings;
use evcal_simulator::rays::Rays;
use evcal_simulator::scene::SceneSettings;
use evcal_simulator::sensor::SensorModel;
use evcal_simulator::{Simulation, SimulationSettings};

fn main() {
    divan::main();
}

/// Seconds of simulated time in one run.
const DURATION: f64 = 0.1;

fn simulation(motion: MotionSettings) -> Option<Simulation> {
    let camera = Camera::from_parameters(
        ModelKind::Radtan,
        &[331.6, 331.1, 176.9, 134.2, -0.352, 0.149, -0.0004, 0.0005, -0.03],
    )?;
    let settings = SimulationSettings {
        duration: DURATION,
        seed: 1,
        scene: SceneSettings::default(),
        sensor: SensorModel::default(),
        motion,
    };
    Simulation::new(Rays::new(&camera, Sensor::new(346, 260)), "acircles:9x4:55mm:r17.5mm".parse().ok()?, settings).ok()
}

fn run(bencher: divan::Bencher<'_, '_>, motion: MotionSettings, threads: usize) {
    let simulation = simulation(motion).expect("a valid simulation");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
    let sink = |batch: &[Event]| {
        divan::black_box(batch);
        Ok::<(), Infallible>(())
    };
    let Ok(counts) = simulation.run(sink);
    bencher
        .counter(divan::counter::ItemsCount::new(counts.off + counts.on))
        .bench(|| pool.install(|| simulation.run(sink)));
}

#[divan::bench(sample_count = 5, sample_size = 1, args = [1, 0])]
fn slow_100_ms(bencher: divan::Bencher<'_, '_>, threads: usize) {
    run(bencher, MotionSettings::slow(), threads);
}

#[divan::bench(sample_count = 5, sample_size = 1, args = [1, 0])]
fn fast_100_ms(bencher: divan::Bencher<'_, '_>, threads: usize) {
    run(bencher, MotionSettings::fast(), threads);
}

#[divan::bench(sample_count = 5, sample_size = 1, args = [1, 0])]
fn blur_100_ms(bencher: divan::Bencher<'_, '_>, threads: usize) {
    run(bencher, MotionSettings::blur(), threads);
}
