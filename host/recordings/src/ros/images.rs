//! The images of one topic, from a camera that sends no events.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use evcal_core::sensor::Sensor;

use super::container::{MessageHead, OpenContainer, Topic};
use super::message::Kind;
use super::{folder, picture};
use crate::error::{RecordingError, RecordingErrorKind};
use crate::extras::Frame;
use crate::options::Damage;
use crate::pictures::TimedImage;

/// The images of one topic, all of one size.
#[derive(Clone, Debug)]
pub struct ImageTopic {
    path: PathBuf,
    open: OpenContainer,
    topic: String,
    sensor: Sensor,
    damage: Damage,
}

impl ImageTopic {
    /// Opens the images of the topic `wanted` of the file at `path`, or of the only image topic if the file has no
    /// events. `None` if the file does not contain messages, if `wanted` is a topic of events, or if no topic is wanted
    /// and the file has events or no images.
    ///
    /// # Errors
    /// When the file cannot be read, does not have the topic, has several image topics, or its first image cannot be
    /// read.
    pub fn open(path: &Path, wanted: Option<&str>, damage: Damage) -> Result<Option<Self>, RecordingError> {
        let Some(open) = folder::opener(path)? else { return Ok(None) };
        let refuse = |kind| Err(RecordingError::new(path, kind));
        let topics = topics(open, path, wanted, damage)?;
        let of_kind = |fits: fn(Kind) -> bool| topics.iter().filter(move |topic| fits(topic.kind));
        let events = || of_kind(Kind::contains_events);
        let images: Vec<&Topic> = of_kind(Kind::contains_images).collect();
        let list = |topics: Vec<&Topic>| topics.into_iter().map(Topic::description).collect::<Vec<_>>().join(", ");
        let topic = match wanted {
            Some(wanted) if events().any(|topic| topic.name == wanted) => return Ok(None),
            Some(wanted) => match images.iter().find(|topic| topic.name == wanted) {
                Some(topic) => topic,
                None => {
                    let available = list(events().chain(images).collect());
                    return refuse(RecordingErrorKind::NoSuchTopic { wanted: wanted.to_owned(), available });
                }
            },
            None if events().next().is_some() => return Ok(None),
            None => match *images {
                [] => return Ok(None),
                [ref topic] => topic,
                _ => return refuse(RecordingErrorKind::SeveralImageTopics(list(images))),
            },
        };
        let topic = topic.name.clone();
        let mut images = Self { path: path.to_owned(), open, topic, sensor: Sensor::new(0, 0), damage };
        let mut first = None;
        images.read(&mut |frame| {
            first.get_or_insert(frame.size);
            false
        })?;
        let Some((width, height)) = first.filter(|size| size.0 > 0 && size.1 > 0) else {
            return refuse(RecordingErrorKind::NoImages(images.topic));
        };
        images.sensor = Sensor::new(width, height);
        Ok(Some(images))
    }

    /// Path of the file and name of the topic.
    pub fn name(&self) -> String {
        format!("{}, {}", self.path.display(), self.topic)
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the files with the messages.
    pub fn files(&self) -> Vec<PathBuf> {
        match folder::is_bag(&self.path) {
            true => (folder::FORMAT.files)(&self.path),
            false => vec![self.path.clone()],
        }
    }

    /// Width and height of the images in pixels.
    pub fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Passes the images to `visit`, in order of time, with times in µs. Returns a sentence if the file is cut off.
    ///
    /// # Errors
    /// When a message is damaged, or an image has another size or an unsupported encoding, or is not later than the
    /// previous one.
    pub fn visit(&self, mut visit: impl FnMut(TimedImage)) -> Result<Option<String>, RecordingError> {
        let refuse = |kind| Err(RecordingError::new(&self.path, kind));
        let (mut count, mut before, mut wrong) = (0_u64, None, None);
        let note = self.read(&mut |frame| {
            count += 1;
            let topic = || self.topic.clone();
            if (frame.size.0, frame.size.1) != (self.sensor.width, self.sensor.height) {
                wrong = Some(RecordingErrorKind::ImageSize { topic: topic(), image: count, size: frame.size });
            }
            if let Some(before) = before.filter(|before| *before >= frame.t) {
                wrong = Some(RecordingErrorKind::ImageTime { topic: topic(), image: count, time: frame.t, before });
            }
            if wrong.is_none() {
                before = Some(frame.t);
                visit(frame.into());
            }
            wrong.is_none()
        })?;
        wrong.map_or(Ok(note), refuse)
    }

    /// Passes the images to `visit` until it returns `false`.
    fn read(&self, visit: &mut dyn FnMut(Frame) -> bool) -> Result<Option<String>, RecordingError> {
        let mut container = (self.open)(&self.path)?;
        while let Some(MessageHead { topic, byte, .. }) = container.next_readable(self.damage)? {
            let is_wanted = |topic: &&Topic| topic.kind.contains_images() && topic.name == self.topic;
            let Some(topic) = container.topics().get(topic).filter(is_wanted) else { continue };
            match picture::frame(topic.kind, topic.wire, container.message()) {
                Ok(Some(frame)) => {
                    if !visit(frame) {
                        return Ok(None);
                    }
                }
                Ok(None) => {
                    let described = picture::description(topic.kind, topic.wire, container.message());
                    let encoding = described.map(|described| described.encoding).unwrap_or_default();
                    let kind = RecordingErrorKind::ImageEncoding { topic: topic.name.clone(), encoding };
                    return Err(RecordingError::new(&self.path, kind));
                }
                Err(_) if self.damage == Damage::Skip => {}
                Err(error) => {
                    return Err(container.damaged(byte, format!("a message of {} is damaged: {error}", topic.name)));
                }
            }
        }
        let cut_off = |cut: &crate::Truncation| format!("{}: {}", self.name(), cut.lost);
        Ok(container.truncated().map(cut_off))
    }
}

/// Returns the topics of a file that have messages. Stops as soon as the `wanted` topic is found, or a topic of events
/// if none is wanted.
fn topics(
    open: OpenContainer,
    path: &Path,
    wanted: Option<&str>,
    damage: Damage,
) -> Result<Vec<Topic>, RecordingError> {
    let mut container = open(path)?;
    // Indices in order of the first messages.
    let (mut seen, mut known) = (Vec::new(), BTreeSet::new());
    while let Some(head) = container.next_readable(damage)? {
        if !known.insert(head.topic) {
            continue;
        }
        seen.push(head.topic);
        let enough = |topic: &Topic| match wanted {
            Some(wanted) => topic.name == wanted,
            None => topic.kind.contains_events(),
        };
        if container.topics().get(head.topic).is_some_and(enough) {
            break;
        }
    }
    Ok(seen.iter().filter_map(|topic| container.topics().get(*topic).cloned()).collect())
}
