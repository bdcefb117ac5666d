//! The stream of bulk endpoint 0x82: 16-bit little-endian words.
//!
//! Guarantees: the stream may be split at any byte; the decoder allocates nothing and never panics; every fault is an
//! [`Anomaly`], which is counted and reported with its byte offset, and decoding continues. The [`Encoder`] is the
//! inverse: decoding its output returns its input.
//!
//! | item | words (details in [`mod@word`]) | result |
//! |---|---|---|
//! | pixel event | timestamp (if it changed), row address (if it changed), column address | [`PolarityEvent`] |
//! | connector | timestamp, special 2–4, 16, 17 | [`SignalEvent`] |
//! | IMU sample | timestamp, special 5, contents, up to 14 bytes, timestamp, special 7 | [`ImuSample`] |
//! | frame | special 8 or 9, exposure, corners, columns (11 or 12, samples, 13), 14, 15, special 10 | [`Frame`] |
//! | time | wrap word with a multiplier; special 1 restarts it | 64-bit µs |
//!
//! **Time.** A timestamp word contains the low 15 bits and comes before the word that it applies to, unless the value
//! is unchanged. After 2^15 µs a wrap word adds 2^15 µs, or a multiple of it after a stall. A timestamp word with zero
//! low bits is never sent, because the wrap word implies it. Times are summed in 64 bits, so nothing special happens at
//! 2^31 µs (35.8 minutes).
//!
//! **Geometry.** The chip of a DAVIS346 is mounted rotated: its 260 columns are the user's rows, its 346 rows the
//! user's columns. Events are already mirrored correctly, so only the axes are swapped. Frames are sent as the chip is
//! wired: their wire columns and rows are first mirrored, then swapped. See [`Layout`].

mod anomaly;
mod decoder;
mod encoder;
mod frame;
mod imu;
mod layout;
mod message;
pub mod word;

pub use anomaly::{Anomaly, AnomalyCounts, AnomalyKind};
pub use decoder::{Decoder, DecoderCounts};
pub use encoder::{EncodeError, Encoder, FrameStep, frame_steps};
pub use imu::{ImuSample, ImuScale};
pub use layout::{ImuLayout, ImuModel, Layout, MAXIMUM_SIZE, PixelArray};
pub use message::{Frame, Message, Polarity, PolarityEvent, Region, Shutter, Signal, SignalEvent};
