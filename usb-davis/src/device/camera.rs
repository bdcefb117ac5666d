//! An open camera with its registers and configuration.

use std::sync::Arc;

use rusb::{Context, DeviceHandle};

use super::error::DeviceError;
use super::list::{INTERFACE, Selector, cameras, check_versions, open, read, write};
use crate::configuration::{Configuration, QUIESCE};
use crate::dump::{DumpHeader, Identity};
use crate::protocol::Layout;
use crate::registers::{Clocks, Register, RegisterSnapshot, aps, dvs, external_input, imu, mux, sysinfo};

/// Read-only registers that describe the camera.
const DESCRIPTION: [Register; 26] = [
    sysinfo::LOGIC_VERSION,
    sysinfo::CHIP_ID,
    sysinfo::DEVICE_IS_MASTER,
    sysinfo::LOGIC_CLOCK,
    sysinfo::ADC_CLOCK,
    sysinfo::USB_CLOCK,
    sysinfo::CLOCK_DEVIATION,
    sysinfo::LOGIC_PATCH,
    dvs::SIZE_COLUMNS,
    dvs::SIZE_ROWS,
    dvs::ORIENTATION,
    dvs::HAS_PIXEL_FILTER,
    dvs::HAS_BACKGROUND_ACTIVITY_FILTER,
    dvs::HAS_REGION_OF_INTEREST,
    dvs::HAS_SKIP_EVENTS,
    dvs::HAS_POLARITY_FILTER,
    dvs::HAS_STATISTICS,
    aps::SIZE_COLUMNS,
    aps::SIZE_ROWS,
    aps::ORIENTATION,
    aps::COLOR_FILTER,
    aps::HAS_GLOBAL_SHUTTER,
    imu::TYPE,
    imu::ORIENTATION,
    external_input::HAS_GENERATOR,
    mux::HAS_STATISTICS,
];

/// An open DAVIS346. Dropping it releases the camera.
pub struct Camera {
    pub(super) context: Context,
    pub(super) handle: Arc<DeviceHandle<Context>>,
    identity: Identity,
    registers: RegisterSnapshot,
}

impl Camera {
    /// Opens the first usable camera that matches `selector`. If none is usable, returns the error of the first camera.
    pub fn open(selector: &Selector) -> Result<Self, DeviceError> {
        let context = Context::new().map_err(DeviceError::usb("starting libusb"))?;
        let mut first_error = None;
        for (device, identity) in cameras(&context)? {
            if !selector.admits(device.bus_number(), device.address()) {
                continue;
            }
            let camera = open(&device, identity).and_then(|(handle, identity)| {
                let other = selector.serial.as_ref().is_some_and(|serial| *serial != identity.serial);
                if other { Ok(None) } else { Self::describe(context.clone(), handle, identity).map(Some) }
            });
            match camera {
                Ok(Some(camera)) => return Ok(camera),
                Ok(None) => {}
                Err(error) => first_error = first_error.or(Some(error)),
            }
        }
        Err(first_error.unwrap_or_else(|| DeviceError::NotFound { wanted: selector.text() }))
    }

    fn describe(context: Context, handle: DeviceHandle<Context>, identity: Identity) -> Result<Self, DeviceError> {
        check_versions(&handle, &identity)?;
        let mut registers = RegisterSnapshot::default();
        for register in DESCRIPTION {
            registers.set(register, read(&handle, register)?);
        }
        Ok(Self { context, handle: Arc::new(handle), identity, registers })
    }

    /// Returns the identity from the USB descriptors.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Returns all registers read and written so far: description and configuration of the camera.
    pub fn registers(&self) -> &RegisterSnapshot {
        &self.registers
    }

    /// Returns the header of a dump that begins now. A recording has its own header: [`super::Stream::header`].
    pub fn header(&self) -> DumpHeader {
        DumpHeader::new(Some(self.identity.clone()), self.registers.clone())
    }

    /// Returns sizes and orientations.
    pub fn layout(&self) -> Layout {
        self.registers.layout()
    }

    /// Returns the clock rates.
    pub fn clocks(&self) -> Clocks {
        self.registers.clocks()
    }

    /// Reads a register.
    pub fn read(&mut self, register: Register) -> Result<u32, DeviceError> {
        let value = read(&self.handle, register)?;
        self.registers.set(register, value);
        Ok(value)
    }

    /// Writes a register.
    pub fn write(&mut self, register: Register, value: u32) -> Result<(), DeviceError> {
        write(&self.handle, register, value)?;
        self.registers.set(register, value);
        Ok(())
    }

    /// Writes all settings, also while the camera runs.
    pub fn configure(&mut self, configuration: &Configuration) -> Result<(), DeviceError> {
        let mut writes = Vec::new();
        configuration.writes(&self.clocks(), self.layout().imu.model, |register, value| writes.push((register, value)));
        self.write_all(writes)
    }

    pub(super) fn write_all(&mut self, writes: impl IntoIterator<Item = (Register, u32)>) -> Result<(), DeviceError> {
        writes.into_iter().try_for_each(|(register, value)| self.write(register, value))
    }

    pub(super) fn quiesce(&mut self) -> Result<(), DeviceError> {
        self.write_all(QUIESCE)
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        // This fails if the camera is gone, and then there is nothing to release.
        let _ = self.handle.release_interface(INTERFACE);
    }
}
