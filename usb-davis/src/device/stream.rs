//! A running camera.

use std::time::Duration;

use super::camera::Camera;
use super::error::{DeviceError, StreamError};
use super::transfers::Transfers;
use crate::dump::Transfer;

/// What a stream has done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamStatistics {
    /// Transfers that brought something.
    pub transfers: u64,
    /// Bytes they brought.
    pub bytes: u64,
    /// Transfers that could not be queued again at once, because all buffers were full: the reader
    /// is too slow. The camera may have dropped events then; its own counters know
    /// ([`Camera::read_drop_counters`]).
    pub starved: u64,
    /// Largest number of full buffers that waited to be read.
    pub waiting_most: usize,
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
