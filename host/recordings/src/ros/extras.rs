//! Pictures and inertial samples of the camera whose events are read.
//!
//! A bag may hold several cameras and units. The topics that go with the events are those whose names share most of their
//! beginning with that of the events: `/davis/left/image_raw` and `/davis/left/imu` go with `/davis/left/events`. A picture is of another
//! camera if it is larger than the sensor, or smaller and its name shares nothing with that of the events, or if it is one of distances,
//! or if its coordinate frame or topic names another side of a rig (left, right, 0, 1) than those of the events.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use evcal_core::sensor::Sensor;

use super::container::{Container, OpenContainer, Topic, is_skipped};
use super::fields::MessageError;
use super::message::{self, Kind};
use super::picture;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::extras::{
    BOTH, Extra, OtherStreams, ReadExtras, Skipped, UnreadFrame, UnreadFrames, read_or_report, take_until,
};
use crate::options::{Damage, RecordingOptions};
use crate::pictures::TimedImage;

/// So many messages are looked at for topics where the file does not list them, more if there is none of a kind among them.
const LOOKED_AT: usize = 4096;
/// No more bytes of messages than this are looked at: a list may name topics that have no message.
const MOST_LOOKED_AT: u64 = 1 << 28;
/// A message counts as so many bytes at least: there may be very many without any.
const LEAST_OF_A_MESSAGE: u64 = 64;

/// The topics that are read, by their places in [`Container::topics`].
#[derive(Clone, Copy, Debug, Default)]
struct Topics {
    pictures: Option<usize>,
    samples: Option<usize>,
    /// Pictures that would be taken if they were not of another side of the rig.
    foreign: Option<usize>,
}

/// What is read of a topic.
enum Read {
    Extra(Extra),
    Unread(UnreadFrame),
}

/// Those of a file of messages.
struct MessageExtras {
    container: Box<dyn Container>,
    next: Option<Extra>,
    topics: Topics,
    /// As [`super::container::Topic::description`] has them, of pictures and of samples.
    names: [Option<String>; 2],
    /// The same of pictures that are of another camera.
    foreign: Option<String>,
    /// Why the first could not be read.
    lost: Vec<String>,
    damage: Damage,
    skipped: Skipped,
    unread: UnreadFrames,
}

/// The next picture or sample of `topics` that can be read; pictures whose encoding is not read go to `unread`.
fn next(
    container: &mut dyn Container,
    topics: Topics,
    damage: Damage,
    skipped: &mut Skipped,
    unread: &mut UnreadFrames,
) -> Result<Option<Extra>, RecordingError> {
    while let Some(read) = next_or_unread(container, topics, damage, skipped)? {
        match read {
            Read::Extra(extra) => return Ok(Some(extra)),
            Read::Unread(frame) => unread.add(frame),
        }
    }
    Ok(None)
}

/// As [`next`], with the pictures that are not read. What is passed over where no message can be found in it, the reader of
/// the events counts.
fn next_or_unread(
    container: &mut dyn Container,
    topics: Topics,
    damage: Damage,
    skipped: &mut Skipped,
) -> Result<Option<Read>, RecordingError> {
    loop {
        let head = match container.next() {
            Ok(Some(head)) => head,
            Ok(None) => return Ok(None),
            Err(error) if is_skipped(&error, damage) => continue,
            Err(error) => return Err(error),
        };
        let Some(topic) = container.topics().get(head.topic) else { continue };
        let read = if topics.pictures == Some(head.topic) {
            read_picture(topic, container.message()).map(Some)
        } else if topics.samples == Some(head.topic) {
            let sample = message::inertial_sample(topic.wire, container.message());
            sample.map(|sample| Some(Read::Extra(Extra::Inertial(sample))))
        } else {
            Ok(None)
        };
        match read {
            Ok(Some(read)) => return Ok(Some(read)),
            Ok(None) => {}
            Err(error) => {
                let what = format!("a message of {} is damaged: {error}", topic.name);
                skipped.add(container.damaged(head.byte, what))?;
            }
        }
    }
}

fn read_picture(topic: &Topic, message: &[u8]) -> Result<Read, MessageError> {
    if let Some(frame) = picture::frame(topic.kind, topic.wire, message)? {
        return Ok(Read::Extra(Extra::Frame(frame)));
    }
    let picture::Description { t, encoding, .. } = picture::description(topic.kind, topic.wire, message)?;
    Ok(Read::Unread(UnreadFrame { t, encoding }))
}

/// The topics that go with the events of the topic `wanted`, or of the first one that has any.
fn choose(container: &mut dyn Container, wanted: Option<&str>, damage: Damage) -> Result<Topics, RecordingError> {
    let mut events: Option<Events> = None;
    // Topics with the size of a picture of each, where it may be of the camera of the events.
    let mut pictures: BTreeMap<usize, Option<Pictures>> = BTreeMap::new();
    let mut samples: BTreeSet<usize> = BTreeSet::new();
    let listed = container.listed();
    let listed = |kind: Kind| Some(listed.as_ref()?.iter().filter(|topic| topic.kind == kind).count());
    let (listed_pictures, listed_samples) = (listed(Kind::Image), listed(Kind::Imu));
    let (mut count, mut bytes) = (0, 0);
    // Whether topics are to come: as many as the file lists, or, where it has no list, perhaps some.
    let awaited = |listed: Option<usize>, found: usize, count: usize| match listed {
        Some(listed) => found < listed,
        None => found == 0 || count < LOOKED_AT,
    };
    while bytes < MOST_LOOKED_AT
        && (events.is_none()
            || awaited(listed_pictures, pictures.len(), count)
            || awaited(listed_samples, samples.len(), count))
    {
        let head = match container.next() {
            Ok(Some(head)) => head,
            Err(error) if is_skipped(&error, damage) => continue,
            // Damage is reported when its turn comes.
            Ok(None) | Err(RecordingError { kind: RecordingErrorKind::Damaged { .. }, .. }) => break,
            Err(error) => return Err(error),
        };
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
                // A damaged one tells nothing of its topic.
                let Ok(frame) = picture::frame(topic.kind, topic.wire, message) else { continue };
                let described = picture::description(topic.kind, topic.wire, message).ok();
                let described = described.filter(|described| !picture::may_be_distances(&described.encoding));
                let size = described.and_then(|described| described.size);
                let named = message::frame_name(topic.wire, message);
                let of_topic = size.map(|size| Pictures { size, is_read: frame.is_some(), frame: named });
                pictures.insert(head.topic, of_topic);
            }
            Kind::Imu => _ = samples.insert(head.topic),
            _ => {}
        }
    }
    let topics = container.topics();
    let name = |index: usize| topics.get(index).map_or("", |topic| topic.name.as_str());
    let beside = events.as_ref().map_or("", |events| name(events.topic));
    // The first of those that fit equally well.
    let fit = |index: usize| (shared(beside, name(index)), name(index).contains("image_raw"));
    let sensor = events.as_ref().and_then(|events| events.sensor);
    let fits = |(index, pictures): &(usize, Pictures)| {
        let (width, height) = pictures.size;
        let sides = sensor.map(|sensor| (u32::from(sensor.width), u32::from(sensor.height)));
        let is_whole = sides == Some((width, height));
        let fits = sides.is_none_or(|sides| width <= sides.0 && height <= sides.1);
        let is_beside = events.is_none() || shared(beside, name(*index)) > 0;
        is_whole || fits && is_beside
    };
    let is_of_other_side = |index: usize, pictures: &Pictures| {
        events.as_ref().is_some_and(|events| {
            let of_events = side_of_rig(&events.frame).or_else(|| side_of_rig(beside));
            let of_pictures = side_of_rig(&pictures.frame).or_else(|| side_of_rig(name(index)));
            of_events.is_some() && of_pictures.is_some() && of_events != of_pictures
        })
    };
    let pictures = pictures.into_iter().filter_map(|(index, pictures)| Some((index, pictures?))).filter(fits);
    let (foreign, own): (Vec<_>, Vec<_>) = pictures.partition(|(index, pictures)| is_of_other_side(*index, pictures));
    // Of those that fit equally well, one that is read.
    let best = |pictures: Vec<(usize, Pictures)>| {
        let best = pictures.into_iter().max_by_key(|(index, pictures)| {
            let (shared, is_raw) = fit(*index);
            (shared, pictures.is_read, is_raw, Reverse(*index))
        });
        best.map(|(index, _)| index)
    };
    let pictures = best(own);
    let foreign = best(foreign).filter(|_| pictures.is_none());
    let samples = samples.into_iter().max_by_key(|&index| (fit(index), Reverse(index)));
    Ok(Topics { pictures, samples, foreign })
}

/// The topic whose events are read.
struct Events {
    topic: usize,
    sensor: Option<Sensor>,
    /// Name of its coordinate frame.
    frame: String,
}

/// What the first picture of a topic shows of all.
struct Pictures {
    /// Width and height in pixels.
    size: (u32, u32),
    /// Whether their encoding is read.
    is_read: bool,
    /// Name of their coordinate frame.
    frame: String,
}

/// The side of a rig that the name of a topic or coordinate frame contains: the last of its words that is one, or a number of one digit.
fn side_of_rig(name: &str) -> Option<&str> {
    const SIDES: [&str; 12] =
        ["left", "right", "front", "rear", "back", "top", "bottom", "upper", "lower", "center", "master", "slave"];
    let words = name.split(|letter: char| !letter.is_ascii_alphanumeric());
    let side = |word: &'_ str| -> Option<(usize, usize)> {
        let letters = word.trim_end_matches(|letter: char| letter.is_ascii_digit());
        let digits = word.len() - letters.len();
        let is_number = digits == 1;
        let known = SIDES.iter().find(|side| letters.eq_ignore_ascii_case(side));
        known.map(|_| (0, letters.len())).or(is_number.then_some((letters.len(), word.len())))
    };
    words.filter_map(|word| side(word).and_then(|(from, to)| word.get(from..to))).next_back()
}

/// How many parts at their beginnings two names share.
fn shared(first: &str, second: &str) -> usize {
    let parts = |name| str::split(name, '/').filter(|part| !part.is_empty());
    parts(first).zip(parts(second)).take_while(|(first, second)| first == second).count()
}

/// Opens those of the file at `path`.
pub fn open(
    open: OpenContainer,
    path: &Path,
    options: &RecordingOptions,
) -> Result<Box<dyn ReadExtras>, RecordingError> {
    let mut container = open(path)?;
    let topics = choose(&mut *container, options.stream.as_deref(), options.damage)?;
    let description = |topic: Option<usize>| Some(container.topics().get(topic?)?.description());
    let names = [topics.pictures, topics.samples].map(description);
    let foreign = description(topics.foreign);
    let mut container = open(path)?;
    let mut lost = Vec::new();
    let (damage, mut skipped, mut unread) = (options.damage, Skipped::new(options.damage), UnreadFrames::default());
    let first = read_or_report(next(&mut *container, topics, damage, &mut skipped, &mut unread), BOTH, &mut lost);
    Ok(Box::new(MessageExtras { container, next: first, topics, names, foreign, lost, damage, skipped, unread }))
}

impl ReadExtras for MessageExtras {
    fn held(&self) -> OtherStreams {
        OtherStreams { frames: self.topics.pictures.is_some(), imu: self.topics.samples.is_some() }
    }

    fn first_time(&mut self) -> Option<i64> {
        self.next.as_ref().map(Extra::start)
    }

    fn next_until(&mut self, end: i64, lost: &mut Vec<String>) -> Option<Extra> {
        lost.append(&mut self.lost);
        if self.next.is_none() {
            self.skipped.report(lost);
            self.unread.report(lost);
        }
        let Self { container, topics, damage, skipped, unread, .. } = self;
        take_until(&mut self.next, end, lost, || next(&mut **container, *topics, *damage, skipped, unread))
    }

    fn reads(&self, stream: &str) -> bool {
        self.names.iter().flatten().any(|name| name == stream)
    }

    fn chosen(&self) -> Vec<String> {
        let sentence = |(what, name): (&str, &Option<String>)| Some(format!("{what} are those of {}", name.as_ref()?));
        let other = |name: &String| format!("{name} is not read: by its name it is of another camera than the events");
        let chosen = ["frames", "inertial samples"].into_iter().zip(&self.names).filter_map(sentence);
        chosen.chain(self.foreign.iter().map(other)).collect()
    }
}

/// Hands the pictures of the file at `path` to `visit`. The inner error ended them early.
pub fn visit_frames(
    open: OpenContainer,
    path: &Path,
    options: &RecordingOptions,
    visit: &mut dyn FnMut(TimedImage),
) -> Result<Result<(), RecordingError>, RecordingError> {
    let pictures = choose(&mut *open(path)?, options.stream.as_deref(), options.damage)?.pictures;
    let topics = Topics { pictures, ..Topics::default() };
    let (mut container, mut skipped, mut unread) = (open(path)?, Skipped::new(options.damage), UnreadFrames::default());
    Ok(loop {
        match next_or_unread(&mut *container, topics, options.damage, &mut skipped) {
            Ok(Some(Read::Extra(Extra::Frame(frame)))) => visit(frame.into()),
            Ok(Some(Read::Extra(Extra::Inertial(_)))) => {}
            Ok(Some(Read::Unread(frame))) => {
                visit((&frame).into());
                unread.add(frame);
            }
            Ok(None) => break unread.error(path).map_or(Ok(()), Err),
            Err(error) => break Err(error),
        }
    })
}
