//! A running camera: start, reading and stop.

use std::thread::sleep;
use std::time::{Duration, SystemTime};

use super::backlog::{Queue, StreamStatistics};
use super::camera::Camera;
use super::error::{DeviceError, StreamError};
use super::transfers::Transfers;
use crate::capture::DATA_ENDPOINT;
use crate::configuration::Streams;
use crate::dump::{DumpHeader, Transfer};
use crate::registers::{DROP_COUNTERS, Dropped, Register, mux, usb};

/// Pause after the camera was stopped, as in libcaer.
const SETTLE_QUIET: Duration = Duration::from_millis(10);
/// Pause after the chip was switched on, as in libcaer.
const SETTLE_CHIP: Duration = Duration::from_millis(200);
/// Pause before the streams are switched on, as in libcaer.
const SETTLE_STREAM: Duration = Duration::from_millis(50);

/// Time without data after which the camera contains no more data of an earlier run.
const STALE_TIMEOUT: Duration = Duration::from_millis(20);
/// Largest number of reads of data that an earlier run left in the camera.
const STALE_MOST: usize = 256;

impl Camera {
    /// Starts `streams`: stops the camera, discards data of an earlier run, queues the transfers, and then switches on
    /// chip, output, time, multiplexer and finally the streams. If the data endpoint halts in between, the start is
    /// repeated once.
    pub fn start(&mut self, streams: Streams, queue: Queue) -> Result<Stream<'_>, DeviceError> {
        let transfers = match self.try_start(streams, queue) {
            Err(DeviceError::Usb { source: rusb::Error::Pipe, .. }) => self.try_start(streams, queue)?,
            transfers => transfers?,
        };
        let start_unix = SystemTime::now().checked_sub(transfers.started().elapsed());
        let mut header = self.header();
        if let Some(start) = start_unix.and_then(|start| start.duration_since(SystemTime::UNIX_EPOCH).ok()) {
            header.start_unix_ns = u64::try_from(start.as_nanos()).unwrap_or(0);
        }
        Ok(Stream { camera: self, transfers, header, running: true })
    }

    fn try_start(&mut self, streams: Streams, queue: Queue) -> Result<Transfers, DeviceError> {
        self.quiesce()?;
        sleep(SETTLE_QUIET);
        self.handle.clear_halt(DATA_ENDPOINT).map_err(DeviceError::usb("clearing the data endpoint"))?;
        self.discard_stale()?;
        let transfers = Transfers::start(&self.context, &self.handle, DATA_ENDPOINT, queue)
            .map_err(DeviceError::usb("queueing transfers"))?;
        // The camera's counters continue from one recording to the next, so their current values are the zero of this
        // one.
        match self.switch_on(streams).and_then(|()| self.read_counters().map(|_| ())) {
            // The data sent before the camera was unplugged can be read; the stream then ends by itself.
            Ok(()) | Err(DeviceError::Unplugged) => {}
            Err(error) => return Err(error),
        }
        if transfers.halted_at_once() {
            return Err(DeviceError::Usb { doing: "starting the stream", source: rusb::Error::Pipe });
        }
        Ok(transfers)
    }

    fn read_counters(&mut self) -> Result<Vec<(Register, u32)>, DeviceError> {
        DROP_COUNTERS.into_iter().map(|register| Ok((register, self.read(register)?))).collect()
    }

    fn switch_on(&mut self, streams: Streams) -> Result<(), DeviceError> {
        self.write(mux::RUN_CHIP, 1)?;
        sleep(SETTLE_CHIP);
        self.write_all([(usb::RUN, 1), (mux::TIMESTAMP_RUN, 1), (mux::RUN, 1)])?;
        sleep(SETTLE_STREAM);
        self.write_all(streams.writes())
    }

    /// Discards bytes of an earlier run, which would be taken for the beginning of this one.
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
    header: DumpHeader,
    running: bool,
}

impl Stream<'_> {
    /// Returns the header of a dump of this stream, with the registers as they were after the start.
    pub fn header(&self) -> &DumpHeader {
        &self.header
    }

    /// Returns the next transfer in the order of the wire, waiting for it up to `timeout`; `None` if none arrived.
    /// Returns an error after the last transfer of the stream.
    pub fn next(&mut self, timeout: Duration) -> Result<Option<Transfer<'_>>, StreamError> {
        self.transfers.next(timeout)
    }

    /// Stops the camera. Data that it sent before can still be read, followed by [`StreamError::Stopped`] or the reason
    /// why the stream had already ended. An unplugged camera is not an error here.
    pub fn stop(&mut self) -> Result<(), DeviceError> {
        if !std::mem::take(&mut self.running) {
            return Ok(());
        }
        // Stopping may clear the counters, so they are read first.
        let counted = self.camera.read_counters().map(|_| ());
        let quiesced = self.camera.quiesce();
        self.transfers.stop();
        match counted.and(quiesced) {
            Err(DeviceError::Unplugged) => Ok(()),
            result => result,
        }
    }

    /// Returns the statistics so far.
    pub fn statistics(&self) -> StreamStatistics {
        self.transfers.statistics()
    }

    /// Reads from the camera how much it has dropped since the start. The stream itself does not contain this.
    pub fn read_dropped(&mut self) -> Result<Dropped, DeviceError> {
        self.camera.read_counters()?;
        Ok(self.dropped())
    }

    /// Returns how much the camera had dropped since the start at the last reading; stopping the camera reads it too.
    pub fn dropped(&self) -> Dropped {
        Dropped::between(&self.header.registers, self.camera.registers())
    }

    /// Returns the camera's drop counters as of the last reading, for [`crate::dump::DumpWriter::registers`]. They
    /// continue from the values in [`Stream::header`].
    pub fn drop_counters(&self) -> Vec<(Register, u32)> {
        let value = |register| Some((register, self.camera.registers().get(register)?));
        DROP_COUNTERS.into_iter().filter_map(value).collect()
    }

    /// Returns the camera, for reading or changing a setting while it runs.
    pub fn camera(&mut self) -> &mut Camera {
        self.camera
    }
}

impl Drop for Stream<'_> {
    fn drop(&mut self) {
        // This fails if the camera is gone, and then there is nothing to stop.
        let _ = self.stop();
    }
}
