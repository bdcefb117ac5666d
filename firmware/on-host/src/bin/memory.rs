//! Prints a Markdown table of the RAM that the detector takes, for some sensors and window sizes.
//!
//! Sizes are for this machine's pointers; on a microcontroller they are up to 64 bytes smaller.

use evcal_core::detector::Detector;
use evcal_core::filter::FilterStorage;
use evcal_core::window::EventStorage;
use evcal_detector::{Storage, row_bytes, row_count};

/// One row of the table: a sensor and its capacities.
macro_rules! row {
    ($width:literal x $height:literal, $runs:literal, $clusters:literal, $events:literal, $cells:literal, $slots:literal) => {
        const { assert!($width <= 2048 && $height <= 2048) };
        println!(
            "| {}×{} | {} | {} | {} | {} | {} | {:.1} | {:.1} | {:.1} | {:.1} |",
            $width,
            $height,
            $events,
            $runs,
            $clusters,
            $cells,
            $slots,
            kib(size_of::<Detector<f32, { row_bytes($width) }, { row_count($height) }, $runs, $clusters>>()),
            kib(size_of::<EventStorage<$events>>()),
            kib(size_of::<FilterStorage<$cells, $slots>>()),
            kib(size_of::<
                Storage<{ row_bytes($width) }, { row_count($height) }, $runs, $clusters, $events, $cells, $slots>,
            >()),
        );
    };
}

fn main() {
    println!(
        "| sensor | `EVENTS` | `RUNS` | `CLUSTERS` | `CELLS` | `SLOTS` | detector KiB | events KiB | filter KiB | all KiB |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    row!(128 x 128, 1024, 64, 2000, 1024, 256);
    row!(320 x 320, 2048, 128, 4000, 1600, 512);
    row!(346 x 260, 2048, 128, 4000, 1452, 512);
    row!(346 x 260, 4096, 256, 8000, 5655, 1024);
    row!(640 x 480, 4096, 256, 8000, 4800, 1024);
    row!(1280 x 720, 8192, 256, 16000, 3600, 2048);
}

fn kib(bytes: usize) -> f64 {
    bytes as f64 / 1024.0
}
