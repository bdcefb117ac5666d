//! Access to the camera through libusb.
//!
//! ```no_run
//! use std::time::{Duration, Instant};
//! use usb_davis::configuration::{Configuration, Streams};
//! use usb_davis::device::{Camera, Queue, Selector, StreamError};
//! use usb_davis::dump::{Compression, DumpWriter};
//!
//! let mut camera = Camera::open(&Selector::default())?;
//! camera.configure(&Configuration::calibration())?;
//! let mut stream = camera.start(Streams::EVENTS, Queue::default())?;
//! let file = std::fs::File::create("recording.dvraw")?;
//! let mut dump = DumpWriter::new(file, stream.header(), Compression::None)?;
//! let end = Instant::now() + Duration::from_secs(10);
//! loop {
//!     match stream.next(Duration::from_millis(100)) {
//!         Ok(Some(transfer)) => dump.transfer(&transfer)?,
//!         Ok(None) => {}
//!         Err(StreamError::Stopped) => break,
//!         Err(error) => return Err(error.into()), // unplugged: all earlier transfers are in the dump
//!     }
//!     if Instant::now() >= end {
//!         stream.stop()?; // transfers under way still arrive, then `Stopped`
//!     }
//! }
//! dump.registers(stream.drop_counters())?;
//! dump.finish()?;
//! println!("the camera dropped {} events", stream.dropped().events);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Guarantees: no call waits forever; an error never loses data that were received before it; the memory of a stream is
//! bounded ([`Queue`]).

mod backlog;
mod camera;
mod error;
mod list;
mod stream;
#[allow(unsafe_code, reason = "asynchronous transfers exist only in libusb's C interface")]
mod transfers;

pub use backlog::{Queue, StreamStatistics};
pub use camera::Camera;
pub use error::{DeviceError, StreamError, UDEV_RULE, UDEV_RULE_FILE, Unsupported};
pub use list::{Availability, Listing, Selector, list};
pub use stream::Stream;
