//! Conversion from wire coordinates to user coordinates: sizes, axis swap, mirrors (see [`super`]).

#[cfg(feature = "std")]
use crate::registers::RegisterSnapshot;
use crate::registers::{Register, aps, dvs, imu};

/// Largest supported width or height of an array: coordinates have 12 bits, and every DAVIS is much smaller.
pub const MAXIMUM_SIZE: u16 = 2048;

/// One of the chip's two arrays and its orientation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelArray {
    /// Columns on the wire.
    pub columns: u16,
    /// Rows on the wire.
    pub rows: u16,
    /// `true` if the user's x is the wire's row.
    pub swap_axes: bool,
    /// `true` if the wire's columns run against the user's axis.
    pub mirror_columns: bool,
    /// `true` if the wire's rows run against the user's axis.
    pub mirror_rows: bool,
}

impl PixelArray {
    /// Returns width and height in user coordinates.
    pub const fn size(&self) -> (u16, u16) {
        if self.swap_axes { (self.rows, self.columns) } else { (self.columns, self.rows) }
    }

    /// Converts the wire's (column, row) of an event to the user's (x, y), without mirrors.
    pub const fn swap(&self, column: u16, row: u16) -> (u16, u16) {
        if self.swap_axes { (row, column) } else { (column, row) }
    }
}

/// The IMU and its mounting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImuLayout {
    /// Model from register 3.0, which determines the formula for the temperature.
    pub model: ImuModel,
    /// `true` for each axis x, y, z to negate.
    pub negate: [bool; 3],
}

/// IMU model, from register 3.0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ImuModel {
    /// No IMU.
    Absent,
    /// InvenSense MPU-6050 or 6150.
    Mpu6050,
    /// InvenSense MPU-9250.
    Mpu9250,
}

/// Information about a camera that decoding requires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// The event pixels.
    pub dvs: PixelArray,
    /// The frame pixels.
    pub aps: PixelArray,
    /// The IMU.
    pub imu: ImuLayout,
}

impl Layout {
    /// A DAVIS346 whose frames need no mirroring, for data without registers.
    pub const DAVIS346: Self = {
        let array = PixelArray { columns: 260, rows: 346, swap_axes: true, mirror_columns: false, mirror_rows: false };
        Self { dvs: array, aps: array, imu: ImuLayout { model: ImuModel::Mpu9250, negate: [false; 3] } }
    };

    /// Reads sizes and orientations through `read`; absent registers are assumed as in [`Layout::DAVIS346`]. Sizes are
    /// clamped to 1..=[`MAXIMUM_SIZE`].
    pub fn from_registers(read: impl Fn(Register) -> Option<u32>) -> Self {
        let size = |register, assumed: u16| {
            read(register).map_or(assumed, |value| value.clamp(1, u32::from(MAXIMUM_SIZE)) as u16)
        };
        let Self { dvs, aps, imu } = Self::DAVIS346;
        let dvs_orientation = read(dvs::ORIENTATION).unwrap_or(0b100);
        let aps_orientation = read(aps::ORIENTATION).unwrap_or(0b100);
        let imu_orientation = read(imu::ORIENTATION).unwrap_or(0);
        Self {
            dvs: PixelArray {
                columns: size(dvs::SIZE_COLUMNS, dvs.columns),
                rows: size(dvs::SIZE_ROWS, dvs.rows),
                swap_axes: dvs_orientation & 0b100 != 0,
                ..dvs
            },
            aps: PixelArray {
                columns: size(aps::SIZE_COLUMNS, aps.columns),
                rows: size(aps::SIZE_ROWS, aps.rows),
                swap_axes: aps_orientation & 0b100 != 0,
                mirror_columns: aps_orientation & 0b010 != 0,
                mirror_rows: aps_orientation & 0b001 != 0,
            },
            imu: ImuLayout {
                model: match read(imu::TYPE) {
                    Some(0) => ImuModel::Absent,
                    Some(1) => ImuModel::Mpu6050,
                    Some(2) => ImuModel::Mpu9250,
                    _ => imu.model,
                },
                negate: [imu_orientation & 0b100 != 0, imu_orientation & 0b010 != 0, imu_orientation & 0b001 != 0],
            },
        }
    }
}

#[cfg(feature = "std")]
impl RegisterSnapshot {
    /// Returns the sizes and orientations that the registers describe.
    pub fn layout(&self) -> Layout {
        Layout::from_registers(|register| self.get(register))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_layout_follows_the_registers() {
        let layout = Layout::from_registers(|register| match register {
            dvs::SIZE_COLUMNS => Some(240),
            dvs::SIZE_ROWS => Some(180),
            dvs::ORIENTATION => Some(0),
            aps::ORIENTATION => Some(0b111),
            imu::TYPE => Some(1),
            imu::ORIENTATION => Some(0b010),
            _ => None,
        });
        assert_eq!(layout.dvs.size(), (240, 180));
        assert_eq!(layout.dvs.swap(3, 5), (3, 5));
        assert_eq!(layout.aps.size(), (346, 260));
        assert!(layout.aps.mirror_columns && layout.aps.mirror_rows);
        assert_eq!(layout.imu, ImuLayout { model: ImuModel::Mpu6050, negate: [false, true, false] });
        assert_eq!(Layout::from_registers(|_| None), Layout::DAVIS346);
        assert_eq!(Layout::from_registers(|_| Some(0)).dvs.size(), (1, 1));
    }
}
