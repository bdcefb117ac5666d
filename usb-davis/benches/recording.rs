//! Recording to disk at 50 MB/s: `cargo bench -p usb-davis --bench recording`.
//!
//! An emulated camera sends in real time; `davis-record` receives through libusb. Prints the number of events that the
//! camera dropped because no transfer was queued, and the recorder's memory. Needs the Debian package `umockdev`.

#[cfg(not(target_os = "linux"))]
fn main() {}

#[cfg(target_os = "linux")]
fn main() {
    use std::process::{Command, Stdio};
    use std::thread::sleep;
    use std::time::Duration;

    use usb_davis::emulator::umockdev::EmulatedBus;
    use usb_davis::emulator::{Model, Pace, Piece};

    const SECONDS: u64 = 5;
    const RATE: u64 = 50_000_000;
    const PIECE: u64 = 8192;
    // Pieces of 8 KiB, the size that the FPGA passes to the USB controller.
    let source = || {
        let pieces = SECONDS * RATE / PIECE;
        (0..pieces).map(|index| Piece {
            time: index * PIECE * 1_000_000 / RATE,
            bytes: [0x01, 0x80, 0x05, 0x10, 0x07, 0x20, 0x08, 0x30].repeat(PIECE as usize / 8),
        })
    };
    let bytes = source().count() as u64 * PIECE;
    let model = Model::new("1", source).with_pace(Pace::Real);
    let bus = EmulatedBus::start(model).expect("the bus starts");
    let directory = tempfile::tempdir().expect("a directory can be made");
    let path = directory.path().join("bench.dvraw");
    let mut recorder = Command::new(env!("CARGO_BIN_EXE_davis-record"))
        .args([path.to_str().expect("UTF-8"), "15", &format!("bytes={bytes}")])
        .envs(bus.environment())
        .stdout(Stdio::piped())
        .spawn()
        .expect("davis-record runs");
    let status = format!("/proc/{}/status", recorder.id());
    let mut memory = String::new();
    while recorder.try_wait().expect("it is ours").is_none() {
        let status = std::fs::read_to_string(&status).unwrap_or_default();
        memory = status.lines().find(|line| line.starts_with("VmHWM")).map_or(memory, str::to_owned);
        sleep(Duration::from_millis(50));
    }
    let output = recorder.wait_with_output().expect("it is ours");
    println!("{} MB at {} MB/s, {memory}", bytes / 1_000_000, RATE / 1_000_000);
    println!("{}", String::from_utf8_lossy(&output.stdout));
}
