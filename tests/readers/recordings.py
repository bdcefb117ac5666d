"""Reads and writes recordings with the programs that the formats belong to.

Standard input is JSON: {"tasks": [{"action": "read" or "write", "program", "path"}], "events": [[t, x, y, p], ...],
"size": [width, height]}; the events (t in microseconds) are what is written. Standard output is a JSON list with an object
for each task: {} of one that writes, else {"events"} and, where the file has them, {"frames": [[t, width, height, pixels]],
"samples": [[t, gyroscope, accelerometer]]}.
"""

import json
import pathlib
import sys

import numpy as np

PACKET = 1000
EVENT_ARRAY = {
    "dvs_msgs/msg/Event": "uint16 x\nuint16 y\ntime ts\nbool polarity\n",
    "dvs_msgs/msg/EventArray": "std_msgs/Header header\nuint32 height\nuint32 width\ndvs_msgs/Event[] events\n",
}
EVENT_PACKET = {
    "event_camera_msgs/msg/EventPacket": "std_msgs/Header header\nuint32 height\nuint32 width\nuint64 seq\n"
    "uint64 time_base\nstring encoding\nbool is_bigendian\nuint8[] events\n",
}


def typestore(ros, definitions):
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    for name, text in definitions.items():
        store.register(get_types_from_msg(text, name))
    return store


def packets(events):
    return [events[start : start + PACKET] for start in range(0, len(events), PACKET)]


def header(types, ros, t):
    stamp = types["builtin_interfaces/msg/Time"](sec=t // 1_000_000, nanosec=t % 1_000_000 * 1000)
    fields = {"stamp": stamp, "frame_id": "camera"}
    return types["std_msgs/msg/Header"](**({"seq": 0} if ros == 1 else {}), **fields)


def event_array(types, events, size):
    """Creates a message of dvs_msgs."""
    stamps = [types["builtin_interfaces/msg/Time"](t // 1_000_000, t % 1_000_000 * 1000) for t, *_ in events]
    array = [types["dvs_msgs/msg/Event"](x=x, y=y, ts=ts, polarity=bool(p)) for ts, (_, x, y, p) in zip(stamps, events)]
    return types["dvs_msgs/msg/EventArray"](header(types, 1, events[-1][0]), size[1], size[0], array)


def mono(events):
    """The encoding `mono`: nanoseconds after the first event, x, y and polarity in 64 bits."""
    words = [(t - events[0][0]) * 1000 | x << 32 | y << 48 | p << 63 for t, x, y, p in events]
    return np.array(words, dtype="<u8").view(np.uint8)


def write_bag(path, events, size, compression):
    from rosbags.rosbag1 import Writer

    store = typestore(1, EVENT_ARRAY)
    types = store.types
    writer = Writer(path)
    if compression:
        writer.set_compression(getattr(Writer.CompressionFormat, compression))
    with writer:
        connection = writer.add_connection("/dvs/events", "dvs_msgs/msg/EventArray", typestore=store)
        for part in packets(events):
            message = event_array(types, part, size)
            data = store.serialize_ros1(message, "dvs_msgs/msg/EventArray")
            writer.write(connection, part[-1][0] * 1000, data)


def write_rosbag2(path, events, size, storage):
    """Creates a message with the encoding `mono`."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    store = typestore(2, EVENT_PACKET)
    types = store.types
    folder = pathlib.Path(path).with_suffix(".folder")
    with Writer(folder, version=9, storage_plugin=getattr(StoragePlugin, storage)) as writer:
        connection = writer.add_connection("/camera/events", "event_camera_msgs/msg/EventPacket", typestore=store)
        for number, part in enumerate(packets(events)):
            base = part[0][0]
            message = types["event_camera_msgs/msg/EventPacket"](
                header(types, 2, base), size[1], size[0], number, base * 1000, "mono", False, mono(part)
            )
            data = store.serialize_cdr(message, "event_camera_msgs/msg/EventPacket")
            writer.write(connection, part[-1][0] * 1000, data)
    (file,) = [file for file in folder.iterdir() if file.suffix in (".db3", ".mcap")]
    file.rename(path)


def write_numpy(path, events, dtype):
    array = np.array([tuple(event) for event in events], dtype=dtype)
    np.save(path, array)


def write_npz(path, events, save):
    t, x, y, p = np.array(events).T
    save(path, x=x.astype("u2"), y=y.astype("u2"), t=t, p=p.astype(bool))


def write_faery(path, events, size):
    import faery

    array = np.array([tuple(event) for event in events], dtype=faery.EVENTS_DTYPE)
    faery.events_stream_from_array(array, tuple(size)).to_file(path)


DV = np.dtype(
    {"names": ["t", "x", "y", "p"], "formats": ["<i8", "<i2", "<i2", "i1"], "offsets": [0, 8, 10, 12], "itemsize": 16}
)
WRITERS = {
    "rosbags-none": lambda path, events, size: write_bag(path, events, size, None),
    "rosbags-bz2": lambda path, events, size: write_bag(path, events, size, "BZ2"),
    "rosbags-lz4": lambda path, events, size: write_bag(path, events, size, "LZ4"),
    "rosbags-db3": lambda path, events, size: write_rosbag2(path, events, size, "SQLITE3"),
    "rosbags-mcap": lambda path, events, size: write_rosbag2(path, events, size, "MCAP"),
    "numpy-padded": lambda path, events, size: write_numpy(path, events, DV),
    "numpy-table": lambda path, events, size: np.save(path, np.array(events, dtype="f8") * [1e-6, 1, 1, 1]),
    "numpy-fortran": lambda path, events, size: np.save(path, np.asfortranarray(np.array(events))),
    "numpy-stored": lambda path, events, size: write_npz(path, events, np.savez),
    "numpy-deflated": lambda path, events, size: write_npz(path, events, np.savez_compressed),
    "faery": write_faery,
}


def writer(program):
    if program.startswith("hdf5"):
        import hdf5

        return hdf5.WRITERS[program]
    return WRITERS[program]


def microseconds(stamp):
    return stamp.sec * 1_000_000 + stamp.nanosec // 1000


def extras(kind, message):
    """Creates a frame or IMU sample of sensor_msgs."""
    t = microseconds(message.header.stamp)
    if kind.endswith("/Image"):
        assert message.encoding == "mono8" and message.step == message.width
        return "frames", [t, message.width, message.height, bytes(message.data).hex()]
    vector = lambda value: [value.x, value.y, value.z]
    return "samples", [t, vector(message.angular_velocity), vector(message.linear_acceleration)]


def read_bag(path):
    from rosbags.highlevel import AnyReader

    found = {"events": [], "frames": [], "samples": []}
    with AnyReader([pathlib.Path(path)]) as reader:
        times = []
        for connection, time, data in reader.messages():
            times.append(time)
            message = reader.deserialize(data, connection.msgtype)
            if connection.msgtype.endswith("/EventArray"):
                events = [[microseconds(event.ts), event.x, event.y, int(event.polarity)] for event in message.events]
                found["events"] += events
            else:
                name, value = extras(connection.msgtype, message)
                found[name].append(value)
        # Through the file's index, in order of time.
        assert times == sorted(times) and len(times) == reader.message_count
    return found


def compressed(base, payload):
    """The encoding `libcaer_cmp`, without groups."""
    high = low = x = 0
    for word in np.frombuffer(payload, dtype="<u2").tolist():
        kind, value = word >> 12, word & 0xFFF
        if kind == 0:
            high = value
        elif kind == 1:
            low = value
        elif kind == 2:
            x = value
        else:
            assert kind == 3
            yield [base // 1000 + (high << 12 | low), x, value & 0x7FF, value >> 11]


def read_mcap(path):
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    found = {"events": [], "frames": [], "samples": []}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        summary = reader.get_summary()
        count = 0
        for schema, _, message, decoded in reader.iter_decoded_messages():
            count += 1
            if schema.name.endswith("/EventPacket"):
                assert decoded.encoding == "libcaer_cmp" and not decoded.is_bigendian
                found["events"] += compressed(decoded.time_base, bytes(decoded.events))
                assert message.log_time == found["events"][-1][0] * 1000
            else:
                name, value = extras(schema.name, decoded)
                found[name].append(value)
        assert summary.statistics.message_count == count and len(summary.chunk_indexes) > 0
    return found


def read_npz(path):
    with np.load(path) as arrays:
        events = np.stack([arrays[name].astype(np.int64) for name in "txyp"], axis=1)
        return {"events": events.tolist(), "size": [int(arrays["width"]), int(arrays["height"])]}


def read_h5(path):
    """DSEC's layout, and the properties of the index that DSEC's own reader assumes."""
    import h5py

    with h5py.File(path, "r") as file:
        start, index, group = file["t_offset"][()], file["ms_to_idx"][:], file["events"]
        columns = {name: group[name][:] for name in "txyp"}
        types = [str(columns[name].dtype) for name in "txyp"] + [str(index.dtype), str(start.dtype)]
        assert types == ["uint32", "uint16", "uint16", "uint8", "uint64", "int64"], types
        t = columns["t"].astype(np.int64)
        assert len(index) == t[-1] // 1000 + 1
        for ms, place in enumerate(index):
            assert t[place] >= 1000 * ms and (place == 0 or t[place - 1] < 1000 * ms), ms
        columns = [t + start] + [columns[name].astype(np.int64) for name in "xyp"]
        size = [int(file.attrs["width"]), int(file.attrs["height"])]
        return {"events": np.stack(columns, axis=1).tolist(), "size": size}


def read_faery(path):
    import faery

    stream = faery.events_stream_from_file(path)
    array = stream.to_array()
    events = np.stack([array[name].astype(np.int64) for name in ("t", "x", "y", "on")], axis=1)
    return {"events": events.tolist(), "size": list(stream.dimensions())}


READERS = {"rosbags": read_bag, "mcap": read_mcap, "numpy": read_npz, "h5py": read_h5, "faery": read_faery}


def main():
    question = json.load(sys.stdin)
    answers = []
    for task in question["tasks"]:
        if task["action"] == "write":
            writer(task["program"])(task["path"], question["events"], question["size"])
            answers.append({})
        else:
            answers.append(READERS[task["program"]](task["path"]))
    json.dump(answers, sys.stdout)


if __name__ == "__main__":
    main()
