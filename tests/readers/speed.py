"""Writes recordings in formats that evcal does not write, to measure reading speed: FOLDER contains source.npz and source.bag."""

import pathlib
import sys

import hdf5
import numpy as np


def aedat2(path, t, x, y, p):
    address = (259 - y) << 22 | (345 - x) << 12 | p << 11
    words = np.column_stack([address, t & 0x7FFFFFFF]).astype(">u4")
    path.write_bytes(b"#!AER-DAT2.0\r\n# AEChip: Davis346B\r\n" + words.tobytes())


def aedat31(path, t, x, y, p):
    data = b"#!AER-DAT3.1\r\n#Format: RAW\r\n#Source 1: DAVIS346\r\n#!END-HEADER\r\n"
    words = np.column_stack([x << 17 | y << 2 | p << 1 | 1, t]).astype("<i4")
    for start in range(0, len(words), 4096):
        part = words[start : start + 4096]
        head = np.array([1 << 16 | 1, 8, 4, 0, len(part), len(part), len(part)], dtype="<i4")
        data += head.tobytes() + part.tobytes()
    path.write_bytes(data)


def dat(path, t, x, y, p):
    words = np.column_stack([t, x | y << 14 | p << 28]).astype("<u4")
    path.write_bytes(b"% Version 2\n% Height 260\n% Width 346\n" + bytes([12, 8]) + words.tobytes())


def evt2(path, t, x, y, p):
    events = (p << 28 | (t & 63) << 22 | x << 11 | y).astype("<u4")
    high = t >> 6
    first = np.flatnonzero(np.diff(high, prepend=-1))
    words = np.insert(events, first, (8 << 28 | high[first]).astype("<u4"))
    path.write_bytes(b"% evt 2.0\n% geometry 346x260\n% end\n" + words.tobytes())


def lz4_bag(path, source):
    from rosbags.rosbag1 import Reader, Writer

    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    with Reader(source) as reader, writer:
        kinds = {
            connection.id: writer.add_connection(
                connection.topic, connection.msgtype, msgdef=connection.msgdef.data, md5sum=connection.digest
            )
            for connection in reader.connections
        }
        for connection, stamp, data in reader.messages():
            writer.write(kinds[connection.id], stamp, data)


def main():
    folder = pathlib.Path(sys.argv[1])
    with np.load(folder / "source.npz") as arrays:
        t, x, y, p = (arrays[name].astype("i8") for name in "txyp")
    for name, write in [("aedat2.aedat", aedat2), ("aedat31.aedat", aedat31), ("v2.dat", dat), ("evt2.raw", evt2)]:
        write(folder / name, t, x, y, p)
    lz4_bag(folder / "lz4.bag", folder / "source.bag")
    rows = list(zip(*(values.tolist() for values in (t, x, y, p))))
    hdf5.write_dsec(folder / "dsec.h5", rows, (346, 260))
    # Encoded in Python.
    hdf5.write_metavision(folder / "metavision.h5", rows[:1_000_000], (346, 260))


main()
