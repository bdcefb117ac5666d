//! Calibrates a camera from a recording, prints it with its standard deviations, and writes all results.
//!
//!     cargo run --release --example calibrate -- fixtures/board/events.dvraw acircles:9x4:55mm:r17.5mm calibration

use std::error::Error;
use std::ops::ControlFlow;

use evcal::{Board, Recording, RecordingOptions, Task, calibrate, write_new_folder};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [recording, board, folder] = arguments.as_slice() else { return Err("give RECORDING BOARD FOLDER".into()) };
    let board: Board = board.parse()?;
    let inputs = [Recording::new(recording, RecordingOptions::default())?.into()];
    let task = Task::new(&inputs, &board);
    let calibrated = calibrate(&task, |stage| {
        eprintln!("{stage}");
        ControlFlow::Continue(())
    })?;
    let camera = calibrated.camera();
    let names = camera.kind().parameter_names();
    for (name, (value, sigma)) in names.iter().zip(camera.parameters().iter().zip(calibrated.sigma())) {
        println!("{name:<3} {value:>11.5} ± {sigma:.5}");
    }
    println!("{}", calibrated.verdict);
    write_new_folder(folder, &calibrated, &task)?;
    Ok(())
}
