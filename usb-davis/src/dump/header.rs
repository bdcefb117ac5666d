//! Description of the recorded camera.

use std::time::SystemTime;

use serde::{Deserialize, Serialize};

use crate::protocol::Decoder;
use crate::registers::{RegisterSnapshot, sysinfo};

/// Identity of a camera from its USB descriptors.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// 0x152A for iniVation.
    pub vendor_id: u16,
    /// 0x841A for the DAVIS family on a Cypress FX3.
    pub product_id: u16,
    /// `bcdDevice`; its low byte is the firmware version.
    pub device_version: u16,
    /// Serial number, at most 8 characters on this family.
    pub serial: String,
}

impl Identity {
    /// Returns the version of the firmware.
    pub fn firmware(&self) -> u8 {
        self.device_version.to_be_bytes()[1]
    }
}

/// Information about a recording that is not in its payload.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DumpHeader {
    /// The camera, if known.
    pub identity: Option<Identity>,
    /// The camera's registers at the beginning of the recording; empty if unknown.
    #[serde(default)]
    pub registers: RegisterSnapshot,
    /// Start of the recording in ns since 1970, the zero of host times; 0 if unknown.
    #[serde(default)]
    pub start_unix_ns: u64,
    /// Program that wrote the file.
    #[serde(default)]
    pub writer: String,
    /// Free text, for example origin and licence of the data.
    #[serde(default)]
    pub note: String,
}

impl DumpHeader {
    /// Creates a header with the current time.
    pub fn new(identity: Option<Identity>, registers: RegisterSnapshot) -> Self {
        let start = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        Self {
            identity,
            registers,
            start_unix_ns: u64::try_from(start.as_nanos()).unwrap_or(0),
            writer: concat!("usb-davis ", env!("CARGO_PKG_VERSION")).to_owned(),
            note: String::new(),
        }
    }

    /// Returns a decoder for this camera, with memory for its frames.
    pub fn decoder(&self) -> Decoder<Vec<u16>> {
        let layout = self.registers.layout();
        let memory = vec![0; usize::from(layout.aps.columns) * usize::from(layout.aps.rows)];
        Decoder::with_frames(layout, memory)
    }

    /// Returns the camera's name as in AEDAT4 files, for example `DAVIS346_00000002`.
    pub fn camera_name(&self) -> String {
        let model = match self.registers.get(sysinfo::CHIP_ID) {
            Some(0..=2) => "DAVIS240",
            Some(3) => "DAVIS128",
            Some(6 | 7) => "DAVIS640",
            Some(8) => "DAVIS208",
            _ => "DAVIS346",
        };
        match &self.identity {
            Some(identity) => format!("{model}_{}", identity.serial),
            None => model.to_owned(),
        }
    }
}
