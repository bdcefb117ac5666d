//! Finds the ordered board in the events of one window: `cargo run -p evcal-core --example detector`.
//!
//! The events are synthetic: a board of 9 × 4 dots, slightly rotated in the image, moves to the right. With a real
//! sensor the events come from its decoder (`evcal_core::decode`), and `evcal_core::window` divides them into windows.

use std::error::Error;

use evcal_core::cluster::{row_bytes, row_count};
use evcal_core::detector::{Detector, DetectorSettings};
use evcal_core::event::{Event, Polarity};
use evcal_core::grid::{GridCandidate, GridOptions, GridWorkspace, find_grid};
use evcal_core::pattern::{Layout, Pattern};
use evcal_core::sensor::Sensor;

const SENSOR: Sensor = Sensor::new(346, 260);
const BOARD: Pattern = Pattern { layout: Layout::Asymmetric, rows: 9, columns: 4 };

/// Capacity for 4096 runs of pixels and 256 clusters of each polarity; on a microcontroller this is a `static`.
type Detector346 = Detector<f32, { row_bytes(346) }, { row_count(260) }, 4096, 256>;

/// Returns the events of a dark dot of 8 px radius that moves to the right: OFF events ahead of it, ON events behind.
fn dot(center: [f32; 2]) -> impl Iterator<Item = Event> {
    (-60_i16..=60).flat_map(move |degrees| {
        let (sin, cos) = f32::from(degrees).to_radians().sin_cos();
        [(1.0, Polarity::Off), (-1.0, Polarity::On)].map(|(side, polarity)| Event {
            t: 0,
            x: (center[0] + side * 8.0 * cos).round() as u16,
            y: (center[1] + 8.0 * sin).round() as u16,
            polarity,
        })
    })
}

/// Returns the events of all dots of the board.
fn events() -> impl Iterator<Item = Event> {
    (0..BOARD.circle_count()).flat_map(|circle| {
        let (x, y) = BOARD.lattice_position(circle);
        let (x, y) = (x as f32, y as f32);
        dot([70.0 + 26.0 * x - 2.0 * y, 30.0 + 24.0 * y + 1.5 * x])
    })
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut detector = Detector346::new();
    let detection = detector.detect(SENSOR, events(), &DetectorSettings::default())?;
    println!("{} events, {} circles", detection.clusters.events, detection.circles.circles);

    let candidates: Vec<GridCandidate<f32>> = detector
        .circles()
        .iter()
        .map(|circle| GridCandidate { center: circle.center, radius: circle.radius })
        .collect();
    let options = GridOptions::new(&BOARD, (f64::from(SENSOR.width), f64::from(SENSOR.height)));
    let mut workspace = GridWorkspace::<f32, 256>::new();
    let board = find_grid(&candidates, &BOARD, &options, &mut workspace)?;
    println!(
        "{} circles of the board, order {:?}, scatter {:.2} px",
        board.circles.len(),
        board.ordering,
        board.scatter
    );
    for circle in &board.circles {
        let Some(candidate) = candidates.get(usize::from(circle.candidate)) else { continue };
        println!(
            "{:2}: ({:6.2}, {:6.2}), radius {:.2} px",
            circle.board, candidate.center.x, candidate.center.y, candidate.radius
        );
    }
    Ok(())
}
