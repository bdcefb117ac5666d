//! RISC-V: the virt machine.

use riscv::register::mcycle;

/// Counts instructions by `mcycle`, which `-icount shift=0` makes count them.
pub struct InstructionCounter(());

impl InstructionCounter {
    /// Starts counting.
    pub fn start() -> Option<Self> {
        Some(Self(()))
    }

    /// The counter.
    pub fn now(&self) -> u32 {
        mcycle::read() as u32
    }

    /// Instructions from one value of the counter to a later one.
    pub fn between(before: u32, after: u32) -> u32 {
        after.wrapping_sub(before)
    }
}

/// The stack is measured on Cortex-M, whose runtime paints it.
pub fn stack_bytes() -> usize {
    0
}
