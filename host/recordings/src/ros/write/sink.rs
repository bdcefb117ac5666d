//! Where written messages go.

use crate::encode::WriteError;

/// A file of messages that is being written.
pub trait Sink {
    /// Appends a message of a topic (its place in the list of topics) with its time in µs.
    fn message(&mut self, topic: usize, t: i64, message: &[u8]) -> Result<(), WriteError>;

    /// Writes whatever closes the file.
    fn finish(&mut self) -> Result<(), WriteError>;
}

/// What a topic is called and holds.
pub struct TopicDefinition {
    /// Its name.
    pub name: &'static str,
    /// The type of its messages.
    pub type_name: &'static str,
    /// The fields of its messages and of the types that they consist of.
    pub definition: &'static str,
    /// MD5 of the definition as ROS 1 computes it; empty for ROS 2.
    pub md5: &'static str,
}

/// A chunk is written when it has this many bytes.
pub const CHUNK_BYTES: usize = 768 * 1024;
