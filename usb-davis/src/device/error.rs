//! Errors of a camera, with advice in their messages.

/// Path of the file for [`UDEV_RULE`].
pub const UDEV_RULE_FILE: &str = "/etc/udev/rules.d/65-inivation.rules";
/// udev rule that allows the user at the computer to open the camera.
pub const UDEV_RULE: &str =
    r#"SUBSYSTEM=="usb", ATTR{idVendor}=="152a", ATTR{idProduct}=="84[0-1]?", MODE="0660", TAG+="uaccess""#;

/// A firmware or logic version that this crate does not support.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Unsupported {
    /// Unsupported firmware of the USB controller.
    #[error("firmware {found} is too old, at least 6 is needed; update the camera with iniVation's Flashy")]
    Firmware {
        /// Version found.
        found: u8,
    },
    /// Unsupported version of the logic.
    #[error("logic version {found} is not 18; update the camera with iniVation's Flashy")]
    Logic {
        /// Version found.
        found: u32,
    },
    /// Unsupported patch level of the logic.
    #[error("logic patch level {found} is too old, at least 1 is needed; update the camera with iniVation's Flashy")]
    Patch {
        /// Patch level found.
        found: u32,
    },
    /// The camera has another sensor chip than a DAVIS346.
    #[error("the sensor chip is number {found}, not a DAVIS346 (4, 5 or 9)")]
    Chip {
        /// Number found.
        found: u32,
    },
}

/// Reason why a camera cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DeviceError {
    /// No matching camera is connected.
    #[error("no camera found (USB 152a:841a{wanted}); is it plugged in?")]
    NotFound {
        /// Criteria in addition to the model, formatted for the message.
        wanted: String,
    },
    /// The user has no permission to open the camera.
    #[error(
        "the camera at bus {bus}, address {address} may not be opened: put this line into {UDEV_RULE_FILE}, then plug the camera in again:\n{UDEV_RULE}"
    )]
    Forbidden {
        /// Number of the bus.
        bus: u8,
        /// Address on the bus.
        address: u8,
    },
    /// Another program uses the camera.
    #[error("the camera at bus {bus}, address {address} is used by another program; end that first")]
    Busy {
        /// Number of the bus.
        bus: u8,
        /// Address on the bus.
        address: u8,
    },
    /// The version is not supported.
    #[error("{0}")]
    Unsupported(#[from] Unsupported),
    /// The camera was unplugged.
    #[error("the camera was unplugged")]
    Unplugged,
    /// The bus or the operating system reported an error.
    #[error("while {doing}: {source}")]
    Usb {
        /// Operation that failed.
        doing: &'static str,
        /// Error of libusb.
        source: rusb::Error,
    },
}

impl DeviceError {
    pub(super) fn usb(doing: &'static str) -> impl Fn(rusb::Error) -> Self {
        move |source| match source {
            rusb::Error::NoDevice => Self::Unplugged,
            source => Self::Usb { doing, source },
        }
    }
}

/// Reason why a stream ended. All transfers received before have been returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum StreamError {
    /// [`super::Stream::stop`] was called.
    #[error("the stream was stopped")]
    Stopped,
    /// The camera was unplugged.
    #[error("the camera was unplugged")]
    Unplugged,
    /// The camera halted its data endpoint.
    #[error("the camera halted its data endpoint; start again")]
    Stalled,
    /// Too many consecutive transfers failed.
    #[error("too many transfers in a row failed ({0:?}); check cable and hub, then start again")]
    Failed(crate::dump::TransferStatus),
    /// libusb rejected a transfer.
    #[error("a transfer could not be queued: {0}; use fewer or smaller ones (usbfs_memory_mb limits their sum)")]
    Queue(rusb::Error),
    /// libusb's event handling failed.
    #[error("libusb could not process its events: {0}; start again")]
    Events(rusb::Error),
}
