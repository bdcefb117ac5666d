//! Pictures and inertial samples of the camera whose events are read.
//!
//! A bag may hold several cameras and units. The topics that go with the events are those whose names share most of their
//! beginning with that of the events: `/davis/left/image_raw` and `/davis/left/imu` go with `/davis/left/events`. A picture is of another
//! camera if it is larger than the sensor, or smaller and its name shares nothing with that of the events, or if it is one of distances.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use evcal_core::sensor::Sensor;

use super::container::{Container, OpenContainer, is_skipped};
use super::message::{self, Kind};
use super::picture;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::extras::{BOTH, Extra, OtherStreams, ReadExtras, Skipped, take_until, told};
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
}

/// Those of a file of messages.
struct MessageExtras {
    container: Box<dyn Container>,
    next: Option<Extra>,
    topics: Topics,
    /// As [`super::container::Topic::description`] has them, of pictures and of samples.
    names: [Option<String>; 2],
    /// Why the first could not be read.
    lost: Vec<String>,
    damage: Damage,
    skipped: Skipped,
}

/// The next picture or sample of `topics` that can be read. What is passed over where no message can be found in it, the reader of
/// the events counts.
fn next(
    container: &mut dyn Container,
    topics: Topics,
    damage: Damage,
    skipped: &mut Skipped,
) -> Result<Option<Extra>, RecordingError> {
    loop {
        let head = match container.next() {
            Ok(Some(head)) => head,
            Ok(None) => return Ok(None),
            Err(error) if is_skipped(&error, damage) => continue,
            Err(error) => return Err(error),
        };
        let Some(topic) = container.topics().get(head.topic) else { continue };
        let read = if topics.pictures == Some(head.topic) {
            let frame = picture::frame(topic.kind, topic.wire, container.message());
            frame.map(|frame| frame.map(Extra::Frame))
        } else if topics.samples == Some(head.topic) {
            let sample = message::inertial_sample(topic.wire, container.message());
            sample.map(|sample| Some(Extra::Inertial(sample)))
        } else {
            Ok(None)
        };
        match read {
            Ok(Some(extra)) => return Ok(Some(extra)),
            Ok(None) => {}
            Err(error) => {
                let what = format!("a message of {} is damaged: {error}", topic.name);
                skipped.add(container.damaged(head.byte, what))?;
            }
        }
    }
}

/// The topics that go with the events of the topic `wanted`, or of the first one that has any.
fn choose(container: &mut dyn Container, wanted: Option<&str>, damage: Damage) -> Result<Topics, RecordingError> {
    let mut events: Option<(usize, Option<Sensor>)> = None;
    // Topics with the size of a picture of each, where it may be of the camera of the events.
    let mut pictures: BTreeMap<usize, Option<(u16, u16)>> = BTreeMap::new();
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
                events = described.map(|described| (head.topic, described.sensor));
            }
            Kind::Image if !pictures.contains_key(&head.topic) => {
                let encoding = picture::encoding(topic.kind, topic.wire, message).unwrap_or_default();
                // A damaged one tells nothing of its topic.
                let Ok(frame) = picture::frame(topic.kind, topic.wire, message) else { continue };
                let frame = frame.filter(|_| !picture::may_be_distances(&encoding));
                pictures.insert(head.topic, frame.map(|frame| frame.size));
            }
            Kind::Imu => _ = samples.insert(head.topic),
            _ => {}
        }
    }
    let topics = container.topics();
    let name = |index: usize| topics.get(index).map_or("", |topic| topic.name.as_str());
    let beside = events.map_or("", |(topic, _)| name(topic));
    // The first of those that fit equally well.
    let best = |candidates: &mut dyn Iterator<Item = usize>| {
        let fit = |index: usize| (shared(beside, name(index)), name(index).contains("image_raw"));
        candidates.max_by_key(|&index| (fit(index), Reverse(index)))
    };
    let sensor = events.and_then(|(_, sensor)| sensor);
    let fits = |(index, picture): (usize, Option<(u16, u16)>)| {
        let (width, height) = picture?;
        let is_whole = sensor.is_some_and(|sensor| (width, height) == (sensor.width, sensor.height));
        let fits = sensor.is_none_or(|sensor| width <= sensor.width && height <= sensor.height);
        let is_beside = events.is_none() || shared(beside, name(index)) > 0;
        (is_whole || fits && is_beside).then_some(index)
    };
    Ok(Topics { pictures: best(&mut pictures.into_iter().filter_map(fits)), samples: best(&mut samples.into_iter()) })
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
    let mut container = open(path)?;
    let mut lost = Vec::new();
    let (damage, mut skipped) = (options.damage, Skipped::new(options.damage));
    let first = told(next(&mut *container, topics, damage, &mut skipped), BOTH, &mut lost);
    Ok(Box::new(MessageExtras { container, next: first, topics, names, lost, damage, skipped }))
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
            self.skipped.tell(lost);
        }
        let Self { container, topics, damage, skipped, .. } = self;
        take_until(&mut self.next, end, lost, || next(&mut **container, *topics, *damage, skipped))
    }

    fn reads(&self, stream: &str) -> bool {
        self.names.iter().flatten().any(|name| name == stream)
    }

    fn chosen(&self) -> Vec<String> {
        let sentence = |(what, name): (&str, &Option<String>)| Some(format!("{what} are those of {}", name.as_ref()?));
        ["frames", "inertial samples"].into_iter().zip(&self.names).filter_map(sentence).collect()
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
    let topics = Topics { pictures, samples: None };
    let (mut container, mut skipped) = (open(path)?, Skipped::new(options.damage));
    Ok(loop {
        match next(&mut *container, topics, options.damage, &mut skipped) {
            Ok(Some(Extra::Frame(frame))) => visit(frame.into()),
            Ok(Some(Extra::Inertial(_))) => {}
            Ok(None) => break Ok(()),
            Err(error) => break Err(error),
        }
    })
}
