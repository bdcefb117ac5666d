//! What can be wrong with a stream. Nothing of it stops the decoder.

use core::fmt;

macro_rules! anomalies {
    ($($(#[doc = $documentation:literal])* $kind:ident: $text:literal,)*) => {
        /// A kind of fault.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[non_exhaustive]
        pub enum AnomalyKind {
            $($(#[doc = $documentation])* $kind,)*
        }

        impl AnomalyKind {
            /// All kinds, in the order of their numbers.
            pub const ALL: &'static [Self] = &[$(Self::$kind),*];

            /// What happened, in words.
            pub const fn text(self) -> &'static str {
                match self {
                    $(Self::$kind => $text,)*
                }
            }
        }
    };
}

anomalies! {
    /// A row address beyond the array. The columns that follow are dropped until the next row.
    RowOutOfRange: "row address beyond the sensor",
    /// A column address beyond the array; the event is dropped.
    ColumnOutOfRange: "column address beyond the sensor",
    /// A column address before any good row address; the event is dropped.
    ColumnWithoutRow: "column address without a row",
    /// A word without meaning; it is skipped.
    UnknownWord: "word without meaning",
    /// A timestamp below the one before. Taken as it is.
    TimeBackwards: "time went back",
    /// The source lost bytes here. Whatever was in progress is dropped.
    Gap: "bytes lost",
    /// An inertial sample ended with the wrong number of bytes, or none ended it; it is dropped.
    ImuIncomplete: "inertial sample incomplete",
    /// A word of an inertial sample outside of one; it is skipped.
    ImuStray: "word of an inertial sample outside of one",
    /// The frame's exposure time or corners are incomplete. Without corners the frame is dropped.
    FrameHeaderIncomplete: "frame header incomplete",
    /// The frame reaches beyond the sensor; it is dropped.
    FrameOutOfRange: "frame region beyond the sensor",
    /// The frame has more pixels than the memory lent for it; it is dropped.
    FrameTooLarge: "frame larger than its memory",
    /// A frame ended with the wrong number of columns, or another began before it ended; dropped.
    FrameIncomplete: "frame with columns missing",
    /// The camera's clock restarted within a frame, whose times would be of two clocks; it is dropped.
    FrameAcrossReset: "clock restarted within a frame",
    /// A word of a frame outside of one, or a sample or the end of a column outside of a column; it is
    /// skipped.
    FrameStray: "word of a frame out of place",
    /// A column has too few samples. The frame is delivered and says so.
    ColumnIncomplete: "frame column with samples missing",
    /// A column has too many samples; those are dropped. The frame is delivered and says so.
    ColumnOverfull: "frame column with too many samples",
    /// The word that ends a column is missing. Harmless if its samples are complete.
    ColumnEndLost: "end of a frame column lost",
}

impl AnomalyKind {
    /// How many kinds there are.
    pub const COUNT: usize = Self::ALL.len();
}

impl fmt::Display for AnomalyKind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.text())
    }
}

/// One fault and where it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Anomaly {
    /// What happened.
    pub kind: AnomalyKind,
    /// Offset of the word in the payload, in bytes since the decoder was made.
    pub offset: u64,
    /// The word, 0 for [`AnomalyKind::Gap`].
    pub word: u16,
    /// Time of the stream in µs.
    pub time: u64,
}

impl fmt::Display for Anomaly {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} at byte {} (word {:#06x}, {} µs)", self.kind, self.offset, self.word, self.time)
    }
}

/// How often each kind happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AnomalyCounts([u64; AnomalyKind::COUNT]);

impl Default for AnomalyCounts {
    fn default() -> Self {
        Self([0; AnomalyKind::COUNT])
    }
}

impl AnomalyCounts {
    /// How often `kind` happened.
    pub fn of(&self, kind: AnomalyKind) -> u64 {
        self.0.get(kind as usize).copied().unwrap_or(0)
    }

    /// All of them together.
    pub fn total(&self) -> u64 {
        self.0.iter().sum()
    }

    /// Kinds that happened at all, with how often.
    pub fn iter(&self) -> impl Iterator<Item = (AnomalyKind, u64)> + '_ {
        AnomalyKind::ALL.iter().copied().zip(self.0.iter().copied()).filter(|&(_, count)| count > 0)
    }

    pub(super) fn add(&mut self, kind: AnomalyKind) {
        if let Some(count) = self.0.get_mut(kind as usize) {
            *count += 1;
        }
    }
}
