//! Bags and MCAP files, built byte by byte.

use std::io::{Cursor, Write};

use evcal_core::event::{Event, Polarity};

use super::super::fields::Wire;

/// A message under construction.
pub struct Message(Wire, Vec<u8>);

impl Message {
    /// Begins with a header with this time in µs.
    pub fn new(wire: Wire, t: i64) -> Self {
        let mut message = Self(wire, Vec::new());
        if wire == Wire::Ros1 {
            message.number(7_u32.to_le_bytes());
        }
        message.time(t).text("camera");
        message
    }

    pub fn number<const N: usize>(&mut self, bytes: [u8; N]) -> &mut Self {
        while self.0 == Wire::Cdr && !self.1.len().is_multiple_of(N) {
            self.1.push(0xee);
        }
        self.1.extend_from_slice(&bytes);
        self
    }

    fn time(&mut self, t: i64) -> &mut Self {
        let (seconds, nanoseconds) = ((t / 1_000_000) as u32, (t % 1_000_000 * 1000 + 999) as u32);
        self.number(seconds.to_le_bytes()).number(nanoseconds.to_le_bytes())
    }

    pub fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.number((bytes.len() as u32).to_le_bytes());
        self.1.extend_from_slice(bytes);
        self
    }

    pub fn text(&mut self, text: &str) -> &mut Self {
        match self.0 {
            Wire::Ros1 => self.bytes(text.as_bytes()),
            Wire::Cdr => self.bytes(&[text.as_bytes(), &[0]].concat()),
        }
    }

    pub fn finish(&self) -> Vec<u8> {
        match self.0 {
            Wire::Ros1 => self.1.clone(),
            Wire::Cdr => [&[0, 1, 0, 0], self.1.as_slice()].concat(),
        }
    }
}

pub fn event_array(wire: Wire, events: &[Event]) -> Vec<u8> {
    let mut message = Message::new(wire, 99);
    message.number(260_u32.to_le_bytes()).number(346_u32.to_le_bytes());
    message.number((events.len() as u32).to_le_bytes());
    for event in events {
        message.number(event.x.to_le_bytes()).number(event.y.to_le_bytes()).time(event.t);
        message.number([u8::from(event.polarity == Polarity::On)]);
    }
    message.finish()
}

pub fn event_packet(wire: Wire, encoding: &str, time_base: u64, words: &[u16]) -> Vec<u8> {
    let payload: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    let mut message = Message::new(wire, 99);
    message.number(260_u32.to_le_bytes()).number(346_u32.to_le_bytes()).number(3_u64.to_le_bytes());
    message.number(time_base.to_le_bytes()).text(encoding).number([0]).bytes(&payload);
    message.finish()
}

/// An image of 3 x 2 pixels.
pub fn image(wire: Wire, t: i64, encoding: &str, step: u32, pixels: &[u8]) -> Vec<u8> {
    sized_image(wire, t, [3, 2], encoding, step, pixels)
}

pub fn sized_image(wire: Wire, t: i64, size: [u32; 2], encoding: &str, step: u32, pixels: &[u8]) -> Vec<u8> {
    let [width, height] = size;
    let mut message = Message::new(wire, t);
    message.number(height.to_le_bytes()).number(width.to_le_bytes()).text(encoding);
    message.number([0]).number(step.to_le_bytes()).bytes(pixels);
    message.finish()
}

pub fn imu(wire: Wire, t: i64) -> Vec<u8> {
    imu_of(wire, t, [0.0, 1.0, -2.0], [9.80665, 0.0, -9.80665])
}

pub fn imu_of(wire: Wire, t: i64, angular_velocity: [f64; 3], acceleration: [f64; 3]) -> Vec<u8> {
    let mut message = Message::new(wire, t);
    let numbers = [[0.0_f64; 13].as_slice(), &angular_velocity, &[0.0; 9], &acceleration, &[0.0; 9]].concat();
    numbers.iter().for_each(|number| {
        message.number(number.to_le_bytes());
    });
    message.finish()
}

/// Compresses messages individually, like `ros2 bag record --compression-mode message`.
pub fn packed_one_by_one(messages: Messages) -> Messages {
    let pack = |(name, type_name, message): (_, _, Vec<u8>)| (name, type_name, packed("zstd", &message));
    messages.into_iter().map(pack).collect()
}

/// Compresses the bytes of a chunk.
fn packed(compression: &str, bytes: &[u8]) -> Vec<u8> {
    match compression {
        "lz4" => {
            let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
            encoder.write_all(bytes).unwrap();
            encoder.finish().unwrap()
        }
        "bz2" => {
            let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::best());
            encoder.write_all(bytes).unwrap();
            encoder.finish().unwrap()
        }
        "zstd" => zstd::stream::encode_all(Cursor::new(bytes), 3).unwrap(),
        _ => bytes.to_vec(),
    }
}

/// Messages of a recording: name of the topic, type, and content of each.
pub type Messages = Vec<(&'static str, &'static str, Vec<u8>)>;

pub fn bag_record(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    let fields = fields.iter().map(|(name, value)| [name.as_bytes(), b"=", value].concat());
    let header: Vec<u8> = fields.flat_map(|field| [&(field.len() as u32).to_le_bytes()[..], &field].concat()).collect();
    let lengths = [header.len(), data.len()].map(|length| (length as u32).to_le_bytes());
    [&lengths[0], header.as_slice(), &lengths[1], data].concat()
}

/// Builds a bag with chunks of two messages.
pub fn bag(compression: &str, messages: &Messages) -> Vec<u8> {
    let mut bytes = b"#ROSBAG V2.0\n".to_vec();
    bytes.extend(bag_record(&[("op", &[3]), ("index_pos", &[0; 8])], &[b' '; 20]));
    let mut names: Vec<&str> = Vec::new();
    for part in messages.chunks(2) {
        let mut chunk = Vec::new();
        for (name, type_name, message) in part {
            let known = names.iter().position(|known| known == name);
            let number = known.unwrap_or(names.len()) as u32;
            if known.is_none() {
                names.push(name);
                let data = bag_record(&[("topic", name.as_bytes()), ("type", type_name.as_bytes())], &[]);
                let data = &data[4..data.len() - 4];
                let head = [("op", &[7_u8][..]), ("conn", &number.to_le_bytes()), ("topic", name.as_bytes())];
                chunk.extend(bag_record(&head, data));
            }
            chunk.extend(bag_record(&[("op", &[2]), ("conn", &number.to_le_bytes()), ("time", &[0; 8])], message));
        }
        let packed = packed(compression, &chunk);
        let size = (chunk.len() as u32).to_le_bytes();
        bytes.extend(bag_record(&[("op", &[5]), ("compression", compression.as_bytes()), ("size", &size)], &packed));
        bytes.extend(bag_record(&[("op", &[4]), ("count", &[2, 0, 0, 0])], &[0; 24]));
    }
    bytes
}

pub fn mcap_record(kind: u8, content: &[u8]) -> Vec<u8> {
    [&[kind][..], &(content.len() as u64).to_le_bytes(), content].concat()
}

pub fn mcap_text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

/// Builds an MCAP file with chunks of two messages, or without chunks if the compression is `-`.
pub fn mcap(compression: &str, messages: &Messages) -> Vec<u8> {
    let mut bytes = b"\x89MCAP0\r\n".to_vec();
    bytes.extend(mcap_record(1, &[mcap_text("ros2"), mcap_text("test")].concat()));
    let mut names: Vec<&str> = Vec::new();
    for part in messages.chunks(2) {
        let mut records = Vec::new();
        for (name, type_name, message) in part {
            let known = names.iter().position(|known| known == name);
            let number = (known.unwrap_or(names.len()) as u16 + 1).to_le_bytes();
            if known.is_none() {
                names.push(name);
                let schema = [&number[..], &mcap_text(type_name), &mcap_text("ros2msg"), &mcap_text("")].concat();
                records.extend(mcap_record(3, &schema));
                let channel = [&number[..], &number, &mcap_text(name), &mcap_text("cdr"), &[0; 4]].concat();
                records.extend(mcap_record(4, &channel));
            }
            records.extend(mcap_record(5, &[&number[..], &[0; 20], message].concat()));
        }
        if compression == "-" {
            bytes.extend(records);
            continue;
        }
        let packed = packed(compression, &records);
        let head = [&[0; 16][..], &(records.len() as u64).to_le_bytes(), &[0; 4], &mcap_text(compression)].concat();
        bytes.extend(mcap_record(6, &[&head[..], &(packed.len() as u64).to_le_bytes(), &packed].concat()));
    }
    bytes.extend(mcap_record(15, &[0; 4]));
    bytes.extend(mcap_record(2, &[0; 20]));
    bytes.extend(b"\x89MCAP0\r\n");
    bytes
}

pub const START: i64 = 1_700_000_000_000_000;

pub fn events(first: i64, count: i64) -> Vec<Event> {
    let on = |index: i64| if index % 3 == 0 { Polarity::On } else { Polarity::Off };
    let event = |index: i64| Event {
        t: START + index * 500,
        x: 5 + (index % 250) as u16,
        y: (index % 250) as u16,
        polarity: on(index),
    };
    (first..first + count).map(event).collect()
}
