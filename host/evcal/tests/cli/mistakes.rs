//! Mistakes of new users, one per line, with the answer of the program, its exit code, and the files that it leaves.
//!
//! Every answer contains the cause and the next step, no internals of the program, and leaves no result.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use tempfile::TempDir;

use crate::command::evcal;

const BOARD: &str = "acircles:9x4:55mm:r17.5mm";
/// The recorded session, with [`BOARD`] in it.
const FIXTURE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/board/events.dvraw");

/// One mistake: the command line, in which `DIR` stands for a folder with the files of [`prepare`], `FIXTURE` and `BOARD`
/// for the constants above; the exit code; parts of the answer about the cause and about the next step.
struct Mistake {
    command: &'static str,
    code: i32,
    cause: &'static str,
    next: &'static str,
}

const fn mistake(command: &'static str, code: i32, cause: &'static str, next: &'static str) -> Mistake {
    Mistake { command, code, cause, next }
}

/// Mistakes on the command line, found before a file is read.
const USAGE: &[Mistake] = &[
    mistake("calibrate a.csv -o DIR/out", 2, "--board", "evcal check RECORDING"),
    mistake("calibrate a.csv --board BOARD", 2, "--output", "--help"),
    mistake("calibrate --board BOARD -o DIR/out", 2, "RECORDINGS", "--help"),
    mistake("calibrate a.csv --board 9x4 -o DIR/out", 2, "1 part", "acircles:9x4:55mm:r17.5mm"),
    mistake(
        "calibrate a.csv --board acircles:9x4:55:r17.5 -o DIR/out",
        2,
        "not a length with a unit",
        "acircles:9x4:55mm:r17.5mm",
    ),
    mistake(
        "calibrate a.csv --board acircles:9x4:55mm:17.5mm -o DIR/out",
        2,
        "radius \"17.5mm\"",
        "acircles:9x4:55mm:r17.5mm",
    ),
    mistake(
        "calibrate a.csv --board acircles:9:55mm:r17.5mm -o DIR/out",
        2,
        "ROWSxCOLUMNS",
        "acircles:9x4:55mm:r17.5mm",
    ),
    mistake(
        "calibrate a.csv --board asymmetric:9x4:55mm:r17.5mm -o DIR/out",
        2,
        "is called acircles here",
        "write acircles:9x4:55mm:r17.5mm",
    ),
    mistake("calibrate a.csv --board dots:9x4:55mm:r17.5mm -o DIR/out", 2, "unknown layout", "acircles or circles"),
    mistake("calibrate a.csv --board CirclesA -o DIR/out", 2, "is called acircles here", "acircles:9x4:55mm:r17.5mm"),
    mistake(
        "calibrate a.csv --board circlegrid:9x4:55mm:r17.5mm -o DIR/out",
        2,
        "either of two layouts",
        "asymmetricGrid",
    ),
    mistake("calibrate a.csv --board target.yaml -o DIR/out", 2, "target.yaml", "No such file"),
    mistake("convert FIXTURE -", 2, "`-` is not accepted as an output", "/dev/stdout"),
    mistake("board --pdf -", 2, "`-` is not accepted as an output", "give a file name"),
    mistake("calibrate a.csv --board acircles:9x4:55mm:r45mm -o DIR/out", 2, "overlap", "is the radius a diameter?"),
    mistake(
        "calibrate a.csv --board checkerboard:9x6 -o DIR/out",
        2,
        "size of a square is missing",
        "checkerboard:6x9:25mm",
    ),
    mistake("calibrate a.csv --board aprilgrid:6x6:24mm:6mm -o DIR/out", 2, "here 0.25", "aprilgrid:6x6:35.2mm:0.3"),
    mistake("calibrate a.csv --board charuco:5x7:30mm:r20mm -o DIR/out", 2, "size of a marker", "DICT_5X5_100"),
    mistake("calibrate a.csv --board auto:55 -o DIR/out", 2, "auto:SPACING:rRADIUS", "auto:55mm:r17.5mm"),
    mistake("calibrate a.csv --board BOARD --model pinhole -o DIR/out", 2, "pinhole", "radtan"),
    mistake("calibrate a.csv --board BOARD --model fisheye -o DIR/out", 2, "fisheye", "kannala-brandt"),
    mistake("calibrate a.csv --board BOARD --model radtan5 -o DIR/out", 2, "radtan5", "radtan"),
    mistake("calibrate a.csv --board BOARD --model equidistant -o DIR/out", 2, "equidistant", "kannala-brandt"),
    mistake("calibrate a.csv --board BOARD --model plumb_bob -o DIR/out", 2, "plumb_bob", "radtan"),
    mistake("calibrate a.csv --board BOARD --model ds -o DIR/out", 2, "ds", "double-sphere"),
    mistake("calibrate a.csv --board BOARD --sensor 346 -o DIR/out", 2, "346", "346x260"),
    mistake("calibrate a.csv --board BOARD --time-unit h -o DIR/out", 2, "--time-unit", "ms"),
    mistake("calibrate a.csv --board BOARD --columns x,y,t -o DIR/out", 2, "x,y,t", "x,y,p,t"),
    mistake("calibrate a.csv --board BOARD --threads 0 -o DIR/out", 2, "--threads", "1 to 1024"),
    mistake("calibrate a.csv --board BOARD --imu i.csv --gravity nan -o DIR/out", 2, "--gravity", "9.7 to 9.9 m/s²"),
    mistake("calibrate a.csv --board BOARD --imu i.csv --gravity 0 -o DIR/out", 2, "--gravity", "9.7 to 9.9 m/s²"),
    mistake("calibrate a.csv --board BOARD --frame-only -o DIR/out", 2, "--frame-only", "--frames-only"),
    mistake("live --board BOARD --fix k9=0 -o DIR/out", 2, "k9", "k1"),
    mistake("detect FIXTURE --board BOARD --fewest 9", 2, "--board", "--fewest"),
    mistake("evaluate DIR/camera --truth DIR/camera --body rig", 2, "--body", "--truth"),
    mistake("export DIR/camera --format ros --max-error 0.1", 2, "--rust-table", "--c-header"),
    mistake("export DIR/camera --c-header DIR/table --rust-table DIR/table", 1, "two results", "a name of its own"),
    mistake("calibrat a.csv", 2, "calibrat", "calibrate"),
    mistake("evaluate DIR/camera", 2, "--truth", "--help"),
    mistake("repeat a.csv --board BOARD --seconds 4", 2, "--seconds", "6s"),
    mistake(
        "live --board auto -o DIR/out",
        1,
        "`auto` requires a recording of events",
        "--board acircles:9x4:55mm:r17.5mm",
    ),
    mistake("live --sensor 346x260 --board BOARD -o DIR/out", 2, "describe a recording", "--replay RECORDING"),
    mistake("DIR/sizeless.csv", 2, "unrecognized subcommand", "evcal info"),
    mistake("calibrate BOARD --board DIR/sizeless.csv -o DIR/out", 2, "looks like a file", "acircles:9x4:55mm:r17.5mm"),
    mistake("calibrate a.csv -board BOARD -o DIR/out", 2, "'-b'", "two hyphens: '--board'"),
    mistake("calibrate a.csv --board acircles:9x4:55,5mm:r17,5mm -o DIR/out", 2, "55,5mm", "acircles:9x4:55mm:r17.5mm"),
    mistake("calibrate a.csv --board acircles:9x4:55m:r17.5m -o DIR/out", 2, "55m", "acircles:9x4:55mm:r17.5mm"),
    mistake("calibrate a.csv --board acircles:9*4:55mm:r17.5mm -o DIR/out", 2, "9*4", "acircles:9x4:55mm:r17.5mm"),
    mistake(
        "simulate -o DIR/out --model radtan4 --parameters 300;300;172;129;0;0;0;0",
        2,
        "300;300",
        "331.6,331.1,176.9,134.2",
    ),
    mistake("simulate -o DIR/out --duration 3,5s", 2, "3,5s", "for example 6s"),
    mistake("record DIR/out.dvraw --duration 10", 2, "'10'", "for example 6s"),
    mistake("record DIR/out.aedat4", 2, "recorded as .dvraw", "evcal convert"),
    mistake("live FIXTURE --board BOARD -o DIR/out", 2, "a recording is played with", "--follow"),
    mistake("live - --follow --board BOARD -o DIR/out", 2, "as it arrives", "leave out --follow"),
    mistake("live DIR/sizeless.csv --follow --board BOARD -o DIR/out", 1, "sensor", "--sensor"),
    mistake(
        "board checkerboard:6x9:20mm --pdf DIR/board.pdf",
        2,
        "unexpected argument",
        "--board checkerboard:6x9:20mm",
    ),
    mistake("calibrate --bag a.bag --board BOARD -o DIR/out", 2, "'--bag'", "evcal calibrate RECORDING"),
    mistake("calibrate a.bag --target board.yaml -o DIR/out", 2, "'--target'", "--board acircles:9x4"),
    mistake("calibrate a.bag --topics /dvs/events --board BOARD -o DIR/out", 2, "'--topics'", "--stream TOPIC"),
    mistake("simulate -o DIR/out --duration -1s", 2, "'-1'", "above 0"),
    mistake("simulate -o DIR/out --frames 0", 2, "--frames", "0.1 to 1000 per second"),
    mistake("simulate -o DIR/out --effects hot-pixels:99999999", 2, "hot-pixels", "at most 89960"),
    mistake("repeat a.csv --board BOARD --runs 1", 2, "--runs", "2 to 65535"),
    mistake("info --threads 99999999 a.csv", 2, "--threads", "1 to 1024"),
    mistake("undistort a.png -c c -o b.png --alpha 1.5", 2, "--alpha", "from 0 to 1"),
    mistake("export c --c-header a.h --max-error 0", 2, "--max-error", "pixels"),
    mistake("export c --c-header a.h --ideal 1,1,0", 2, "--ideal", "fx,fy,cx,cy"),
    mistake("board --pdf a.pdf --margin=-1", 2, "--margin", "from 0 to 100 mm"),
    mistake("board --paper a9 --pdf DIR/out.pdf", 2, "a9", "600x400mm"),
];

/// Mistakes with files.
const FILES: &[Mistake] = &[
    mistake(
        "calibrate DIR/missing.dvraw --board BOARD -o DIR/out",
        1,
        "missing.dvraw: cannot be read: No such file",
        "check the path",
    ),
    mistake("calibrate DIR/my recording.dvraw --board BOARD -o DIR/out", 1, "/my: cannot be read", "need quotes"),
    mistake("calibrate DIR/*.aedat4 --board BOARD -o DIR/out", 1, "*.aedat4: cannot be read", "check the folder"),
    mistake("calibrate ~/a.bag --board BOARD -o DIR/out", 1, "~/a.bag: cannot be read", "write the full path"),
    mistake("info -", 1, "standard input is not supported", "write it to a file"),
    mistake(
        "calibrate https://example.org/a.raw --board BOARD -o DIR/out",
        1,
        "addresses are not supported",
        "download the file",
    ),
    mistake("calibrate /dev/ttyACM99 --board BOARD -o DIR/out", 1, "cannot be read", "serial:PORT"),
    mistake("calibrate DIR/camera --board BOARD -o DIR/out", 1, "is a folder", "give the recording"),
    mistake(
        "calibrate DIR/several --board BOARD -o DIR/out",
        1,
        "is a folder",
        "give the recording in it (a.raw, b.raw, c.raw …)",
    ),
    mistake("calibrate DIR/video.mp4 --board BOARD -o DIR/out", 1, "is a video file", "the events of the camera"),
    mistake("calibrate DIR/video.avi --board BOARD -o DIR/out", 1, "is a video file", "the events of the camera"),
    mistake("calibrate DIR/recording.tar --board BOARD -o DIR/out", 1, "is a tar file", "unpack it with tar"),
    mistake("calibrate DIR/recording.7z --board BOARD -o DIR/out", 1, "is a 7z file", "unpack it first"),
    mistake("calibrate DIR/recording.rar --board BOARD -o DIR/out", 1, "is a RAR file", "unpack it first"),
    mistake("calibrate DIR/events.parquet --board BOARD -o DIR/out", 1, "is a Parquet file", "numpy.savez"),
    mistake("calibrate DIR/events.pkl --board BOARD -o DIR/out", 1, "is a Python pickle file", "numpy.savez"),
    mistake("calibrate DIR/events.mat --board BOARD -o DIR/out", 1, "is a MATLAB file", "-v7.3"),
    mistake(
        "calibrate DIR/page.raw --board BOARD -o DIR/out",
        1,
        "is a downloaded HTML file",
        "download the recording again",
    ),
    mistake("calibrate DIR/pointer.aedat4 --board BOARD -o DIR/out", 1, "Git LFS pointer", "git lfs pull"),
    mistake("calibrate DIR/windows.csv --board BOARD -o DIR/out", 1, "is a UTF-16 text file", "save it as UTF-8"),
    mistake(
        "calibrate DIR/german.csv --sensor 346x260 --board BOARD -o DIR/out",
        1,
        "line 2: has 5 fields, not 4",
        "write 0.5 instead of 0,5",
    ),
    mistake("calibrate FIXTURE --imu DIR/missing.csv --board BOARD -o DIR/out", 1, "missing.csv", "is the path right?"),
    mistake(
        "calibrate FIXTURE --settings FIXTURE --board BOARD -o DIR/out",
        1,
        "cannot be read as settings",
        "settings.toml",
    ),
    mistake("compare FIXTURE FIXTURE", 1, "events.dvraw", "calibration.json"),
    mistake("calibrate DIR/empty.csv --board BOARD -o DIR/out", 1, "empty.csv", "empty"),
    mistake("calibrate DIR/picture.png --board BOARD -o DIR/out", 1, "picture.png", "PNG"),
    mistake("calibrate DIR/recording.h5 --board BOARD -o DIR/out", 1, "structure of the HDF5 file", "copy it again"),
    mistake("calibrate DIR/words.txt --board BOARD -o DIR/out", 1, "has an unknown format", "known: AEDAT4"),
    mistake("calibrate DIR/camera/calibration.json --board BOARD -o DIR/out", 1, "is a JSON file", "evcal export"),
    mistake(
        "calibrate DIR/sizeless.csv --board BOARD -o DIR/out",
        1,
        "does not say how many pixels",
        "--sensor 346x260",
    ),
    mistake(
        "calibrate DIR/sizeless.csv --sensor 240x180 --board BOARD -o DIR/out",
        1,
        "lie outside the 240",
        "true size",
    ),
    mistake("calibrate DIR/milliseconds.csv --board BOARD -o DIR/out", 1, "events per second", "--time-unit ms"),
    mistake("convert DIR/sizeless.csv DIR/out.csv --sensor 240x180", 1, "lie outside the", "give the true size"),
    mistake(
        "calibrate DIR/shuffled.csv --sensor 346x260 --board BOARD -o DIR/out",
        1,
        "not in order",
        "sorted by time",
    ),
    mistake("calibrate FIXTURE --board BOARD -o DIR/camera", 1, "is there already", "--force"),
    mistake("calibrate FIXTURE --board BOARD -o /proc/evcal", 1, "/proc/evcal", "-o"),
    mistake("calibrate FIXTURE --board BOARD -o DIR/words.txt", 1, "words.txt: is a file", "choose another folder"),
    mistake("calibrate FIXTURE FIXTURE --board BOARD -o DIR/out", 1, "same events", "give each recording once"),
    mistake("calibrate FIXTURE --settings DIR/settings.toml --board BOARD -o DIR/out", 1, "epsilonn", "epsilon"),
    mistake("calibrate FIXTURE --settings DIR/missing.toml --board BOARD -o DIR/out", 1, "missing.toml", ""),
    mistake(
        "calibrate DIR/sizeless.csv --sensor 346x260 --frames-only --board BOARD -o DIR/out",
        1,
        "contains no frames",
        "record with --frames",
    ),
    mistake("evaluate DIR/camera --truth DIR/foreign.json", 1, "is not a camera file", "\"parameters\": {\"fx\""),
    mistake("evaluate DIR/camera --truth DIR/foreign.yaml", 1, "is not a camera file", "\"model\": \"radtan4\""),
    mistake("export DIR/sizeless.json --format ros -o DIR/out.yaml", 1, "0 x 260 pixels", "1 to 32767 pixels a side"),
    mistake("undistort FIXTURE -c DIR/huge.json -o DIR/x.csv", 1, "40000 x 260 pixels", "1 to 32767 pixels a side"),
    mistake("undistort FIXTURE -c DIR/huge-flat.json -o DIR/x.csv", 1, "40000 x 260", "1 to 32767 pixels a side"),
    mistake("export DIR/camera --format ros -o DIR/words.txt", 1, "words.txt is there already", "--force"),
    mistake("export DIR/camera --c-header DIR/words.txt", 1, "words.txt is there already", "--force"),
    mistake("board --svg DIR/words.txt", 1, "words.txt is there already", "--force"),
    mistake("detect FIXTURE -o DIR/words.txt", 1, "words.txt is there already", "--force"),
    mistake("convert FIXTURE DIR/words.txt", 1, "words.txt is there already", "--force"),
    mistake("undistort FIXTURE -c DIR/camera -o DIR/words.txt", 1, "words.txt is there already", "--force"),
    mistake("export DIR --format ros", 1, "calibration.json: No such file", "or its folder"),
    mistake("export DIR/camera --format rospy", 2, "rospy", "ros"),
    mistake("export DIR/camera --format ros -o DIR", 1, "is a directory", "name a file in it"),
    mistake("board --pdf DIR/missing/out.pdf", 1, "missing/out.pdf", "does the folder exist?"),
    mistake("undistort DIR/camera -c FIXTURE -o DIR/new.csv", 1, "events.dvraw", "or its folder"),
    mistake("convert FIXTURE DIR/x.csv --sensor 240x180", 1, "829126 of 1947933 events", "the file states 346 x 260"),
    mistake("convert FIXTURE DIR/x.csv --sensor 640x480", 1, "is of a sensor of 346 x 260", "leave out --sensor"),
    mistake(
        "calibrate FIXTURE --board BOARD --sensor 240x180 -o DIR/out",
        1,
        "829126 of 1947933 events lie outside the 240 x 180",
        "the file states 346 x 260",
    ),
    mistake("detect DIR/sizeless.csv", 1, "does not say how many pixels", "add --sensor 346x260"),
    mistake(
        "detect FIXTURE --board BOARD --sensor 240x180",
        1,
        "829126 of 1947933 events",
        "the file states 346 x 260",
    ),
    mistake("detect FIXTURE --board BOARD --sensor 640x480", 1, "is of a sensor of 346 x 260", "leave out --sensor"),
    mistake(
        "repeat FIXTURE --board BOARD --sensor 240x180",
        1,
        "829126 of 1947933 events",
        "the file states 346 x 260",
    ),
    mistake("detect FIXTURE --board BOARD -o DIR/nodir/c.csv", 1, "nodir/c.csv", "does the folder exist?"),
    mistake("detect FIXTURE --picture DIR/nodir/c.png", 1, "nodir/c.png", "does the folder exist?"),
    mistake("convert FIXTURE DIR/nodir/c.csv", 1, "nodir/c.csv", "does the folder exist?"),
    mistake("convert DIR/sizeless.csv DIR/x.aedat4", 1, "does not say how many pixels", "--sensor 346x260"),
    mistake("info DIR/camera", 1, "contains a calibration", "undistort -c"),
    mistake("info DIR/opencv.yaml", 1, "is for OpenCV", "give the recording"),
    mistake("info DIR/report.html", 1, "is a calibration report file", "open it in a browser"),
    mistake("convert FIXTURE DIR/events.xyz", 1, "events.xyz", "csv"),
    mistake("repeat FIXTURE --board BOARD", 1, "3.0 s long", "--seconds 1.4s"),
];

/// Mistakes that the program finds only in the circles of the recording.
const BOARDS: &[Mistake] = &[
    mistake(
        "calibrate FIXTURE --board acircles:9x4:55mm:r35mm -o DIR/out",
        1,
        "is the radius a diameter?",
        "--board acircles:9x4:55mm:r17.5mm",
    ),
    mistake(
        "calibrate FIXTURE --board acircles:9x4:110mm:r17.5mm -o DIR/out",
        1,
        "half of it is required",
        "--board acircles:9x4:55mm:r17.5mm",
    ),
    mistake(
        "calibrate FIXTURE --board acircles:4x9:55mm:r17.5mm -o DIR/out",
        1,
        "no pattern found",
        "--board acircles:9x4:55mm:r17.5mm",
    ),
    mistake(
        "calibrate FIXTURE --board circles:9x4:55mm:r17.5mm -o DIR/out",
        1,
        "no pattern found",
        "--board acircles:9x4:55mm:r17.5mm",
    ),
    mistake(
        "calibrate FIXTURE --board circles:9x4:110mm:r17.5mm -o DIR/out",
        1,
        "no pattern found",
        "--board acircles:9x4:55mm:r17.5mm",
    ),
    mistake(
        "calibrate FIXTURE --board acircles:11x5:55mm:r17.5mm -o DIR/out",
        1,
        "no pattern found",
        "--board acircles:9x4:55mm:r17.5mm",
    ),
    mistake(
        "calibrate FIXTURE --board circles:20x20:55mm:r17.5mm -o DIR/out",
        1,
        "no pattern found",
        "--board acircles:9x4:55mm:r17.5mm",
    ),
    mistake(
        "calibrate FIXTURE --board BOARD --fix cx=9999 --model radtan -o DIR/out",
        1,
        "no event is near the board's circles",
        "leave out --fix",
    ),
    mistake("calibrate FIXTURE --board auto -o DIR/out", 1, "the board is acircles:9x4", "--board acircles:9x4:"),
];

/// Writes the files that a new user may have.
fn prepare() -> TempDir {
    let directory = tempfile::tempdir().unwrap();
    let put = |name: &str, content: &[u8]| fs::write(directory.path().join(name), content).unwrap();
    put("empty.csv", b"");
    put("picture.png", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x01\0\0\0\x01\x08\x02\0\0\0");
    put("recording.h5", b"\x89HDF\r\n\x1a\n\0\0\0\0\0\x08\x08\0");
    put("words.txt", b"These are my events.\nThey were recorded on Monday.\n");
    let line = |index: u32| format!("{},{},{},1\n", index * 4, index % 346, index * 7 % 260);
    put("sizeless.csv", format!("t_us,x,y,p\n{}", (0..20_000).map(line).collect::<String>()).as_bytes());
    let slow = |index: u32| format!("{:.3},{},{},1\n", f64::from(index) * 0.004, index % 346, index * 7 % 260);
    let head = "# sensor 346 x 260\nt,x,y,p\n";
    put("milliseconds.csv", format!("{head}{}", (0..50_000).map(slow).collect::<String>()).as_bytes());
    let shuffled: String = (0..20_000_u32).map(|index| line(index * 7919 % 20_011 * 1000)).collect();
    put("shuffled.csv", format!("t_us,x,y,p\n{shuffled}").as_bytes());
    put("video.mp4", &[b"\0\0\0\x20ftypisom".as_slice(), &[0; 1000]].concat());
    put("video.avi", &[b"RIFF\x24\x08\0\0AVI LIST".as_slice(), &[0; 1000]].concat());
    put("recording.tar", &[[0_u8; 257].as_slice(), b"ustar", &[0; 1000]].concat());
    put("recording.7z", &[b"7z\xbc\xaf\x27\x1c".as_slice(), &[0; 1000]].concat());
    put("recording.rar", &[b"Rar!\x1a\x07\x01".as_slice(), &[0; 1000]].concat());
    put("events.parquet", &[b"PAR1".as_slice(), &[0; 1000]].concat());
    put("events.pkl", &[b"\x80\x04\x95".as_slice(), &[0; 1000]].concat());
    put("events.mat", &[b"MATLAB 5.0 MAT-file, Platform: GLNXA64".as_slice(), &[0; 1000]].concat());
    put("page.raw", b"<!DOCTYPE html><html><body>Not Found</body></html>");
    put("pointer.aedat4", b"version https://git-lfs.github.com/spec/v1\noid sha256:0123\nsize 12345\n");
    let windows: Vec<u8> = format!("\u{feff}t,x,y,p\n{}", line(1)).encode_utf16().flat_map(u16::to_le_bytes).collect();
    put("windows.csv", &windows);
    let comma = |index: u32| format!("0,{:06};{};{};1\n", index * 4, index % 346, index * 7 % 260);
    put("german.csv", format!("t;x;y;p\n{}", (0..20_000).map(comma).collect::<String>()).as_bytes());
    fs::create_dir(directory.path().join("several")).unwrap();
    for name in ["a.raw", "b.raw", "c.raw", "d.raw"] {
        put(&format!("several/{name}"), b"% evt 3.0\n");
    }
    put("settings.toml", b"[detection.cluster]\nepsilonn = 3.0\n");
    put("foreign.json", br#"{"K": [[300, 0, 172], [0, 300, 129], [0, 0, 1]], "dist": [0, 0, 0, 0, 0]}"#);
    put("opencv.yaml", b"%YAML:1.0\n---\nimage_width: 346\n");
    put("report.html", b"<!DOCTYPE html><html><head><meta name=\"generator\" content=\"evcal 1.0\">");
    put("foreign.yaml", b"image_width: 346\nimage_height: 260\ncamera_name: dvs\n");
    let camera = serde_json::json!({
        "sensor": { "width": 346, "height": 260 },
        "camera": { "model": "radtan4", "parameters": {
            "fx": 300.0, "fy": 300.0, "cx": 172.5, "cy": 129.5, "k1": -0.3, "k2": 0.1, "p1": 0.0, "p2": 0.0
        } },
    });
    fs::create_dir(directory.path().join("camera")).unwrap();
    put("camera/calibration.json", camera.to_string().as_bytes());
    for (name, width) in [("sizeless.json", 0), ("huge.json", 40_000)] {
        let mut camera = camera.clone();
        camera["sensor"]["width"] = width.into();
        put(name, camera.to_string().as_bytes());
    }
    let flat = serde_json::json!({ "camera": {
        "model": "radtan4", "width": 40_000, "height": 260, "fx": 300.0, "fy": 300.0, "cx": 172.5, "cy": 129.5,
        "dist": { "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0 },
    } });
    put("huge-flat.json", flat.to_string().as_bytes());
    directory
}

fn run(command: &str, directory: &Path) -> Output {
    let words = command.replace("FIXTURE", FIXTURE).replace("BOARD", BOARD).replace("DIR", directory.to_str().unwrap());
    evcal(&words.split(' ').collect::<Vec<_>>())
}

/// Runs each mistake, and reports all wrong answers together.
fn check(mistakes: &[Mistake]) {
    let directory = prepare();
    let path = directory.path();
    let before = fs::read(path.join("camera/calibration.json")).unwrap();
    let mut wrong = String::new();
    for Mistake { command, code, cause, next } in mistakes {
        let output = run(command, path);
        let errors = String::from_utf8(output.stderr).unwrap();
        let left = fs::read_dir(path.join("out")).into_iter().flatten().flatten().map(|entry| entry.file_name());
        let results: Vec<_> =
            left.filter(|name| !name.to_str().is_some_and(|name| name.starts_with("failure."))).collect();
        let good = output.status.code() == Some(*code)
            && errors.contains(cause)
            && errors.contains(next)
            && output.stdout.is_empty()
            && results.is_empty()
            && !["panicked", "Os {", "Error(", "RUST_BACKTRACE"].iter().any(|word| errors.contains(word));
        if !good {
            wrong += &format!("{command}\n  {:?} {errors}  left {results:?}\n", output.status.code());
        }
        let _ = fs::remove_dir_all(path.join("out"));
    }
    assert!(wrong.is_empty(), "{wrong}");
    assert_eq!(fs::read(path.join("camera/calibration.json")).unwrap(), before, "nothing old is touched");
}

#[test]
fn mistakes_on_the_command_line() {
    check(USAGE);
}

#[test]
fn mistakes_with_files() {
    check(FILES);
}

#[test]
fn mistakes_with_boards() {
    check(BOARDS);
}

/// A smaller board is found in some windows, but its poses contradict each other.
#[test]
fn the_error_about_too_small_a_board_names_the_whole_board() {
    let directory = prepare();
    let output = run("calibrate FIXTURE --board acircles:7x3:55mm:r17.5mm -o DIR/out", directory.path());
    let errors = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{errors}");
    assert!(
        errors.contains("is the board described correctly?") && errors.contains("--board acircles:9x4:55mm:r17.5mm"),
        "{errors}"
    );
}

/// Names may contain characters that end a string in YAML or JSON.
#[test]
fn special_characters_in_a_camera_name_leave_files_valid() {
    let directory = prepare();
    let output = run("export DIR/camera --format dv-processing --camera-name a\"b\nc", directory.path());
    let file: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(file["cameras"]["C0"]["name"], "a_b_c");
    let output = run("export DIR/camera --format ros --camera-name a\"b\nc", directory.path());
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("a_b_c") && !text.contains("a\"b"), "{text}");
}

/// Scripts need the exit code even if standard error is closed.
#[cfg(target_os = "linux")]
#[test]
fn the_exit_code_is_right_even_if_errors_cannot_be_written() {
    for (arguments, code) in [(&["info", "/missing.dvraw"][..], 1), (&["info"], 2)] {
        let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let status = Command::new(env!("CARGO_BIN_EXE_evcal")).args(arguments).stderr(full).status().unwrap();
        assert_eq!(status.code(), Some(code), "{arguments:?}");
    }
}

#[test]
fn suspicious_events_are_reported() {
    let directory = prepare();
    let printed = |command: &str| String::from_utf8(run(command, directory.path()).stdout).unwrap();
    assert!(printed("info DIR/milliseconds.csv").contains("add --time-unit ms"));
    let checked = printed("check DIR/sizeless.csv");
    assert!(checked.contains("ON events only") && checked.contains("recording too short"), "{checked}");
    fs::write(directory.path().join("one.csv"), "# sensor 346 x 260\nt_us,x,y,p\n7,1,2,1\n").unwrap();
    assert!(!printed("check DIR/one.csv").contains("inf"));
}

/// `check` reports errors with which a calibration would fail.
#[test]
fn check_reports_a_wrong_radius() {
    let directory = prepare();
    for board in ["acircles:9x4:55mm:r35mm", "acircles:9x4:110mm:r17.5mm"] {
        let output = run(&format!("check FIXTURE --board {board}"), directory.path());
        let printed = String::from_utf8(output.stdout).unwrap();
        assert!(
            printed.contains("next: the circles appear to have") && !printed.contains("next: evcal"),
            "{board}: {printed}"
        );
        assert!(printed.contains("--board acircles:9x4:55mm:r17.5mm"), "{board}: {printed}");
    }
}

#[test]
fn a_failed_calibration_writes_a_description_and_a_picture() {
    let directory = prepare();
    let failed = run("calibrate FIXTURE --board acircles:9x4:55mm:r35mm --json -o DIR/out", directory.path());
    let printed: serde_json::Value = serde_json::from_slice(&failed.stdout).unwrap();
    assert!(printed["error"].as_str().unwrap().contains("circles appear to have"), "{printed}");
    assert!(printed["stages"].as_array().unwrap().len() >= 2, "{printed}");
    assert!(printed["seen"]["windows"]["found"].as_u64().unwrap() > 300, "{printed}");
    let text = fs::read_to_string(directory.path().join("out/failure.txt")).unwrap();
    for part in [
        "circles appear to have",
        "looking for the board in",
        "initial model from",
        "windows tried",
        "--board acircles",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let picture = fs::read(directory.path().join("out/failure.png")).unwrap();
    assert!(picture.starts_with(b"\x89PNG") && picture.ends_with(b"IEND\xaeB`\x82"));
    // If nothing could be read, no file is left, and the error is nevertheless JSON.
    let failed = run("calibrate DIR/empty.csv --board BOARD --json -o DIR/nothing", directory.path());
    let printed: serde_json::Value = serde_json::from_slice(&failed.stdout).unwrap();
    assert!(printed["error"].as_str().unwrap().contains("is empty"), "{printed}");
    assert!(!directory.path().join("nothing").exists());
    // The next run needs no --force, and a success removes the files of the failure.
    let good = run("calibrate FIXTURE --board auto:55mm:r17.5mm -o DIR/out", directory.path());
    assert_eq!(good.status.code(), Some(0), "{}", String::from_utf8_lossy(&good.stderr));
    assert!(String::from_utf8_lossy(&good.stderr).contains("recognised board: acircles:9x4:55mm:r17.5mm"));
    assert!(directory.path().join("out/calibration.json").exists());
    assert!(!directory.path().join("out/failure.txt").exists() && !directory.path().join("out/failure.png").exists());
}
