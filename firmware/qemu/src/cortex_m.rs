//! Instruction counter and stack use of Cortex-M (MPS2 machines).

use cortex_m::Peripherals;
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;

/// SysTick counts down with 24 bits.
const MASK: u32 = (1 << 24) - 1;

/// Counts instructions by SysTick, because QEMU has no cycle counter.
///
/// With `-icount shift=6` an instruction takes 64 ns, and SysTick of the MPS2 machines counts every 40 ns. Up to 10
/// million instructions can be measured at once.
pub struct InstructionCounter(());

impl InstructionCounter {
    /// Starts counting; call it once in a program.
    pub fn start() -> Option<Self> {
        let mut timer = Peripherals::take()?.SYST;
        timer.set_clock_source(SystClkSource::Core);
        timer.set_reload(MASK);
        timer.clear_current();
        timer.enable_counter();
        // The counter is zero until its first tick.
        while SYST::get_current() == 0 {}
        Some(Self(()))
    }

    /// Returns the counter.
    pub fn now(&self) -> u32 {
        SYST::get_current()
    }

    /// Returns the number of instructions from one value of the counter to a later one.
    pub fn between(before: u32, after: u32) -> u32 {
        (before.wrapping_sub(after) & MASK) * 5 / 8
    }
}

/// Returns the largest number of bytes of stack used so far: the runtime paints the stack before the program starts.
pub fn stack_bytes() -> usize {
    unsafe extern "C" {
        static _stack_end: u32;
        static _stack_start: u32;
    }
    let (end, start) = (&raw const _stack_end, &raw const _stack_start);
    let mut untouched = end;
    // SAFETY: all words between the two symbols are RAM that nothing but the stack uses.
    while untouched < start && unsafe { untouched.read_volatile() } == cortex_m_rt::STACK_PAINT_VALUE {
        untouched = untouched.wrapping_add(1);
    }
    start as usize - untouched as usize
}
