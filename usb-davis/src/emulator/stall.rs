//! How the camera says no.

/// The endpoint is halted, or the request is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stall;

/// Why a transfer brings nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum TransferFault {
    /// The endpoint is halted.
    Stall,
    /// The bus failed; what the transfer would have brought is lost.
    Bus,
}

impl TransferFault {
    /// Linux's error number for it.
    #[cfg(target_os = "linux")]
    pub(super) fn errno(self) -> i32 {
        match self {
            Self::Stall => 32,
            Self::Bus => 71,
        }
    }
}
