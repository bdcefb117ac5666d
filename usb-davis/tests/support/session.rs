//! A short session with every kind of data that a camera sends: frames of both shutters with events between their
//! columns, an IMU sample, a signal.

use usb_davis::emulator::Piece;
use usb_davis::protocol::{
    Encoder, Frame, ImuModel, ImuSample, ImuScale, Layout, Message, Polarity, PolarityEvent, Region, Shutter, Signal,
    SignalEvent, frame_steps,
};

const SHUTTERS: [Shutter; 3] = [Shutter::Global, Shutter::Rolling, Shutter::Global];
const SAMPLE: ImuSample = ImuSample {
    time: 70_000,
    acceleration: Some([1, -2, 8192]),
    angular_velocity: Some([-300, 400, 500]),
    temperature: Some(1000),
    scale: ImuScale { accelerometer: 1, gyroscope: 1 },
    model: ImuModel::Mpu9250,
};
const SIGNAL: SignalEvent = SignalEvent { time: 70_001, signal: Signal::ExternalInputPulse };

fn pixels() -> Vec<u16> {
    (0..346 * 260).map(|index| (index * 7 % 1024) as u16).collect()
}

/// Returns the session as one piece.
pub fn session() -> impl Iterator<Item = Piece> + Send + 'static {
    let pixels = pixels();
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(Layout::DAVIS346);
    for (index, shutter) in (0..).zip(SHUTTERS) {
        let start = 20_000 * index;
        let frame = Frame {
            shutter,
            start,
            exposure_start: Some(start + 5000),
            exposure_end: Some(start + 9000),
            end: start + 15_000,
            exposure_cycles: 120_960,
            region: Region { x: 0, y: 0, width: 346, height: 260 },
            damaged_columns: 0,
            pixels: &pixels,
        };
        for (time, step) in frame_steps(&Layout::DAVIS346, &frame) {
            encoder.frame_step(time, &frame, step, &mut bytes).expect("in order");
            let event = PolarityEvent { time, x: 3, y: 4, polarity: Polarity::On };
            encoder.event(&event, &mut bytes).expect("in order");
        }
    }
    encoder.imu(&SAMPLE, &mut bytes).expect("in order");
    encoder.signal(&SIGNAL, &mut bytes).expect("in order");
    std::iter::once(Piece { time: 0, bytes })
}

/// Data received of the session.
#[derive(Default)]
pub struct Received {
    frames: Vec<(u64, Option<u64>, u64, Shutter, u16)>,
    samples: Vec<ImuSample>,
    signals: Vec<SignalEvent>,
    events: usize,
}

impl Received {
    /// Adds a message, and checks the pixels of a frame.
    pub fn take(&mut self, message: &Message<'_>) {
        match message {
            Message::Frame(frame) => {
                assert_eq!(frame.pixels, pixels());
                let (middle, damage) = (frame.exposure_middle(), frame.damaged_columns);
                self.frames.push((frame.start, middle, frame.end, frame.shutter, damage));
            }
            Message::Imu(sample) => self.samples.push(*sample),
            Message::Signal(signal) => self.signals.push(*signal),
            Message::Events(events) => self.events += events.len(),
            other => panic!("{other:?}"),
        }
    }

    /// Asserts that exactly the session was received.
    pub fn check(&self) {
        let expected = [
            (0, Some(7000), 15_000, Shutter::Global, 0),
            (20_000, Some(27_000), 35_000, Shutter::Rolling, 0),
            (40_000, Some(47_000), 55_000, Shutter::Global, 0),
        ];
        assert_eq!(self.frames, expected);
        assert_eq!((&self.samples[..], &self.signals[..]), (&[SAMPLE][..], &[SIGNAL][..]));
        assert_eq!(self.events, 3 * (2 * 260 + 4));
    }
}
