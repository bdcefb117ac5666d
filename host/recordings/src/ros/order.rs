//! Messages in order of their times of recording.
//!
//! The three containers allow messages in any order, and other readers return them by time. An index determines the
//! order in which chunks are read; messages of chunks that overlap in time, or of a file without an index, are sorted
//! within a limited number of bytes. If the clock of the recorder was set back meanwhile, the stamps in the messages are in
//! the order of the file, and so are the messages.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use super::container::{Container, MessageHead, Topic};
use super::fields::Fields;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::read_report::Truncation;

/// Size limit in bytes of the messages that are sorted together.
const MOST_BYTES: usize = 1 << 26;
/// Smallest size in bytes with which a message is counted, because there may be very many empty ones.
const LEAST_OF_A_MESSAGE: usize = 256;
/// Largest number of messages whose stamps are compared with their times.
const MOST_STAMPS: usize = 1 << 20;

/// A chunk according to the index of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct IndexedChunk {
    /// Time of its first message.
    pub start: i64,
    /// Offset in the file.
    pub byte: u64,
}

/// The chunks of a file in order of time.
#[derive(Debug, Default)]
pub struct ChunkOrder {
    chunks: Vec<IndexedChunk>,
    /// `true` if this is not the order of the file.
    is_moved: bool,
    /// `true` if messages keep the order of the file, whatever their times.
    is_of_file: bool,
    next: usize,
}

impl ChunkOrder {
    /// Sorts the chunks of an index. Without an index, `chunks` is empty.
    pub fn new(mut chunks: Vec<IndexedChunk>) -> Self {
        chunks.sort_unstable();
        let is_moved = !chunks.is_sorted_by_key(|chunk| chunk.byte);
        Self { chunks, is_moved, ..Self::default() }
    }

    /// `true` if chunks must be read in another order than that of the file.
    pub fn is_moved(&self) -> bool {
        self.is_moved
    }

    /// `true` if messages keep the order of the file.
    pub fn is_of_file(&self) -> bool {
        self.is_of_file
    }

    /// Offset of the next chunk, if the order is not that of the file. The inner value is `None` at the end.
    pub fn next(&mut self) -> Option<Option<u64>> {
        self.is_moved.then(|| {
            let chunk = self.chunks.get(self.next).map(|chunk| chunk.byte);
            self.next += 1;
            chunk
        })
    }

    /// `true` if no message of a later chunk is earlier than any of the chunk at `byte`, whose messages have these
    /// `times`, and if these are in order.
    pub fn is_settled(&mut self, byte: u64, times: impl Iterator<Item = i64>) -> bool {
        if self.is_of_file {
            return true;
        }
        let mut last = i64::MIN;
        for time in times {
            if time < last {
                return false;
            }
            last = time;
        }
        if !self.is_moved {
            // Chunks that the index does not list are never settled.
            self.next = self.chunks.partition_point(|chunk| chunk.byte <= byte);
        }
        let is_listed =
            self.next.checked_sub(1).and_then(|index| self.chunks.get(index)).is_some_and(|it| it.byte == byte);
        is_listed && self.chunks.get(self.next).is_none_or(|chunk| last <= chunk.start)
    }
}

/// Returns the chunks of a file from the times of their messages, because an index may be damaged. A chunk that cannot be
/// read gets the time before it, so that it is reported later. `None` if the file is cut off.
pub fn scan(container: &mut impl Container) -> Option<ChunkOrder> {
    let (mut starts, mut latest) = (BTreeMap::new(), i64::MIN);
    let mut stamped: Vec<Stamped> = Vec::new();
    loop {
        match container.next() {
            Ok(Some(MessageHead { byte, time, topic, .. })) => {
                let of_events = container.topics().get(topic).filter(|topic| topic.kind.contains_events());
                let header =
                    of_events.map(|topic| Fields::new(topic.wire, container.message()).and_then(|mut it| it.header()));
                if let Some(Ok(stamp)) = header.filter(|_| stamped.len() < MOST_STAMPS) {
                    stamped.push(Stamped { time, stamp, topic });
                }
                latest = time;
                let start = starts.entry(byte).or_insert(time);
                *start = time.min(*start);
            }
            Ok(None) => break,
            Err(RecordingError { kind: RecordingErrorKind::Damaged { byte, .. }, .. }) => {
                starts.entry(byte).or_insert(latest);
            }
            Err(_) => return None,
        }
    }
    let chunks = starts.into_iter().map(|(byte, start)| IndexedChunk { start, byte }).collect();
    let order = if is_of_file(stamped) {
        ChunkOrder { is_of_file: true, ..ChunkOrder::default() }
    } else {
        ChunkOrder::new(chunks)
    };
    container.truncated().is_none().then_some(order)
}

/// Time of recording and stamp of a message with events.
#[derive(Clone, Copy)]
struct Stamped {
    time: i64,
    stamp: i64,
    topic: usize,
}

/// Returns `true` if the stamps of messages, given in the order of the file, step back less often in it than in the order of
/// their times.
fn is_of_file(mut stamped: Vec<Stamped>) -> bool {
    let back = |stamped: &[Stamped]| {
        let mut last: BTreeMap<usize, i64> = BTreeMap::new();
        let steps_back = |one: &&Stamped| last.insert(one.topic, one.stamp).is_some_and(|last| one.stamp < last);
        stamped.iter().filter(steps_back).count()
    };
    let of_file = back(&stamped);
    stamped.sort_by_key(|one| one.time);
    of_file < back(&stamped)
}

/// A message that is kept until no earlier one can follow.
struct Kept {
    head: MessageHead,
    content: Vec<u8>,
}

/// The messages of a file in order of time.
pub struct Ordered<C> {
    container: C,
    /// Kept messages by time and number, the earliest first.
    order: BinaryHeap<Reverse<(i64, u64, usize)>>,
    kept: Vec<Option<Kept>>,
    free: Vec<usize>,
    bytes: usize,
    count: u64,
    /// Time up to which the kept messages can be returned.
    settled: i64,
    /// A message of the container that precedes all kept ones that are not settled, and an error after them.
    waiting: Option<MessageHead>,
    error: Option<RecordingError>,
    ended: bool,
    /// The message that was returned last, if it was kept.
    message: Option<Vec<u8>>,
}

impl<C: Container> Ordered<C> {
    /// Starts at the first message of `container`.
    pub fn new(container: C) -> Self {
        Self {
            container,
            order: BinaryHeap::new(),
            kept: Vec::new(),
            free: Vec::new(),
            bytes: 0,
            count: 0,
            settled: i64::MIN,
            waiting: None,
            error: None,
            ended: false,
            message: None,
        }
    }

    fn keep(&mut self, head: MessageHead) {
        let content = self.container.message().to_vec();
        self.bytes += content.len().max(LEAST_OF_A_MESSAGE);
        let time = head.time;
        let kept = Some(Kept { head, content });
        let place = match self.free.pop() {
            Some(place) => {
                if let Some(slot) = self.kept.get_mut(place) {
                    *slot = kept;
                }
                place
            }
            None => {
                self.kept.push(kept);
                self.kept.len() - 1
            }
        };
        self.order.push(Reverse((time, self.count, place)));
        self.count += 1;
    }

    /// Returns the earliest of the kept messages, if no earlier one can follow.
    fn take_kept(&mut self) -> Option<MessageHead> {
        let Reverse((time, _, place)) = *self.order.peek()?;
        let is_due = time <= self.settled || self.bytes > MOST_BYTES || self.ended || self.error.is_some();
        if !is_due {
            return None;
        }
        self.order.pop();
        let Kept { head, content } = self.kept.get_mut(place)?.take()?;
        self.free.push(place);
        self.bytes -= content.len().max(LEAST_OF_A_MESSAGE);
        self.message = Some(content);
        Some(head)
    }
}

impl<C: Container> Container for Ordered<C> {
    fn next(&mut self) -> Result<Option<MessageHead>, RecordingError> {
        self.message = None;
        loop {
            if let Some(head) = self.take_kept() {
                return Ok(Some(head));
            }
            if let Some(error) = self.error.take() {
                return Err(error);
            }
            if let Some(head) = self.waiting.take() {
                return Ok(Some(head));
            }
            if self.ended {
                return Ok(None);
            }
            match self.container.next() {
                // A message that is too large to be kept stays in its place in the file.
                Ok(Some(head)) if head.is_settled || self.container.message().len() > MOST_BYTES => {
                    self.settled = self.settled.max(head.time);
                    self.waiting = Some(head);
                }
                Ok(Some(head)) => self.keep(head),
                Ok(None) => self.ended = true,
                Err(error) => self.error = Some(error),
            }
        }
    }

    fn message(&self) -> &[u8] {
        self.message.as_deref().unwrap_or_else(|| self.container.message())
    }

    fn topics(&self) -> &[Topic] {
        self.container.topics()
    }

    fn done(&self) -> f64 {
        self.container.done()
    }

    fn truncated(&self) -> Option<&Truncation> {
        // Kept messages precede the end.
        let is_end = self.order.is_empty() && self.error.is_none();
        self.container.truncated().filter(|_| is_end)
    }

    fn listed(&mut self) -> Option<Vec<Topic>> {
        self.container.listed()
    }

    fn doubt(&self) -> Option<String> {
        self.container.doubt()
    }

    fn damaged(&self, byte: u64, what: String) -> RecordingError {
        self.container.damaged(byte, what)
    }
}
