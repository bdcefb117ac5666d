//! Links only if the public functions of core, link and detector cannot reach a panic.
//!
//! The panic handler calls a function that does not exist. The linker removes the handler if nothing refers to it, so a
//! link error means that a panic can be reached. The check works on the optimised program as a whole (fat LTO), for the
//! types used on a device (`f32`) and on the host (`f64`). The program is never run.
//!
//! All input passes through [`black_box`], so that the compiler knows nothing but its type. Formatting (`Display`,
//! `Debug`) is not checked because it belongs to `core::fmt`.
#![no_std]
#![no_main]

mod camera;
mod detection;
mod device;
mod grid;
mod spline;

use core::hint::black_box;
use core::panic::PanicInfo;

use nalgebra::RealField;

unsafe extern "C" {
    fn a_panic_can_be_reached() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    // SAFETY: the function does not exist, so a program that contains this call cannot be linked.
    unsafe { a_panic_can_be_reached() }
}

/// Calls everything that must not panic.
#[unsafe(no_mangle)]
extern "C" fn _start() {
    device::formats();
    device::filters();
    device::link();
    device::pipeline();
    detection::windows();
    detection::detector::<f32>();
    detection::detector::<f64>();
    grid::find::<f32>();
    grid::find::<f64>();
    grid::board();
    spline::curves::<f32>();
    spline::curves::<f64>();
    spline::rotations::<f32>();
    spline::rotations::<f64>();
    camera::every_model::<f32>();
    camera::every_model::<f64>();
    camera::conversions::<f32>();
    camera::conversions::<f64>();
    camera::undistortion::<f32>();
    camera::undistortion::<f64>();
    #[cfg(feature = "deliberate-panic")]
    deliberate_panic();
}

#[cfg(feature = "deliberate-panic")]
#[inline(never)]
fn deliberate_panic() {
    let values: &[u32] = black_box(&[1, 2, 3]);
    black_box(values[black_box(1)]);
}

/// Returns a number that is unknown to the compiler.
fn any<T: RealField + Copy>() -> T {
    black_box(T::one())
}
