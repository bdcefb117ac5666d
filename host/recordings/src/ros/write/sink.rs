//! The interface of a file of messages that is being written.

use crate::encode::WriteError;

/// A file of messages that is being written.
pub trait Sink {
    /// Appends a message of a topic (an index in the list of topics) with its time in µs.
    fn message(&mut self, topic: usize, t: i64, message: &[u8]) -> Result<(), WriteError>;

    /// Completes the file.
    fn finish(&mut self) -> Result<(), WriteError>;
}

/// Definition of a topic.
pub struct TopicDefinition {
    /// Name of the topic.
    pub name: &'static str,
    /// Type of its messages.
    pub type_name: &'static str,
    /// Fields of its messages, and of the types that occur in them.
    pub definition: &'static str,
    /// MD5 of the definition as ROS 1 computes it; empty for ROS 2.
    pub md5: &'static str,
}

/// Size in bytes from which a chunk is written.
pub const CHUNK_BYTES: usize = 768 * 1024;
