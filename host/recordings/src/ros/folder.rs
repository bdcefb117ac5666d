//! Folders written by `ros2 bag record`: `metadata.yaml`, and the messages in one file or, if the recording was split,
//! in several consecutive files.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use yaml_rust2::Yaml;

use super::bag::Bag;
use super::container::{Container, MessageHead, OpenContainer, Topic};
use super::mcap::Mcap;
use super::{BAG_FORMAT, DB3_FORMAT, MCAP_FORMAT, chunked, db3, events, extras};
use crate::error::{RecordingError, RecordingErrorKind};
use crate::format::{FileFormat, Head, Uses};
use crate::read_report::Truncation;
use crate::unsupported_format;
use evcal_files::{visible, yaml};

/// Folder of a ROS 2 bag. It is recognised by the files in it.
pub const FORMAT: FileFormat = FileFormat {
    files: |path| std::iter::once(path.join(METADATA)).chain(files(path).unwrap_or_default()).collect(),
    streams: |path, options| events::summarise(open, path, options),
    frames: Some(|path, options| extras::frames(open, path, options)),
    extras: Some(|path, options| extras::open(open, path, options)),
    uses: Uses { stream: true, ..Uses::NONE },
    ..FileFormat::of_events("ROS 2 bag", |_| false, |path, options| events::open(FORMAT.name, open, path, options))
};

const METADATA: &str = "metadata.yaml";
/// Size limit of the metadata in bytes. Each topic and each file needs some hundred bytes.
const LONGEST_METADATA: usize = 1 << 20;

/// `true` if `path` is the folder of a bag.
pub fn is_bag(path: &Path) -> bool {
    path.join(METADATA).is_file()
}

/// Returns the folder of a bag if `path` is its metadata, which users name because it is the only file that they can read.
pub fn folder_of(path: &Path) -> Option<PathBuf> {
    let folder = path.parent().filter(|_| path.file_name().is_some_and(|name| name == METADATA))?;
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    files(folder).is_ok().then(|| folder.to_owned())
}

/// Returns the function that opens the messages at `path`, a file or folder; `None` if it is of another kind.
///
/// # Errors
/// When it cannot be read.
pub fn opener(path: &Path) -> Result<Option<OpenContainer>, RecordingError> {
    if is_bag(path) {
        return Ok(Some(open));
    }
    if path.is_dir() { Ok(None) } else { file_opener(path) }
}

fn file_opener(path: &Path) -> Result<Option<OpenContainer>, RecordingError> {
    const FILES: [(&FileFormat, OpenContainer); 3] =
        [(&BAG_FORMAT, chunked::open::<Bag>), (&MCAP_FORMAT, chunked::open::<Mcap>), (&DB3_FORMAT, db3::open)];
    let head = Head::read(path)?;
    Ok(FILES.into_iter().find(|(format, _)| (format.recognise)(&head)).map(|(_, open)| open))
}

/// Opens the files of the folder, one after the other.
fn open(path: &Path) -> Result<Box<dyn Container>, RecordingError> {
    let mut files: VecDeque<PathBuf> = files(path)?.into();
    let count = files.len();
    let first = files.pop_front().unwrap_or_default();
    let now = open_file(&first)?;
    let (topics, known, indices) = (Vec::new(), BTreeMap::new(), Vec::new());
    Ok(Box::new(Folder { files, count, path: first, now, topics, known, indices, truncated: None }))
}

/// Opens a file of the folder. A folder is not accepted here, because it could contain itself.
fn open_file(path: &Path) -> Result<Box<dyn Container>, RecordingError> {
    match file_opener(path)? {
        Some(open) => open(path),
        None => {
            let another =
                || RecordingErrorKind::NoEventStream("content in a format other than those of bags".to_owned());
            let kind = unsupported_format::recognise(&Head::read(path)?.bytes)
                .map_or_else(another, RecordingErrorKind::Unsupported);
            Err(RecordingError::new(path, kind))
        }
    }
}

/// Returns the files that the folder's metadata names, in their order; at least one.
fn files(folder: &Path) -> Result<Vec<PathBuf>, RecordingError> {
    let path = folder.join(METADATA);
    let damaged = |what| RecordingError::new(&path, RecordingErrorKind::BagMetadata(what));
    let mut text = Vec::new();
    let read = File::open(&path).and_then(|file| file.take(LONGEST_METADATA as u64 + 1).read_to_end(&mut text));
    read.map_err(|error| RecordingError::io(&path, error))?;
    let documents =
        yaml::load(&String::from_utf8_lossy(&text), LONGEST_METADATA).map_err(|error| damaged(error.to_string()))?;
    let names = documents.first().map(|all| &all["rosbag2_bagfile_information"]["relative_file_paths"]);
    let names = names.and_then(Yaml::as_vec).into_iter().flatten().filter_map(Yaml::as_str);
    let locate = |name: &str| {
        let path = folder.join(name);
        // Some versions prepend the name of the folder.
        let inside = Path::new(name).file_name().map(|name| folder.join(name));
        let path = inside.filter(|inside| !path.exists() && inside.exists()).unwrap_or(path);
        // A file that was compressed as a whole may have been decompressed.
        let unpacked = path.to_str().and_then(|path| path.strip_suffix(".zstd")).map(PathBuf::from);
        unpacked.filter(|unpacked| unpacked.exists()).unwrap_or(path)
    };
    let files: Vec<PathBuf> = names.map(locate).collect();
    if files.is_empty() {
        return Err(damaged("it lists no files under relative_file_paths".to_owned()));
    }
    let mut seen = BTreeSet::new();
    if let Some(twice) = files.iter().find(|file| !seen.insert(file.file_name())) {
        return Err(damaged(format!("it lists {} twice under relative_file_paths", visible::path(twice))));
    }
    Ok(files)
}

struct Folder {
    /// The files that follow, and the number of all files.
    files: VecDeque<PathBuf>,
    count: usize,
    /// Path of the current file.
    path: PathBuf,
    now: Box<dyn Container>,
    /// Topics of all files so far, their indices by name and type, and the indices of the current file's topics.
    topics: Vec<Topic>,
    known: BTreeMap<(String, String), usize>,
    indices: Vec<usize>,
    /// End of the first file that ends too early.
    truncated: Option<Truncation>,
}

impl Folder {
    /// Converts the index of a topic in the current file to its index among all topics.
    fn index_of(&mut self, topic: usize) -> usize {
        for topic in self.now.topics().get(self.indices.len()..).unwrap_or_default() {
            let name = (topic.name.clone(), topic.type_name.clone());
            let index = *self.known.entry(name).or_insert(self.topics.len());
            if index == self.topics.len() {
                self.topics.push(topic.clone());
            }
            self.indices.push(index);
        }
        self.indices.get(topic).copied().unwrap_or(usize::MAX)
    }

    fn note_end(&mut self) {
        if let (None, Some(Truncation { byte, lost })) = (&self.truncated, self.now.truncated()) {
            let lost = format!("{lost} ({})", self.path.display());
            self.truncated = Some(Truncation { byte: *byte, lost });
        }
    }
}

impl Container for Folder {
    fn next(&mut self) -> Result<Option<MessageHead>, RecordingError> {
        loop {
            match self.now.next() {
                Ok(Some(head)) => {
                    return Ok(Some(MessageHead { topic: self.index_of(head.topic), ..head }));
                }
                Ok(None) => self.note_end(),
                Err(error) => {
                    self.note_end();
                    return Err(error);
                }
            }
            let Some(path) = self.files.pop_front() else { return Ok(None) };
            self.now = open_file(&path)?;
            self.path = path;
            self.indices.clear();
        }
    }

    fn message(&self) -> &[u8] {
        self.now.message()
    }

    fn topics(&self) -> &[Topic] {
        &self.topics
    }

    fn listed(&mut self) -> Option<Vec<Topic>> {
        // The list of the first file. Topics of later files are found when they occur.
        self.now.listed()
    }

    fn done(&self) -> f64 {
        let before = self.count.saturating_sub(1 + self.files.len());
        (before as f64 + self.now.done()) / self.count.max(1) as f64
    }

    fn truncated(&self) -> Option<&Truncation> {
        self.truncated.as_ref()
    }

    fn doubt(&self) -> Option<String> {
        self.now.doubt()
    }

    fn damaged(&self, byte: u64, what: String) -> RecordingError {
        self.now.damaged(byte, what)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the files named in metadata of this text.
    fn named(text: &str) -> Result<Vec<PathBuf>, String> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(METADATA), text).unwrap();
        let files = files(folder.path()).map_err(|error| error.to_string())?;
        Ok(files.iter().map(|file| file.strip_prefix(folder.path()).unwrap().to_owned()).collect())
    }

    /// A kilobyte of aliases could fill the memory.
    #[test]
    fn metadata_with_repetition_or_deep_nesting_are_rejected() {
        let line = |level: usize| format!("a{level}: &a{level} [{}]\n", format!("*a{},", level - 1).repeat(9));
        let bomb: String = (1..20).map(line).collect();
        for (text, part) in [
            (format!("a0: &a0 1\n{bomb}"), "repeats parts of itself"),
            ("[".repeat(100_000), "metadata.yaml"),
            (format!("a: {}\n", "b".repeat(LONGEST_METADATA)), "more than 1048576 bytes"),
            ("a: [\n".to_owned(), "the list of the files of the bag cannot be read"),
            ("rosbag2_bagfile_information: {relative_file_paths: [a.db3, ./a.db3]}".to_owned(), "a.db3 twice"),
        ] {
            let error = named(&text).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn a_decompressed_file_is_preferred_to_the_compressed_one() {
        let folder = tempfile::tempdir().unwrap();
        let text = "rosbag2_bagfile_information:\n  relative_file_paths: [a_0.db3.zstd, a_1.db3.zstd]\n";
        for (name, content) in [(METADATA, text), ("a_0.db3.zstd", ""), ("a_0.db3", ""), ("a_1.db3.zstd", "")] {
            std::fs::write(folder.path().join(name), content).unwrap();
        }
        let expected = ["a_0.db3", "a_1.db3.zstd"].map(|name| folder.path().join(name));
        assert_eq!(files(folder.path()).unwrap(), expected);
    }

    #[test]
    fn long_metadata_with_quoted_marks_are_read() {
        let qos = "- history: 3\\n  depth: 0\\n  reliability: 1\\n".repeat(10);
        let topic = format!(
            "    - topic_metadata:\n        name: /a\n        offered_qos_profiles: \"{qos}\"\n      message_count: 1\n"
        );
        let text = format!(
            "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n    - \"R&D *1.db3\"\n    - b.db3\n  \
             topics_with_message_count:\n{}",
            topic.repeat(400)
        );
        assert!(text.len() > 1 << 17);
        assert_eq!(named(&text), Ok(vec![PathBuf::from("R&D *1.db3"), PathBuf::from("b.db3")]));
    }
}
