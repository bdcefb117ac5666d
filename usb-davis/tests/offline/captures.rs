//! pcap and pcapng files of USB traffic, written by an independent library, and bare payload.

use std::borrow::Cow;
use std::io::Cursor;
use std::time::Duration;

use pcap_file::pcap::{PcapHeader, PcapPacket, PcapWriter};
use pcap_file::pcapng::PcapNgWriter;
use pcap_file::pcapng::blocks::enhanced_packet::EnhancedPacketBlock;
use pcap_file::pcapng::blocks::interface_description::InterfaceDescriptionBlock;
use pcap_file::{DataLink, Endianness, TsResolution};
use usb_davis::capture::{Capture, CaptureError, CaptureFormat, DeviceAddress};
use usb_davis::dump::TransferStatus;
use usb_davis::protocol::{AnomalyKind, Encoder, Layout, Message, Polarity, PolarityEvent};
use usb_davis::registers::{aps, dvs};

fn events(count: u64) -> Vec<PolarityEvent> {
    (0..count)
        .map(|index| PolarityEvent {
            time: 40 * index,
            x: (index * 7 % 346) as u16,
            y: (index * 11 % 260) as u16,
            polarity: if index % 3 == 0 { Polarity::On } else { Polarity::Off },
        })
        .collect()
}

fn payload(events: &[PolarityEvent]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(Layout::DAVIS346);
    events.iter().for_each(|event| encoder.event(event, &mut bytes).expect("in order"));
    bytes
}

/// Beginning or end of a USB transfer.
struct Usb<'a> {
    device: u8,
    id: u64,
    completion: bool,
    transfer: u8,
    endpoint: u8,
    status: i32,
    setup: Option<[u8; 8]>,
    data: &'a [u8],
    /// Length of the transfer.
    length: usize,
}

fn usbmon(usb: &Usb<'_>, header: usize, big_endian: bool) -> Vec<u8> {
    let mut bytes = vec![0; header];
    let mut put = |at: usize, little: &[u8]| {
        let mut number = little.to_vec();
        if big_endian {
            number.reverse();
        }
        bytes[at..at + number.len()].copy_from_slice(&number);
    };
    put(0, &usb.id.to_le_bytes());
    put(8, &[if usb.completion { b'C' } else { b'S' }]);
    put(9, &[usb.transfer]);
    put(10, &[usb.endpoint]);
    put(11, &[usb.device]);
    put(12, &2u16.to_le_bytes());
    put(14, &[if usb.setup.is_some() { 0 } else { b'-' }]);
    put(15, &[if usb.data.is_empty() { b'<' } else { 0 }]);
    put(28, &usb.status.to_le_bytes());
    put(32, &(usb.length as u32).to_le_bytes());
    put(36, &(usb.data.len() as u32).to_le_bytes());
    bytes[40..48].copy_from_slice(&usb.setup.unwrap_or_default());
    bytes.extend(usb.data);
    bytes
}

fn usbpcap(usb: &Usb<'_>) -> Vec<u8> {
    let control = usb.transfer == 2;
    let setup: Vec<u8> = usb.setup.into_iter().flatten().collect();
    let mut bytes = Vec::new();
    bytes.extend((if control { 28u16 } else { 27 }).to_le_bytes());
    bytes.extend(usb.id.to_le_bytes());
    let status: u32 = match usb.status {
        0 => 0,
        -2 => 0xC001_0000,
        _ => 0xC000_0004,
    };
    bytes.extend(status.to_le_bytes());
    bytes.extend(9u16.to_le_bytes());
    bytes.push(u8::from(usb.completion));
    bytes.extend(2u16.to_le_bytes());
    bytes.extend(u16::from(usb.device).to_le_bytes());
    bytes.extend([usb.endpoint, usb.transfer]);
    bytes.extend(((setup.len() + usb.length) as u32).to_le_bytes());
    if control {
        bytes.push(if usb.completion { 3 } else { 0 });
    }
    bytes.extend(setup);
    bytes.extend(usb.data);
    bytes
}

/// Submission and completion of a control transfer.
fn control(device: u8, id: u64, setup: [u8; 8], data: &'static [u8]) -> [Usb<'static>; 2] {
    let read = setup[0] & 0x80 != 0;
    let endpoint = setup[0] & 0x80;
    let end = |completion, setup, data: &'static [u8]| Usb {
        device,
        id,
        completion,
        transfer: 2,
        endpoint,
        status: 0,
        setup,
        data,
        length: data.len(),
    };
    if read {
        [end(false, Some(setup), &[]), end(true, None, data)]
    } else {
        [end(false, Some(setup), data), end(true, None, &[])]
    }
}

fn bulk(device: u8, id: u64, data: &[u8]) -> Usb<'_> {
    Usb { device, id, completion: true, transfer: 3, endpoint: 0x82, status: 0, setup: None, data, length: data.len() }
}

const DESCRIPTOR: &[u8] = &[18, 1, 0, 3, 0, 0, 0, 9, 0x2A, 0x15, 0x1A, 0x84, 6, 0, 1, 2, 3, 1];
const SERIAL: &[u8] = &[10, 3, b'A', 0, b'B', 0, b'1', 0, b'2', 0];

/// Enumeration, three register reads and one write.
fn enumeration(device: u8) -> Vec<Usb<'static>> {
    let mut packets = Vec::new();
    packets.extend(control(device, 1, [0x80, 6, 0, 1, 0, 0, 18, 0], DESCRIPTOR));
    packets.extend(control(device, 2, [0x80, 6, 3, 3, 9, 4, 255, 0], SERIAL));
    packets.extend(control(device, 3, [0xC0, 0xBF, 1, 0, 0, 0, 4, 0], &[0, 0, 1, 4]));
    packets.extend(control(device, 3, [0xC0, 0xBF, 2, 0, 2, 0, 4, 0], &[0, 0, 0, 7]));
    packets.extend(control(device, 4, [0x40, 0xBF, 2, 0, 12, 0, 4, 0], &[0, 1, 2, 3]));
    packets.extend(control(device, 5, [0x40, 0xC2, 1, 0, 0, 0, 6, 0], &[1, 3, 0, 0, 0, 1]));
    packets
}

fn pcap(link: u32, big_endian: bool, packets: &[Usb<'_>]) -> Vec<u8> {
    let endianness = if big_endian { Endianness::Big } else { Endianness::Little };
    let header = PcapHeader {
        datalink: DataLink::from(link),
        endianness,
        ts_resolution: TsResolution::NanoSecond,
        ..PcapHeader::default()
    };
    let mut writer = PcapWriter::with_header(Vec::new(), header).expect("a vector takes it");
    for (index, usb) in packets.iter().enumerate() {
        let data = bytes(link, big_endian, usb);
        let time = Duration::new(1000, 1000 * index as u32);
        let packet = PcapPacket { timestamp: time, orig_len: data.len() as u32, data: Cow::Owned(data) };
        writer.write_packet(&packet).expect("a vector takes it");
    }
    writer.into_writer()
}

fn bytes(link: u32, big_endian: bool, usb: &Usb<'_>) -> Vec<u8> {
    match link {
        189 => usbmon(usb, 48, big_endian),
        220 => usbmon(usb, 64, big_endian),
        _ => usbpcap(usb),
    }
}

fn pcapng(link: u32, packets: &[Usb<'_>]) -> Vec<u8> {
    let mut writer = PcapNgWriter::with_endianness(Vec::new(), Endianness::native()).expect("a vector takes it");
    let other = InterfaceDescriptionBlock { linktype: DataLink::ETHERNET, snaplen: 0, options: vec![] };
    writer.write_pcapng_block(other).expect("a vector takes it");
    let interface = InterfaceDescriptionBlock { linktype: DataLink::from(link), snaplen: 0, options: vec![] };
    writer.write_pcapng_block(interface).expect("a vector takes it");
    for (index, usb) in packets.iter().enumerate() {
        let data = bytes(link, cfg!(target_endian = "big"), usb);
        let block = EnhancedPacketBlock {
            interface_id: 1,
            timestamp: Duration::from_micros(index as u64),
            original_len: data.len() as u32,
            data: Cow::Owned(data),
            options: vec![],
        };
        writer.write_pcapng_block(block).expect("a vector takes it");
    }
    writer.into_inner()
}

/// Returns all events of a capture, and the number of its gaps.
fn decode(file: Vec<u8>) -> (Vec<PolarityEvent>, u64, Capture<Cursor<Vec<u8>>>) {
    let mut capture = Capture::new(Cursor::new(file), None).expect("it is a capture");
    let mut decoder = capture.header().decoder();
    let mut events = Vec::new();
    let mut sink = |message: Message<'_>| {
        if let Message::Events(new) = message {
            events.extend_from_slice(new);
        }
    };
    while capture.decode_next(&mut decoder, &mut sink).expect("it is whole") {}
    let gaps = decoder.counts().anomalies.of(AnomalyKind::Gap);
    assert_eq!(decoder.counts().anomalies.total(), gaps);
    (events, gaps, capture)
}

#[test]
fn all_link_types_decode_to_the_same_events() {
    let expected = events(3000);
    let payload = payload(&expected);
    let mut packets = enumeration(5);
    // Another device on the bus, with bulk traffic of its own.
    packets.extend(control(
        4,
        9,
        [0x80, 6, 0, 1, 0, 0, 18, 0],
        &[18, 1, 0, 2, 0, 0, 0, 64, 1, 2, 3, 4, 0, 0, 1, 2, 3, 1],
    ));
    for (index, piece) in payload.chunks(513).enumerate() {
        packets.push(Usb { completion: false, data: &[], length: 513, ..bulk(5, 100 + index as u64, &[]) });
        packets.push(bulk(5, 100 + index as u64, piece));
        packets.push(bulk(4, 500, b"not of the camera"));
    }
    packets.push(Usb { status: -2, ..bulk(5, 1000, &[]) });
    // Switching off at the end must not affect the header.
    packets.extend(control(5, 7, [0x40, 0xBF, 1, 0, 3, 0, 4, 0], &[0, 0, 0, 0]));
    let mut files = vec![pcap(189, false, &packets), pcap(220, false, &packets), pcap(220, true, &packets)];
    files.extend([pcap(249, false, &packets), pcapng(220, &packets), pcapng(249, &packets)]);
    for (index, file) in files.into_iter().enumerate() {
        let (events, gaps, capture) = decode(file);
        assert_eq!(capture.format(), CaptureFormat::Packets, "file {index}");
        assert_eq!((events.len(), gaps), (expected.len(), 0), "file {index}");
        assert_eq!(events, expected);
        let header = capture.header();
        let identity = header.identity.clone().expect("the descriptor is there");
        assert_eq!((identity.vendor_id, identity.product_id, identity.firmware()), (0x152A, 0x841A, 6));
        assert_eq!(identity.serial, "AB12");
        assert_eq!(header.registers.get(dvs::SIZE_COLUMNS), Some(260));
        assert_eq!(header.registers.get(aps::EXPOSURE), Some(0x010203));
        assert_eq!(header.registers.get(dvs::RUN), Some(1));
        assert!(header.registers.layout().aps.mirror_columns && header.registers.layout().aps.mirror_rows);
    }
}

#[test]
fn cut_transfers_are_gaps() {
    let all = events(3000);
    let payload = payload(&all);
    let pieces: Vec<&[u8]> = payload.chunks(1024).collect();
    let mut packets = enumeration(5);
    for (index, piece) in pieces.iter().enumerate() {
        let kept = if index == 2 { &piece[..100] } else { piece };
        packets.push(Usb { length: piece.len(), ..bulk(5, index as u64, kept) });
    }
    let (events, gaps, _) = decode(pcap(220, false, &packets));
    assert_eq!(gaps, 1);
    let lost = all.len() - events.len();
    assert!((100..300).contains(&lost), "{lost} events lost");
    assert!(events.iter().all(|event| all.contains(event)));
    // The data of a failed transfer are not used.
    let failed = pieces.iter().enumerate().map(|(index, piece)| {
        let status = if index == 2 { -71 } else { 0 };
        Usb { status, ..bulk(5, index as u64, piece) }
    });
    let (events, gaps, _) = decode(pcap(220, false, &failed.collect::<Vec<_>>()));
    assert_eq!(gaps, 1);
    assert!(events.len() < all.len() - 100 && events.iter().all(|event| all.contains(event)));
}

#[test]
fn the_camera_is_found_without_enumeration_or_chosen() {
    let expected = events(100);
    let payload = payload(&expected);
    // Only register traffic distinguishes device 5 from device 4.
    let mut packets = enumeration(5).split_off(4);
    packets.extend([bulk(5, 1, &payload), bulk(4, 2, &payload[..20])]);
    let (events, _, capture) = decode(pcap(220, false, &packets));
    assert_eq!(events, expected);
    assert_eq!(capture.header().identity, None);
    // Nothing distinguishes them.
    let file = pcap(220, false, &[bulk(5, 1, &payload), bulk(4, 2, &payload)]);
    let (four, five) = (DeviceAddress { bus: 2, device: 4 }, DeviceAddress { bus: 2, device: 5 });
    match Capture::new(Cursor::new(file.clone()), None) {
        Err(CaptureError::SeveralDevices(devices)) => assert_eq!(devices, [four, five]),
        other => panic!("{:?}", other.err()),
    }
    let mut capture = Capture::new(Cursor::new(file.clone()), Some(five)).expect("it is there");
    assert_eq!(capture.next_transfer().expect("it is whole").expect("it is there").payload, payload);
    let six = DeviceAddress { bus: 2, device: 6 };
    assert!(matches!(Capture::new(Cursor::new(file), Some(six)), Err(CaptureError::NoSuchDevice(_))));
    assert!(matches!(Capture::new(Cursor::new(pcap(220, false, &[])), None), Err(CaptureError::NoCamera)));
}

#[test]
fn a_capture_that_ends_within_a_packet() {
    let expected = events(500);
    let payload = payload(&expected);
    let packets: Vec<Usb<'_>> = payload.chunks(512).map(|piece| bulk(5, 1, piece)).collect();
    let but_last = &packets[..packets.len() - 1];
    for (file, begins) in [
        (pcap(220, false, &packets), pcap(220, false, but_last).len()),
        (pcapng(220, &packets), pcapng(220, but_last).len()),
    ] {
        for length in [begins, begins + 1, begins + 7, begins + 50, file.len() - 1] {
            let (events, gaps, capture) = decode(file[..length].to_vec());
            assert!(events.len() > 300 && expected.starts_with(&events), "{}", events.len());
            assert_eq!((gaps, capture.damage().unfinished), (0, (length - begins) as u64));
        }
    }
}

/// The data before the damage are returned, then an error names its byte.
#[test]
fn a_capture_is_read_up_to_its_damage() {
    let expected = events(500);
    let payload = payload(&expected);
    let mut packets = enumeration(5);
    packets.extend(payload.chunks(512).map(|piece| bulk(5, 100, piece)));
    let head = [1000u32, 0, 0x7FFF_FFFF, 64].map(u32::to_le_bytes).concat();
    let mut block = [6u32, 5].map(u32::to_le_bytes).concat();
    block.extend(b"garbage!");
    for (whole, damage, what) in [
        (pcap(220, false, &packets), head, "a packet of 2147483647 bytes"),
        (pcapng(220, &packets), block, "a block of 5 bytes"),
    ] {
        let place = whole.len() as u64;
        let behind = whole[whole.len() / 2..].to_vec();
        let mut capture = Capture::new(Cursor::new([whole, damage, behind].concat()), None).expect("a capture");
        assert_eq!(capture.header().identity.as_ref().map(|identity| &identity.serial[..]), Some("AB12"));
        let (mut decoder, mut read) = (capture.header().decoder(), Vec::new());
        let error = loop {
            let more = capture.decode_next(&mut decoder, |message| {
                if let Message::Events(new) = message {
                    read.extend_from_slice(new);
                }
            });
            match more {
                Ok(more) => assert!(more, "the damage is passed over"),
                Err(error) => break error,
            }
        };
        assert_eq!(read, expected);
        assert!(matches!(error, CaptureError::Damaged { byte, .. } if byte == place), "{error}");
        assert!(error.to_string().ends_with(&format!("at byte {place}: {what}")), "{error}");
    }
}

#[test]
fn a_capture_whose_header_is_incomplete_is_damaged_from_its_beginning() {
    for whole in [pcap(220, false, &[]), pcapng(220, &[])] {
        for length in [4, 11, 15] {
            let error = Capture::new(Cursor::new(whole[..length].to_vec()), None).err().expect("it is damaged");
            assert!(matches!(error, CaptureError::Damaged { byte: 0, .. }), "{error}");
        }
    }
}

/// A simple packet of 12 bytes has no room for its length; the remaining length must not underflow.
#[test]
fn blocks_that_are_too_short_for_a_packet_are_rejected() {
    let block = |kind: u32, body: &[u8]| {
        let length = (body.len() as u32 + 12).to_le_bytes();
        [&kind.to_le_bytes()[..], &length, body, &length].concat()
    };
    let section =
        block(0x0A0D_0D0A, &[0x4D, 0x3C, 0x2B, 0x1A, 1, 0, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF]);
    let interface = block(1, &[220, 0, 0, 0, 0, 0, 0, 0]);
    for (kind, length) in [(3, 0), (6, 0), (6, 16)] {
        let file = [section.clone(), interface.clone(), block(kind, &[0; 16][..length])].concat();
        let error = Capture::new(Cursor::new(file), None).err().expect("it is damaged").to_string();
        assert!(error.contains(&format!("a block of {} bytes", length + 12)), "{error}");
    }
}

#[test]
fn bare_payload_is_recognised_by_its_words() {
    let expected = events(100_000);
    let (events, gaps, capture) = decode(payload(&expected));
    assert_eq!((events.len(), gaps), (expected.len(), 0));
    assert_eq!(capture.format(), CaptureFormat::BarePayload);
    let transfer = Capture::new(Cursor::new(payload(&expected)), None).expect("it is a stream");
    assert!(transfer.header().registers.is_empty());
    for other in [
        &b"#!AER-DAT4.0\r\n0123456789"[..],
        &b"t,x,y,p\n12,3,4,1\n13,5,6,0\n".repeat(100),
        &[0; 4000],
        &[],
        &[0xFF; 100],
    ] {
        assert!(matches!(Capture::new(Cursor::new(other.to_vec()), None), Err(CaptureError::Unknown)));
    }
    assert_eq!(TransferStatus::Completed as u8, 0);
}
