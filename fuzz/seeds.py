"""Makes the seeds of fuzz/corpus that other programs can write: small recordings with frames, pictures and IMU samples, in
every compression, and calibrations in every program's format.

    sh tools/setup/readers.sh
    target/readers/bin/python fuzz/seeds.py target/release/evcal
"""

import io
import json
import pathlib
import sqlite3
import struct
import subprocess
import sys
import tempfile
import zlib

import cv2
import h5py
import numpy as np

repository = pathlib.Path(__file__).resolve().parent.parent
sys.path.insert(0, str(repository / "tests/readers"))
import hdf5
import recordings

CORPUS = repository / "fuzz/corpus"
SIZE = (16, 12)
START = 1_000_000
EVENTS = [(START + 37 * index, index * 7 % SIZE[0], index // 3 * 5 % SIZE[1], index % 2) for index in range(72)]
PICTURE = (np.arange(SIZE[0] * SIZE[1], dtype="u1") * 5 % 251).reshape(SIZE[1], SIZE[0])


def put(target, name, data):
    folder = CORPUS / target
    folder.mkdir(exist_ok=True)
    (folder / f"seed-{name}").write_bytes(data)


def pieces(*parts):
    """Each after two bytes with its length: the files of a folder."""
    return b"".join(struct.pack("<H", len(part)) + part for part in parts)


# ---- ROS


def pictures():
    colour = np.stack([PICTURE, PICTURE[::-1], PICTURE[:, ::-1]], axis=2)
    deep = PICTURE.astype("u2") << 4
    return [
        ("mono8", PICTURE),
        ("rgb8", colour),
        ("bgr8", colour),
        ("mono16", deep),
        ("bayer_rggb8", PICTURE),
        ("bayer_gbrg16", deep),
    ]


def compressed_pictures():
    yield "jpeg", cv2.imencode(".jpg", PICTURE)[1]
    yield "png", cv2.imencode(".png", PICTURE.astype("u2") << 4)[1]
    yield "bayer_bggr8; png compressed", cv2.imencode(".png", PICTURE)[1]


def other_messages(store, ros):
    """(topic, type, time, message) of frames, pictures of other cameras and IMU samples."""
    types = store.types
    for number, (encoding, pixels) in enumerate(pictures()):
        t = START + 400 * number
        image = types["sensor_msgs/msg/Image"](
            recordings.header(types, ros, t), SIZE[1], SIZE[0], encoding, 0,
            pixels.strides[0], np.frombuffer(pixels.tobytes(), dtype="u1"),
        )
        topic = "/dvs/image_raw" if encoding == "mono8" else f"/camera{number}/image_raw"
        yield topic, "sensor_msgs/msg/Image", t, image
    for number, (encoding, data) in enumerate(compressed_pictures()):
        t = START + 500 * number
        image = types["sensor_msgs/msg/CompressedImage"](recordings.header(types, ros, t), encoding, data.ravel())
        yield f"/packed{number}/compressed", "sensor_msgs/msg/CompressedImage", t, image
    vector, zeros = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    for number in range(3):
        t = START + 700 * number
        sample = types["sensor_msgs/msg/Imu"](
            recordings.header(types, ros, t), types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0), zeros,
            vector(0.1 * number, 0.2, 0.3), zeros, vector(0.0, 9.8, 0.1), zeros,
        )
        yield "/dvs/imu", "sensor_msgs/msg/Imu", t, sample


def write_bag(path, compression):
    from rosbags.rosbag1 import Writer

    store = recordings.typestore(1, recordings.EVENT_ARRAY)
    types = store.types
    events = recordings.event_array(types, EVENTS, SIZE)
    writer = Writer(path)
    if compression:
        writer.set_compression(getattr(Writer.CompressionFormat, compression))
    with writer:
        topics = {}
        for topic, kind, t, message in [
            ("/dvs/events", "dvs_msgs/msg/EventArray", START, events),
            *other_messages(store, 1),
        ]:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(topics[topic], t * 1000, store.serialize_ros1(message, kind))


def evt3():
    words, high = [], None
    for t, x, y, p in EVENTS:
        if t >> 12 != high:
            high = t >> 12
            words.append(0x8 << 12 | high & 0xFFF)
        words += [0x6 << 12 | t & 0xFFF, y, 0x2 << 12 | p << 11 | x]
    return "evt3", np.array(words, dtype="<u2").view(np.uint8)


def libcaer():
    words = [((t - START) * 1000, y << 16 | x << 1 | p) for t, x, y, p in EVENTS]
    return "libcaer", np.array(words, dtype="<u4").reshape(-1).view(np.uint8)


def write_rosbag2(folder, storage, compression=None):
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    store = recordings.typestore(2, recordings.EVENT_PACKET)
    types = store.types
    writer = Writer(folder, version=9, storage_plugin=getattr(StoragePlugin, storage))
    if compression:
        writer.set_compression(getattr(CompressionMode, compression), CompressionFormat.ZSTD)
    with writer:
        topics = {}
        packets = [
            (f"/{encoding}/events", "event_camera_msgs/msg/EventPacket", START, types["event_camera_msgs/msg/EventPacket"](
                recordings.header(types, 2, START), SIZE[1], SIZE[0], 0, START * 1000, encoding, False, payload
            ))
            for encoding, payload in (evt3(), libcaer(), ("mono", recordings.mono(EVENTS)))
        ]
        for topic, kind, t, message in [*packets, *other_messages(store, 2)]:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(topics[topic], t * 1000, store.serialize_cdr(message, kind))
    (path,) = [path for path in folder.iterdir() if path.suffix in (".db3", ".mcap")]
    return path


def smaller_pages(path):
    """An SQLite file with the smallest pages, so that its trees have several levels."""
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA journal_mode = DELETE")
    connection.execute("PRAGMA page_size = 512")
    connection.execute("VACUUM")
    connection.close()
    return path.read_bytes()


METADATA = """rosbag2_bagfile_information:
  version: 5
  storage_identifier: mcap
  duration:
    nanoseconds: 2627000
  starting_time:
    nanoseconds_since_epoch: 1000000000
  message_count: 15
  topics_with_message_count:
    - topic_metadata: {name: /evt3/events, type: event_camera_msgs/msg/EventPacket, serialization_format: cdr}
      message_count: 1
  relative_file_paths:
    - '0'
    - bag/1
"""


def ros(folder, evcal):
    for name, compression in (("others", None), ("others-bz2", "BZ2"), ("others-lz4", "LZ4")):
        path = folder / f"{name}.bag"
        write_bag(path, compression)
        put("bag", name, path.read_bytes())
    for suffix, target in (("mcap", "mcap"), ("aedat4", "aedat4")):
        path = folder / f"converted.{suffix}"
        subprocess.run([evcal, "convert", folder / "others.bag", path], check=True, stdout=subprocess.DEVNULL)
        put(target, "others", path.read_bytes())
    mcap = write_rosbag2(folder / "mcap", "MCAP").read_bytes()
    put("mcap", "packets", mcap)
    put("db3", "packets", smaller_pages(write_rosbag2(folder / "db3", "SQLITE3")))
    put("db3", "packed", smaller_pages(write_rosbag2(folder / "packed", "SQLITE3", "MESSAGE")))
    put("ros-folder", "split", METADATA.encode() + b"\0" + pieces(mcap, (folder / "converted.mcap").read_bytes()))


# ---- AEDAT


def aedat2():
    """A DAVIS240 with a frame of 4 x 3 pixels and IMU samples between its events."""
    width, height = 240, 180
    words = []
    for index in range(60):
        words.append(((height - 1 - index) << 22 | (width - 1 - index * 3) << 12 | index % 2 << 11, START + 37 * index))
    for sample in range(2):
        t = START + 300 + 1000 * sample
        words += [(1 << 31 | part << 28 | (100 * part + 7) << 12 | 1 << 11 | 1 << 10, t + part) for part in range(7)]
    for kind, begin, level in ((0, START + 100, 900), (1, START + 900, 300)):
        places = [(column, row) for column in range(8, 12) for row in range(5, 8)]
        words += [
            (1 << 31 | row << 22 | column << 12 | kind << 10 | level + column + row, begin + number)
            for number, (column, row) in enumerate(places)
        ]
    words.sort(key=lambda word: word[1])
    head = b"#!AER-DAT2.0\r\n# This is a raw AE data file\r\n# AEChip: eu.seebetter.ini.chips.davis.DAVIS240C\r\n"
    return head + b"".join(struct.pack(">II", *word) for word in words)


def aedat3(version):
    head = f"#!AER-DAT{version}\r\n#Format: RAW\r\n#Source 1: DAVIS346\r\n#Source 2: DVS128\r\n"
    head += "#Start-Time: 2020-01-01 00:00:00 (TZ+0000)\r\n" + ("#!END-HEADER\r\n" if version == "3.1" else "")

    def packet(kind, source, events, offset):
        size = len(events[0])
        assert all(len(event) == size for event in events)
        numbers = struct.pack("<hhiiiiii", kind, source, size, offset, 0, len(events), len(events), len(events))
        return numbers + b"".join(events)

    polarity = [struct.pack("<II", y << 2 | x << 17 | p << 1 | 1, t) for t, x, y, p in EVENTS]
    sample = [
        struct.pack("<Ii7f", 1, START + 700 * number, 0.1, 1.0, -0.1, 3.0, -4.0, 5.0, 30.0 + number) for number in range(3)
    ]

    def frame(channels):
        values = np.arange(4 * 3 * channels, dtype="<u2") * 1000
        times = [START + 200, START + 1200, START + 300, START + 900]
        return struct.pack("<I8i", 1 | channels << 1, *times, 4, 3, 20, 30) + values.tobytes()

    others = packet(2, 1, [frame(1), frame(1)], 12) + packet(2, 1, [frame(3)], 12) + packet(2, 1, [frame(4)], 12)
    return head.encode() + packet(1, 1, polarity[:40], 4) + others + packet(3, 1, sample, 4) + packet(1, 1, polarity[40:], 4)


def aedat4(folder):
    """With each compression that dv-processing knows."""
    import dv_processing as dv

    for name in ("NONE", "LZ4", "LZ4_HIGH", "ZSTD_HIGH"):
        path = folder / f"{name}.aedat4"
        config = dv.io.MonoCameraWriter.Config("seed", getattr(dv.CompressionType, name))
        config.addEventStream(SIZE)
        config.addFrameStream(SIZE)
        config.addImuStream()
        config.addTriggerStream()
        writer = dv.io.MonoCameraWriter(str(path), config)
        store = dv.EventStore()
        for t, x, y, p in EVENTS:
            store.push_back(t, x, y, bool(p))
        writer.writeEvents(store)
        colour = np.stack([PICTURE] * 3, axis=2)
        for number, pixels in enumerate((PICTURE, colour)):
            writer.writeFrame(dv.Frame(START + 400 * number, 300, 0, 0, pixels, dv.FrameSource.SENSOR))
        writer.writeImu(dv.IMU(START + 500, 30.0, 0.1, 1.0, -0.1, 3.0, -4.0, 5.0, 0.0, 0.0, 0.0))
        writer.writeTrigger(dv.Trigger(START + 600, dv.TriggerType.EXTERNAL_SIGNAL_RISING_EDGE))
        del writer
        put("aedat4", name.lower().replace("_", "-"), path.read_bytes())


# ---- The camera's own stream


def special(number):
    return [number]


def stamp(t):
    return [0x8000 | t & 0x7FFF]


def camera_words():
    """Events, an IMU sample and a frame of 4 x 3 pixels, as the camera sends them: its columns are our rows."""
    words = special(1) + stamp(10)
    for index in range(30):
        words += stamp(20 + 5 * index) + [1 << 12 | index * 9 % 346, (2 + index % 2) << 12 | index * 5 % 260]
    sample = struct.pack(">7h", 100, 4000, -100, 300, 50, -60, 70)
    words += stamp(200) + special(5) + [5 << 12 | 3 << 8 | 0xE5] + [5 << 12 | byte for byte in sample] + stamp(210) + special(7)
    corners = struct.pack(">4H", 6, 5, 8, 8)
    words += stamp(220) + special(8) + [6 << 12 | 100, 6 << 12, 6 << 12]
    words += [5 << 12 | (1 + index % 2) << 8 | byte for index, byte in enumerate(corners)]
    for kind, level in ((11, 800), (12, 300)):
        if kind == 12:
            words += stamp(400) + special(14) + stamp(500) + special(15)
        for column in range(3):
            t = (300 if kind == 11 else 510) + 10 * column
            words += stamp(t) + special(kind) + [4 << 12 | level + row + column for row in range(4)] + stamp(t + 5) + special(13)
    words += stamp(600) + special(10)
    words += [7 << 12 | 1] + stamp(20) + [1 << 12 | 7, 3 << 12 | 9] + stamp(30) + special(2)
    # The same with a rolling shutter, whose reset and signal columns alternate.
    words += stamp(40) + special(9) + [6 << 12 | 100, 6 << 12, 6 << 12]
    words += [5 << 12 | (1 + index % 2) << 8 | byte for index, byte in enumerate(corners)]
    for column in range(4):
        t = 100 + 20 * column
        if column < 3:
            words += stamp(t) + special(11) + [4 << 12 | 800 + row for row in range(4)] + stamp(t + 4) + special(13)
        if column > 0:
            words += stamp(t + 8) + special(12) + [4 << 12 | 300 + row for row in range(4)] + stamp(t + 12) + special(13)
    words += stamp(200) + special(10) + stamp(210)
    return np.array(words, dtype="<u2").tobytes()


DESCRIPTOR = struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x0300, 0, 0, 0, 9, 0x152A, 0x841A, 0x0003, 1, 2, 3, 1)


def usb_packets(payload):
    """(completion, transfer type, endpoint, set-up, data): the camera's descriptor, a register that is read, and its data."""
    yield False, 2, 0x80, struct.pack("<BBHHH", 0x80, 6, 0x0100, 0, 18), b""
    yield True, 2, 0x80, None, DESCRIPTOR
    yield False, 2, 0x80, struct.pack("<BBHHH", 0xC0, 0xBF, 1, 0, 4), b""
    yield True, 2, 0x80, None, struct.pack(">I", 260)
    yield False, 2, 0x00, struct.pack("<BBHHH", 0x40, 0xBF, 1, 3, 4), struct.pack(">I", 1)
    yield True, 2, 0x00, None, b""
    step = len(payload) // 3 & ~1
    for start in range(0, len(payload), step):
        yield False, 3, 0x82, None, b""
        yield True, 3, 0x82, None, payload[start : start + step]


def usbmon(number, packet, header):
    completion, transfer, endpoint, setup, data = packet
    absent = (0 if setup else 0x2D, 0 if data or completion else 0x3C)
    head = struct.pack(
        "<QBBBBHBBqiiII8s", number // 2, ord("C" if completion else "S"), transfer, endpoint, 5, 2, *absent,
        0, 0, 0 if completion else -115, len(data), len(data), setup or b"",
    )
    return head.ljust(header, b"\0") + data


def usbpcap(number, packet):
    completion, transfer, endpoint, setup, data = packet
    control = transfer == 2
    if setup:
        data = setup + data
    stage = bytes([3 if completion else 0]) if control else b""
    return struct.pack(
        "<HQIHBHHBBI", 27 + len(stage), number // 2, 0, 8 if control else 9, completion, 2, 5, endpoint, transfer, len(data)
    ) + stage + data


def pcap(link, packets):
    data = struct.pack("<IHHIIII", 0xA1B23C4D, 2, 4, 0, 0, 1 << 18, link)
    for number, packet in enumerate(packets):
        data += struct.pack("<IIII", 100, 1_000_000 * number, len(packet), len(packet)) + packet
    return data


def pcapng(link, packets):
    def block(kind, body):
        body += b"\0" * (-len(body) % 4)
        return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)

    data = block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
    data += block(1, struct.pack("<HHI", link, 0, 0) + struct.pack("<HHB3xHH", 9, 1, 9, 0, 0))
    for number, packet in enumerate(packets):
        time = 100 * 10**9 + 1_000_000 * number
        data += block(6, struct.pack("<IIIII", 0, time >> 32, time & 0xFFFFFFFF, len(packet), len(packet)) + packet)
    return data


def camera():
    payload = camera_words()
    put("wire", "all", bytes([7]) + payload)
    put("bare", "words", payload)
    packets = list(enumerate(usb_packets(payload)))
    mmapped = [usbmon(number, packet, 64) for number, packet in packets]
    put("davis", "usbmon", pcap(220, mmapped))
    put("davis", "usbmon-short", pcap(189, [usbmon(number, packet, 48) for number, packet in packets]))
    put("davis", "usbmon-ng", pcapng(220, mmapped))
    put("davis", "usbpcap", pcap(249, [usbpcap(number, packet) for number, packet in packets]))
    record = lambda data: (
        lambda head: head + struct.pack("<I", zlib.crc32(head + data)) + data
    )(b"DVSR" + bytes([0, 0, 0, 0]) + struct.pack("<QII", 1_000_000, len(data), len(data)))
    header = b'{"identity":{"vendor_id":5418,"product_id":33818,"device_version":3,"serial":"00000001"},"registers":[[1,0,260],[1,1,346]]}'
    start = b"DVSRAW1\n" + struct.pack("<I", len(header)) + header
    put("davis", "frames.dvraw", start + struct.pack("<I", zlib.crc32(start)) + record(payload))


# ---- HDF5 and NumPy


def arrays(folder):
    for name in (
        "gzip", "blosclz-bits", "lz4-bits", "zlib", "zstd-bits", "lz4-filter", "zstd-filter", "mvsec",
    ):
        path = folder / f"{name}.h5"
        hdf5.WRITERS[f"hdf5-{name}"](path, EVENTS, SIZE)
        put("hdf5", name, path.read_bytes())
    for name, options, storage in (
        ("latest", {"libver": "latest"}, {"chunks": (8,)}),
        ("latest-filled", {"libver": "latest"}, {"chunks": (8,), "compression": "gzip"}),
        ("szip", {}, {"compression": "szip"}),
        ("scale-offset", {}, {"scaleoffset": 0, "chunks": (32,)}),
        ("user-block", {"userblock_size": 512}, {"chunks": (24,)}),
    ):
        path = folder / f"{name}.h5"
        with h5py.File(path, "w", **options) as file:
            file.attrs["width"], file.attrs["height"] = SIZE
            for key, values in zip("txyp", np.array(EVENTS).T):
                values = values.astype("i8" if key == "t" else "u2")
                # Chunk lists differ between data sets that may grow and those that may not.
                file.create_dataset(key, data=values, maxshape=(None,) if key in "ty" else None, **storage)
        put("hdf5", name, path.read_bytes())
    # In all three ways of Metavision's compression, in chunks of a few events with long steps and long runs.
    chunk = 60
    runs = [(START + (index // 40) * 70_000, 3 + index % 6, index // 35, index // 45 % 2) for index in range(3 * chunk)]
    hdf5.write_metavision(folder / "ecf.h5", runs, SIZE, chunk)
    put("hdf5", "ecf", (folder / "ecf.h5").read_bytes())
    for name, dtype in {
        "seconds": "f8", "big-endian": ">i4", "fortran": "i8",
    }.items():
        table = np.array(EVENTS) * ([1e-6, 1, 1, 1] if name == "seconds" else 1)
        data = io.BytesIO()
        np.save(data, np.asfortranarray(table.astype(dtype)) if name == "fortran" else table.astype(dtype))
        put("npy", name, data.getvalue())
    t, x, y, p = np.array(EVENTS).T
    columns = []
    for values in (t * 1e-6, np.stack([x, y], axis=1).astype("u2"), p.astype(bool)):
        data = io.BytesIO()
        np.save(data, values)
        columns.append(data.getvalue())
    put("npy-folder", "evimo", b"\0" + pieces(*columns))
    for name, fields in {
        "evimo": {"events_t": t * 1e-6, "events_xy": np.stack([x, y], axis=1).astype("u2"), "events_p": p.astype("u1")},
        "records": {"events": np.array(EVENTS, dtype=recordings.DV), "note": np.array("a"), "width": np.uint16(16), "height": np.uint16(12)},
        "table": {"attitude": np.zeros((9, 4)), "left": np.array(EVENTS)},
    }.items():
        data = io.BytesIO()
        (np.savez if name == "table" else np.savez_compressed)(data, **fields)
        put("npz", name, data.getvalue())


# ---- Calibrations


CAMERAS = {
    "radtan": {"fx": 380, "fy": 381, "cx": 172, "cy": 130, "k1": -0.35, "k2": 0.15, "p1": 0.001, "p2": -0.002, "k3": -0.03},
    "kannala-brandt": {"fx": 250, "fy": 251, "cx": 172, "cy": 130, "k1": 0.05, "k2": -0.01, "k3": 0.002, "k4": -0.001},
    "double-sphere": {"fx": 200, "fy": 201, "cx": 172, "cy": 130, "xi": -0.2, "alpha": 0.55},
    "omni": {"fx": 700, "fy": 701, "cx": 172, "cy": 130, "xi": 1.2, "k1": -0.1, "k2": 0.02, "p1": 0.001, "p2": -0.001},
}
# Of other models most programs get a refit to one of the first two.
KEPT = {"double-sphere": {"basalt.json", "camchain.yaml"}, "omni": {"camera.json", "camchain.yaml"}}


def calibrations(folder, evcal):
    for model, parameters in CAMERAS.items():
        camera, exported = folder / f"{model}.json", folder / model
        truth = {"sensor": {"width": 346, "height": 260}, "camera": {"model": model, "parameters": parameters}}
        camera.write_text(json.dumps(truth, indent=1))
        put("calibration", camera.name, camera.read_bytes())
        subprocess.run([evcal, "export", camera, "--format", "all", "-o", exported], check=True, stdout=subprocess.DEVNULL)
        for path in sorted(exported.iterdir()):
            if path.suffix != ".csv" and path.name in KEPT.get(model, {path.name}):
                put("calibration", f"{model}-{path.name}", path.read_bytes())


def main():
    evcal = pathlib.Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        ros(folder, evcal)
        aedat4(folder)
        arrays(folder)
        calibrations(folder, evcal)
    put("aedat2", "others", aedat2())
    put("aedat3", "others", aedat3("3.1"))
    put("aedat3", "others-3.0", aedat3("3.0"))
    camera()


main()
