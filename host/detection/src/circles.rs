//! Circles: reference frames, and the files and streams that provide circles instead of events.

pub mod compact_frame;
pub mod event_pixel;
pub mod file;
pub mod reference_frame;
pub mod serial;
pub mod stream;
pub mod track;
