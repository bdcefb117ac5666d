//! Fuzz targets: all readers of untrusted input. A target must not panic, hang or take memory out of proportion to its
//! input, and its output must satisfy the guarantees of the reader.

use std::fs;
use std::io::{Read as _, Write as _};
use std::net::{Ipv4Addr, Shutdown, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::time::Duration;

use evcal_calibrate::result::calibrated_camera::CalibratedCamera;
use evcal_calibrate::settings::Settings;
use evcal_core::decode::{Evt2Decoder, Evt3Decoder, Evt4Decoder, Evt21Decoder};
use evcal_core::sensor::Sensor;
use evcal_detection::circles::{stream, track};
use evcal_geometry::board::{Board, BoardError, BoardProblem};
use evcal_live::page::Page;
use event_recordings::image_folder::{self, ImageFolder, ImageFolderError, Stamps};
use event_recordings::images::Images;
use event_recordings::{Damage, Recording, RecordingError, RecordingErrorKind, RecordingOptions};
use usb_davis::protocol::{Decoder, Layout};

/// A reader of bytes.
pub struct Target {
    /// Its name, also the name of its folder in the corpus.
    pub name: &'static str,
    read: Read,
}

/// Method of reading bytes.
enum Read {
    /// As a file of this format ([`event_recordings::FileFormat::name`]).
    Recording(&'static str),
    /// As a file of another kind.
    File(fn(&Path)),
    /// As the files of a folder of this format.
    Folder(&'static FolderOf),
    /// In memory.
    Bytes(fn(&[u8])),
}

const fn recording(name: &'static str, format: &'static str) -> Target {
    Target { name, read: Read::Recording(format) }
}

/// A recording format that consists of a folder of files.
struct FolderOf {
    /// [`event_recordings::FileFormat::name`].
    format: &'static str,
    /// The file that receives the bytes before the first zero byte, if there is one.
    text: Option<&'static str>,
    /// Names of the files that receive the following bytes.
    names: &'static [&'static str],
}

static ROS_FOLDER: FolderOf =
    FolderOf { format: "ROS 2 bag", text: Some("metadata.yaml"), names: &["0", "1", "2", "3"] };
static NPY_FOLDER: FolderOf = FolderOf {
    format: "NumPy arrays",
    text: None,
    names: &["dataset_events_t.npy", "dataset_events_xy.npy", "dataset_events_p.npy"],
};

const fn file(name: &'static str, read: fn(&Path)) -> Target {
    Target { name, read: Read::File(read) }
}

const fn bytes(name: &'static str, read: fn(&[u8])) -> Target {
    Target { name, read: Read::Bytes(read) }
}

/// All targets.
pub const TARGETS: &[Target] = &[
    recording("aedat4", "AEDAT4"),
    recording("aedat2", "AEDAT 2.0"),
    recording("aedat3", "AEDAT 3"),
    recording("davis", "DAVIS USB recording"),
    recording("raw", "Prophesee RAW"),
    recording("dat", "Prophesee DAT"),
    recording("bag", "ROS bag"),
    recording("mcap", "MCAP"),
    recording("db3", "ROS 2 bag (SQLite)"),
    recording("hdf5", "HDF5"),
    recording("event-stream", "Event Stream"),
    recording("npy", "NumPy array"),
    recording("npz", "NumPy archive"),
    recording("text", "text"),
    recording("event-calib", "EventCalib binary"),
    recording("bare", "bare DAVIS stream"),
    Target { name: "ros-folder", read: Read::Folder(&ROS_FOLDER) },
    Target { name: "npy-folder", read: Read::Folder(&NPY_FOLDER) },
    file("circle-track", read_circle_track),
    file("circle-stream", read_circle_stream),
    file("settings", read_settings),
    file("calibration", read_calibration),
    bytes("board", read_board),
    bytes("wire", read_wire),
    bytes("evt", read_evt),
    bytes("image-folder", |bytes| _ = images_in(bytes)),
    bytes("http", read_http),
];

/// More events than any fuzzer input can contain.
const MOST_EVENTS: usize = 1 << 24;

impl Target {
    /// Reads `bytes`, and returns `true` if they are worth keeping, that is, if they have the right format.
    pub fn run(&self, bytes: &[u8]) -> bool {
        match self.read {
            Read::Bytes(read) => {
                read(bytes);
                true
            }
            Read::File(read) => with_file(bytes, |path| {
                read(path);
                true
            }),
            Read::Recording(format) => with_file(bytes, |path| read_recording(format, path)),
            Read::Folder(folder) => with_files(folder, bytes, |path| read_recording(folder.format, path)),
        }
    }

    /// Returns the number of events in `bytes`, if they are a recording.
    ///
    /// # Errors
    /// If they cannot be read to their end.
    #[cfg(test)]
    pub fn events(&self, bytes: &[u8]) -> Option<Result<u64, RecordingError>> {
        match self.read {
            Read::Bytes(_) | Read::File(_) => None,
            Read::Recording(_) => Some(with_file(bytes, count_events)),
            Read::Folder(folder) => Some(with_files(folder, bytes, count_events)),
        }
    }
}

#[cfg(test)]
fn count_events(path: &Path) -> Result<u64, RecordingError> {
    let recording = Recording::new(path, options_for(path)?)?;
    let (mut reader, mut batch) = (recording.open()?, Vec::new());
    while reader.next_batch(&mut batch)? {}
    // Frames and IMU samples as well.
    if let Some(open) = recording.format().extras {
        open(path, recording.options())?;
    }
    Ok(reader.report().events)
}

/// Returns options with which the recording at `path` can be opened, whether its sensor is known or not.
fn options_for(path: &Path) -> Result<RecordingOptions, RecordingError> {
    let options = RecordingOptions::default();
    let opened = Recording::new(path, options.clone())?.open();
    let needs_sensor = opened.is_err_and(|error| matches!(error.kind, RecordingErrorKind::ChipUnknown));
    Ok(RecordingOptions { sensor: needs_sensor.then_some(Sensor::new(346, 260)), ..options })
}

/// Calls `read` with a folder whose files contain these bytes.
fn with_files<R>(folder: &FolderOf, bytes: &[u8], read: impl FnOnce(&Path) -> R) -> R {
    let (table, pieces) = pieces(bytes);
    let texts = folder.text.map(|name| (PathBuf::from(name), table));
    let files = folder.names.iter().map(PathBuf::from).zip(pieces);
    with_folder(texts.into_iter().chain(files), read)
}

/// Returns the bytes before the first zero byte, and the following pieces, each preceded by two bytes with its length.
fn pieces(bytes: &[u8]) -> (&[u8], impl Iterator<Item = &[u8]>) {
    let (text, rest) = bytes.split_at(bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len()));
    let mut rest = rest.get(1..).unwrap_or_default();
    let pieces = std::iter::from_fn(move || {
        let [low, high, behind @ ..] = rest else { return None };
        let (piece, behind) = behind.split_at(behind.len().min(usize::from(u16::from_le_bytes([*low, *high]))));
        rest = behind;
        Some(piece)
    });
    (text, pieces)
}

/// Calls `read` with a folder with these files.
fn with_folder<'a, R>(files: impl Iterator<Item = (PathBuf, &'a [u8])>, read: impl FnOnce(&Path) -> R) -> R {
    let folder = scratch(&[]).with_extension("folder");
    for (name, content) in files {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().expect("it is in the folder")).expect("the scratch folder can be made");
        fs::write(path, content).expect("the scratch file can be written");
    }
    let seen = read(&folder);
    let _ = fs::remove_dir_all(folder);
    seen
}

/// Calls `read` with a file with this content.
fn with_file<R>(bytes: &[u8], read: impl FnOnce(&Path) -> R) -> R {
    let path = scratch(bytes);
    let kept = read(&path);
    let _ = fs::remove_file(path);
    kept
}

/// Returns the path of a file with this content, one per thread; in memory if the system has such a folder.
fn scratch(bytes: &[u8]) -> PathBuf {
    let memory = Path::new("/dev/shm");
    let folder = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
    let path = folder.join(format!("evcal-fuzz-{}-{:?}", std::process::id(), std::thread::current().id()));
    fs::write(&path, bytes).expect("the scratch file can be written");
    path
}

fn read_recording(format: &str, path: &Path) -> bool {
    let Ok(options) = options_for(path) else { return false };
    for damage in [Damage::Refuse, Damage::Skip] {
        let options = RecordingOptions { damage, ..options.clone() };
        let Ok(recording) = Recording::new(path, options) else { return false };
        if recording.format().name != format {
            return false;
        }
        read_events(&recording);
        // Other streams do not depend on this option.
        if damage == Damage::Refuse {
            read_others(&recording);
        }
    }
    true
}

fn read_events(recording: &Recording) {
    let Ok(mut reader) = recording.open() else { return };
    let sensor = reader.information().sensor;
    let (mut count, mut latest, mut batch) = (0, i64::MIN, Vec::new());
    while let Ok(true) = reader.next_batch(&mut batch) {
        for event in &batch {
            assert!(event.t >= latest, "times go back");
            latest = event.t;
            assert!(sensor.is_none_or(|sensor| sensor.contains(event.x, event.y)), "an event outside the sensor");
        }
        count += batch.len();
        assert!(count < MOST_EVENTS, "the reader does not end");
    }
    assert!(reader.report().events >= count as u64);
}

fn read_others(recording: &Recording) {
    // Reads each topic as the images of a second camera.
    for stream in recording.streams().unwrap_or_default() {
        let topic = stream.name.rsplit_once(" (").map_or(stream.name.as_str(), |(name, _)| name);
        if let Ok(Some(images)) = Images::open(recording.path(), Some(topic), Damage::Refuse, Stamps::Start) {
            let _ = images.visit(|_| {});
        }
    }
    let _ = recording.visit_frames(|_| {});
    if let Some(open) = recording.format().extras
        && let Ok(mut extras) = open(recording.path(), recording.options())
    {
        let (mut lost, mut count) = (Vec::new(), 0);
        while extras.next_until(i64::MAX, &mut lost).is_some() {
            count += 1;
            assert!(count < MOST_EVENTS, "the reader does not end");
        }
    }
    if let Some(open) = recording.format().transfers
        && let Ok(mut capture) = open(recording.path(), recording.options())
    {
        while let Ok(Some(_)) = capture.next_transfer() {}
    }
}

#[cfg(test)]
#[test]
fn frames_have_the_documented_layout() {
    let frame = [0, 0, 1, 0, 0xC0, 0x84, 0x3D, 0, 0, 0x80, 0x3F, 0, 0, 0, 0x40, 0, 0, 0x40, 0x40, 0, 0, 0, 0, 5, 6];
    let sum = crc32(&frame);
    assert_eq!(sum.to_le_bytes(), [0xEE, 0x32, 0x07, 0x78]);
    let coded = cobs(&[frame.as_slice(), &sum.to_le_bytes()].concat());
    let expected = [
        0x01, 0x01, 0x02, 0x01, 0x04, 0xC0, 0x84, 0x3D, 0x01, 0x03, 0x80, 0x3F, 0x01, 0x01, 0x02, 0x40, 0x01, 0x03,
        0x40, 0x40, 0x01, 0x01, 0x01, 0x07, 0x05, 0x06, 0xEE, 0x32, 0x07, 0x78, 0x00,
    ];
    assert_eq!(coded, expected);
}

fn read_circle_track(path: &Path) {
    let board: Board = "acircles:9x4:55mm:r17.5mm".parse().expect("a board");
    let _ = track::read(path, &board.lattice(), 0);
}

/// Reads the bytes unchanged, and as frames with correct checksums: each frame is a byte with its length, then its kind
/// and body.
fn read_circle_stream(path: &Path) {
    let _ = stream::read(path);
    let mut rest = fs::read(path).expect("the scratch file can be read").into_iter();
    let (mut framed, mut number) = (Vec::new(), 0u16);
    while let Some(length) = rest.next() {
        let body: Vec<u8> = rest.by_ref().take(length.min(243).into()).collect();
        let mut frame = [number.to_le_bytes().as_slice(), &body].concat();
        frame.extend(crc32(&frame).to_le_bytes());
        framed.extend(cobs(&frame));
        number = number.wrapping_add(1);
    }
    fs::write(path, framed).expect("the scratch file can be written");
    let _ = stream::read(path);
}

/// Computes the same CRC as zlib.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |sum, byte| {
        (0..8).fold(sum ^ u32::from(*byte), |sum, _| (sum >> 1) ^ (0xEDB8_8320 & (sum & 1).wrapping_neg()))
    })
}

/// Encodes frames below 254 bytes, with the terminating zero.
fn cobs(frame: &[u8]) -> Vec<u8> {
    let parts = frame.split(|byte| *byte == 0);
    let mut coded: Vec<u8> =
        parts.flat_map(|part| std::iter::once(part.len() as u8 + 1).chain(part.to_vec())).collect();
    coded.push(0);
    coded
}

/// Reads images in a folder with this table, named 0, 1 and so on ([`pieces`]). Returns their number.
pub fn images_in(bytes: &[u8]) -> Result<usize, ImageFolderError> {
    let (table, images) = pieces(bytes);
    let images =
        images.enumerate().map(|(number, image)| (Path::new(image_folder::IMAGES).join(number.to_string()), image));
    with_folder(std::iter::once((PathBuf::from(image_folder::TABLE), table)).chain(images), read_images)
}

fn read_images(folder: &Path) -> Result<usize, ImageFolderError> {
    let mut count = 0;
    for &stamps in Stamps::ALL {
        let images = ImageFolder::open(folder, stamps)?;
        let (sensor, mut before) = (images.sensor(), i64::MIN);
        count = 0;
        images.visit(|image| {
            let (start, end) = image.exposure;
            assert!(start <= end, "an exposure ends before it begins");
            if stamps == Stamps::Start {
                assert!(start >= before, "times go back");
                before = start;
            }
            if let Ok(image) = &image.image {
                assert_eq!((image.width(), image.height()), (sensor.width.into(), sensor.height.into()));
            }
            count += 1;
        })?;
    }
    Ok(count)
}

fn read_settings(path: &Path) {
    if let Ok(settings) = Settings::read(path) {
        let written = settings.to_toml();
        fs::write(path, &written).expect("the scratch file can be written");
        let again = Settings::read(path).expect("what was written is read");
        assert_eq!(again.to_toml(), written);
    }
}

fn read_calibration(path: &Path) {
    let _ = CalibratedCamera::read(path);
    let _ = evcal_geometry::lens::camera_file::read(path);
}

fn read_board(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    if let Ok(board) = text.parse::<Board>() {
        // Lengths are written to the nanometre, so circles that nearly touch may touch after reading.
        match board.to_string().parse::<Board>() {
            Ok(again) => assert_eq!(again.to_string(), board.to_string()),
            Err(BoardError::Circles(error)) => assert_eq!(error.problem, BoardProblem::Overlap),
            Err(error) => panic!("{board} is not read back: {error}"),
        }
    }
}

/// The first byte determines the sizes of the pieces of the rest; the sizes must not affect the result.
fn read_wire(bytes: &[u8]) {
    let [piece, bytes @ ..] = bytes else { return };
    let messages = |size: usize| {
        let mut decoder = Decoder::with_frames(Layout::DAVIS346, vec![0; 346 * 260]);
        let mut seen = Vec::new();
        for part in bytes.chunks(size) {
            decoder.decode(part, |message| match message {
                usb_davis::protocol::Message::Events(events) => {
                    seen.extend(events.iter().map(|event| format!("{event:?}")));
                }
                other => seen.push(format!("{other:?}")),
            });
        }
        seen
    };
    assert_eq!(messages(usize::from(*piece).max(1)), messages(bytes.len().max(1)));
}

/// The page and its address.
static PAGE: LazyLock<(Page, String)> = LazyLock::new(|| {
    let page = Page::start(Ipv4Addr::LOCALHOST.into(), Some(0)).expect("a page can be served");
    let address = page.url();
    let address = address.trim_start_matches("http://").split('/').next().unwrap_or_default().to_owned();
    (page, address)
});

/// Sends a request to the page of `evcal live`; its own address replaces every `@`. The token is unknown, so the page
/// must accept no command, and must still answer the next request.
fn read_http(bytes: &[u8]) {
    let (page, address) = &*PAGE;
    let sent: Vec<u8> =
        bytes.iter().flat_map(|byte| if *byte == b'@' { address.as_bytes().to_vec() } else { vec![*byte] }).collect();
    let stream = send(address, &sent);
    // Otherwise the page would wait for more data.
    let _ = stream.shutdown(Shutdown::Write);
    answer(stream);
    let next = format!("GET / HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    let answer = answer(send(address, next.as_bytes()));
    assert!(answer.starts_with(b"HTTP/1.1 200"), "the page does not answer any more");
    assert!(!page.is_finish_asked() && page.take_next().is_none(), "a command without the token");
}

/// Sends a request to the page, which may close the connection early.
fn send(address: &str, request: &[u8]) -> TcpStream {
    let mut stream = TcpStream::connect(address).expect("the page listens");
    stream.set_read_timeout(Some(Duration::from_secs(10))).expect("a socket waits for some time only");
    let _ = stream.write_all(request);
    stream
}

/// Returns everything that the page sends until it closes the connection.
fn answer(mut stream: TcpStream) -> Vec<u8> {
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    answer
}

fn read_evt(bytes: &[u8]) {
    let mut evt2 = Evt2Decoder::default();
    let mut evt21 = Evt21Decoder::default();
    let mut evt3 = Evt3Decoder::default();
    let mut evt4 = Evt4Decoder::default();
    for word in bytes.as_chunks().0 {
        let _ = evt2.push(u32::from_le_bytes(*word));
        let _ = evt4.push(u32::from_le_bytes(*word)).count();
    }
    for word in bytes.as_chunks().0 {
        let _ = evt21.push(u64::from_le_bytes(*word)).count();
    }
    for word in bytes.as_chunks().0 {
        let _ = evt3.push(u16::from_le_bytes(*word)).count();
    }
}
