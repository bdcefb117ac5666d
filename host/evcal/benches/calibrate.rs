//! Processor time and memory of a calibration, by stage.
//!
//! ```text
//! cargo bench -p evcal --bench calibrate [-- RECORDING BOARD MODEL]
//! ```
//!
//! Without arguments it calibrates the fixture. Processor times are sums over all threads, so a busy machine hardly changes them.
//! The report is a separate stage, as in `evcal calibrate`. Needs Linux's `/proc`.

use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use evcal_calibrate::calibrate::input::Input;
use evcal_calibrate::calibrate::{Task, calibrate};
use evcal_calibrate::initial::model_choice::ModelRequest;
use evcal_core::camera::ModelKind;
use event_recordings::RecordingOptions;

/// Ticks of processor time per second in `/proc/self/stat`: the same on every Linux.
const TICKS: f64 = 100.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let argument = |index: usize, usual: &'static str| arguments.get(index).map_or(usual, String::as_str);
    let fixture = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/board/events.dvraw");
    let path = argument(0, fixture);
    let board = argument(1, "acircles:9x4:55mm:r17.5mm").parse()?;
    let model = ModelRequest::Given(argument(2, "radtan").parse::<ModelKind>()?);
    let inputs = [Input::open(Path::new(path), &RecordingOptions::default(), &board)?];
    let task = Task { model, ..Task::new(&inputs, &board) };

    let start = Instant::now();
    let mut stages: Vec<(String, f64)> = vec![("start".to_owned(), processor_time()?)];
    let calibrated = calibrate(&task, |step| {
        if stages.last().is_none_or(|(last, _)| last != step.text) {
            stages.push((step.text.to_owned(), processor_time().unwrap_or(0.0)));
        }
        ControlFlow::Continue(())
    })?;
    stages.push(("results and report".to_owned(), processor_time()?));
    let folder = tempfile::tempdir()?;
    evcal::write_new_folder(folder.path(), &calibrated, &task)?;
    let end = processor_time()?;
    let wall = start.elapsed().as_secs_f64();

    let events: u64 = calibrated.recordings.iter().map(|recording| recording.count).sum();
    let length: f64 = calibrated.recordings.iter().map(|recording| recording.duration).sum();
    let first = stages.first().map_or(0.0, |(_, time)| *time);
    let total = end - first;
    let millions = events as f64 * 1e-6;
    println!("{}: {millions:.2} million events, {length:.1} s", Path::new(path).display());
    println!("{:<44} {:>6} {:>7} {:>12}", "stage", "CPU s", "share", "s / Mevent");
    let ends = stages.iter().skip(1).map(|(_, time)| *time).chain([end]);
    for ((stage, start), end) in stages.iter().zip(ends).filter(|((_, start), end)| end > start) {
        let time = end - start;
        println!("{stage:<44} {time:>6.2} {:>5.1} % {:>12.3}", 100.0 * time / total, time / millions);
    }
    println!("{:<44} {total:>6.2} {:>5.1} % {:>12.3}", "whole", 100.0, total / millions);
    println!("{wall:.1} s on this machine, {:.2} times the recording; {:.0} MB at most", wall / length, peak_memory()?);
    Ok(())
}

/// Returns user plus system time of this process (s).
fn processor_time() -> Result<f64, Box<dyn std::error::Error>> {
    let text = std::fs::read_to_string("/proc/self/stat")?;
    // Fields follow the program's name, which may contain blanks; field 14 is the user time, field 15 the system time.
    let (_, fields) = text.rsplit_once(')').ok_or("no fields in /proc/self/stat")?;
    let ticks = fields.split_whitespace().skip(11).take(2).map(str::parse::<f64>).sum::<Result<f64, _>>()?;
    Ok(ticks / TICKS)
}

/// Returns the peak resident memory (MB).
fn peak_memory() -> Result<f64, Box<dyn std::error::Error>> {
    let text = std::fs::read_to_string("/proc/self/status")?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:")).ok_or("no VmHWM in /proc/self/status")?;
    Ok(line.trim_end_matches("kB").trim().parse::<f64>()? * 1024e-6)
}
