//! Processor time, passes and memory of a calibration, by stage.
//!
//! ```text
//! cargo bench -p evcal --bench calibrate [-- RECORDING BOARD MODEL]
//! ```
//!
//! Without arguments it calibrates the fixture. Processor times are sums over all threads, so a busy machine hardly changes them.
//! Passes are passes through the file; passes through the observations are the iterations of the joint solve. The report is a
//! separate stage, as in `evcal calibrate`. Needs Linux's `/proc`.

use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use evcal_calibrate::calibrate::calibrate;
use evcal_calibrate::calibrate::calibrated::EventCalibration;
use evcal_calibrate::task::Task;
use evcal_calibrate::task::input::Input;
use evcal_core::camera::ModelKind;
use evcal_solve::initial::model_choice::ModelRequest;
use evcal_solve::solve::levenberg::{OF_CAMERA, Schedule, solve_with_progress};
use evcal_solve::solve::refinement::{Refined, RoundReport};
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
    let mut stages: Vec<(String, Counters)> = vec![("start".to_owned(), Counters::now()?)];
    let calibrated = calibrate(&task, |step| {
        if stages.last().is_none_or(|(last, _)| last != step.text) {
            stages.extend(Counters::now().map(|counters| (step.text.to_owned(), counters)));
        }
        ControlFlow::Continue(())
    })?;
    stages.push(("results and report".to_owned(), Counters::now()?));
    let folder = tempfile::tempdir()?;
    evcal::write_new_folder(folder.path(), &calibrated, &task)?;
    stages.push(("end".to_owned(), Counters::now()?));
    let (wall, memory) = (start.elapsed().as_secs_f64(), peak_memory()?);

    let events = calibrated.recordings.iter().map(|recording| recording.count).sum::<u64>() as f64;
    let length: f64 = calibrated.recordings.iter().map(|recording| recording.duration).sum();
    let size = std::fs::metadata(path)?.len() as f64;
    println!("{}: {:.2} million events, {length:.1} s", Path::new(path).display(), 1e-6 * events);
    println!("{:<44} {:>6} {:>8} {:>10} {:>6}", "stage", "CPU s", "share", "ns / event", "passes");
    let [(_, first), .., (_, last)] = stages.as_slice() else { return Ok(()) };
    let line = |stage: &str, from: &Counters, to: &Counters| {
        let (time, passes) = (to.time - from.time, (to.read - from.read) / size);
        let share = 100.0 * time / (last.time - first.time);
        println!("{stage:<44} {time:>6.2} {share:>6.1} % {:>10.1} {passes:>6.2}", 1e9 * time / events);
    };
    for ((stage, from), (_, to)) in stages.iter().zip(stages.iter().skip(1)) {
        line(stage, from, to);
    }
    line("whole", first, last);
    if let Some(EventCalibration { refined, .. }) = calibrated.events() {
        println!(
            "{:<44} {:>12} {:>10} {:>8}",
            "round of the last joint solve", "observations", "iterations", "rejected"
        );
        for (round, RoundReport { solve, .. }) in refined.rounds.iter().enumerate() {
            println!("{:<44} {:>12} {:>10} {:>8}", round + 1, solve.observations, solve.iterations, solve.rejected);
        }
        println!("joint solve: {:.0} ns per observation and iteration, one core", 1e9 * solve_time(refined)?);
    }
    println!("{wall:.1} s on this machine, {:.2} times the recording; {memory:.0} MB at most", wall / length);
    Ok(())
}

/// Consumption of this process since it began.
struct Counters {
    /// User plus system time (s).
    time: f64,
    /// Bytes read from files.
    read: f64,
}

impl Counters {
    fn now() -> Result<Self, Box<dyn std::error::Error>> {
        let text = std::fs::read_to_string("/proc/self/io")?;
        let read = text.lines().find_map(|line| line.strip_prefix("rchar:")).ok_or("no rchar in /proc/self/io")?;
        Ok(Self { time: processor_time()?, read: read.trim().parse()? })
    }
}

/// Repeats the last solve on one core, from its result on. Returns the processor time per observation and iteration (s).
fn solve_time(refined: &Refined) -> Result<f64, Box<dyn std::error::Error>> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let start = processor_time()?;
    // No step is trusted, so that all are evaluated.
    let schedule = Schedule { trusted: 0.0, ..OF_CAMERA };
    let goes_on = &mut |_| ControlFlow::Continue(());
    let solved = pool.install(|| solve_with_progress(&refined.problem, refined.state.clone(), schedule, goes_on))?;
    // The observations are also processed once before the first iteration.
    Ok((processor_time()? - start) / (solved.report.observations * (solved.report.iterations + 1)) as f64)
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
