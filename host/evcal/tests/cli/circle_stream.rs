//! Calibration from the circle stream of a detector on a microcontroller: from a file and from a serial port.

use std::f64::consts::TAU;
use std::fs::{self, File};
use std::io::Write;
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use evcal_geometry::board::CircleBoard;
use evcal_link::{Circle, DeviceName, Encoder, Hello, Message, PROTOCOL_VERSION, WindowEnd};
use evcal_simulator::motion::{Motion, MotionSettings};
use evcal_simulator::rays::Rays;
use nalgebra::{Point3, Vector3};
use serde_json::Value;
use serialport::{SerialPort, TTYPort};
use tempfile::TempDir;

const BOARD: &str = "acircles:9x4:55mm:r17.5mm";
const SENSOR: Sensor = Sensor::new(346, 260);
const LENS: [f64; 9] = [330.0, 331.0, 170.0, 131.5, -0.35, 0.15, 0.0, 0.0, 0.0];
/// Windows of 4 ms, one per 10 ms.
const WINDOWS: u32 = 500;

/// Frames from a device in front of a hand-moved board: centres with 0.05 px of noise, some circles missing, some
/// not of the board.
fn frames() -> Vec<Vec<u8>> {
    let camera = Camera::from_parameters(ModelKind::Radtan, &LENS).unwrap();
    let board: CircleBoard = BOARD.parse().unwrap();
    let duration = f64::from(WINDOWS) * 0.01;
    let motion = Motion::new(&MotionSettings::fast(), &board.into(), &Rays::new(&camera, SENSOR), duration, 3).unwrap();
    let mut state = 7_u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / (1_u64 << 31) as f64
    };
    let mut encoder = Encoder::new();
    let hello = Hello {
        protocol: PROTOCOL_VERSION,
        first: true,
        device: DeviceName::try_from("test detector").unwrap(),
        sensor_width: SENSOR.width,
        sensor_height: SENSOR.height,
        ..Hello::default()
    };
    let mut frames = vec![encoder.encode(&Message::Hello(hello)).to_vec()];
    for window in 0..WINDOWS {
        let start_us = 3_000_000 + u64::from(window) * 10_000;
        let pose = motion.pose(f64::from(window) * 0.01 + 0.002);
        let project = |x: f64, y: f64| {
            let point = pose.inverse_transform_point(&Point3::new(x, y, 0.0)).coords;
            let pixel = camera.project(&Vector3::new(point.x, point.y, point.z))?;
            let inside = pixel.x > 8.0 && pixel.y > 8.0;
            (inside && pixel.x < f64::from(SENSOR.width) - 9.0 && pixel.y < f64::from(SENSOR.height) - 9.0)
                .then_some(pixel)
        };
        let mut circles = Vec::new();
        for index in 0..board.circle_count() {
            let center = board.circle_center(index);
            let rim = project(center.x + board.radius, center.y);
            let (Some(pixel), Some(rim)) = (project(center.x, center.y), rim) else { continue };
            if random() < 0.03 {
                continue;
            }
            let (length, angle) = (0.07 * random(), TAU * random());
            circles.push((pixel.x + length * angle.cos(), pixel.y + length * angle.sin(), (rim - pixel).norm()));
        }
        for _ in 0..2 {
            circles.push((346.0 * random(), 260.0 * random(), 3.0 + 8.0 * random()));
        }
        for &(x, y, radius) in &circles {
            let circle = Circle {
                window,
                time_us: start_us + 2000,
                x: x as f32,
                y: y as f32,
                radius: radius as f32,
                ..Circle::default()
            };
            frames.push(encoder.encode(&Message::Circle(circle)).to_vec());
        }
        let circles = circles.len() as u16;
        let end = WindowEnd { window, start_us, length_us: 4000, circles, ..WindowEnd::default() };
        frames.push(encoder.encode(&Message::WindowEnd(end)).to_vec());
    }
    frames
}

fn evcal(arguments: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_evcal"))
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn json(output: &Output) -> Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn calibrate(input: &str, output: &Path) -> Child {
    evcal(&["calibrate", input, "--board", BOARD, "-o", text(output), "--json", "--accept-any"])
}

fn assert_near_truth(calibration: &Value) {
    let parameter = |name: &str| calibration["camera"]["parameters"][name].as_f64().unwrap();
    for (index, name, tolerance) in [(0, "fx", 0.003 * 330.0), (1, "fy", 0.003 * 330.0), (2, "cx", 1.0), (3, "cy", 1.0)]
    {
        let error = parameter(name) - LENS[index];
        assert!(error.abs() < tolerance, "{name} is off by {error}");
    }
}

fn notes(calibration: &Value) -> String {
    calibration["stages"]["recordings"][0]["notes"].to_string()
}

/// A pseudo-terminal: the device's end, the path of the computer's end, and that end, kept open but not locked, so that
/// bytes wait in it until the program starts.
#[expect(unsafe_code, reason = "serialport gives no handle that the safe wrappers of fcntl take")]
fn port_pair() -> (TTYPort, PathBuf, File) {
    let (device, computer) = TTYPort::pair().unwrap();
    // A program that inherited the device's end would never see it close.
    // SAFETY: a flag is set on a descriptor that `device` owns.
    assert_eq!(unsafe { libc::fcntl(device.as_raw_fd(), libc::F_SETFD, libc::FD_CLOEXEC) }, 0);
    let path = PathBuf::from(computer.name().unwrap());
    let open = File::open(&path).unwrap();
    (device, path, open)
}

#[test]
fn a_stream_is_calibrated_from_a_file_and_from_a_serial_port_alike() {
    let directory = TempDir::new().unwrap();
    let bytes = frames().concat();
    let file = directory.path().join("stream");
    fs::write(&file, &bytes).unwrap();
    let from_file = json(&calibrate(text(&file), &directory.path().join("file")).wait_with_output().unwrap());
    assert_near_truth(&from_file);
    assert_eq!(from_file["sensor"], serde_json::json!({"width": SENSOR.width, "height": SENSOR.height}));
    assert!(notes(&from_file).contains("test detector"), "{}", notes(&from_file));

    let (mut device, computer, _open) = port_pair();
    let output = directory.path().join("serial");
    let address = format!("serial:{}?baud=115200&seconds=600", computer.display());
    let program = calibrate(&address, &output);
    device.set_timeout(Duration::from_secs(300)).unwrap();
    for part in bytes.chunks(301) {
        device.write_all(part).unwrap();
    }
    device.flush().unwrap();
    // Bytes that are unread when the device closes are lost.
    let saved = || {
        let entries = fs::read_dir(&output).ok()?.map(|entry| entry.unwrap().path());
        entries.into_iter().find(|path| path.extension().is_some_and(|extension| extension == "circles"))
    };
    let arrived = || saved().is_some_and(|path| fs::metadata(path).unwrap().len() == bytes.len() as u64);
    for _ in 0..3000 {
        if arrived() {
            break;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    drop(device);
    let from_port = json(&program.wait_with_output().unwrap());
    assert_eq!(fs::read(saved().unwrap()).unwrap(), bytes);
    assert_eq!(from_port["camera"], from_file["camera"]);
    assert!(notes(&from_port).contains("ended after"), "{}", notes(&from_port));
}

/// A device does not send its data again.
#[test]
fn a_stream_that_was_saved_is_never_overwritten() {
    let directory = TempDir::new().unwrap();
    let output = directory.path().join("serial");
    fs::create_dir(&output).unwrap();
    let (mut device, computer, _open) = port_pair();
    let name = computer.file_name().unwrap().to_str().unwrap();
    let [first, second] = ["", "-2"].map(|number| output.join(format!("{name}{number}.circles")));
    fs::write(&first, "first").unwrap();
    let errors = |program: Child| {
        let ended = program.wait_with_output().unwrap();
        assert_eq!(ended.status.code(), Some(1));
        String::from_utf8(ended.stderr).unwrap()
    };

    let listen = |options: &str| format!("serial:{}?{options}", computer.display());
    // The device sends nothing.
    let program = evcal(&["calibrate", &listen("baud=115200&seconds=0.2"), "--board", BOARD, "-o", text(&output)]);
    let printed = errors(program);
    assert!(printed.contains("no circle in 0 bytes"), "{printed}");
    assert!(!second.exists());
    let printed = errors(evcal(&["detect", &listen(&format!("baud=115200&seconds=0.2&save={}", text(&first)))]));
    assert!(printed.contains("is there already: choose another name"), "{printed}");

    let program = evcal(&["calibrate", &listen("baud=115200&seconds=600"), "--board", BOARD, "-o", text(&output)]);
    device.write_all(b"no circle").unwrap();
    device.flush().unwrap();
    for _ in 0..3000 {
        if fs::metadata(&second).is_ok_and(|there| there.len() == 9) {
            break;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    drop(device);
    let printed = errors(program);
    assert!(printed.contains("no circle in 9 bytes"), "{printed}");
    assert_eq!(fs::read(&second).unwrap(), b"no circle");
    assert_eq!(fs::read(&first).unwrap(), b"first");
}

/// The program once saved 219 MB from a port that sent no circle.
#[test]
fn listening_ends_if_no_circle_is_received() {
    let directory = TempDir::new().unwrap();
    let output = directory.path().join("calibration");
    let (mut device, computer, open) = port_pair();
    let saved = directory.path().join("saved");
    let address = format!("serial:{}?seconds=600&save={}", computer.display(), text(&saved));
    let program = evcal(&["calibrate", &address, "--board", BOARD, "-o", text(&output)]);
    let sending = std::thread::spawn(move || while device.write_all(&[7; 4096]).is_ok() {});
    let ended = program.wait_with_output().unwrap();
    drop(open);
    drop(sending);
    let printed = String::from_utf8(ended.stderr).unwrap();
    assert!(ended.status.code() == Some(1) && printed.contains("after 4 MB without a circle"), "{printed}");
    assert!(fs::metadata(&saved).unwrap().len() < (4 << 20) + 8192);
}

#[test]
fn a_damaged_stream_is_calibrated_with_what_is_left() {
    let directory = TempDir::new().unwrap();
    let mut bytes = frames().concat();
    // Starts in the middle of a frame; every 40th frame has a changed byte; one part is missing.
    bytes.drain(..20);
    for byte in bytes.iter_mut().skip(500).step_by(1201) {
        *byte ^= 0x55;
    }
    bytes.drain(100_000..103_000);
    let file = directory.path().join("stream");
    fs::write(&file, &bytes).unwrap();
    let arguments = [text(&file), "--board", BOARD, "--sensor", "346x260", "--json"];
    let output = directory.path().join("calibration");
    let calibration = evcal(&[["calibrate"].as_slice(), &arguments, &["--accept-any", "-o", text(&output)]].concat());
    let calibration = json(&calibration.wait_with_output().unwrap());
    assert_near_truth(&calibration);
    let notes = notes(&calibration);
    assert!(notes.contains("arrived damaged") && notes.contains("are missing"), "{notes}");
}

#[test]
fn detection_puts_the_circles_of_a_stream_in_order() {
    let directory = TempDir::new().unwrap();
    let (file, track) = (directory.path().join("stream"), directory.path().join("circles.csv"));
    fs::write(&file, frames().concat()).unwrap();
    let detect = |options: &[&str]| {
        let arguments = [["detect", text(&file), "-o", text(&track), "--force", "--json"].as_slice(), options].concat();
        json(&evcal(&arguments).wait_with_output().unwrap())
    };
    let report = detect(&["--board", BOARD]);
    assert_eq!(report["windows"], WINDOWS);
    assert!(report["found"].as_u64().unwrap() > u64::from(WINDOWS) * 8 / 10, "{report}");
    let written = fs::read_to_string(&track).unwrap();
    assert!(written.contains("# time_origin_us 3000000\n"), "{written:.200}");
    assert!(written.contains("# sensor "), "{written:.200}");
    let circles = |track: &str| track.lines().filter(|line| !line.starts_with('#')).count() as u64 - 1;
    assert_eq!(circles(&written), report["board_circles"].as_u64().unwrap());

    let all = detect(&["--fewest", "1"]);
    assert_eq!(all["found"], WINDOWS);
    assert_eq!(circles(&fs::read_to_string(&track).unwrap()), all["circles"].as_u64().unwrap());
}

#[test]
fn unusable_streams_are_reported() {
    let directory = TempDir::new().unwrap();
    let output = directory.path().join("never");
    let run = |input: &str| {
        let output = calibrate(input, &output).wait_with_output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let (code, message) = run("serial:/dev/ttyNONE?bits=8");
    assert!(code == Some(2) && message.contains("\"bits\"") && message.contains("serial:PORT"), "{message}");
    let (code, message) = run("serial:/dev/ttyNONE");
    assert!(code == Some(1) && message.contains("/dev/ttyNONE") && message.contains("plugged in"), "{message}");
    let (mut device, computer, _open) = port_pair();
    device.write_all(b"no circles here").unwrap();
    let (code, message) = run(&format!("serial:{}?seconds=1", computer.display()));
    assert!(code == Some(1) && message.contains("no circle in 15 bytes") && message.contains("baud"), "{message}");
}
