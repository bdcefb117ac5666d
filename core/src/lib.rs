#![cfg_attr(feature = "geometry", doc = include_str!("../README.md"))]
//!
//! # Modules
//!
//! Data flows one way, one module per stage:
//!
//! | module | from | to |
//! |---|---|---|
//! | [`event`] | | one change of brightness at one pixel |
//! | [`decode`] | words of a sensor | events |
//! | [`filter`] | events | events without hot, refractory and isolated pixels |
//! | [`budget`] | events | as many events as can be processed |
//! | [`window`] | events | time windows to search |
//! | [`cluster`] | events of one polarity | DBSCAN clusters |
//! | [`circle`] | clusters of both polarities | circle candidates |
//! | [`detector`] | events of a window | circle candidates: the two stages above in one type |
//! | [`grid`] | circle candidates | the ordered board |
//! | [`spline`] | control points | poses at any time |
//! | [`camera`] | points | pixels, and back |
//! | [`settings`](mod@settings) | one declaration | a structure of settings with descriptions |
//! | [`undistortion`] | pixels | pixels without distortion |
//!
//! # Conventions
//!
//! Pixel (0, 0) is the centre of the top-left pixel; x to the right, y down. Times of
//! events are in microseconds. A pose `T_world_camera` maps camera coordinates (z forward) to world
//! coordinates, where the board lies in the plane z = 0.
#![no_std]
#![forbid(unsafe_code)]
// No input causes a panic; firmware/no-panic proves it for slice indices.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable)]

#[cfg(test)]
extern crate std;

pub mod budget;
#[cfg(feature = "geometry")]
pub mod camera;
#[cfg(feature = "geometry")]
pub mod circle;
#[cfg(feature = "geometry")]
pub mod cluster;
pub mod decode;
#[cfg(feature = "geometry")]
pub mod detector;
pub mod event;
pub mod filter;
#[cfg(feature = "geometry")]
pub mod grid;
pub mod pattern;
pub mod sensor;
pub mod settings;
#[cfg(feature = "geometry")]
pub mod spline;
#[cfg(feature = "geometry")]
pub mod undistortion;
pub mod window;
