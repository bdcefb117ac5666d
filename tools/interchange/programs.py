"""How other programs read and write events. Each function exchanges arrays t (µs), x, y and p (0 or 1)."""

import pathlib
from importlib.metadata import version

import numpy as np

SIZE = (346, 260)


def columns(t, x, y, p):
    """Converts the columns of a program: ON is the larger polarity."""
    t, x, y, p = (np.asarray(column) for column in (t, x, y, p))
    if t.dtype.kind == "m":
        t = t.astype("timedelta64[us]")
    return t.astype(np.int64), x.astype(np.int64), y.astype(np.int64), (p.astype(np.int64) > 0).astype(np.int64)


def structured(events, polarity="p"):
    return columns(events["t"], events["x"], events["y"], events[polarity])


def read_dv(path):
    import dv_processing as dv

    reader = dv.io.MonoCameraRecording(str(path))
    parts = []
    while (batch := reader.getNextEventBatch()) is not None:
        parts.append(batch.numpy())
    events = np.concatenate(parts)
    return columns(events["timestamp"], events["x"], events["y"], events["polarity"])


def write_dv(path, t, x, y, p):
    import dv_processing as dv

    store = dv.EventStore()
    for event in zip(t.tolist(), x.tolist(), y.tolist(), p.astype(bool).tolist()):
        store.push_back(*event)
    writer = dv.io.MonoCameraWriter(str(path), dv.io.MonoCameraWriter.EventOnlyConfig("CAMERA_1", SIZE))
    writer.writeEvents(store)


def read_aedat(path):
    import aedat

    parts = [packet["events"] for packet in aedat.Decoder(str(path)) if "events" in packet]
    events = np.concatenate(parts)
    return structured(events, "on" if "on" in events.dtype.names else "p")


def read_faery(path):
    import faery

    return structured(faery.events_stream_from_file(str(path)).to_array(), "on")


def write_faery(path, t, x, y, p):
    import faery

    events = np.zeros(len(t), dtype=faery.EVENTS_DTYPE)
    events["t"], events["x"], events["y"], events["on"] = t, x, y, p > 0
    faery.events_stream_from_array(events, SIZE).to_file(str(path))


def read_evutils(path):
    from evutils import io

    with io.EventReader(str(path)) as reader:
        events = reader.read_all()
    return columns(events.t, events.x, events.y, events.p)


def write_evutils(path, t, x, y, p):
    from evutils import io
    from evutils.types import EventArray

    events = EventArray(t=t, x=x.astype(np.uint16), y=y.astype(np.uint16), p=p.astype(np.uint8))
    with io.EventWriter(str(path), width=SIZE[0], height=SIZE[1]) as writer:
        writer.write(events)


def read_evlib(path):
    import evlib

    events = evlib.load_events(str(path)).collect()
    t = events["t"].dt.total_microseconds().to_numpy()
    return columns(t, *(events[name].to_numpy() for name in ("x", "y", "polarity")))


def write_evlib(path, t, x, y, p):
    import evlib

    seconds = t / 1e6
    arguments = (x.astype(np.int64), y.astype(np.int64), seconds, np.where(p > 0, 1, -1).astype(np.int64), str(path))
    if path.suffix == ".h5":
        evlib.save_events_to_hdf5(*arguments)
    else:
        evlib.save_events_to_text(*arguments)


def read_eventcv(path):
    import eventcv

    topic = eventcv.bag_topics(str(path))[0][0] if path.suffix == ".bag" else None
    events = eventcv.load(str(path), topic=topic).numpy()
    return columns(events[:, 2], events[:, 0], events[:, 1], events[:, 3])


def write_eventcv(path, t, x, y, p):
    import eventcv

    events = np.stack([x, y, t, p], axis=1)
    eventcv.save(eventcv.from_numpy(events, sensor_size=SIZE, time_unit="us"), str(path))


def read_evt3(path):
    import evt3

    events = evt3.decode_file(str(path))
    return columns(events.timestamp, events.x, events.y, events.polarity)


def read_expelliarmus(path):
    from expelliarmus import Wizard

    return structured(Wizard(encoding=EXPELLIARMUS[path.suffix]).read(str(path)))


def write_expelliarmus(path, t, x, y, p):
    from expelliarmus import Wizard

    events = np.zeros(len(t), dtype=[("t", "<i8"), ("x", "<i2"), ("y", "<i2"), ("p", "u1")])
    events["t"], events["x"], events["y"], events["p"] = t, x, y, p
    Wizard(encoding=EXPELLIARMUS[path.suffix]).save(str(path), events)


EXPELLIARMUS = {".raw": "evt3", ".dat": "dat"}


def write_event_stream(path, t, x, y, p):
    import event_stream

    events = np.zeros(len(t), dtype=event_stream.dvs_dtype)
    # Rows count from below in this format, and the package leaves them as they are.
    events["t"], events["x"], events["y"], events["on"] = t, x, SIZE[1] - 1 - y, p > 0
    with event_stream.Encoder(str(path), "dvs", *SIZE) as encoder:
        encoder.write(events)


def read_numpy(path):
    file = np.load(path)
    return columns(file["t"], file["x"], file["y"], file["p"])


def write_numpy(path, t, x, y, p):
    np.savez(path, t=t, x=x.astype(np.uint16), y=y.astype(np.uint16), p=p.astype(np.uint8))


def read_h5py(path):
    import h5py

    with h5py.File(path) as file:
        events = file["events"]
        t = events["t"][:].astype(np.int64) + int(file["t_offset"][()] if "t_offset" in file else 0)
        return columns(t, events["x"][:], events["y"][:], events["p"][:])


def write_h5py(path, t, x, y, p):
    import h5py

    with h5py.File(path, "w") as file:
        for name, column, kind in (("t", t, "u4"), ("x", x, "u2"), ("y", y, "u2"), ("p", p, "u1")):
            file.create_dataset(f"events/{name}", data=column.astype(kind), chunks=(4096,), compression="gzip")
        file["t_offset"] = 0


EVENT = "uint16 x\nuint16 y\n{time} ts\nbool polarity\n"
EVENT_ARRAY = "std_msgs/Header header\nuint32 height\nuint32 width\ndvs_msgs/Event[] events\n"


def store(ros):
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_JAZZY)
    time = "time" if ros == 1 else "builtin_interfaces/Time"
    types.register(get_types_from_msg(EVENT.format(time=time), "dvs_msgs/msg/Event"))
    types.register(get_types_from_msg(EVENT_ARRAY, "dvs_msgs/msg/EventArray"))
    return types


def of_messages(messages):
    rows = [
        (event.ts.sec * 1_000_000 + event.ts.nanosec // 1000, event.x, event.y, event.polarity)
        for message in messages
        for event in message.events
    ]
    return columns(*np.array(rows).T)


def read_rosbags(path):
    from rosbags.rosbag1 import Reader

    types = store(1)
    with Reader(path) as reader:
        chosen = [connection for connection in reader.connections if connection.msgtype.endswith("EventArray")]
        raw = [data for _, _, data in reader.messages(connections=chosen)]
    return of_messages(types.deserialize_ros1(data, "dvs_msgs/msg/EventArray") for data in raw)


def write_rosbags(path, t, x, y, p):
    """A bag of ROS 1, or a folder with a bag of ROS 2 in SQLite or MCAP."""
    from rosbags.rosbag1 import Writer
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    ros = 1 if path.suffix == ".bag" else 2
    types = store(ros)
    time = types.types["builtin_interfaces/msg/Time"]
    stamp = lambda t: time(int(t) // 1_000_000, int(t) % 1_000_000 * 1000)
    header = types.types["std_msgs/msg/Header"]
    event = types.types["dvs_msgs/msg/Event"]
    if ros == 1:
        writer = Writer(path)
    else:
        plugin = StoragePlugin.SQLITE3 if path.suffix == ".sqlite" else StoragePlugin.MCAP
        writer = Writer2(path, version=9, storage_plugin=plugin)
    serialize = types.serialize_ros1 if ros == 1 else types.serialize_cdr
    with writer:
        connection = writer.add_connection("/dvs/events", "dvs_msgs/msg/EventArray", typestore=types)
        for part in np.array_split(np.arange(len(t)), 20):
            events = [event(int(x[i]), int(y[i]), stamp(t[i]), bool(p[i])) for i in part]
            first = (0,) if ros == 1 else ()
            message = types.types["dvs_msgs/msg/EventArray"](
                header(*first, stamp(t[part[-1]]), "camera"), SIZE[1], SIZE[0], events
            )
            writer.write(connection, int(t[part[-1]]) * 1000, serialize(message, "dvs_msgs/msg/EventArray"))


def read_mcap(path):
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [message for _, _, _, message in reader.iter_decoded_messages()]
    return columns(*np.concatenate([packet(message) for message in found]).T)


def packet(message):
    """The events of an EventPacket in the encoding libcaer_cmp, by its public description."""
    assert message.encoding == "libcaer_cmp"
    high = low = x = first = on = 0
    rows = []
    for word in np.frombuffer(bytes(message.events), "<u2").tolist():
        kind, content = word >> 12, word & 0xFFF
        t = (message.time_base + (high << 12 | low) * 1000) // 1000
        if kind == 0:
            high = content
        elif kind == 1:
            low = content
        elif kind == 2:
            x = content & 0x7FF
        elif kind == 3:
            rows.append((t, x, content & 0x7FF, content >> 11))
        elif kind == 4:
            on, first = content >> 11, content & 0x7F8
        elif kind == 5:
            rows.extend((t, x, first + row, on) for row in range(8) if content >> row & 1)
            first += 8
    return np.array(rows)


# Names of the programs as in the table, and their packages.
PACKAGES = {
    "dv-processing": "dv-processing",
    "aedat": "aedat",
    "faery": "faery",
    "evutils": "evutils",
    "evlib": "evlib",
    "eventcv": "eventcv",
    "evt3": "evt3",
    "expelliarmus": "expelliarmus",
    "event_stream": "event_stream",
    "rosbags": "rosbags",
    "mcap": "mcap",
    "NumPy": "numpy",
    "h5py": "h5py",
}
READERS = {
    "aedat4": {
        "dv-processing": read_dv,
        "aedat": read_aedat,
        "faery": read_faery,
        "evutils": read_evutils,
        "evlib": read_evlib,
        "eventcv": read_eventcv,
    },
    "raw": {
        "faery": read_faery,
        "evutils": read_evutils,
        "evlib": read_evlib,
        "eventcv": read_eventcv,
        "evt3": read_evt3,
        "expelliarmus": read_expelliarmus,
    },
    "evt4": {"evutils": read_evutils},
    "bag": {"rosbags": read_rosbags, "eventcv": read_eventcv},
    "mcap": {"mcap": read_mcap},
    "npz": {"NumPy": read_numpy, "evutils": read_evutils, "eventcv": read_eventcv},
    "h5": {"h5py": read_h5py, "evutils": read_evutils, "evlib": read_evlib, "eventcv": read_eventcv},
    "csv": {"faery": read_faery, "evutils": read_evutils, "evlib": read_evlib, "eventcv": read_eventcv},
}
# Per program the endings of the files that it writes, and what they are if the ending does not say it.
WRITERS = {
    "dv-processing": (write_dv, ["aedat4"]),
    "faery": (write_faery, ["aedat4", "raw", "dat", "es", "csv"]),
    "evutils": (write_evutils, ["aedat4", "raw", "evt4", "dat", "npz", "h5", "csv"]),
    "evlib": (write_evlib, ["h5", "txt"]),
    "eventcv": (write_eventcv, ["npz", "h5", "bag", "txt"]),
    "expelliarmus": (write_expelliarmus, ["raw", "dat"]),
    "event_stream": (write_event_stream, ["es"]),
    "rosbags": (write_rosbags, ["bag", "sqlite", "mcap"]),
    "NumPy": (write_numpy, ["npz"]),
    "h5py": (write_h5py, ["h5"]),
}


def versioned(program):
    return f"{program} {version(PACKAGES[program])}"


def file_name(folder, program, ending):
    return pathlib.Path(folder) / f"{program.lower()}.{ending}"
