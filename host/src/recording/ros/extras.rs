//! Pictures and inertial samples of the first topic of each kind.

use std::path::Path;

use super::container::{Container, OpenContainer};
use super::message::{self, Kind};
use super::picture;
use crate::recording::extras::{Extra, OtherStreams, ReadExtras, take_until};
use crate::recording::pictures::TimedImage;
use crate::recording::{RecordingError, RecordingErrorKind};

/// Those of a file of messages.
struct MessageExtras {
    container: Box<dyn Container>,
    next: Option<Extra>,
    /// The topics that are read: of pictures, and of samples.
    topics: [Option<usize>; 2],
    held: OtherStreams,
    /// As [`super::container::Topic::description`] has them.
    names: Vec<String>,
}

/// The next picture or sample. Topics are chosen as they come.
fn next(container: &mut dyn Container, topics: &mut [Option<usize>; 2]) -> Result<Option<Extra>, RecordingError> {
    while let Some(head) = container.next()? {
        let Some(topic) = container.topics().get(head.topic) else { continue };
        let damaged = |error: super::fields::MessageError| {
            container.damaged(head.byte, format!("a message of {} is damaged: {error}", topic.name))
        };
        let [pictures, samples] = topics;
        match topic.kind {
            Kind::Image if *pictures.get_or_insert(head.topic) == head.topic => {
                if let Some(frame) = picture::frame(topic.kind, topic.wire, container.message()).map_err(damaged)? {
                    return Ok(Some(Extra::Frame(frame)));
                }
            }
            Kind::Imu if *samples.get_or_insert(head.topic) == head.topic => {
                let sample = message::inertial_sample(topic.wire, container.message()).map_err(damaged)?;
                return Ok(Some(Extra::Inertial(sample)));
            }
            _ => {}
        }
    }
    Ok(None)
}

/// Opens those of the file at `path`.
pub fn open(open: OpenContainer, path: &Path) -> Result<Box<dyn ReadExtras>, RecordingError> {
    let mut container = open(path)?;
    let mut topics = [None; 2];
    let mut held = OtherStreams::default();
    while !(held.frames && held.imu) {
        match next(&mut *container, &mut topics) {
            Ok(Some(Extra::Frame(_))) => held.frames = true,
            Ok(Some(Extra::Inertial(_))) => held.imu = true,
            // Damage is reported when its turn comes.
            Ok(None) | Err(RecordingError { kind: RecordingErrorKind::Damaged { .. }, .. }) => break,
            Err(error) => return Err(error),
        }
    }
    let names = topics.iter().flatten().filter_map(|topic| Some(container.topics().get(*topic)?.description()));
    let names = names.collect();
    let mut container = open(path)?;
    let mut topics = [None; 2];
    let first = next(&mut *container, &mut topics).unwrap_or_default();
    Ok(Box::new(MessageExtras { container, next: first, topics, held, names }))
}

impl ReadExtras for MessageExtras {
    fn held(&self) -> OtherStreams {
        self.held
    }

    fn first_time(&mut self) -> Option<i64> {
        self.next.as_ref().map(Extra::start)
    }

    fn next_until(&mut self, end: i64, lost: &mut Vec<String>) -> Option<Extra> {
        take_until(&mut self.next, end, lost, || next(&mut *self.container, &mut self.topics))
    }

    fn reads(&self, stream: &str) -> bool {
        self.names.iter().any(|name| name == stream)
    }
}

/// Hands the pictures of the file at `path` to `visit`. The inner error ended them early.
pub fn visit_frames(
    open: OpenContainer,
    path: &Path,
    visit: &mut dyn FnMut(TimedImage),
) -> Result<Result<(), RecordingError>, RecordingError> {
    let mut container = open(path)?;
    let mut topics = [None; 2];
    Ok(loop {
        match next(&mut *container, &mut topics) {
            Ok(Some(Extra::Frame(frame))) => visit(frame.into()),
            Ok(Some(Extra::Inertial(_))) => {}
            Ok(None) => break Ok(()),
            Err(error) => break Err(error),
        }
    })
}
