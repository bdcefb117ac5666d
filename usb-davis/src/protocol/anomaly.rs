//! Faults of a stream. None of them stops the decoder.

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

            /// Returns a description of the fault.
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
    /// A word that the protocol does not define; it is skipped.
    UnknownWord: "unknown word",
    /// A timestamp below the previous one; it is used unchanged.
    TimeBackwards: "time went back",
    /// The source lost bytes here. Incomplete items are dropped.
    Gap: "bytes lost",
    /// An IMU sample ended with the wrong number of bytes, or its end is missing; it is dropped.
    ImuIncomplete: "IMU sample incomplete",
    /// A word of an IMU sample outside a sample; it is skipped.
    ImuStray: "word of an IMU sample outside a sample",
    /// The frame's exposure time or corners are incomplete. Without corners the frame is dropped.
    FrameHeaderIncomplete: "frame header incomplete",
    /// The frame reaches beyond the sensor; it is dropped.
    FrameOutOfRange: "frame region beyond the sensor",
    /// The frame has more pixels than the memory provided for it; it is dropped.
    FrameTooLarge: "frame larger than its memory",
    /// A frame ended with the wrong number of columns, or another frame began before it ended; it is dropped.
    FrameIncomplete: "frame with columns missing",
    /// The camera's clock restarted during a frame, whose times would belong to two clocks; the frame is dropped.
    FrameAcrossReset: "clock restarted within a frame",
    /// A word of a frame outside a frame, or a sample or end of a column outside a column; it is skipped.
    FrameStray: "word of a frame out of place",
    /// A column has too few samples. The frame is returned with a count of damaged columns.
    ColumnIncomplete: "frame column with samples missing",
    /// A column has too many samples, which are dropped. The frame is returned with a count of damaged columns.
    ColumnOverfull: "frame column with too many samples",
    /// The word that ends a column is missing. Harmless if its samples are complete.
    ColumnEndLost: "end of a frame column lost",
}

impl AnomalyKind {
    /// Number of kinds.
    pub const COUNT: usize = Self::ALL.len();
}

impl fmt::Display for AnomalyKind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.text())
    }
}

/// A fault with its position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Anomaly {
    /// Kind of fault.
    pub kind: AnomalyKind,
    /// Offset of the word in the payload, in bytes since the decoder was created.
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

/// Number of faults of each kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AnomalyCounts([u64; AnomalyKind::COUNT]);

impl Default for AnomalyCounts {
    fn default() -> Self {
        Self([0; AnomalyKind::COUNT])
    }
}

impl AnomalyCounts {
    /// Returns the number of faults of `kind`.
    pub fn of(&self, kind: AnomalyKind) -> u64 {
        self.0.get(kind as usize).copied().unwrap_or(0)
    }

    /// Returns the total number of faults.
    pub fn total(&self) -> u64 {
        self.0.iter().sum()
    }

    /// Returns the kinds that occurred, with their numbers.
    pub fn iter(&self) -> impl Iterator<Item = (AnomalyKind, u64)> + '_ {
        AnomalyKind::ALL.iter().copied().zip(self.0.iter().copied()).filter(|&(_, count)| count > 0)
    }

    pub(super) fn add(&mut self, kind: AnomalyKind) {
        if let Some(count) = self.0.get_mut(kind as usize) {
            *count += 1;
        }
    }
}
