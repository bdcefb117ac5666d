//! Simulates a fisheye camera in front of a moving board, and counts the events per 25 ms.
//!
//!     cargo run --release --example simulate

use std::convert::Infallible;
use std::error::Error;

use evcal::Board;
use evcal_core::camera::ModelKind;
use evcal_core::sensor::Sensor;
use evcal_simulator::lens::lens;
use evcal_simulator::presets::{LightPreset, MotionPreset};
use evcal_simulator::rays::Rays;
use evcal_simulator::scene::SceneSettings;
use evcal_simulator::{Simulation, SimulationSettings};

fn main() -> Result<(), Box<dyn Error>> {
    let board: Board = "acircles:9x4:55mm:r17.5mm".parse()?;
    let camera = lens(ModelKind::KannalaBrandt, &[196.4, 196.0, 119.3, 86.1, -0.018, 0.006, -0.003, 0.0006])?;
    let settings = SimulationSettings {
        duration: 0.1,
        seed: 1,
        scene: SceneSettings::default(),
        sensor: LightPreset::Default.sensor(),
        motion: MotionPreset::Slow.settings(0.1),
    };
    let simulation = Simulation::new(Rays::new(&camera, Sensor::new(240, 180)), board, settings)?;
    let counts = simulation.run(|events| {
        println!("{} events", events.len());
        Ok::<(), Infallible>(())
    })?;
    println!("{} OFF and {} ON events", counts.off, counts.on);
    Ok(())
}
