//! The lines at the top, and the heads of packets.

use evcal_core::sensor::Sensor;

use crate::bytes::ByteReader;
use crate::error::RecordingError;
use crate::read_report::Truncation;

/// How a file begins.
pub const MAGIC: &[u8] = b"#!AER-DAT3.";
const LAST_LINE: &str = "#!END-HEADER";
/// No line of the header is longer.
const LONGEST_LINE: usize = 4096;
/// Size of a packet's head.
const HEAD: usize = 28;
/// Kind of packets of events.
pub const POLARITY: i16 = 1;
/// Size of a polarity event.
pub const EVENT: usize = 8;
/// Names of what packets hold, by kind.
const KINDS: [&str; 5] = ["special events", "events", "frames", "inertial samples", "inertial samples with compass"];
/// Kinds below this number are counted one by one: cAER has fewer.
const KNOWN_KINDS: i16 = 32;
/// What in the line of the source tells its sensor.
const SOURCES: &[(&str, Sensor)] = &[
    ("DAVIS346", Sensor::new(346, 260)),
    ("DAVIS240", Sensor::new(240, 180)),
    ("DAVIS640", Sensor::new(640, 480)),
    ("DVS128", Sensor::new(128, 128)),
];

/// What the lines at the top say.
pub struct Header {
    /// Version 3.0, where y counts from below.
    pub from_below: bool,
    /// Number and name of each camera.
    pub sources: Vec<(i16, String)>,
    /// When it was recorded.
    pub began: Option<String>,
    /// How packets are put into bytes, `RAW` unless they are compressed.
    pub encoding: Option<String>,
    /// Number of bytes before the first packet.
    pub length: u64,
}

impl Header {
    /// The camera that is asked for by its number or name, else the first one; `None` if there is none such.
    pub fn source(&self, wanted: Option<&str>) -> Option<&(i16, String)> {
        match wanted {
            Some(wanted) => self.sources.iter().find(|(number, name)| number.to_string() == wanted || name == wanted),
            None => self.sources.first(),
        }
    }

    /// Whether packets of the source `number` are those of `chosen`. Where the header names but one source, all are.
    pub fn is_of(&self, chosen: Option<i16>, number: i16) -> bool {
        self.sources.len() < 2 || chosen == Some(number)
    }

    /// Whether the header names the source `number`.
    pub fn names(&self, number: i16) -> bool {
        self.sources.iter().any(|(known, _)| *known == number)
    }

    /// What packets of this kind and source are called.
    pub fn name_of(&self, kind: i16, source: i16) -> String {
        match self.sources.iter().find(|(number, _)| *number == source) {
            Some((_, camera)) if self.sources.len() > 1 => format!("{} of {source} {camera}", name(kind)),
            _ => name(kind).to_owned(),
        }
    }

    /// The sources by numbers and names.
    pub fn list(&self) -> String {
        let all: Vec<String> = self.sources.iter().map(|(number, name)| format!("{number} {name}")).collect();
        if all.is_empty() { "none is named".to_owned() } else { all.join(", ") }
    }
}

/// The sensor of a camera of this name.
pub fn sensor(camera: &str) -> Option<Sensor> {
    let camera = camera.to_uppercase();
    SOURCES.iter().find(|(name, _)| camera.contains(name)).map(|&(_, sensor)| sensor)
}

/// `None` if the end of the header is not in `bytes`.
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

/// Head of a packet.
#[derive(Clone, Copy)]
pub struct PacketHead {
    /// Its offset in the file.
    pub byte: u64,
    /// What the packet holds.
    pub kind: i16,
    /// Which camera it is of.
    pub source: i16,
    /// Bytes of one event.
    pub size: u64,
    /// Bytes of all events that are there.
    pub length: u64,
    /// Bytes that there should be.
    pub wanted: u64,
    /// Added to the times in µs.
    pub turns: i64,
    /// Number of events.
    pub count: u64,
}

impl PacketHead {
    /// The head of what of the packet is left when its first `bytes` were read.
    pub fn without(self, bytes: u64) -> Self {
        let [length, wanted] = [self.length, self.wanted].map(|length| length.saturating_sub(bytes));
        Self { length, wanted, ..self }
    }
}

/// The next head; `None` at the end of the file, or where it is cut off.
pub fn next_head(
    file: &mut ByteReader,
    truncated: &mut Option<Truncation>,
) -> Result<Option<PacketHead>, RecordingError> {
    let byte = file.position();
    if file.left() == 0 {
        return Ok(None);
    }
    let Some(head) = file.array::<HEAD>()? else {
        *truncated = Some(Truncation { byte, lost: format!("{} bytes of a packet's head are left", file.left()) });
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
        return Err(file.damaged(byte, format!("a packet of events says that an event has {size} bytes, not {EVENT}")));
    }
    // Two numbers of 31 bits.
    let wanted = size * count;
    let length = wanted.min(file.left());
    if length < wanted {
        *truncated = Some(Truncation { byte, lost: format!("{length} of {wanted} bytes of a packet are left") });
    }
    Ok(Some(PacketHead { byte, kind, source, size, length, wanted, turns: i64::from(turns) << 31, count }))
}

/// A time of an event in µs, of the packet with this head.
pub fn time(head: &PacketHead, bytes: [u8; 4]) -> i64 {
    head.turns + i64::from(i32::from_le_bytes(bytes))
}

/// Whether cAER may have packets of this kind.
pub fn is_known(kind: i16) -> bool {
    (0..KNOWN_KINDS).contains(&kind)
}

/// What packets of this kind hold.
pub fn name(kind: i16) -> &'static str {
    usize::try_from(kind).ok().and_then(|kind| KINDS.get(kind)).copied().unwrap_or("other packets")
}
