//! The camera's own pictures: a second, independent calibration of the same pixels.
//!
//! A DAVIS takes ordinary pictures with the pixels that send events. Where a recording has them, the
//! camera is calibrated from them too, in the ordinary way, and both results are compared: sensor, lens
//! and board are the same, but light, detector, residual and every correction of events are not.
//!
//! pictures → dark spots → dots → board → reference frames → first camera and poses
//! ([`crate::initial`]) → bundle → witness.

pub mod alignment;
pub mod bundle;
pub mod calibration;
pub mod circle_image;
pub mod joint;
