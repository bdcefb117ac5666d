//! What can go wrong with a camera, and what to do about it.

/// Where to put [`UDEV_RULE`].
pub const UDEV_RULE_FILE: &str = "/etc/udev/rules.d/65-inivation.rules";
/// Lets whoever sits at the computer open the camera.
pub const UDEV_RULE: &str =
    r#"SUBSYSTEM=="usb", ATTR{idVendor}=="152a", ATTR{idProduct}=="84[0-1]?", MODE="0660", TAG+="uaccess""#;

/// Firmware or logic that this crate does not speak to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Unsupported {
    /// The firmware of the USB controller.
    #[error("firmware {found} is too old, at least 6 is needed; update the camera with iniVation's Flashy")]
    Firmware {
        /// Its version.
        found: u8,
    },
    /// The logic.
    #[error("logic version {found} is not 18; update the camera with iniVation's Flashy")]
    Logic {
        /// Its version.
        found: u32,
    },
    /// The patch level of the logic.
    #[error("logic patch level {found} is too old, at least 1 is needed; update the camera with iniVation's Flashy")]
    Patch {
        /// Its patch level.
        found: u32,
    },
    /// The sensor chip.
    #[error("the sensor chip is number {found}, no DAVIS346 (4, 5 or 9)")]
    Chip {
        /// Its number.
        found: u32,
    },
}

/// Why a camera cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DeviceError {
    /// None is there.
    #[error("no camera found (USB 152a:841a{wanted}); is it plugged in?")]
    NotFound {
        /// What was asked for beyond the model, ready to be printed.
        wanted: String,
    },
    /// The user may not open it.
    #[error(
        "the camera at bus {bus}, address {address} may not be opened: put this line into {UDEV_RULE_FILE}, then plug the camera in again:\n{UDEV_RULE}"
    )]
    Forbidden {
        /// Number of the bus.
        bus: u8,
        /// Address on it.
        address: u8,
    },
    /// Another program has it.
    #[error("the camera at bus {bus}, address {address} is used by another program; end that first")]
    Busy {
        /// Number of the bus.
        bus: u8,
        /// Address on it.
        address: u8,
    },
    /// This crate does not speak to its version.
    #[error("{0}")]
    Unsupported(#[from] Unsupported),
    /// It was unplugged.
    #[error("the camera was unplugged")]
    Unplugged,
    /// The bus or the operating system failed.
    #[error("while {doing}: {source}")]
    Usb {
        /// What was being done.
        doing: &'static str,
        /// What libusb says.
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

/// Why no more transfers come. All that came before has been handed over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum StreamError {
    /// It was asked to.
    #[error("the stream was stopped")]
    Stopped,
    /// The camera was unplugged.
    #[error("the camera was unplugged")]
    Unplugged,
    /// The camera halted its data endpoint.
    #[error("the camera halted its data endpoint; start again")]
    Stalled,
    /// The bus failed many times in a row.
    #[error("too many transfers in a row failed ({0:?}); check cable and hub, then start again")]
    Failed(crate::dump::TransferStatus),
    /// libusb refuses a transfer.
    #[error("a transfer could not be queued: {0}; use fewer or smaller ones (usbfs_memory_mb limits their sum)")]
    Queue(rusb::Error),
    /// libusb cannot tell any more what comes.
    #[error("libusb could not process its events: {0}; start again")]
    Events(rusb::Error),
}
