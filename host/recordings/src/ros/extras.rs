//! Images and IMU samples of the camera whose events are read.
//!
//! A bag may contain several cameras and IMUs. The topics that belong to the events are the topics whose names share
//! the most leading parts with the name of the event topic: `/davis/left/image_raw` and `/davis/left/imu` belong to
//! `/davis/left/events`. Images are taken to be from another camera in three cases: if they are larger than the sensor,
//! if they are smaller and their topic shares no part with the event topic, or if their coordinate frame or topic names
//! another side of a rig (left, right, 0, 1) than the coordinate frame or topic of the events. Images that may be depth
//! images are not read; they are reported if there are no other images. If the topic of samples lacks accelerations or
//! angular velocities, they are taken from another topic ([`super::merged_samples`]).

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::Path;

use evcal_core::sensor::Sensor;

use super::container::{Container, OpenContainer, Topic};
use super::fields::MessageError;
use super::merged_samples::{MergedSamples, Quantities};
use super::message::{self, Kind};
use super::picture;
use crate::error::{RecordingError, up_to_damage};
use crate::extras::{BOTH, Extras, Item, Items, OtherStreams, UnreadFrame};
use crate::options::{Damage, RecordingOptions};

/// Number of messages that are examined to find topics if the file does not list them. More are examined until there is
/// a topic of each kind.
const EXAMINED: usize = 4096;
/// Size limit in bytes of the messages that are examined, because a list may name topics without messages.
const MOST_BYTES: u64 = 1 << 28;
/// Smallest size in bytes with which a message is counted, because there may be very many empty ones.
const LEAST_OF_A_MESSAGE: u64 = 64;

/// The topics that are read, as indices in [`Container::topics`].
#[derive(Clone, Copy, Debug, Default)]
struct Topics {
    pictures: Option<usize>,
    /// `true` if the encoding of the images is supported.
    are_pictures_read: bool,
    samples: Option<usize>,
    /// Topic of the accelerations, if those of `samples` are without accelerations.
    accelerations: Option<usize>,
    /// Topic of images that seem to be from another camera, if there are no others.
    other: Option<Other>,
}

/// A topic of images that are not read.
#[derive(Clone, Copy, Debug)]
struct Other {
    topic: usize,
    /// Width and height of the images in pixels, if they are larger than the sensor of the events.
    larger: Option<(u32, u32)>,
}

/// Reader of the images and samples in a file of messages.
struct MessageItems {
    container: Box<dyn Container>,
    topics: Topics,
    damage: Damage,
    merged: MergedSamples,
}

/// Damage without a recognisable message is skipped silently, because the reader of the events counts it.
impl Iterator for MessageItems {
    type Item = Result<Item, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        let Self { container, topics, damage, merged } = self;
        loop {
            if let Some(sample) = merged.next() {
                return Some(Ok(Item::Inertial(sample)));
            }
            let head = match container.next_readable(*damage) {
                Ok(head) => head?,
                Err(error) => return Some(Err(error)),
            };
            let Some(topic) = container.topics().get(head.topic) else { continue };
            let is = |of: Option<usize>| of == Some(head.topic);
            let item = if is(topics.pictures) {
                read_picture(topic, container.message())
            } else if is(topics.samples) || is(topics.accelerations) {
                message::inertial_sample(topic.wire, container.message()).map(Item::Inertial)
            } else {
                continue;
            };
            match item {
                Ok(Item::Inertial(sample)) if is(topics.accelerations) => merged.add_acceleration(sample),
                Ok(Item::Inertial(sample)) if topics.accelerations.is_some() => merged.add_angular_velocity(sample),
                Ok(item) => return Some(Ok(item)),
                Err(error) => {
                    let what = format!("a message of {} is damaged: {error}", topic.name);
                    return Some(Item::skipped(container.damaged(head.byte, what), *damage));
                }
            }
        }
    }
}

fn read_picture(topic: &Topic, message: &[u8]) -> Result<Item, MessageError> {
    let picture::Description { t, encoding, .. } = picture::description(topic.kind, topic.wire, message)?;
    if let Some(encoding) = picture::unread_encoding(topic.wire, message) {
        return Ok(Item::Unread(UnreadFrame { t, encoding }));
    }
    let frame = picture::frame(topic.kind, topic.wire, message)?;
    Ok(frame.map_or(Item::Unread(UnreadFrame { t, encoding }), |frame| Item::Frame(frame, None)))
}

/// Chooses the topics that belong to the events of the topic `wanted`, or of the first topic that has any.
fn choose(container: &mut dyn Container, wanted: Option<&str>, damage: Damage) -> Result<Topics, RecordingError> {
    let mut events: Option<Events> = None;
    // Topics of images, each with its first image; `None` if they cannot be from the camera of the events.
    let mut pictures: BTreeMap<usize, Option<Pictures>> = BTreeMap::new();
    // Topics of samples, each with the quantities of its first sample.
    let mut samples: BTreeMap<usize, Quantities> = BTreeMap::new();
    let listed = container.listed();
    let listed = |kind: Kind| Some(listed.as_ref()?.iter().filter(|topic| topic.kind == kind).count());
    let (listed_pictures, listed_samples) = (listed(Kind::Image), listed(Kind::Imu));
    let (mut count, mut bytes) = (0, 0);
    // `true` if more topics may follow: as many as the file lists, or possibly some if it has no list.
    let awaited = |listed: Option<usize>, found: usize, count: usize| match listed {
        Some(listed) => found < listed,
        None => found == 0 || count < EXAMINED,
    };
    while bytes < MOST_BYTES
        && (events.is_none()
            || awaited(listed_pictures, pictures.len(), count)
            || awaited(listed_samples, samples.len(), count))
    {
        let Some(head) = up_to_damage(container.next_readable(damage))? else { break };
        count += 1;
        let message = container.message();
        bytes += (message.len() as u64).max(LEAST_OF_A_MESSAGE);
        let Some(topic) = container.topics().get(head.topic) else { continue };
        match topic.kind {
            Kind::EventArray | Kind::EventPacket
                if events.is_none() && wanted.is_none_or(|wanted| wanted == topic.name) =>
            {
                let described = message::description(topic.kind, topic.wire, message).ok();
                let described = described.filter(|it| it.has_events && it.unread_encoding().is_none());
                events = described.map(|described| Events {
                    topic: head.topic,
                    sensor: described.sensor,
                    frame: message::frame_name(topic.wire, message),
                });
            }
            Kind::Image if !pictures.contains_key(&head.topic) => {
                // A damaged image does not determine the properties of its topic.
                let Ok(frame) = picture::frame(topic.kind, topic.wire, message) else { continue };
                let described = picture::description(topic.kind, topic.wire, message).ok();
                let of_topic = described.and_then(|described| {
                    Some(Pictures {
                        size: described.size?,
                        is_read: frame.is_some(),
                        may_be_distances: picture::may_be_distances(&described.encoding),
                        frame: message::frame_name(topic.wire, message),
                    })
                });
                pictures.insert(head.topic, of_topic);
            }
            Kind::Imu if !samples.contains_key(&head.topic) => {
                // A damaged sample does not determine the quantities of its topic.
                let Ok(sample) = message::inertial_sample(topic.wire, message) else { continue };
                samples.insert(head.topic, Quantities::of(&sample));
            }
            _ => {}
        }
    }
    let topics = container.topics();
    let name = |index: usize| topics.get(index).map_or("", |topic| topic.name.as_str());
    let of_events = events.as_ref().map_or("", |events| name(events.topic));
    // Measures how well the name of a topic matches the name of the event topic.
    let fit = |index: usize| (shared(of_events, name(index)), name(index).contains("image_raw"));
    let sensor = events.as_ref().and_then(|events| events.sensor);
    let sides = sensor.map(|sensor| (u32::from(sensor.width), u32::from(sensor.height)));
    let is_larger = |size: (u32, u32)| sides.is_some_and(|sides| size.0 > sides.0 || size.1 > sides.1);
    let fits = |index: usize, pictures: &Pictures| {
        let is_related = events.is_none() || shared(of_events, name(index)) > 0;
        sides == Some(pictures.size) || !is_larger(pictures.size) && is_related
    };
    let is_of_other_side = |index: usize, pictures: &Pictures| {
        events.as_ref().is_some_and(|events| {
            let side_of_events = side_of_rig(&events.frame).or_else(|| side_of_rig(of_events));
            let side_of_pictures = side_of_rig(&pictures.frame).or_else(|| side_of_rig(name(index)));
            side_of_events.is_some() && side_of_pictures.is_some() && side_of_events != side_of_pictures
        })
    };
    let pictures = pictures.into_iter().filter_map(|(index, pictures)| Some((index, pictures?)));
    let (own, others): (Vec<_>, Vec<_>) =
        pictures.partition(|(index, pictures)| fits(*index, pictures) && !is_of_other_side(*index, pictures));
    // Depth images are chosen only if there are no others, so that their encoding is named. Among topics that share equally many
    // parts, prefers one with a supported encoding.
    let best = |pictures: Vec<(usize, Pictures)>| {
        pictures.into_iter().max_by_key(|(index, pictures)| {
            let (shared, is_raw) = fit(*index);
            (!pictures.may_be_distances, shared, pictures.is_read, is_raw, Reverse(*index))
        })
    };
    let own = best(own);
    let other = best(others).filter(|_| own.is_none());
    let are_pictures_read = own.as_ref().is_some_and(|(_, own)| own.is_read && !own.may_be_distances);
    let pictures = own.map(|(index, _)| index);
    let other =
        other.map(|(index, other)| Other { topic: index, larger: Some(other.size).filter(|size| is_larger(*size)) });
    let best = |is_wanted: fn(&Quantities) -> bool| {
        let wanted = samples.iter().filter(|(_, quantities)| is_wanted(quantities)).map(|(index, _)| *index);
        wanted.max_by_key(|&index| (fit(index), Reverse(index)))
    };
    let any = best(|_| true);
    // Drivers of some cameras publish accelerations and angular velocities in topics of their own.
    let (samples, accelerations) = match (best(|it| it.angular_velocity), best(|it| it.acceleration)) {
        (Some(turns), Some(accelerations))
            if [turns, accelerations].iter().all(|index| samples.get(index).is_some_and(|it| !it.are_both())) =>
        {
            (Some(turns), Some(accelerations))
        }
        _ => (any, None),
    };
    Ok(Topics { pictures, are_pictures_read, samples, accelerations, other })
}

/// The topic of the events.
struct Events {
    topic: usize,
    sensor: Option<Sensor>,
    /// Name of the events' coordinate frame.
    frame: String,
}

/// Properties of a topic of images, from its first image.
struct Pictures {
    /// Width and height in pixels.
    size: (u32, u32),
    /// `true` if their encoding is supported.
    is_read: bool,
    /// `true` if they may be depth images.
    may_be_distances: bool,
    /// Name of the images' coordinate frame.
    frame: String,
}

/// Returns the side of a rig in the name of a topic or coordinate frame: the last word that names a side, is its first letter, or ends
/// in a single digit.
fn side_of_rig(name: &str) -> Option<&str> {
    const SIDES: [&str; 12] =
        ["left", "right", "front", "rear", "back", "top", "bottom", "upper", "lower", "center", "master", "slave"];
    fn side(word: &str) -> Option<&str> {
        let letters = word.trim_end_matches(|letter: char| letter.is_ascii_digit());
        let is = |side: &str| letters.eq_ignore_ascii_case(side);
        let named = SIDES.into_iter().find(|side| is(side));
        let named = named.or_else(|| is("l").then_some("left")).or_else(|| is("r").then_some("right"));
        named.or_else(|| word.get(letters.len()..).filter(|digits| digits.len() == 1))
    }
    name.split(|letter: char| !letter.is_ascii_alphanumeric()).filter_map(side).next_back()
}

/// Returns the number of leading parts that two names share.
fn shared(first: &str, second: &str) -> usize {
    let parts = |name| str::split(name, '/').filter(|part| !part.is_empty());
    parts(first).zip(parts(second)).take_while(|(first, second)| first == second).count()
}

/// Opens the images and samples of the file at `path`.
pub fn open(open: OpenContainer, path: &Path, options: &RecordingOptions) -> Result<Extras, RecordingError> {
    let mut container = open(path)?;
    let topics = choose(&mut *container, options.stream.as_deref(), options.damage)?;
    let description = |topic: Option<usize>| Some(container.topics().get(topic?)?.description());
    let read = [
        ("frames", topics.pictures, topics.are_pictures_read),
        ("IMU samples", topics.samples, true),
        ("their accelerations", topics.accelerations, true),
    ];
    let read = read.map(|(what, topic, is_read)| Some((description(topic)?, what, is_read)));
    let chosen = read.iter().flatten().filter(|(.., is_read)| *is_read);
    let other = description(topics.other.map(|other| other.topic));
    let larger = topics.other.and_then(|other| other.larger);
    let streams = OtherStreams { frames: topics.pictures.is_some(), imu: topics.samples.is_some() };
    let mut extras = Extras {
        streams,
        chosen: chosen.map(|(name, what, _)| format!("{what} are read from {name}")).collect(),
        names: read.iter().flatten().map(|(name, ..)| name.clone()).collect(),
        passed_over: other.map(|name| match larger {
            Some((width, height)) => {
                format!(
                    "{name} is not read: its images of {width} x {height} pixels are larger than the sensor of the events"
                )
            }
            None => format!("{name} is not read: its name belongs to another camera than the events"),
        }),
        ..Extras::default()
    };
    extras.add(BOTH, None, items(open, path, topics, options.damage)?);
    Ok(extras)
}

/// Opens the images of the file at `path`.
pub fn frames(open: OpenContainer, path: &Path, options: &RecordingOptions) -> Result<Items, RecordingError> {
    let pictures = choose(&mut *open(path)?, options.stream.as_deref(), options.damage)?.pictures;
    items(open, path, Topics { pictures, ..Topics::default() }, options.damage)
}

fn items(open: OpenContainer, path: &Path, topics: Topics, damage: Damage) -> Result<Items, RecordingError> {
    Ok(Box::new(MessageItems { container: open(path)?, topics, damage, merged: MergedSamples::default() }))
}
