//! Counts the instructions of one evaluation of a cubic spline in space: basis functions, position,
//! velocity and acceleration, in single precision. Prints `name=value`.
#![no_std]
#![no_main]

use core::hint::black_box;

use evcal_core::spline::{Knots, vector};
use nalgebra::Vector3;
use qemu::InstructionCounter;
use semihosting::{println, process};

const KNOTS: [f32; 13] = [0.0, 0.0, 0.0, 0.0, 0.1, 0.25, 0.3, 0.5, 0.8, 1.0, 1.0, 1.0, 1.0];
const EVALUATIONS: u16 = 1000;

#[cfg_attr(target_arch = "arm", cortex_m_rt::entry)]
#[cfg_attr(target_arch = "riscv32", riscv_rt::entry)]
fn main() -> ! {
    let Some(counter) = InstructionCounter::start() else { process::exit(1) };
    let control: [Vector3<f32>; 9] = core::array::from_fn(|index| Vector3::repeat(index as f32));
    let Ok(knots) = Knots::new(&KNOTS, 3) else { process::exit(1) };
    let mut evaluated = 0_u32;
    let mut instructions = 0;
    counter.measure(&mut instructions, || {
        for index in 0..EVALUATIONS {
            let at = f32::from(index) / f32::from(EVALUATIONS);
            let sample =
                knots.basis(black_box(at)).ok().and_then(|basis| vector::evaluate(&basis, black_box(&control)));
            evaluated += u32::from(black_box(sample).is_some());
        }
    });
    println!("evaluated={evaluated}");
    println!("instructions_per_evaluation={}", instructions / u64::from(EVALUATIONS));
    process::exit(i32::from(evaluated != u32::from(EVALUATIONS)))
}
