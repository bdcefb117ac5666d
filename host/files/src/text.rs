//! Text files from outside, within bounds: a file that is too long is refused before it fills the memory.

use std::borrow::Cow;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// Size limit in bytes of files with settings or other structured text (4 MiB).
pub const SETTINGS: u64 = 1 << 22;
/// Size limit in bytes of files with one sample, pose or circle per line (256 MiB).
pub const TABLE: u64 = 1 << 28;
/// Length limit of a line of such a file in bytes.
const LINE: usize = 1 << 16;
/// Number of characters of an excerpt.
const EXCERPT: usize = 60;

/// Reads the file at `path`, which may have up to `longest` bytes.
///
/// # Errors
/// The error of the operating system; of the kind [`io::ErrorKind::FileTooLarge`] if it is longer.
pub fn bytes(path: &Path, longest: u64) -> io::Result<Vec<u8>> {
    let file = File::open(path)?;
    let mut content = Vec::new();
    // The length is only known for ordinary files.
    if file.metadata()?.len() <= longest {
        file.take(longest.saturating_add(1)).read_to_end(&mut content)?;
        if content.len() as u64 <= longest {
            return Ok(content);
        }
    }
    Err(io::Error::new(io::ErrorKind::FileTooLarge, format!("it has more than {} MiB", longest >> 20)))
}

/// Reads the text in the file at `path`, which may have up to `longest` bytes.
///
/// # Errors
/// As [`bytes`]; of the kind [`io::ErrorKind::InvalidData`] if it is not UTF-8.
pub fn read(path: &Path, longest: u64) -> io::Result<String> {
    String::from_utf8(bytes(path, longest)?)
        .map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "stream did not contain valid UTF-8"))
}

/// Reads the text in the file at `path`, which has one sample, pose or circle per line.
///
/// # Errors
/// As [`read`]; also if a line is too long.
pub fn table(path: &Path) -> io::Result<String> {
    let text = read(path, TABLE)?;
    match text.split('\n').position(|line| line.len() > LINE) {
        None => Ok(text),
        Some(index) => {
            let what = format!("line {} has more than {} KiB", index + 1, LINE >> 10);
            Err(io::Error::new(io::ErrorKind::InvalidData, what))
        }
    }
}

/// Returns the beginning of a text for a message.
pub fn excerpt(text: &str) -> Cow<'_, str> {
    match text.char_indices().nth(EXCERPT) {
        Some((end, _)) => Cow::Owned(format!("{}…", text.get(..end).unwrap_or_default())),
        None => Cow::Borrowed(text),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(content: &[u8], read: impl Fn(&Path) -> io::Result<String>) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("text");
        std::fs::write(&path, content).unwrap();
        read(&path).map_or_else(|error| error.to_string(), |text| format!("{} bytes", text.len()))
    }

    #[test]
    fn long_files_and_long_lines_are_refused() {
        let of_a_mebibyte = |path: &Path| read(path, 1 << 20);
        assert_eq!(error(&vec![b'a'; 1 << 20], of_a_mebibyte), "1048576 bytes");
        assert_eq!(error(&vec![b'a'; (1 << 20) + 1], of_a_mebibyte), "it has more than 1 MiB");
        assert!(error(&[0xff], of_a_mebibyte).contains("UTF-8"));
        assert_eq!(error(&[b'a'; LINE + 1], table), "line 1 has more than 64 KiB");
        assert_eq!(
            error(&[&[b'a'; LINE][..], b"\n", &[b'a'; LINE + 1]].concat(), table),
            "line 2 has more than 64 KiB"
        );
        assert_eq!(error(&[&[b'a'; LINE][..], b"\nb"].concat(), table), "65538 bytes");
    }

    /// A file without content that claims gigabytes takes no memory and no time.
    #[test]
    fn a_sparse_file_is_refused_before_it_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("text");
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        assert_eq!(table(&path).unwrap_err().kind(), io::ErrorKind::FileTooLarge);
    }

    #[test]
    fn an_excerpt_ends_between_characters() {
        assert_eq!(excerpt("short"), "short");
        assert_eq!(excerpt(&"µ".repeat(100)), format!("{}…", "µ".repeat(EXCERPT)));
    }
}
