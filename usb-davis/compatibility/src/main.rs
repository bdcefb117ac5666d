//! Receives events from the first camera with the crate neuromorphic-drivers, and prints their number and a checksum:
//! `usb-davis-compatibility COUNT`.

use std::error::Error;
use std::time::{Duration, Instant};

use neuromorphic_drivers::types::Polarity;
use neuromorphic_drivers::{GenericDevice, Identifier, inivation_davis346};
use usb_davis_compatibility::Checksum;

fn main() -> Result<(), Box<dyn Error>> {
    let wanted: u64 = std::env::args().nth(1).ok_or("how many events?")?.parse()?;
    let (flag, event_loop) = neuromorphic_drivers::flag_and_event_loop()?;
    let device = inivation_davis346::open(
        Identifier::None,
        inivation_davis346::DEFAULT_CONFIGURATION,
        &inivation_davis346::RING_CONFIGURATION,
        event_loop,
        flag.clone(),
    )?;
    let mut adapter = device.create_adapter();
    let mut checksum = Checksum::default();
    let end = Instant::now() + Duration::from_secs(60);
    while checksum.count() < wanted && Instant::now() < end {
        if let Some(view) = device.next_with_timeout(&Duration::from_millis(100)) {
            let take = |event: neuromorphic_drivers::types::PolarityEvent<u64, u16, u16>| {
                checksum.add(event.t, event.x, event.y, event.polarity == Polarity::On);
            };
            adapter.convert(view.slice, take, |_| {}, |_| {}, |_| {});
        }
        flag.load_error()?;
    }
    println!("{} {checksum} {}", device.serial(), device.dropped_packets());
    Ok(())
}
