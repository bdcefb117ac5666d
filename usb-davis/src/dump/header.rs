//! What a recording says of its camera.

use std::time::SystemTime;

use serde::{Deserialize, Serialize};

use crate::protocol::Decoder;
use crate::registers::{RegisterSnapshot, sysinfo};

/// What the USB descriptors say of a camera.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// 0x152A for iniVation.
    pub vendor_id: u16,
    /// 0x841A for the DAVIS family on a Cypress FX3.
    pub product_id: u16,
    /// `bcdDevice`; its low byte is the firmware's version.
    pub device_version: u16,
    /// Serial number, at most 8 characters on this family.
    pub serial: String,
}

impl Identity {
    /// Version of the firmware.
    pub fn firmware(&self) -> u8 {
        self.device_version.to_be_bytes()[1]
    }
}

/// Everything about a recording that its payload does not say.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DumpHeader {
    /// The camera, if known.
    pub identity: Option<Identity>,
    /// The camera's registers when the recording began. Empty if not known.
    #[serde(default)]
    pub registers: RegisterSnapshot,
    /// When it began, in ns since 1970; host times count from here. 0 if not known.
    #[serde(default)]
    pub start_unix_ns: u64,
    /// What wrote it.
    #[serde(default)]
    pub writer: String,
    /// Where the data come from, their licence: free text.
    #[serde(default)]
    pub note: String,
}

impl DumpHeader {
    /// A header of now.
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

    /// A decoder for this camera, with memory for its frames.
    pub fn decoder(&self) -> Decoder<Vec<u16>> {
        let layout = self.registers.layout();
        let memory = vec![0; usize::from(layout.aps.columns) * usize::from(layout.aps.rows)];
        Decoder::with_frames(layout, memory)
    }

    /// The camera's name as AEDAT4 files have it, such as `DAVIS346_00000002`.
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
