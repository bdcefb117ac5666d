//! Negative answers of the camera.

/// The endpoint is halted, or the request is unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stall;

/// Reason why a transfer has no data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum TransferFault {
    /// The endpoint is halted.
    Stall,
    /// The bus failed; the data of the transfer are lost.
    Bus,
}

impl TransferFault {
    /// Returns Linux's error number for the fault.
    #[cfg(target_os = "linux")]
    pub(super) fn errno(self) -> i32 {
        match self {
            Self::Stall => 32,
            Self::Bus => 71,
        }
    }
}
