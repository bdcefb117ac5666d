//! A running camera: how it is started and stopped.

use std::thread::sleep;
use std::time::Duration;

use super::camera::Camera;
use super::error::{DeviceError, StreamError};
use super::transfers::{Queue, StreamStatistics, Transfers};
use crate::capture::DATA_ENDPOINT;
use crate::configuration::Streams;
use crate::dump::Transfer;
use crate::registers::{mux, usb};

/// Pauses after switching, as libcaer makes them.
const SETTLE_QUIET: Duration = Duration::from_millis(10);
const SETTLE_CHIP: Duration = Duration::from_millis(200);
const SETTLE_STREAM: Duration = Duration::from_millis(50);

/// Reads of what an earlier run left in the camera: as long as it takes one to find nothing.
const STALE_TIMEOUT: Duration = Duration::from_millis(20);
const STALE_MOST: usize = 256;

impl Camera {
    /// Starts `streams`: brings the camera to rest, empties it of what an earlier run left, queues
    /// the transfers, then switches on chip, output, time, multiplexer and at last the streams.
    pub fn start(&mut self, streams: Streams, queue: Queue) -> Result<Stream<'_>, DeviceError> {
        self.quiesce()?;
        sleep(SETTLE_QUIET);
        self.handle.clear_halt(DATA_ENDPOINT).map_err(DeviceError::usb("clearing the data endpoint"))?;
        self.discard_stale()?;
        let transfers = Transfers::start(&self.context, &self.handle, DATA_ENDPOINT, queue)
            .map_err(DeviceError::usb("queueing transfers"))?;
        match self.switch_on(streams) {
            // What it sent before it was unplugged can be read; the stream ends by itself then.
            Ok(()) | Err(DeviceError::Unplugged) => Ok(Stream::new(self, transfers)),
            Err(error) => Err(error),
        }
    }

    fn switch_on(&mut self, streams: Streams) -> Result<(), DeviceError> {
        self.write(mux::RUN_CHIP, 1)?;
        sleep(SETTLE_CHIP);
        self.write_all([(usb::RUN, 1), (mux::TIMESTAMP_RUN, 1), (mux::RUN, 1)])?;
        sleep(SETTLE_STREAM);
        self.write_all(streams.writes())
    }

    /// Bytes of an earlier run would be taken for the beginning of this one.
    fn discard_stale(&self) -> Result<(), DeviceError> {
        let mut stale = vec![0; 16 * 1024];
        for _ in 0..STALE_MOST {
            match self.handle.read_bulk(DATA_ENDPOINT, &mut stale, STALE_TIMEOUT) {
                Ok(0) | Err(rusb::Error::Timeout) => break,
                Ok(_) | Err(rusb::Error::Overflow) => {}
                Err(error) => return Err(DeviceError::usb("emptying the camera")(error)),
            }
        }
        Ok(())
    }
}

/// A running camera. Dropping it stops the camera.
pub struct Stream<'c> {
    camera: &'c mut Camera,
    transfers: Transfers,
    running: bool,
}

impl<'c> Stream<'c> {
    pub(super) fn new(camera: &'c mut Camera, transfers: Transfers) -> Self {
        Self { camera, transfers, running: true }
    }

    /// The next transfer, in the order of the wire, waiting for it up to `timeout`; `None` if none
    /// came. An error says that none will come any more, after the last that came.
    pub fn next(&mut self, timeout: Duration) -> Result<Option<Transfer<'_>>, StreamError> {
        self.transfers.next(timeout)
    }

    /// Stops the camera. What it had sent before can still be read; then comes
    /// [`StreamError::Stopped`], or the reason for which it had ended already. That it is unplugged
    /// is no error here.
    pub fn stop(&mut self) -> Result<(), DeviceError> {
        if !std::mem::take(&mut self.running) {
            return Ok(());
        }
        let quiesced = self.camera.quiesce();
        self.transfers.stop();
        match quiesced {
            Err(DeviceError::Unplugged) => Ok(()),
            quiesced => quiesced,
        }
    }

    /// What happened so far.
    pub fn statistics(&self) -> StreamStatistics {
        self.transfers.statistics()
    }

    /// The camera, to read its counters or change a setting while it runs.
    pub fn camera(&mut self) -> &mut Camera {
        self.camera
    }
}

impl Drop for Stream<'_> {
    fn drop(&mut self) {
        // A camera that is gone needs no stopping.
        let _ = self.stop();
    }
}
