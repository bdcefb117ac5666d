//! Reader of the fields of a message, one after the other.

/// Serialization of messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    /// ROS 1: fields without padding.
    Ros1,
    /// ROS 2: CDR. After four bytes of encapsulation, numbers are aligned to multiples of their size.
    Cdr,
}

/// Fault of a message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MessageError {
    /// The message is shorter than its fields require.
    #[error("the message ends within {0}")]
    TooShort(&'static str),
    /// The message is not in little-endian CDR.
    #[error("the message is not in little-endian CDR")]
    Encapsulation,
    /// The rows of an image are shorter than its width.
    #[error("the rows of the picture are too short for its width")]
    Rows,
    /// The JPEG or PNG of an image cannot be read.
    #[error("the picture is {0}")]
    Picture(String),
    /// The encoding of events is unknown.
    #[error("its events have an unknown encoding (known: evt3, libcaer, libcaer_cmp, mono)")]
    Encoding,
    /// The events are big-endian.
    #[error("the events are big-endian")]
    BigEndian,
}

/// Reader of fields from the front of a message.
pub struct Fields<'a> {
    rest: &'a [u8],
    /// Number of bytes read so far, for the alignment.
    position: usize,
    wire: Wire,
}

impl<'a> Fields<'a> {
    /// Starts at the beginning of a message.
    pub fn new(wire: Wire, message: &'a [u8]) -> Result<Self, MessageError> {
        let rest = match (wire, message) {
            (Wire::Ros1, message) => message,
            (Wire::Cdr, [0, 1, _, _, rest @ ..]) => rest,
            (Wire::Cdr, _) => return Err(MessageError::Encapsulation),
        };
        Ok(Self { rest, position: 0, wire })
    }

    fn take(&mut self, count: usize, what: &'static str) -> Result<&'a [u8], MessageError> {
        let (taken, rest) = self.rest.split_at_checked(count).ok_or(MessageError::TooShort(what))?;
        self.rest = rest;
        self.position += count;
        Ok(taken)
    }

    fn number<const N: usize>(&mut self, what: &'static str) -> Result<[u8; N], MessageError> {
        if self.wire == Wire::Cdr {
            self.take(self.position.next_multiple_of(N) - self.position, what)?;
        }
        self.take(N, what)?.try_into().map_err(|_| MessageError::TooShort(what))
    }

    pub fn u8(&mut self, what: &'static str) -> Result<u8, MessageError> {
        self.number(what).map(u8::from_le_bytes)
    }

    pub fn u16(&mut self, what: &'static str) -> Result<u16, MessageError> {
        self.number(what).map(u16::from_le_bytes)
    }

    pub fn u32(&mut self, what: &'static str) -> Result<u32, MessageError> {
        self.number(what).map(u32::from_le_bytes)
    }

    pub fn u64(&mut self, what: &'static str) -> Result<u64, MessageError> {
        self.number(what).map(u64::from_le_bytes)
    }

    pub fn f64(&mut self, what: &'static str) -> Result<f64, MessageError> {
        self.number(what).map(f64::from_le_bytes)
    }

    /// Reads a sequence of bytes, preceded by its length.
    pub fn bytes(&mut self, what: &'static str) -> Result<&'a [u8], MessageError> {
        let length = self.u32(what)?;
        self.take(usize::try_from(length).unwrap_or(usize::MAX), what)
    }

    /// Reads text, preceded by its length. In CDR it ends with a zero byte, which is removed.
    pub fn text(&mut self, what: &'static str) -> Result<&'a [u8], MessageError> {
        let text = self.bytes(what)?;
        Ok(match self.wire {
            Wire::Ros1 => text,
            Wire::Cdr => text.strip_suffix(&[0]).unwrap_or(text),
        })
    }

    /// Reads a time of seconds and nanoseconds. Returns it in µs.
    pub fn time(&mut self, what: &'static str) -> Result<i64, MessageError> {
        let seconds = self.u32(what)?;
        let seconds = match self.wire {
            Wire::Ros1 => i64::from(seconds),
            Wire::Cdr => i64::from(seconds.cast_signed()),
        };
        Ok(seconds * 1_000_000 + i64::from(self.u32(what)? / 1000))
    }

    /// Reads a message header. Returns its time in µs.
    pub fn header(&mut self) -> Result<i64, MessageError> {
        self.header_with_frame().map(|(time, _)| time)
    }

    /// Reads a message header. Returns its time in µs and the name of the coordinate frame.
    pub fn header_with_frame(&mut self) -> Result<(i64, &'a [u8]), MessageError> {
        if self.wire == Wire::Ros1 {
            self.u32("the header")?;
        }
        Ok((self.time("the header")?, self.text("the header")?))
    }

    /// The part that has not been read.
    pub fn rest(&self) -> &'a [u8] {
        self.rest
    }
}
