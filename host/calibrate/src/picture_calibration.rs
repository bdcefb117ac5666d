//! The camera's own pictures: a second, independent calibration of the same pixels.
//!
//! A DAVIS takes ordinary pictures with the pixels that send events. If a recording contains them, the camera is calibrated from
//! them too, in the ordinary way, and both results are compared: sensor, lens and board are the same, but light, detector,
//! residual and corrections of events are not.
//!
//! pictures → dark spots → dots → board → reference frames → first camera and poses ([`evcal_solve::initial`]) → bundle → cross-check.

pub mod alignment;
pub mod bundle;
pub mod calibration;
pub mod circle_image;
pub mod joint;
pub mod uneven_board;
