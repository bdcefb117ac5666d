//! Tests that need no camera: protocol, registers, dumps and captures.

mod captures;
mod configuration;
mod dumps;
mod nasty_streams;
mod round_trip;
