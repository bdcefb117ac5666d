//! Files that other programs load.
//!
//! A format is one file with a [`format::Format`] in it, the camera models that it holds among them,
//! and one line in [`format::FORMATS`]. A calibration of another model is replaced by the nearest camera
//! that the format holds ([`nearest`]), with the difference stated: no coefficient is ever dropped.
//!
//! Everywhere pixel (0, 0) is the centre of the top-left pixel, as in OpenCV, ROS, Kalibr and mrcal.

pub mod basalt;
pub mod csv;
pub mod dv_processing;
pub mod dv_xml;
mod file_storage;
pub mod format;
pub mod kalibr;
pub mod mrcal;
mod number;
pub mod opencv;
pub mod ros;
pub mod undistortion_table;
