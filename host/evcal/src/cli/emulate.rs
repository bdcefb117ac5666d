//! `evcal emulate`.

use std::path::PathBuf;
use std::thread::sleep;
use std::time::{Duration, Instant};

use clap::ValueEnum;
use evcal_live::playback::Playback;
use usb_davis::emulator::vhci::VirtualCamera;
use usb_davis::emulator::{Faults, Model, Pace};

use super::interrupt::Interrupt;
use super::source_arguments::SourceArguments;
use super::{print, value};

/// How often to look what has happened.
const POLL: Duration = Duration::from_millis(50);
/// Longest wait for the kernel to number the camera.
const ENUMERATION: Duration = Duration::from_secs(10);

/// Arguments of `evcal emulate`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Recording that the camera sends each time it is started: .dvraw, pcap, pcapng or bare stream as
    /// it is, events of any other format as a DAVIS346 sends them
    #[arg(value_name = "RECORDING")]
    recording: PathBuf,
    #[command(flatten)]
    source: SourceArguments,
    /// How fast it sends
    #[arg(long, value_enum, default_value_t = PaceArgument::Real)]
    pace: PaceArgument,
    /// Serial number of the camera [default: that of the recording]
    #[arg(long, value_name = "TEXT")]
    serial: Option<String>,
    /// Unplug the camera when it has sent so many bytes
    #[arg(long, value_name = "BYTES")]
    unplug_at: Option<u64>,
    /// Plug the camera in again so long after it was unplugged
    #[arg(long, value_name = "TIME", requires = "unplug_at", value_parser = value::seconds)]
    plug_in_after: Option<f64>,
    /// Halt the data endpoint when the camera has sent so many bytes
    #[arg(long, value_name = "BYTES")]
    stall_at: Option<u64>,
    /// Lengths of the transfers in bytes, over and over, such as 1,513,7
    #[arg(long, value_name = "LENGTHS", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..))]
    cuts: Vec<u32>,
    /// Of so many words sent, replace the last by one that no camera sends
    #[arg(long, value_name = "WORDS", value_parser = clap::value_parser!(u64).range(1..))]
    bad_word_every: Option<u64>,
}

/// Paces by name.
#[derive(Clone, Copy, ValueEnum)]
enum PaceArgument {
    /// As it was recorded; what the program does not fetch in time is lost, as with a camera
    Real,
    /// As fast as the program takes it; nothing is lost
    Full,
}

/// Runs `evcal emulate`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let playback = Playback::open(&arguments.recording, arguments.source.options())?;
    let serial = arguments.serial.clone().unwrap_or_else(|| playback.serial().to_owned());
    let header = playback.header().clone();
    let (plays, failures) = playback.plays();
    let faults = Faults {
        unplug_at: arguments.unplug_at,
        stall_at: arguments.stall_at,
        cuts: arguments.cuts.iter().map(|&length| length as usize).collect(),
        bad_word_every: arguments.bad_word_every,
        ..Faults::default()
    };
    let pace = match arguments.pace {
        PaceArgument::Real => Pace::Real,
        PaceArgument::Full => Pace::Full,
    };
    let model =
        Model::new(&serial, plays).with_header(&header).with_serial(&serial).with_pace(pace).with_faults(faults);
    let interrupt = Interrupt::catch()?;
    let mut camera = VirtualCamera::plug_in(model)?;
    announce(&camera, &serial)?;
    let mut unplugged = None;
    while !interrupt.is_asked() {
        if let Ok(failure) = failures.try_recv() {
            return Err(failure.into());
        }
        match (camera.is_plugged_in(), unplugged) {
            (true, _) => {}
            (false, None) => {
                print::line(format!("unplugged, {} bytes after the start", camera.model(|model| model.sent())))?;
                unplugged = Some(Instant::now());
            }
            (false, Some(since)) => {
                let duration = |seconds| Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX);
                let after = arguments.plug_in_after.map(duration);
                if after.is_some_and(|after| since.elapsed() >= after) {
                    camera.plug_in_again()?;
                    announce(&camera, &serial)?;
                    unplugged = None;
                }
            }
        }
        sleep(POLL);
    }
    camera.unplug()?;
    print::line(format!("unplugged, {} bytes after the start", camera.model(|model| model.sent())))
}

/// Tells where the camera is.
fn announce(camera: &VirtualCamera, serial: &str) -> super::Outcome {
    let end = Instant::now() + ENUMERATION;
    let location = loop {
        match camera.location()? {
            Some(location) => break location,
            None if Instant::now() < end => sleep(POLL),
            None => return Err("the kernel does not enumerate the camera; `dmesg` tells why".into()),
        }
    };
    print::line(format!(
        "DAVIS346 {serial} is at bus {}, address {} (/dev/bus/usb/{:03}/{:03}); Ctrl-C unplugs it",
        location.bus, location.address, location.bus, location.address
    ))
}
