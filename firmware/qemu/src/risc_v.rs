//! Instruction counter of RISC-V (virt machine).

use riscv::register::mcycle;

/// Counts instructions by `mcycle`, which counts them with `-icount shift=0`.
pub struct InstructionCounter(());

impl InstructionCounter {
    /// Starts counting.
    pub fn start() -> Option<Self> {
        Some(Self(()))
    }

    /// Returns the counter.
    pub fn now(&self) -> u32 {
        mcycle::read() as u32
    }

    /// Returns the number of instructions from one value of the counter to a later one.
    pub fn between(before: u32, after: u32) -> u32 {
        after.wrapping_sub(before)
    }
}

/// Returns 0: the stack is measured on Cortex-M only, whose runtime paints it.
pub fn stack_bytes() -> usize {
    0
}
