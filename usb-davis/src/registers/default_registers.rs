//! The registers of a camera that was just plugged in.

use super::{RegisterSnapshot, aps, dvs, external_input, imu, mux, sysinfo};

/// Returns the registers of a DAVIS346 that describe it before it is configured.
pub fn default_registers() -> RegisterSnapshot {
    RegisterSnapshot::from_iter([
        (sysinfo::LOGIC_VERSION, 18),
        (sysinfo::CHIP_ID, 5),
        (sysinfo::DEVICE_IS_MASTER, 1),
        (sysinfo::LOGIC_CLOCK, 100),
        (sysinfo::ADC_CLOCK, 30),
        (sysinfo::USB_CLOCK, 80),
        (sysinfo::CLOCK_DEVIATION, 1008),
        (sysinfo::LOGIC_PATCH, 1),
        (dvs::SIZE_COLUMNS, 260),
        (dvs::SIZE_ROWS, 346),
        (dvs::ORIENTATION, 0b100),
        (dvs::HAS_PIXEL_FILTER, 1),
        (dvs::HAS_BACKGROUND_ACTIVITY_FILTER, 1),
        (dvs::HAS_REGION_OF_INTEREST, 1),
        (dvs::HAS_SKIP_EVENTS, 1),
        (dvs::HAS_POLARITY_FILTER, 1),
        (dvs::HAS_STATISTICS, 1),
        (aps::SIZE_COLUMNS, 260),
        (aps::SIZE_ROWS, 346),
        (aps::ORIENTATION, 0b100),
        (aps::COLOR_FILTER, 0),
        (aps::HAS_GLOBAL_SHUTTER, 1),
        (imu::TYPE, 2),
        (imu::ORIENTATION, 0),
        (external_input::HAS_GENERATOR, 1),
        (mux::HAS_STATISTICS, 1),
    ])
}
