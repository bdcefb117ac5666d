//! Registers of the camera's logic (version 18).
//!
//! A register is identified by a module and a parameter, which are sent in the set-up packet of vendor request 0xBF
//! (`wValue`, `wIndex`); its value has 32 bits, big-endian. A 64-bit counter uses two parameters, upper half first.
//! Some values are in cycles of a clock, whose rate is also a register of [`sysinfo`], see [`Clocks`].

#[cfg(feature = "std")]
mod default_registers;
#[cfg(feature = "std")]
mod dropped;
#[cfg(feature = "std")]
mod snapshot;

use core::fmt;

#[cfg(feature = "std")]
pub use default_registers::default_registers;
#[cfg(feature = "std")]
pub use dropped::{DROP_COUNTERS, Dropped};
#[cfg(feature = "std")]
pub use snapshot::RegisterSnapshot;

/// Vendor request that reads or writes one register.
pub const REQUEST_REGISTER: u8 = 0xBF;
/// Vendor request that writes several registers: `wValue` records of module, parameter, value.
pub const REQUEST_REGISTERS: u8 = 0xC2;
/// Bytes of one record of [`REQUEST_REGISTERS`]: module, parameter, value (big-endian).
pub const REGISTERS_RECORD: usize = 6;

/// Identifies one 32-bit register.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Register {
    /// Module of the logic: [`mux`] 0, [`dvs`] 1, [`aps`] 2, [`imu`] 3, [`external_input`] 4,
    /// [`chip`] 5, [`sysinfo`] 6, [`usb`] 9.
    pub module: u8,
    /// Parameter within the module.
    pub parameter: u8,
}

impl Register {
    /// Creates the register `module`.`parameter`.
    pub const fn new(module: u8, parameter: u8) -> Self {
        Self { module, parameter }
    }

    /// Returns the next register, which is the lower half of a 64-bit counter.
    pub const fn next(self) -> Self {
        Self { module: self.module, parameter: self.parameter.wrapping_add(1) }
    }

    /// Returns `true` if writing to the register has no effect (sizes, versions, counters and the `HAS_…` switches).
    pub const fn is_read_only(self) -> bool {
        match self.module {
            0 => self.parameter >= 80,
            1 => matches!(self.parameter, 0..=2 | 10 | 30 | 40 | 50 | 60 | 80..=99),
            2 => matches!(self.parameter, 0..=3 | 6),
            3 => matches!(self.parameter, 0 | 1),
            4 => self.parameter == 10,
            6 => true,
            _ => false,
        }
    }
}

impl fmt::Display for Register {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}.{}", self.module, self.parameter)
    }
}

macro_rules! registers {
    ($(#[$attribute:meta])* $name:ident = $module:literal { $($(#[$documentation:meta])* $register:ident = $parameter:literal,)* }) => {
        $(#[$attribute])*
        pub mod $name {
            use super::Register;
            $($(#[$documentation])* pub const $register: Register = Register::new($module, $parameter);)*
        }
    };
}

registers! {
    /// Module 0, the multiplexer: joins the data of all other modules into one stream.
    mux = 0 {
        /// Lets data through to the USB module.
        RUN = 0,
        /// Lets the microsecond counter run.
        TIMESTAMP_RUN = 1,
        /// Pulse (1, then 0): time restarts at zero.
        TIMESTAMP_RESET = 2,
        /// Powers the sensor chip (biases on).
        RUN_CHIP = 3,
        /// 1: drops external input while the host reads too slowly; 0: waits for the host.
        DROP_EXTERNAL_INPUT_ON_STALL = 4,
        /// 1: drops pixel events while the host reads too slowly; 0: waits for the host.
        DROP_DVS_ON_STALL = 5,
        /// 1 if the drop counters exist.
        HAS_STATISTICS = 80,
        /// External-input events dropped, 64-bit counter.
        EXTERNAL_INPUT_DROPPED = 81,
        /// Pixel events dropped, 64-bit counter.
        DVS_DROPPED = 83,
    }
}

registers! {
    /// Module 1, the event pixels.
    dvs = 1 {
        /// Columns of the chip, read-only. 260 on a DAVIS346.
        SIZE_COLUMNS = 0,
        /// Rows of the chip, read-only. 346 on a DAVIS346.
        SIZE_ROWS = 1,
        /// Bit 2: the host swaps the axes. Read-only.
        ORIENTATION = 2,
        /// Produces events.
        RUN = 3,
        /// Waits when the output is full, instead of dropping.
        WAIT_ON_TRANSFER_STALL = 4,
        /// 1: another device reads the chip's event bus.
        EXTERNAL_AER_CONTROL = 5,
        /// 1 if the eight pixel filters exist.
        HAS_PIXEL_FILTER = 10,
        /// Row of the first filtered pixel; its column is the next register; eight such pairs.
        PIXEL_FILTER_0_ROW = 11,
        /// 1 if the background-activity and refractory filters exist.
        HAS_BACKGROUND_ACTIVITY_FILTER = 30,
        /// Removes events without a recent neighbour.
        BACKGROUND_ACTIVITY_FILTER = 31,
        /// Largest age of the neighbour's event, in 250 µs.
        BACKGROUND_ACTIVITY_TIME = 32,
        /// Removes events that follow too soon after another event of the same pixel.
        REFRACTORY_PERIOD = 33,
        /// Shortest allowed time between events of a pixel, in 250 µs.
        REFRACTORY_PERIOD_TIME = 34,
        /// 1 if the region of interest exists.
        HAS_REGION_OF_INTEREST = 40,
        /// First user column that produces events.
        START_COLUMN = 41,
        /// First user row that produces events.
        START_ROW = 42,
        /// Last user column that produces events.
        END_COLUMN = 43,
        /// Last user row that produces events.
        END_ROW = 44,
        /// 1 if events can be skipped.
        HAS_SKIP_EVENTS = 50,
        /// Skips one event in every [`SKIP_EVERY`].
        SKIP_EVENTS = 51,
        /// See [`SKIP_EVENTS`].
        SKIP_EVERY = 52,
        /// 1 if the polarity filter exists.
        HAS_POLARITY_FILTER = 60,
        /// Makes all polarities equal.
        POLARITY_FLATTEN = 61,
        /// Removes events of one polarity.
        POLARITY_SUPPRESS = 62,
        /// Polarity that is removed.
        POLARITY_SUPPRESS_TYPE = 63,
        /// 1 if the counters below exist.
        HAS_STATISTICS = 80,
        /// Row requests of the chip, 64-bit counter.
        ROW_EVENTS = 81,
        /// Column requests of the chip, 64-bit counter.
        COLUMN_EVENTS = 83,
        /// Events dropped between chip and multiplexer, 64-bit counter.
        DROPPED = 85,
        /// Events removed by the pixel filters, 64-bit counter.
        FILTERED_PIXEL = 87,
        /// Events removed by the background-activity filter, 64-bit counter.
        FILTERED_BACKGROUND_ACTIVITY = 89,
        /// Events removed by the refractory filter, 64-bit counter.
        FILTERED_REFRACTORY = 91,
    }
}

registers! {
    /// Module 2, the frame pixels.
    aps = 2 {
        /// Columns of the chip, read-only. 260 on a DAVIS346.
        SIZE_COLUMNS = 0,
        /// Rows of the chip, read-only. 346 on a DAVIS346.
        SIZE_ROWS = 1,
        /// Bit 2: the host swaps the axes; bit 1: it mirrors columns; bit 0: it mirrors rows
        /// (columns and rows as on the wire, before the swap). Read-only.
        ORIENTATION = 2,
        /// 0 monochrome, otherwise the colour filter's pattern. Read-only.
        COLOR_FILTER = 3,
        /// Produces frames.
        RUN = 4,
        /// Waits when the output is full, instead of dropping.
        WAIT_ON_TRANSFER_STALL = 5,
        /// 1 if the chip has a global shutter. Read-only.
        HAS_GLOBAL_SHUTTER = 6,
        /// 1 global, 0 rolling shutter. Must equal [`super::chip::GLOBAL_SHUTTER`].
        GLOBAL_SHUTTER = 7,
        /// First user column of the frame.
        START_COLUMN = 8,
        /// First user row of the frame.
        START_ROW = 9,
        /// Last user column of the frame.
        END_COLUMN = 10,
        /// Last user row of the frame.
        END_ROW = 11,
        /// Exposure time in cycles of the ADC clock.
        EXPOSURE = 12,
        /// Time between the starts of consecutive frames in cycles of the ADC clock.
        FRAME_INTERVAL = 13,
    }
}

registers! {
    /// Module 3, the IMU.
    imu = 3 {
        /// 0 none, 1 MPU-6050 or 6150, 2 MPU-9250. Read-only.
        TYPE = 0,
        /// Bit 2: the host negates x; bit 1: y; bit 0: z. Read-only.
        ORIENTATION = 1,
        /// Sends accelerations.
        RUN_ACCELEROMETER = 2,
        /// Sends angular velocities.
        RUN_GYROSCOPE = 3,
        /// Sends temperatures.
        RUN_TEMPERATURE = 4,
        /// Rate = 1 kHz / (1 + divider).
        SAMPLE_RATE_DIVIDER = 5,
        /// Low-pass filter of the accelerometer.
        ACCELEROMETER_LOW_PASS = 6,
        /// 0..=3: ±2, ±4, ±8, ±16 g.
        ACCELEROMETER_FULL_SCALE = 7,
        /// Low-pass filter of the gyroscope (MPU-9250 only).
        GYROSCOPE_LOW_PASS = 9,
        /// 0..=3: ±250, ±500, ±1000, ±2000 °/s.
        GYROSCOPE_FULL_SCALE = 10,
    }
}

registers! {
    /// Module 4, the synchronisation connectors.
    external_input = 4 {
        /// Reports edges and pulses of the input.
        RUN_DETECTOR = 0,
        /// Reports rising edges.
        DETECT_RISING_EDGES = 1,
        /// Reports falling edges.
        DETECT_FALLING_EDGES = 2,
        /// Reports pulses.
        DETECT_PULSES = 3,
        /// 1: a pulse is high.
        DETECT_PULSE_POLARITY = 4,
        /// Shortest pulse, in cycles of the logic clock.
        DETECT_PULSE_LENGTH = 5,
        /// 1 if the camera can generate a signal. Read-only.
        HAS_GENERATOR = 10,
        /// Generates a signal.
        RUN_GENERATOR = 11,
        /// 1: a generated pulse is high.
        GENERATE_PULSE_POLARITY = 12,
        /// Time between generated pulses, in cycles of the logic clock.
        GENERATE_PULSE_INTERVAL = 13,
        /// Length of a generated pulse, in cycles of the logic clock.
        GENERATE_PULSE_LENGTH = 14,
        /// Puts an event into the stream at each generated rising edge.
        GENERATE_INJECT_ON_RISING_EDGE = 15,
        /// Puts an event into the stream at each generated falling edge.
        GENERATE_INJECT_ON_FALLING_EDGE = 16,
    }
}

registers! {
    /// Module 5, the sensor chip: biases below 128 (see [`crate::bias`]), chip configuration above.
    chip = 5 {
        /// First of the four digital multiplexers.
        DIGITAL_MUX_0 = 128,
        /// First of the three analogue multiplexers.
        ANALOG_MUX_0 = 132,
        /// Bias multiplexer.
        BIAS_MUX_0 = 135,
        /// Holds the calibration neuron in reset.
        RESET_CALIBRATION_NEURON = 136,
        /// Type of the calibration neuron.
        TYPE_N_CALIBRATION_NEURON = 137,
        /// Holds the test pixel in reset.
        RESET_TEST_PIXEL = 138,
        /// Row handshake of the event bus.
        AER_N_A_ROW = 140,
        /// Analogue output.
        USE_A_OUT = 141,
        /// 1 global, 0 rolling shutter. Must equal [`super::aps::GLOBAL_SHUTTER`].
        GLOBAL_SHUTTER = 142,
        /// Gray code in the analogue-digital converter.
        SELECT_GRAY_COUNTER = 143,
        /// Test mode of the analogue-digital converter.
        TEST_ADC = 144,
    }
}

registers! {
    /// Module 6, description of the camera. All read-only.
    sysinfo = 6 {
        /// Version of the logic. This crate supports version 18.
        LOGIC_VERSION = 0,
        /// 4, 5, 9: DAVIS346 A, B, C; other values are other chips.
        CHIP_ID = 1,
        /// 1 if this camera is the clock master.
        DEVICE_IS_MASTER = 2,
        /// MHz.
        LOGIC_CLOCK = 3,
        /// MHz.
        ADC_CLOCK = 4,
        /// MHz.
        USB_CLOCK = 5,
        /// True rate of all three clocks divided by their nominal rate, in thousandths.
        CLOCK_DEVIATION = 6,
        /// Patch level of the logic.
        LOGIC_PATCH = 7,
    }
}

registers! {
    /// Module 9, the USB output.
    usb = 9 {
        /// Hands data to the USB controller.
        RUN = 0,
        /// A transfer that is not full is sent after this many cycles of the USB clock.
        EARLY_PACKET_DELAY = 1,
    }
}

/// Clock rates of the logic, from [`sysinfo`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clocks {
    /// Nominal logic clock in MHz.
    pub logic: u32,
    /// Nominal clock of the frame's analogue-digital converter in MHz.
    pub adc: u32,
    /// Nominal clock of the USB output in MHz.
    pub usb: u32,
    /// True rate divided by nominal rate, in thousandths.
    pub deviation: u32,
}

impl Clocks {
    /// Plausible rates if the registers are unknown; the true values depend on the version of the logic.
    pub const ASSUMED: Self = Self { logic: 100, adc: 30, usb: 80, deviation: 1008 };

    /// Reads the four registers through `read`; absent or zero registers get the value in [`Clocks::ASSUMED`].
    pub fn from_registers(read: impl Fn(Register) -> Option<u32>) -> Self {
        let of = |register, assumed| read(register).filter(|&value| value != 0).unwrap_or(assumed);
        Self {
            logic: of(sysinfo::LOGIC_CLOCK, Self::ASSUMED.logic),
            adc: of(sysinfo::ADC_CLOCK, Self::ASSUMED.adc),
            usb: of(sysinfo::USB_CLOCK, Self::ASSUMED.usb),
            deviation: of(sysinfo::CLOCK_DEVIATION, Self::ASSUMED.deviation),
        }
    }

    /// Converts `microseconds` to cycles of a clock of `megahertz`, rounded to nearest as in libcaer; saturates.
    pub fn cycles(&self, megahertz: u32, microseconds: u32) -> u32 {
        let thousandths = u128::from(microseconds) * u128::from(megahertz) * u128::from(self.deviation);
        let cycles = (thousandths + 500) / 1000;
        u32::try_from(cycles).unwrap_or(u32::MAX)
    }

    /// Converts `cycles` of a clock of `megahertz` to microseconds; 0 if the clock rate is zero.
    pub fn microseconds(&self, megahertz: u32, cycles: u32) -> f64 {
        let rate = f64::from(megahertz) * f64::from(self.deviation) / 1000.0;
        if rate > 0.0 { f64::from(cycles) / rate } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cycle counts that libcaer was observed to send for these times and clocks.
    #[test]
    fn cycles_agree_with_libcaer() {
        let clocks = Clocks::ASSUMED;
        assert_eq!(clocks.cycles(clocks.adc, 4000), 120_960);
        assert_eq!(clocks.cycles(clocks.adc, 40_000), 1_209_600);
        assert_eq!(clocks.cycles(clocks.usb, 1000), 80_640);
        assert_eq!(clocks.cycles(clocks.logic, 10), 1008);
        assert_eq!(clocks.cycles(clocks.logic, 5), 504);
        assert_eq!(clocks.cycles(u32::MAX, u32::MAX), u32::MAX);
        // 997.92 and 30.24 cycles.
        assert_eq!((clocks.cycles(clocks.adc, 33), clocks.cycles(clocks.adc, 1)), (998, 30));
        assert!((clocks.microseconds(30, 120_960) - 4000.0).abs() < 1e-9);
    }
}
