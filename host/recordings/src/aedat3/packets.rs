//! The header lines and the heads of packets.

use evcal_core::sensor::Sensor;

use crate::bytes::ByteReader;
use crate::counted::counted;
use crate::error::RecordingError;
use crate::read_report::Truncation;

/// First bytes of a file.
pub const MAGIC: &[u8] = b"#!AER-DAT3.";
const LAST_LINE: &str = "#!END-HEADER";
/// Length limit of a header line in bytes.
const LONGEST_LINE: usize = 4096;
/// Size of a packet's head in bytes.
const HEAD: usize = 28;
/// Kind number of packets with polarity events.
pub const POLARITY: i16 = 1;
/// Size of a polarity event in bytes.
pub const EVENT: usize = 8;
/// Names of the content of packets, indexed by kind.
const KINDS: [&str; 5] = ["special events", "events", "frames", "IMU samples", "IMU samples with compass"];
/// Kinds below this number are counted separately. cAER uses fewer.
const KNOWN_KINDS: i16 = 32;
/// Parts of source names, with the sensor of the camera.
const SOURCES: &[(&str, Sensor)] = &[
    ("DAVIS346", Sensor::new(346, 260)),
    ("DAVIS240", Sensor::new(240, 180)),
    ("DAVIS640", Sensor::new(640, 480)),
    ("DVS128", Sensor::new(128, 128)),
];

/// Content of the header lines.
pub struct Header {
    /// `true` for version 3.0, in which y counts from below.
    pub from_below: bool,
    /// Number and name of each camera.
    pub sources: Vec<(i16, String)>,
    /// Date of the recording.
    pub began: Option<String>,
    /// Encoding of the packets: `RAW`, or the name of a compression.
    pub encoding: Option<String>,
    /// Number of bytes before the first packet.
    pub length: u64,
}

impl Header {
    /// Returns the camera with the `wanted` number or name, or the first one if `wanted` is `None`; `None` if there is
    /// no such camera.
    pub fn source(&self, wanted: Option<&str>) -> Option<&(i16, String)> {
        match wanted {
            Some(wanted) => self.sources.iter().find(|(number, name)| number.to_string() == wanted || name == wanted),
            None => self.sources.first(),
        }
    }

    /// `true` if packets of the source `number` belong to the camera `chosen`. If the header names only one source, all
    /// packets do.
    pub fn is_of(&self, chosen: Option<i16>, number: i16) -> bool {
        self.sources.len() < 2 || chosen == Some(number)
    }

    /// `true` if the header names the source `number`.
    pub fn names(&self, number: i16) -> bool {
        self.sources.iter().any(|(known, _)| *known == number)
    }

    /// Returns the name of packets of this kind and source.
    pub fn name_of(&self, kind: i16, source: i16) -> String {
        match self.sources.iter().find(|(number, _)| *number == source) {
            Some((_, camera)) if self.sources.len() > 1 => format!("{} of {source} {camera}", name(kind)),
            _ => name(kind).to_owned(),
        }
    }

    /// Lists the numbers and names of the sources.
    pub fn list(&self) -> String {
        let all: Vec<String> = self.sources.iter().map(|(number, name)| format!("{number} {name}")).collect();
        if all.is_empty() { "none is named".to_owned() } else { all.join(", ") }
    }
}

/// Returns the sensor of a camera with this name, if it is known.
pub fn sensor(camera: &str) -> Option<Sensor> {
    let camera = camera.to_uppercase();
    SOURCES.iter().find(|(name, _)| camera.contains(name)).map(|&(_, sensor)| sensor)
}

/// Parses the header; `None` if its end is not in `bytes`.
pub fn header(bytes: &[u8]) -> Option<Header> {
    let mut header = Header {
        from_below: bytes.starts_with(b"#!AER-DAT3.0"),
        sources: Vec::new(),
        began: None,
        encoding: None,
        length: 0,
    };
    let mut length = 0;
    while let Some(rest) = bytes.get(length..).filter(|rest| rest.starts_with(b"#")) {
        let end = rest.iter().take(LONGEST_LINE).position(|&byte| byte == b'\n')?;
        length += end + 1;
        let line = String::from_utf8_lossy(rest.get(..end)?);
        let line = line.trim_end();
        if line == LAST_LINE {
            break;
        }
        if let Some((key, value)) = line.split_once(':') {
            if let Some(number) = key.strip_prefix("#Source") {
                header.sources.push((number.trim().parse().unwrap_or_default(), value.trim().to_owned()));
            } else if key == "#Start-Time" {
                header.began = Some(value.trim().to_owned());
            } else if key == "#Format" {
                header.encoding = Some(value.trim().to_owned());
            }
        }
    }
    header.length = length as u64;
    Some(header)
}

/// Head of a packet, or of the rest of one.
#[derive(Clone, Copy)]
pub struct PacketHead {
    /// Offset of the head in the file.
    pub byte: u64,
    /// Kind of the packet.
    pub kind: i16,
    /// Number of the camera.
    pub source: i16,
    /// Size of one event in bytes.
    pub size: u64,
    /// Size of all events in the file, in bytes.
    pub length: u64,
    /// Size that all events should have, in bytes; larger than `length` if the file is cut off.
    pub wanted: u64,
    /// Offset in µs that is added to times.
    pub turns: i64,
    /// Number of events.
    pub count: u64,
}

impl PacketHead {
    /// Returns a head for the rest of the packet after its first `bytes`.
    pub fn without(self, bytes: u64) -> Self {
        let [length, wanted] = [self.length, self.wanted].map(|length| length.saturating_sub(bytes));
        Self { length, wanted, ..self }
    }
}

/// Reads the next head; `None` at the end of the file, or if the head is cut off.
pub fn next_head(
    file: &mut ByteReader,
    truncated: &mut Option<Truncation>,
) -> Result<Option<PacketHead>, RecordingError> {
    let byte = file.position();
    if file.at_end()? {
        return Ok(None);
    }
    let Some(head) = file.array::<HEAD>()? else {
        let lost = counted(file.left(), "byte of a packet's head is left", "bytes of a packet's head are left");
        *truncated = Some(Truncation { byte, lost });
        return Ok(None);
    };
    let [kind0, kind1, source0, source1, rest @ ..] = head;
    let mut numbers = [0_i32; 6];
    numbers.iter_mut().zip(rest.as_chunks().0).for_each(|(number, bytes)| *number = i32::from_le_bytes(*bytes));
    let [size, _, turns, _, number, _] = numbers;
    let sizes = u64::try_from(size).ok().zip(u64::try_from(number).ok());
    let Some((size, count)) = sizes.filter(|_| turns >= 0) else {
        return Err(file.damaged(byte, "the head of a packet has a negative number"));
    };
    let (kind, source) = (i16::from_le_bytes([kind0, kind1]), i16::from_le_bytes([source0, source1]));
    if kind == POLARITY && size != EVENT as u64 {
        return Err(file.damaged(byte, format!("a packet of events states {size} bytes per event instead of {EVENT}")));
    }
    // Both factors have 31 bits, so the product cannot overflow.
    let wanted = size * count;
    let length = wanted.min(file.left());
    if length < wanted {
        *truncated = Some(Truncation { byte, lost: format!("{length} of {wanted} bytes of a packet are left") });
    }
    Ok(Some(PacketHead { byte, kind, source, size, length, wanted, turns: i64::from(turns) << 31, count }))
}

/// Returns the time of an event in µs, from its bytes and the head of its packet.
pub fn time(head: &PacketHead, bytes: [u8; 4]) -> i64 {
    head.turns + i64::from(i32::from_le_bytes(bytes))
}

/// `true` if cAER may write packets of this kind.
pub fn is_known(kind: i16) -> bool {
    (0..KNOWN_KINDS).contains(&kind)
}

/// Returns the name of the content of packets of this kind.
pub fn name(kind: i16) -> &'static str {
    usize::try_from(kind).ok().and_then(|kind| KINDS.get(kind)).copied().unwrap_or("other packets")
}
