//! All settings of the camera, and the register writes that apply them.
//!
//! [`Configuration::default`] is the configuration that libcaer 3.3.15 sends to a DAVIS346, in the same order;
//! [`Configuration::calibration`] differs in the settings that would bias a measurement.

use crate::bias::Biases;
use crate::protocol::{ImuModel, Region, Shutter};
use crate::registers::{Clocks, Register, aps, chip, dvs, external_input, imu, mux, usb};

/// Number of pixels that can be disabled individually.
pub const PIXEL_FILTERS: usize = 8;

/// All settings. Times are in µs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Configuration {
    /// Currents and voltages of the chip.
    pub biases: Biases,
    /// Pixels (x, y) that produce no events.
    pub silent_pixels: [Option<(u16, u16)>; PIXEL_FILTERS],
    /// Removes events without a neighbour within this time; `None` disables the filter. Steps of 250 µs.
    pub background_activity_filter: Option<u32>,
    /// Removes an event that follows another one of its pixel within this time; `None` disables the filter. Steps of 250 µs.
    pub refractory_filter: Option<u32>,
    /// Pixels that produce events.
    pub event_region: Region,
    /// Pixels of a frame.
    pub frame_region: Region,
    /// Shutter of the frames.
    pub shutter: Shutter,
    /// Exposure time of a frame.
    pub exposure: u32,
    /// Time between the starts of consecutive frames.
    pub frame_interval: u32,
    /// The rate of IMU samples is 1 kHz / (1 + this value).
    pub imu_divider: u8,
    /// 0..=3: ±2, ±4, ±8, ±16 g.
    pub accelerometer_scale: u8,
    /// 0..=3: ±250, ±500, ±1000, ±2000 °/s.
    pub gyroscope_scale: u8,
    /// A transfer that is not full is sent after this time.
    pub early_packet_delay: u32,
}

const SENSOR: Region = Region { x: 0, y: 0, width: 346, height: 260 };
/// Step of the filters' times.
const FILTER_STEP: u32 = 250;

impl Default for Configuration {
    fn default() -> Self {
        Self {
            biases: Biases::default(),
            silent_pixels: [None; PIXEL_FILTERS],
            background_activity_filter: Some(2000),
            refractory_filter: None,
            event_region: SENSOR,
            frame_region: SENSOR,
            shutter: Shutter::Global,
            exposure: 4000,
            frame_interval: 40_000,
            imu_divider: 0,
            accelerometer_scale: 1,
            gyroscope_scale: 1,
            early_packet_delay: 1000,
        }
    }
}

impl Configuration {
    /// Configuration for measuring, without the background-activity filter.
    ///
    /// The filter removes an event unless a neighbour had one in the 2 ms before. At the edge of a moving dot it
    /// removes the first event of each burst, which determines the time of the edge best. The remaining events are late
    /// by an amount that depends on speed and contrast, and slow or faint edges vanish. The noise that the filter
    /// removes does not harm clustering, and its rate is useful to know.
    pub fn calibration() -> Self {
        Self { background_activity_filter: None, ..Self::default() }
    }

    /// Calls `write` for all register writes in order, except those that start and stop the camera. `imu` is the model
    /// of the camera's IMU ([`crate::protocol::Layout::imu`]): only the MPU-9250 has a separate filter for the
    /// gyroscope.
    pub fn writes(&self, clocks: &Clocks, imu: ImuModel, mut write: impl FnMut(Register, u32)) {
        for (bias, value) in self.biases.iter() {
            write(bias.register(), u32::from(value));
        }
        self.chip(&mut write);
        write(mux::DROP_EXTERNAL_INPUT_ON_STALL, 1);
        write(mux::DROP_DVS_ON_STALL, 1);
        self.events(&mut write);
        self.frames(clocks, &mut write);
        write(imu::SAMPLE_RATE_DIVIDER, u32::from(self.imu_divider));
        write(imu::ACCELEROMETER_LOW_PASS, 1);
        write(imu::ACCELEROMETER_FULL_SCALE, u32::from(self.accelerometer_scale & 3));
        if imu == ImuModel::Mpu9250 {
            write(imu::GYROSCOPE_LOW_PASS, 1);
        }
        write(imu::GYROSCOPE_FULL_SCALE, u32::from(self.gyroscope_scale & 3));
        self.connectors(clocks, &mut write);
        write(usb::EARLY_PACKET_DELAY, clocks.cycles(clocks.usb, self.early_packet_delay));
    }

    fn chip(&self, write: &mut impl FnMut(Register, u32)) {
        for parameter in chip::DIGITAL_MUX_0.parameter..=chip::BIAS_MUX_0.parameter {
            write(Register::new(chip::DIGITAL_MUX_0.module, parameter), 0);
        }
        write(chip::RESET_CALIBRATION_NEURON, 1);
        write(chip::TYPE_N_CALIBRATION_NEURON, 0);
        write(chip::RESET_TEST_PIXEL, 1);
        write(chip::AER_N_A_ROW, 0);
        write(chip::USE_A_OUT, 0);
        write(chip::SELECT_GRAY_COUNTER, 1);
        write(chip::TEST_ADC, 0);
    }

    fn events(&self, write: &mut impl FnMut(Register, u32)) {
        write(dvs::WAIT_ON_TRANSFER_STALL, 0);
        write(dvs::EXTERNAL_AER_CONTROL, 0);
        let mut register = dvs::PIXEL_FILTER_0_ROW;
        for pixel in self.silent_pixels {
            // The rows and columns of the chip are the user's y and x here; a position beyond the last disables
            // nothing.
            let (x, y) = pixel.unwrap_or((SENSOR.width, SENSOR.height));
            write(register, u32::from(y));
            write(register.next(), u32::from(x));
            register = register.next().next();
        }
        let steps = |time: Option<u32>, idle: u32| time.map_or(idle, |time| (time / FILTER_STEP).max(1));
        write(dvs::BACKGROUND_ACTIVITY_FILTER, u32::from(self.background_activity_filter.is_some()));
        write(dvs::BACKGROUND_ACTIVITY_TIME, steps(self.background_activity_filter, 8));
        write(dvs::REFRACTORY_PERIOD, u32::from(self.refractory_filter.is_some()));
        write(dvs::REFRACTORY_PERIOD_TIME, steps(self.refractory_filter, 1));
        let corners = [dvs::START_COLUMN, dvs::START_ROW, dvs::END_COLUMN, dvs::END_ROW];
        region(self.event_region, corners, write);
        write(dvs::SKIP_EVENTS, 0);
        write(dvs::SKIP_EVERY, 5);
        write(dvs::POLARITY_FLATTEN, 0);
        write(dvs::POLARITY_SUPPRESS, 0);
        write(dvs::POLARITY_SUPPRESS_TYPE, 0);
    }

    fn frames(&self, clocks: &Clocks, write: &mut impl FnMut(Register, u32)) {
        let global = u32::from(self.shutter == Shutter::Global);
        write(aps::WAIT_ON_TRANSFER_STALL, 1);
        write(chip::GLOBAL_SHUTTER, global);
        write(aps::GLOBAL_SHUTTER, global);
        let corners = [aps::START_COLUMN, aps::START_ROW, aps::END_COLUMN, aps::END_ROW];
        region(self.frame_region, corners, write);
        write(aps::EXPOSURE, clocks.cycles(clocks.adc, self.exposure));
        write(aps::FRAME_INTERVAL, clocks.cycles(clocks.adc, self.frame_interval));
    }

    fn connectors(&self, clocks: &Clocks, write: &mut impl FnMut(Register, u32)) {
        write(external_input::DETECT_RISING_EDGES, 0);
        write(external_input::DETECT_FALLING_EDGES, 0);
        write(external_input::DETECT_PULSES, 1);
        write(external_input::DETECT_PULSE_POLARITY, 1);
        write(external_input::DETECT_PULSE_LENGTH, clocks.cycles(clocks.logic, 10));
        write(external_input::RUN_GENERATOR, 0);
        write(external_input::GENERATE_PULSE_POLARITY, 1);
        write(external_input::GENERATE_PULSE_INTERVAL, clocks.cycles(clocks.logic, 10));
        write(external_input::GENERATE_PULSE_LENGTH, clocks.cycles(clocks.logic, 5));
        write(external_input::GENERATE_INJECT_ON_RISING_EDGE, 0);
        write(external_input::GENERATE_INJECT_ON_FALLING_EDGE, 0);
    }
}

fn region(region: Region, corners: [Register; 4], write: &mut impl FnMut(Register, u32)) {
    let last = |start: u16, size: u16| u32::from(start) + u32::from(size.max(1)) - 1;
    let values =
        [u32::from(region.x), u32::from(region.y), last(region.x, region.width), last(region.y, region.height)];
    for (register, value) in corners.into_iter().zip(values) {
        write(register, value);
    }
}

/// Data that the camera sends once it is started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Streams {
    /// Pixel events.
    pub events: bool,
    /// Frames: they take 9 MB/s of the bus at 25 Hz.
    pub frames: bool,
    /// IMU samples.
    pub imu: bool,
    /// Signals at the connectors.
    pub signals: bool,
}

impl Streams {
    /// Events, IMU samples and signals.
    pub const EVENTS: Self = Self { events: true, frames: false, imu: true, signals: true };
    /// Everything.
    pub const ALL: Self = Self { frames: true, ..Self::EVENTS };

    /// Returns the register writes that start these streams, or stop all of them.
    pub fn writes(self) -> [(Register, u32); 6] {
        [
            (dvs::RUN, u32::from(self.events)),
            (aps::RUN, u32::from(self.frames)),
            (imu::RUN_ACCELEROMETER, u32::from(self.imu)),
            (imu::RUN_GYROSCOPE, u32::from(self.imu)),
            (imu::RUN_TEMPERATURE, u32::from(self.imu)),
            (external_input::RUN_DETECTOR, u32::from(self.signals)),
        ]
    }
}

/// The register writes, in order, that stop the camera.
pub const QUIESCE: [(Register, u32); 10] = [
    (dvs::RUN, 0),
    (aps::RUN, 0),
    (imu::RUN_ACCELEROMETER, 0),
    (imu::RUN_GYROSCOPE, 0),
    (imu::RUN_TEMPERATURE, 0),
    (external_input::RUN_DETECTOR, 0),
    (mux::RUN, 0),
    (mux::TIMESTAMP_RUN, 0),
    (usb::RUN, 0),
    (mux::RUN_CHIP, 0),
];
