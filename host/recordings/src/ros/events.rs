//! Decoder of the events of one topic.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::Path;

use evcal_core::event::Event;

use super::container::{Container, MessageHead, OpenContainer, Topic};
use super::message::{self, Description, Kind};
use super::packet::{ENCODINGS, PacketDecoder};
use super::picture;
use crate::error::{RecordingError, RecordingErrorKind, most_events, up_to_damage};
use crate::format::{OpenResult, StreamSummary};
use crate::options::{Damage, RecordingOptions};
use crate::prophesee::{TRIGGERS, store_counts};
use crate::read_report::{ReadReport, Truncation};
use crate::reader::{Decode, Opened, RecordingInformation};

/// Number of events from which a batch is returned.
const BATCH: usize = 16_384;

/// Number of messages of a topic in which its cameras are looked for, and largest number of cameras: a driver may give each message
/// a frame of its own.
const LOOKED_AT: usize = 32;
const MOST_CAMERAS: usize = 4;

struct Decoder {
    container: Box<dyn Container>,
    topic: String,
    /// Coordinate frame of the camera, if messages of others are on the topic.
    frame: Option<String>,
    damage: Damage,
    packets: PacketDecoder,
    /// A message whose events are decoded up to this byte of them.
    begun: Option<(MessageHead, usize)>,
}

/// Opens the events of the requested topic, or of the first topic that has any.
pub fn open(format: &'static str, open: OpenContainer, path: &Path, options: &RecordingOptions) -> OpenResult {
    let mut container = open(path)?;
    let wanted = options.stream.as_deref();
    let Some(First { topic, frame, description }) = first_of(path, &mut *container, wanted, options.damage)? else {
        return Err(match container.truncated() {
            Some(Truncation { byte, lost }) => container.damaged(*byte, format!("{lost}; no events precede it")),
            None => RecordingError::new(path, no_topic(container.topics(), wanted)),
        });
    };
    let Description { sensor, encoding, .. } = description;
    let mut notes = vec![format!("the events of the topic {topic} are read")];
    if let Some(encoding) = encoding {
        notes.push(format!("they are encoded as {encoding}"));
        if encoding == "evt3" {
            notes.push("their times are from the sensor's clock, not from that of other topics".to_owned());
        }
    }
    notes.extend(container.doubt());
    let mut others = other_cameras(&mut *container, &topic, &frame, options.damage);
    others.sort();
    let frame = (!others.is_empty() || wanted == Some(&*frame)).then_some(frame);
    if let Some(frame) = frame.as_ref().filter(|_| !others.is_empty()) {
        let others = others.join(", ");
        notes.push(format!("the topic has the events of several cameras; those of the frame {frame} are read; {others} can be chosen as a stream"));
    }
    let information = RecordingInformation { format, sensor, notes, ..RecordingInformation::default() };
    let packets = PacketDecoder::default();
    let container = open(path)?;
    let decoder = Decoder { container, topic, frame, damage: options.damage, packets, begun: None };
    Ok(Opened::new(information, decoder))
}

/// Returns the frames of other cameras than that of `frame` in the next messages of `topic`; empty if it is the only one.
fn other_cameras(container: &mut dyn Container, topic: &str, frame: &str, damage: Damage) -> Vec<String> {
    let mut messages: BTreeMap<String, usize> = BTreeMap::from([(frame.to_owned(), 1)]);
    let mut seen = 1;
    while seen < LOOKED_AT {
        // The reader of the events reports damage.
        let Ok(Some(head)) = container.next_readable(damage) else { break };
        let of_topic = |one: &&Topic| one.kind.contains_events() && one.name == topic;
        let Some(wire) = container.topics().get(head.topic).filter(of_topic).map(|topic| topic.wire) else { continue };
        *messages.entry(message::frame_name(wire, container.message())).or_default() += 1;
        seen += 1;
    }
    if messages.len() > MOST_CAMERAS || messages.values().any(|count| *count < 2) {
        return Vec::new();
    }
    messages.into_keys().filter(|other| other != frame).collect()
}

/// A topic with events, and the description in its first message with events.
struct First {
    topic: String,
    /// Coordinate frame of the camera; empty if the message has none.
    frame: String,
    description: Description,
}

/// Finds the first message with events of the topic, or of the coordinate frame, `wanted`, or of any if it is `None`. If there is none,
/// returns the first message that could contain events. Messages in an unsupported encoding are an error only if no
/// other follows, because some drivers send triggers in such messages.
fn first_of(
    path: &Path,
    container: &mut dyn Container,
    wanted: Option<&str>,
    damage: Damage,
) -> Result<Option<First>, RecordingError> {
    let (mut without, mut unread) = (None, None);
    loop {
        let Some(head) = container.next_readable(damage)? else {
            return unread.map_or(Ok(without), |kind| Err(RecordingError::new(path, kind)));
        };
        let Some(topic) = container.topics().get(head.topic).filter(|topic| topic.kind.contains_events()) else {
            continue;
        };
        let frame = message::frame_name(topic.wire, container.message());
        if wanted.is_some_and(|wanted| wanted != topic.name && wanted != frame) {
            continue;
        }
        let description = match message::description(topic.kind, topic.wire, container.message()) {
            Ok(description) => description,
            Err(_) if damage == Damage::Skip => continue,
            Err(error) => return Err(damaged(container, &head, topic, &error.to_string())),
        };
        if let Some(encoding) = description.unread_encoding() {
            let (topic, encoding) = (topic.name.clone(), encoding.to_owned());
            unread.get_or_insert(RecordingErrorKind::EventEncoding { topic, encoding, known: &ENCODINGS });
            continue;
        }
        let has_events = description.has_events;
        let first = First { topic: topic.name.clone(), frame, description };
        if has_events {
            return Ok(Some(first));
        }
        without.get_or_insert(first);
    }
}

fn no_topic(topics: &[Topic], wanted: Option<&str>) -> RecordingErrorKind {
    let of_events = topics.iter().filter(|topic| topic.kind.contains_events());
    match wanted {
        Some(wanted) => RecordingErrorKind::NoSuchStream {
            wanted: wanted.to_owned(),
            available: match of_events.map(Topic::description).collect::<Vec<_>>() {
                none if none.is_empty() => "none".to_owned(),
                some => some.join(", "),
            },
        },
        None => RecordingErrorKind::NoEventStream(topics.iter().map(Topic::description).collect::<Vec<_>>().join(", ")),
    }
}

fn damaged(container: &dyn Container, head: &MessageHead, topic: &Topic, what: &str) -> RecordingError {
    container.damaged(head.byte, format!("a message of {} is damaged: {what}", topic.name))
}

impl Decoder {
    /// Appends the next events of a message, or counts a message of another topic. Returns `false` at the end.
    fn next_message(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        let (head, from) = match self.begun.take() {
            Some(begun) => begun,
            None => match self.container.next()? {
                Some(head) => (head, 0),
                None => return Ok(false),
            },
        };
        let Some(topic) = self.container.topics().get(head.topic) else { return Ok(true) };
        if topic.name != self.topic || !topic.kind.contains_events() {
            *report.other_packets.entry(topic.description()).or_default() += 1;
            return Ok(true);
        }
        let message = self.container.message();
        if from == 0
            && let Some(frame) = &self.frame
        {
            let other = message::frame_name(topic.wire, message);
            if other != *frame {
                *report.other_packets.entry(format!("{} of {other}", topic.description())).or_default() += 1;
                return Ok(true);
            }
        }
        let decoded = message::events(topic.kind, topic.wire, message, from, &mut self.packets, batch);
        let rest = decoded.map_err(|error| damaged(&*self.container, &head, topic, &error.to_string()))?;
        self.begun = rest.map(|from| (head, from));
        Ok(true)
    }
}

impl Decode for Decoder {
    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        let mut more = true;
        while more && batch.len() < BATCH {
            let was_whole = self.container.truncated().is_none();
            match self.next_message(batch, report) {
                Ok(there_is) => more = there_is,
                // The rest of the file cannot be read, which is reported as truncation.
                Err(error) if error.is_skipped(self.damage) && was_whole && self.container.truncated().is_some() => {}
                Err(error) if error.is_skipped(self.damage) => report.damaged_packets += 1,
                Err(error) => return Err(error),
            }
        }
        store_counts(self.packets.counts(), report);
        if self.packets.triggers > 0 {
            report.other_packets.insert(TRIGGERS.to_owned(), self.packets.triggers);
        }
        report.truncated = self.container.truncated().cloned();
        Ok(more)
    }

    fn done(&self) -> Option<f64> {
        Some(self.container.done())
    }
}

/// Returns the size in bytes of the file at `path`, or of the files in the folder there.
fn size_of(path: &Path) -> io::Result<u64> {
    let metadata = fs::metadata(path)?;
    if metadata.is_file() {
        return Ok(metadata.len());
    }
    fs::read_dir(path)?.map(|entry| Ok(entry?.metadata()?.len())).sum()
}

/// Counts the content of the topics of the file at `path`. Damaged messages are counted, but not their elements.
pub fn summarise(
    open: OpenContainer,
    path: &Path,
    options: &RecordingOptions,
) -> Result<Vec<StreamSummary>, RecordingError> {
    let bytes = size_of(path).map_err(|error| RecordingError::io(path, error))?;
    let mut container = open(path)?;
    let mut summaries: Vec<StreamSummary> = Vec::new();
    let mut decoders: Vec<PacketDecoder> = Vec::new();
    let mut events = Vec::new();
    while let Some(head) = up_to_damage(container.next_readable(options.damage))? {
        for topic in container.topics().get(summaries.len()..).unwrap_or_default() {
            summaries.push(StreamSummary::new(topic.description()));
            decoders.push(PacketDecoder::default());
        }
        let found = (summaries.get_mut(head.topic), decoders.get_mut(head.topic), container.topics().get(head.topic));
        let (Some(summary), Some(decoder), Some(topic)) = found else { continue };
        summary.packets += 1;
        let (wire, message) = (topic.wire, container.message());
        let (count, times) = match topic.kind {
            Kind::EventArray | Kind::EventPacket => {
                let (mut count, mut times, mut from) = (0, None, 0);
                loop {
                    events.clear();
                    // Events before damage are counted.
                    let rest = message::events(topic.kind, wire, message, from, decoder, &mut events);
                    count += events.len() as u64;
                    if let Some((first, last)) = events.first().zip(events.last()) {
                        times = Some((times.map_or(first.t, |(first, _)| first), last.t));
                    }
                    if summary.elements + count > most_events(bytes) {
                        return Err(RecordingError::new(path, RecordingErrorKind::too_many(bytes)));
                    }
                    match rest {
                        Ok(Some(next)) => from = next,
                        Ok(None) | Err(_) => break (count, times),
                    }
                }
            }
            Kind::Image | Kind::CompressedImage | Kind::Imu => {
                if topic.kind == Kind::Image && summary.unread.is_none() {
                    summary.unread = picture::unread_encoding(wire, message);
                }
                let time = super::fields::Fields::new(wire, message).and_then(|mut fields| fields.header()).ok();
                (1, time.map(|t| (t, t)))
            }
            Kind::Other => (1, None),
        };
        summary.elements += count;
        summary.extend(times);
    }
    Ok(summaries)
}
