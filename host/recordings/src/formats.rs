//! The supported formats, and detection of the format of a file or folder.

use std::path::Path;

use crate::error::{RecordingError, RecordingErrorKind};
use crate::format::{FileFormat, Head};
#[cfg(feature = "hdf5")]
use crate::hdf5;
use crate::options::RecordingOptions;
use crate::{
    aedat2, aedat3, aedat4, davis, event_calib, event_stream, numpy, prophesee, ros, text, unsupported_format,
};

/// Supported formats, in the order in which they are tried.
pub const FORMATS: &[&FileFormat] = &[
    &aedat4::FORMAT,
    &aedat2::FORMAT,
    &aedat3::FORMAT,
    &davis::FORMAT,
    &prophesee::DAT_FORMAT,
    &prophesee::RAW_FORMAT,
    &ros::BAG_FORMAT,
    &ros::MCAP_FORMAT,
    &ros::DB3_FORMAT,
    &event_stream::FORMAT,
    #[cfg(feature = "hdf5")]
    &hdf5::FORMAT,
    &numpy::ARRAY_FORMAT,
    &numpy::ARCHIVE_FORMAT,
    &text::FORMAT,
    &event_calib::FORMAT,
    &davis::BARE_FORMAT,
];

fn find_format(path: &Path, head: &Head) -> Result<&'static FileFormat, RecordingError> {
    if head.bytes.is_empty() {
        return Err(RecordingError::new(path, RecordingErrorKind::Empty));
    }
    if let Some(format) = unsupported_format::recognise(&head.bytes) {
        return Err(RecordingError::new(path, RecordingErrorKind::Unsupported(format)));
    }
    FORMATS.iter().find(|format| (format.recognise)(head)).copied().ok_or_else(|| {
        let known = FORMATS.iter().map(|format| format.name).collect();
        RecordingError::new(path, RecordingErrorKind::UnknownFormat { known })
    })
}

/// Returns the format of the folder at `path`, if it is a recording.
pub(crate) fn folder_format(path: &Path) -> Option<&'static FileFormat> {
    if ros::is_folder(path) {
        Some(&ros::FOLDER_FORMAT)
    } else if numpy::is_folder(path) {
        Some(&numpy::FOLDER_FORMAT)
    } else {
        None
    }
}

/// Detects the format of the file or folder at `path` from its content.
///
/// # Errors
/// When it cannot be read, is empty, or has an unknown format.
pub fn format_of(path: &Path) -> Result<&'static FileFormat, RecordingError> {
    if let Some(format) = folder_format(path) {
        return Ok(format);
    }
    let head = Head::read(path)?;
    find_format(path, &head)
}

/// Adapts `options` that were given for another recording to the one at `path`: removes the options that do not apply
/// to its format.
pub fn options_for(path: &Path, options: &RecordingOptions) -> RecordingOptions {
    format_of(path).map_or_else(|_| options.clone(), |format| format.uses.of(options))
}
