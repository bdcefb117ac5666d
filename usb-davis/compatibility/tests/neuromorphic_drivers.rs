//! An unmodified third-party driver opens the emulated camera and receives the same events.

use std::process::Command;
use std::time::Duration;

use usb_davis::emulator::umockdev::EmulatedBus;
use usb_davis::emulator::{Model, Piece};
use usb_davis::protocol::{Encoder, Layout, Polarity, PolarityEvent};
use usb_davis_compatibility::Checksum;

const COUNT: u64 = 2_000_000;

fn event(index: u64) -> PolarityEvent {
    let mixed = index.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 32;
    PolarityEvent {
        time: index / 2,
        x: (mixed % 346) as u16,
        y: (mixed / 346 % 260) as u16,
        polarity: if mixed & 0x80_0000 == 0 { Polarity::Off } else { Polarity::On },
    }
}

#[test]
fn receives_the_same_events() {
    let source = || {
        let mut encoder = Encoder::new(Layout::DAVIS346);
        (0..COUNT).step_by(4000).map(move |first| {
            let mut bytes = Vec::new();
            for index in first..first + 4000 {
                encoder.event(&event(index), &mut bytes).expect("in order");
            }
            Piece { time: event(first).time, bytes }
        })
    };
    let mut expected = Checksum::default();
    for PolarityEvent { time, x, y, polarity } in (0..COUNT).map(event) {
        expected.add(time, x, y, polarity == Polarity::On);
    }
    // This driver starts the camera before it queues its transfers, and numbers each transfer when it queues it, so
    // transfers that complete in between would be out of order.
    let model = Model::new("00000042", source).with_delay(Duration::from_millis(500));
    let bus = EmulatedBus::start(model).expect("the bus starts");
    let output = Command::new(env!("CARGO_BIN_EXE_usb-davis-compatibility"))
        .arg(COUNT.to_string())
        .envs(bus.environment())
        .output()
        .expect("it runs");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), format!("00000042 {expected} 0"), "{errors}");
}
