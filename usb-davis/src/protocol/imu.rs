//! IMU samples.
//!
//! ```text
//! timestamp · special 5 · misc8(3, contents) · up to 14 × misc8(0, byte) · timestamp · special 7
//!
//! contents  7  6  5   4  3 2 1 0          bytes (big-endian, two's complement)
//!          ┌──┬──┬──┬────┬───┬───┐        0–5   acceleration x y z   if bit 7
//!          │a │g │t │ 0  │ A │ G │        6–7   temperature          if bit 5
//!          └──┴──┴──┴────┴───┴───┘        8–13  angular velocity x y z if bit 6
//!  A: ±2, 4, 8, 16 g      G: ±250, 500, 1000, 2000 °/s
//! ```
//! Measurements that are switched off are absent. The sample's time is the time of its last word.

use super::anomaly::AnomalyKind;
use super::layout::{ImuLayout, ImuModel};

/// Full-scale ranges of an IMU sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImuScale {
    /// 0..=3: ±2, ±4, ±8, ±16 g.
    pub accelerometer: u8,
    /// 0..=3: ±250, ±500, ±1000, ±2000 °/s.
    pub gyroscope: u8,
}

/// An IMU sample in the units of the sensor, with the axes negated as its mounting requires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImuSample {
    /// Time in µs.
    pub time: u64,
    /// Accelerations x, y, z, if they were measured.
    pub acceleration: Option<[i16; 3]>,
    /// Angular velocities about x, y, z, if they were measured.
    pub angular_velocity: Option<[i16; 3]>,
    /// Temperature, if it was measured.
    pub temperature: Option<i16>,
    /// Full-scale ranges.
    pub scale: ImuScale,
    /// IMU model, which determines the formula for the temperature.
    pub model: ImuModel,
}

impl ImuSample {
    /// Returns the accelerations in g.
    pub fn acceleration_g(&self) -> Option<[f32; 3]> {
        let unit = f32::from(2u16 << self.scale.accelerometer.min(3)) / 32768.0;
        self.acceleration.map(|raw| raw.map(|value| f32::from(value) * unit))
    }

    /// Returns the angular velocities in °/s.
    pub fn angular_velocity_degrees(&self) -> Option<[f32; 3]> {
        let unit = f32::from(250u16 << self.scale.gyroscope.min(3)) / 32768.0;
        self.angular_velocity.map(|raw| raw.map(|value| f32::from(value) * unit))
    }

    /// Returns the temperature in °C (data sheets of the MPU-6050 and MPU-9250).
    pub fn temperature_celsius(&self) -> Option<f32> {
        let raw = f32::from(self.temperature?);
        match self.model {
            ImuModel::Absent => None,
            ImuModel::Mpu6050 => Some(raw / 340.0 + 35.0),
            ImuModel::Mpu9250 => Some(raw / 333.87 + 21.0),
        }
    }
}

const ACCELERATION: u8 = 0x80;
const ANGULAR_VELOCITY: u8 = 0x40;
const TEMPERATURE: u8 = 0x20;
const BYTES: usize = 14;

/// Collects the bytes of one sample.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ImuAssembly {
    active: bool,
    /// `true` once a first sample has begun: after that, stray words are faults.
    pub(super) synchronised: bool,
    contents: Option<u8>,
    bytes: [u8; BYTES],
    next: usize,
}

/// Returns the first index at or after `next` whose byte is sent.
fn skip_absent(contents: u8, next: usize) -> usize {
    let next = if next < 6 && contents & ACCELERATION == 0 { 6 } else { next };
    let next = if (6..8).contains(&next) && contents & TEMPERATURE == 0 { 8 } else { next };
    if (8..BYTES).contains(&next) && contents & ANGULAR_VELOCITY == 0 { BYTES } else { next }
}

impl ImuAssembly {
    /// Drops the incomplete sample, because the stream may not continue it.
    pub(super) fn interrupt(&mut self) {
        *self = Self::default();
    }

    pub(super) fn start(&mut self) -> Result<(), AnomalyKind> {
        let unfinished = self.active;
        *self = Self { active: true, synchronised: true, ..Self::default() };
        if unfinished { Err(AnomalyKind::ImuIncomplete) } else { Ok(()) }
    }

    pub(super) fn scale(&mut self, contents: u8) -> Result<(), AnomalyKind> {
        if !self.active || self.contents.is_some() {
            return Err(AnomalyKind::ImuStray);
        }
        self.contents = Some(contents);
        self.next = skip_absent(contents, 0);
        Ok(())
    }

    pub(super) fn byte(&mut self, byte: u8) -> Result<(), AnomalyKind> {
        let Some(contents) = self.contents else { return Err(AnomalyKind::ImuStray) };
        let Some(slot) = self.bytes.get_mut(self.next) else { return Err(AnomalyKind::ImuStray) };
        *slot = byte;
        self.next = skip_absent(contents, self.next + 1);
        Ok(())
    }

    pub(super) fn end(&mut self, time: u64, layout: &ImuLayout) -> Result<ImuSample, AnomalyKind> {
        let assembly = core::mem::replace(self, Self { synchronised: self.synchronised, ..Self::default() });
        if !assembly.active {
            return Err(AnomalyKind::ImuStray);
        }
        let (Some(contents), BYTES) = (assembly.contents, assembly.next) else {
            return Err(AnomalyKind::ImuIncomplete);
        };
        let [ax, ay, az, temperature, gx, gy, gz]: [i16; 7] = {
            let (pairs, _) = assembly.bytes.as_chunks::<2>();
            let mut values = [0; 7];
            for (value, pair) in values.iter_mut().zip(pairs) {
                *value = i16::from_be_bytes(*pair);
            }
            values
        };
        let mounted = |axes: [i16; 3]| {
            let mut mounted = axes;
            for (value, negate) in mounted.iter_mut().zip(layout.negate) {
                // −32768 has no positive counterpart and becomes the nearest value.
                *value = if negate { value.saturating_neg() } else { *value };
            }
            mounted
        };
        Ok(ImuSample {
            time,
            acceleration: (contents & ACCELERATION != 0).then(|| mounted([ax, ay, az])),
            angular_velocity: (contents & ANGULAR_VELOCITY != 0).then(|| mounted([gx, gy, gz])),
            temperature: (contents & TEMPERATURE != 0).then_some(temperature),
            scale: ImuScale { accelerometer: contents >> 2 & 3, gyroscope: contents & 3 },
            model: layout.model,
        })
    }
}

/// Returns the contents byte and the data bytes of `sample`, as the camera would send them.
pub(super) fn wire_bytes(sample: &ImuSample, layout: &ImuLayout) -> (u8, impl Iterator<Item = u8>) {
    let unmounted = |axes: [i16; 3]| {
        let mut unmounted = axes;
        for (value, negate) in unmounted.iter_mut().zip(layout.negate) {
            *value = if negate { value.saturating_neg() } else { *value };
        }
        unmounted
    };
    let bit = |present: bool, bit: u8| if present { bit } else { 0 };
    let contents = bit(sample.acceleration.is_some(), ACCELERATION)
        | bit(sample.angular_velocity.is_some(), ANGULAR_VELOCITY)
        | bit(sample.temperature.is_some(), TEMPERATURE)
        | (sample.scale.accelerometer & 3) << 2
        | (sample.scale.gyroscope & 3);
    let acceleration = sample.acceleration.into_iter().flat_map(unmounted);
    let angular_velocity = sample.angular_velocity.into_iter().flat_map(unmounted);
    let values = acceleration.chain(sample.temperature).chain(angular_velocity);
    (contents, values.flat_map(i16::to_be_bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of the data sheets: 8192 LSB/g at ±4 g, 65.536 LSB/(°/s) at ±500 °/s.
    #[test]
    fn samples_are_converted_to_physical_units() {
        let sample = ImuSample {
            time: 0,
            acceleration: Some([8192, -8192, 0]),
            angular_velocity: Some([6554, 0, -32768]),
            temperature: Some(334),
            scale: ImuScale { accelerometer: 1, gyroscope: 1 },
            model: ImuModel::Mpu9250,
        };
        assert_eq!(sample.acceleration_g(), Some([1.0, -1.0, 0.0]));
        let [x, _, z] = sample.angular_velocity_degrees().expect("present");
        assert!((x - 100.006).abs() < 1e-2, "{x}");
        assert_eq!(z, -500.0);
        let celsius = sample.temperature_celsius().expect("present");
        assert!((celsius - 22.0).abs() < 1e-3, "{celsius}");
    }
}
