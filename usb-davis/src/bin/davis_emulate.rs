//! Emulates a DAVIS346 on this computer, for testing a driver without a camera: every program sees the camera in
//! `/dev/bus/usb`. Needs root and the kernel's virtual USB controller (`modprobe vhci-hcd`).
//!
//! `davis-emulate RECORDING [OPTION]…` sends the recording (`.dvraw`, pcap, pcapng or bare payload) whenever the camera
//! is started, with the identity and timing of the recorded camera, until Ctrl-C. Exit status: 1 after a failure, 2 for
//! wrong arguments.
//!
//! | option | effect |
//! |---|---|
//! | `full` | sends as fast as the program reads; nothing is dropped |
//! | `serial=TEXT` | sets another serial number, so that several cameras can be emulated at the same time |
//! | `device=BUS.DEVICE` | chooses a device in a pcap or pcapng capture with several cameras |
//! | `unplug-at=BYTES` | unplugs the camera after this many bytes were sent |
//! | `plug-in-after=SECONDS` | plugs the camera in again this time after it was unplugged, with its initial registers |
//! | `stall-at=BYTES` | halts the data endpoint until the program clears the halt |
//! | `cuts=LENGTH,…` | uses transfers of these lengths, repeatedly, odd lengths included |
//! | `bad-word-every=WORDS` | replaces every WORDS-th word by a word that no camera sends |
#![cfg_attr(not(target_os = "linux"), allow(unused, reason = "only Linux has the virtual USB controller"))]

use std::error::Error;
use std::fmt::Display;
use std::num::{NonZeroU64, NonZeroUsize};
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;
use std::sync::mpsc::{self, Sender, SyncSender};
use std::thread::{self, sleep};
use std::time::{Duration, Instant};

use usb_davis::capture::{Capture, CaptureError, DeviceAddress};
#[cfg(target_os = "linux")]
use usb_davis::emulator::vhci::VirtualCamera;
use usb_davis::emulator::{CapturePieces, Faults, Model, Pace, Piece};

const USAGE: &str = "usage: davis-emulate RECORDING [full] [serial=TEXT] [device=BUS.DEVICE] [unplug-at=BYTES] \
     [plug-in-after=SECONDS] [stall-at=BYTES] [cuts=LENGTH,...] [bad-word-every=WORDS]";
/// Interval at which the state of the camera is checked.
const POLL: Duration = Duration::from_millis(50);
/// Longest wait for the kernel to number the camera.
const ENUMERATION: Duration = Duration::from_secs(10);
/// Number of pieces that are read ahead.
const AHEAD: usize = 64;
/// Serial number of the camera if the recording contains none.
const SERIAL: &str = "00000000";

#[derive(Clone)]
struct Recording {
    path: PathBuf,
    device: Option<DeviceAddress>,
}

struct Arguments {
    recording: Recording,
    serial: Option<String>,
    pace: Pace,
    plug_in_after: Option<Duration>,
    faults: Faults,
}

/// Parses the value of an option.
fn value<T: FromStr<Err: Display>>(option: &str, text: &str) -> Result<T, String> {
    text.parse().map_err(|error| format!("{option}: {error}"))
}

fn parse(arguments: &[String]) -> Result<Arguments, String> {
    let [path, options @ ..] = arguments else { return Err(USAGE.to_owned()) };
    let mut parsed = Arguments {
        recording: Recording { path: path.into(), device: None },
        serial: None,
        pace: Pace::Real,
        plug_in_after: None,
        faults: Faults::default(),
    };
    for option in options {
        match option.split_once('=') {
            None if option == "full" => parsed.pace = Pace::Full,
            Some(("serial", text)) => parsed.serial = Some(text.to_owned()),
            Some(("device", text)) => parsed.recording.device = Some(value(option, text)?),
            Some(("unplug-at", text)) => parsed.faults.unplug_at = Some(value(option, text)?),
            Some(("plug-in-after", text)) => {
                let seconds = Duration::try_from_secs_f64(value(option, text)?);
                parsed.plug_in_after = Some(seconds.map_err(|error| format!("{option}: {error}"))?);
            }
            Some(("stall-at", text)) => parsed.faults.stall_at = Some(value(option, text)?),
            Some(("cuts", text)) => {
                let lengths = text.split(',').map(|length| value(option, length).map(NonZeroUsize::get));
                parsed.faults.cuts = lengths.collect::<Result<_, _>>()?;
            }
            Some(("bad-word-every", text)) => {
                parsed.faults.bad_word_every = Some(value::<NonZeroU64>(option, text)?.get());
            }
            _ => return Err(format!("unknown option {option}\n{USAGE}")),
        }
    }
    if parsed.plug_in_after.is_some() && parsed.faults.unplug_at.is_none() {
        return Err("plug-in-after needs unplug-at".to_owned());
    }
    Ok(parsed)
}

/// Reads a recording to its end, or until the receiver of the pieces is gone.
fn read(recording: &Recording, pieces: &SyncSender<Piece>) -> Result<(), CaptureError> {
    for piece in CapturePieces::new(Capture::open_device(&recording.path, recording.device)?) {
        if pieces.send(piece?).is_err() {
            break;
        }
    }
    Ok(())
}

/// Returns a function that starts to read the recording, in a thread of its own, so that neither a slow disk nor a long
/// capture delays the camera. Errors that end the reading early are sent to `failures`.
fn plays(recording: Recording, failures: Sender<CaptureError>) -> impl FnMut() -> mpsc::IntoIter<Piece> + Send {
    move || {
        let (sender, pieces) = mpsc::sync_channel(AHEAD);
        let (recording, failures) = (recording.clone(), failures.clone());
        thread::spawn(move || read(&recording, &sender).or_else(|error| failures.send(error)));
        pieces.into_iter()
    }
}

#[cfg(target_os = "linux")]
fn emulate(arguments: Arguments) -> Result<(), Box<dyn Error>> {
    let Arguments { recording, serial, pace, plug_in_after, faults } = arguments;
    let in_recording = |error: CaptureError| format!("{}: {error}", recording.path.display());
    let header = Capture::open_device(&recording.path, recording.device).map_err(in_recording)?.header().clone();
    let recorded = header.identity.as_ref().map_or(SERIAL, |identity| &identity.serial);
    let serial = serial.unwrap_or_else(|| recorded.to_owned());
    let (sender, failures) = mpsc::channel();
    let model = Model::new(&serial, plays(recording.clone(), sender)).with_header(&header);
    let model = model.with_serial(&serial).with_pace(pace).with_faults(faults);
    let mut camera = VirtualCamera::plug_in(model)?;
    announce(&camera, &serial)?;
    let mut unplugged = None;
    loop {
        if let Ok(failure) = failures.try_recv() {
            return Err(in_recording(failure).into());
        }
        if !camera.is_plugged_in() {
            if unplugged.is_none() {
                println!("unplugged, {} bytes after the start", camera.model(|model| model.sent()));
            }
            let since = *unplugged.get_or_insert_with(Instant::now);
            if plug_in_after.is_some_and(|after| since.elapsed() >= after) {
                camera.plug_in_again()?;
                announce(&camera, &serial)?;
                unplugged = None;
            }
        }
        sleep(POLL);
    }
}

/// Prints the bus and address of the camera.
#[cfg(target_os = "linux")]
fn announce(camera: &VirtualCamera, serial: &str) -> Result<(), Box<dyn Error>> {
    let end = Instant::now() + ENUMERATION;
    let location = loop {
        match camera.location()? {
            Some(location) => break location,
            None if Instant::now() < end => sleep(POLL),
            None => return Err("the kernel does not enumerate the camera; see `dmesg` for the reason".into()),
        }
    };
    println!(
        "DAVIS346 {serial} is at bus {}, address {} (/dev/bus/usb/{:03}/{:03}); Ctrl-C unplugs it",
        location.bus, location.address, location.bus, location.address
    );
    Ok(())
}

#[cfg(not(target_os = "linux"))]
fn emulate(_: Arguments) -> Result<(), Box<dyn Error>> {
    Err("only Linux has the virtual USB controller".into())
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments = match parse(&arguments) {
        Ok(arguments) => arguments,
        Err(error) => {
            eprintln!("{error}");
            return ExitCode::from(2);
        }
    };
    match emulate(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
