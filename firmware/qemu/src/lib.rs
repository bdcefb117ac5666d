//! Common code of the programs for emulated microcontrollers: counting instructions and stack use.
#![no_std]

#[cfg_attr(target_arch = "arm", path = "cortex_m.rs")]
#[cfg_attr(target_arch = "riscv32", path = "risc_v.rs")]
mod machine;

pub use machine::{InstructionCounter, stack_bytes};

impl InstructionCounter {
    /// Runs `work`, and adds its number of instructions to `sum`.
    pub fn measure<R>(&self, sum: &mut u64, work: impl FnOnce() -> R) -> R {
        let before = self.now();
        let result = work();
        *sum += u64::from(Self::between(before, self.now()));
        result
    }
}
