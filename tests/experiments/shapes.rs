//! What windows tell of the form of the dots in them: round dots against squares, rings and keys, of many sizes.
//!
//! ```text
//! cargo build --release --workspace --examples
//! target/release/examples/shapes FIRST-LAST          # simulates all lenses, motions and sizes with these seeds
//! target/release/examples/shapes BOARD RECORDING...  # the windows of recordings
//! ```

use std::path::Path;

use evcal_calibrate::circles::reference_frame::{ReferenceFrame, SeenIn};
use evcal_calibrate::detection::dot_shape::DotShape;
use evcal_calibrate::detection::focus::edge_width;
use evcal_calibrate::detection::order_frames;
use evcal_calibrate::detection::search::{FoundContent, SearchFor, search_events, sensor_of};
use evcal_calibrate::detection::settings::DetectionSettings;
use evcal_geometry::board::Board;
use evcal_tests::lens::{KANNALA_BRANDT, Lens, RADTAN};
use evcal_tests::{succeed, text};
use event_recordings::{Recording, RecordingOptions};

/// Boards from large dots to small ones, dense and wide.
const BOARDS: [&str; 5] = [
    "acircles:9x4:55mm:r17.5mm",
    "circles:3x4:90mm:r35mm",
    "circles:6x8:50mm:r15mm",
    "circles:5x7:60mm:r27mm",
    "acircles:11x4:45mm:r8mm",
];
const DOTS: [&str; 4] = ["circles", "squares", "rings", "keys"];
const SCENES: [(Lens, &str, &str); 4] = [
    (RADTAN, "fast", "default"),
    (RADTAN, "slow", "default"),
    (KANNALA_BRANDT, "violent", "default"),
    (RADTAN, "blur", "low"),
];

/// Windows of a recording.
#[derive(Default)]
struct Windows {
    /// With the board, as they are, and where form does not count.
    accepted: u64,
    placed: u64,
    corners: Vec<f64>,
    certain_corners: Vec<f64>,
    hollowness: Vec<f64>,
    all: DotShape,
    sharpness: Option<f64>,
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.as_slice() {
        [] => simulated(1, 1),
        [seeds] if seeds.contains('-') => {
            let (first, last) = seeds.split_once('-').expect("the first and the last seed: 1-3");
            let seed = |text: &str| text.parse::<u64>().expect("a seed is a whole number");
            simulated(seed(first), seed(last));
        }
        [board, recordings @ ..] => {
            for recording in recordings {
                tell(recording, &windows(Path::new(recording), &board.parse().expect("a board")));
            }
        }
    }
}

fn simulated(first: u64, last: u64) {
    for board in BOARDS {
        for (lens, motion, light) in SCENES {
            for dots in DOTS {
                for seed in first..=last {
                    let folder = tempfile::tempdir().expect("a folder can be made");
                    let output = folder.path().join("simulation");
                    let seed = seed.to_string();
                    let lens_options = ["--model", lens.model, "--parameters", lens.parameters];
                    let options =
                        ["--board", board, "--motion", motion, "--light", light, "--dots", dots, "--seed", &seed];
                    let rest = ["--duration", "0.6s", "-o", text(&output)];
                    succeed(&[&["simulate"][..], &lens_options, &options, &rest].concat());
                    let windows = windows(&output.join("events.aedat4"), &board.parse().expect("a board"));
                    tell(&format!("{dots} {board} {} {motion} {light} {seed}", lens.model), &windows);
                }
            }
        }
    }
}

fn windows(path: &Path, board: &Board) -> Windows {
    let recording = Recording::new(path, RecordingOptions::default()).expect("a recording");
    let sensor = sensor_of(&recording).expect("its sensor");
    let wanted = SearchFor::Board(board.pattern);
    let settings = DetectionSettings::default();
    let accepted = search_events(&recording, sensor, wanted, &settings).expect("events").report.found;
    let circles = SearchFor::Circles(settings.fewest_circles(&board.pattern));
    let found = search_events(&recording, sensor, circles, &settings).expect("events");
    let FoundContent::Windows(of_any_form) = found.content else { return Windows::default() };
    let frames: Vec<ReferenceFrame> = of_any_form
        .into_iter()
        .filter_map(|window| {
            let (mut frames, _) = order_frames(&[window.to_frame()], &board.pattern, Some(sensor));
            Some(ReferenceFrame { seen_in: SeenIn::Events(window.pixels), ..frames.pop()? })
        })
        .collect();
    let mut windows = Windows { accepted, placed: frames.len() as u64, ..Windows::default() };
    windows.sharpness = edge_width(&frames).map(|edges| edges.pixels);
    for shape in frames.iter().filter_map(|frame| DotShape::of_frame(frame, &board.pattern)) {
        windows.all.add(&shape);
        if let Some((amplitude, sigma)) = shape.corners() {
            windows.corners.push(amplitude);
            windows.certain_corners.push(amplitude - 3.0 * sigma);
        }
        windows.hollowness.push(shape.hollowness());
    }
    windows
}

fn tell(name: &str, windows: &Windows) {
    let spread = |values: &[f64]| {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let at =
            |share: f64| sorted.get((share * (sorted.len().max(1) - 1) as f64) as usize).copied().unwrap_or(f64::NAN);
        format!("{:.3} {:.3} {:.3}", at(0.005), at(0.5), at(0.995))
    };
    let (amplitude, sigma) = windows.all.corners().unwrap_or((f64::NAN, f64::NAN));
    println!(
        "{:>5} of {:>5} windows accepted; corners {}, certain {}, all {amplitude:.4} ± {sigma:.4}; hollow {}, all {:.3}; edges {:.2} px; {name}",
        windows.accepted,
        windows.placed,
        spread(&windows.corners),
        spread(&windows.certain_corners),
        spread(&windows.hollowness),
        windows.all.hollowness(),
        windows.sharpness.unwrap_or(f64::NAN)
    );
}
