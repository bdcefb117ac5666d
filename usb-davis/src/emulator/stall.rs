//! How the camera says no.

/// The endpoint is halted, or the request is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stall;
