//! Finds the board in a recording and prints where its first circle was seen.
//!
//!     cargo run --release --example detect -- fixtures/board/events.dvraw acircles:9x4:55mm:r17.5mm

use std::error::Error;

use evcal::{CircleBoard, Recording, RecordingOptions};
use evcal_calibrate::settings::Settings;
use evcal_detection::detection::search::{FoundContent, SearchFor, search_events, sensor_of};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [recording, board] = arguments.as_slice() else { return Err("give RECORDING BOARD".into()) };
    let board: CircleBoard = board.parse()?;
    let recording = Recording::new(recording, RecordingOptions::default())?;
    let wanted = SearchFor::Board(board.pattern);
    let found = search_events(&recording, sensor_of(&recording)?, wanted, &Settings::default().detection)?;
    if let FoundContent::Boards(_, frames) = &found.content {
        for frame in frames {
            if let Some(circle) = frame.circles.iter().find(|circle| circle.index == 0) {
                println!("{:8.4} s  {:7.2} {:7.2} px", frame.t(), circle.center.x, circle.center.y);
            }
        }
    }
    println!("the board was found in {} of {} windows", found.report.found, found.report.windows);
    Ok(())
}
