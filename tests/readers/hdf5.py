"""Writes events to HDF5 in the layouts and compressions of published recordings."""

import struct

import h5py
import hdf5plugin
import numpy as np

BLOSC = hdf5plugin.Blosc


def columns(group, events, types, **storage):
    for name, values, dtype in zip("txyp", np.array(events).T, types):
        group.create_dataset(name, data=values.astype(dtype), maxshape=(None,), **storage)


def write_dsec(path, events, size):
    start = events[0][0]
    with h5py.File(path, "w") as file:
        file["t_offset"] = np.int64(start)
        file["ms_to_idx"] = np.arange(10, dtype="u8")
        relative = [(t - start, x, y, p) for t, x, y, p in events]
        columns(file.create_group("events"), relative, ("u4", "u2", "u2", "u1"), **BLOSC("zstd", 5, BLOSC.SHUFFLE))


def write_m3ed(path, events, size):
    with h5py.File(path, "w", libver="latest") as file:
        for side, part in (("left", events), ("right", events[:100])):
            group = file.create_group(f"prophesee/{side}")
            columns(group, part, ("i8", "u2", "u2", "i1"), chunks=(4096,), compression="lzf")
            group["ms_map_idx"] = np.arange(10, dtype="u8")
            group["calib/resolution"] = np.array(size)


def write_e2calib(path, events, size, **storage):
    with h5py.File(path, "w") as file:
        file.attrs["width"], file.attrs["height"] = size
        columns(file, events, ("i8", "u2", "u2", "u1"), **storage)


def write_mvsec(path, events, size):
    with h5py.File(path, "w") as file:
        group = file.create_group("davis/left")
        rows = np.array([(x, y, t * 1e-6, 1 if p else -1) for t, x, y, p in events])
        group.create_dataset("events", data=rows, chunks=(min(1000, len(rows)), 4), compression="gzip", shuffle=True)
        start = events[0][0] * 1e-6
        pictures = np.arange(2 * size[1] * size[0], dtype="u4").reshape(2, size[1], size[0]) % 251
        group.create_dataset("image_raw", data=pictures.astype("u1"), chunks=True)
        group.create_dataset("image_raw_ts", data=start + np.array([0.02, 0.05]))
        # Acceleration, then angular rates, as MVSEC's converter writes a ROS message.
        group.create_dataset("imu", data=np.tile([0.0, 9.80665, -4.903325, np.pi, 0.0, -np.pi / 2], (3, 1)))
        group.create_dataset("imu_ts", data=start + np.array([0.01, 0.03, 0.06]))


def write_matlab(path, events, size):
    """Like MATLAB's files of version 7.3: a header of 512 bytes, and vectors stored as matrices with one row."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in zip("txyp", np.array(events, dtype="f8").T):
            file.create_dataset(name, data=values[np.newaxis, :], chunks=(1, 1000), compression="gzip")
        file.attrs["sensor_size"] = np.array(size, dtype="f8")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")


def write_across(path, events, size):
    """Four rows of N numbers, as MATLAB stores an N x 4 table, next to attitudes whose name sorts first."""
    with h5py.File(path, "w") as file:
        file["attitude"] = np.random.default_rng(1).normal(size=(500, 4))
        file.create_dataset("events", data=np.array(events).T, chunks=(4, 777), compression="lzf")
        file.attrs["sensor_resolution"] = size[::-1]


def write_unnamed(path, events, size):
    """A table with a meaningless name, after attitudes."""
    with h5py.File(path, "w") as file:
        file["attitude"] = np.random.default_rng(1).normal(size=(500, 4))
        file["left"] = np.array(events)
        file.attrs["resolution"] = size


def runs(values):
    """Run lengths as [[value, count], ...]."""
    found = []
    for value in values:
        if found and found[-1][0] == value:
            found[-1][1] += 1
        else:
            found.append([value, 1])
    return found


def ecf_times(times):
    data, now = struct.pack("<Q", times[0]), times[0]
    for time, count in runs(times):
        step, now = time - now, time
        if step >= 15:
            while step:
                data += bytes([0xF0 | step & 15])
                step >>= 4
        data += bytes([step << 4 | min(count, 15)])
        if count >= 15:
            data += struct.pack("<H", count)
    return data


def ecf_columns(pixels):
    data, index = b"", 0
    while index < len(pixels):
        first, mask, index = pixels[index], 0, index + 1
        for step in range(1, 6):
            if index < len(pixels) and pixels[index] == first + step:
                mask, index = mask | 1 << (5 - step), index + 1
        data += struct.pack("<H", first << 5 | mask)
    return data


def packed(values, bits):
    """Packs four numbers into three words; the lower bits of a number in two words are in the first word."""
    word, part = bits * 4 // 3, bits // 3
    values = values + [0] * (-len(values) % 4)
    data = b""
    for a, b, c, d in zip(*[iter(values)] * 4):
        low, high = b & (1 << part) - 1, b >> part
        words = a << part | low, high << 2 * part | c & (1 << 2 * part) - 1, c >> 2 * part << bits | d
        data += b"".join(value.to_bytes(word // 8, "little") for value in words)
    return data


def ecf(events, packing):
    times, xs, ys, ps = zip(*events)
    data = struct.pack("<I", len(events) << 2 | packing) + ecf_times(times)
    if packing == 2:
        return data + packed([y << 12 | x << 1 | p for x, y, p in zip(xs, ys, ps)], 24)
    for y, count in runs(ys):
        data += struct.pack("<H", y << 5 | min(count, 31)) + (struct.pack("<H", count) if count >= 31 else b"")
    if packing == 1:
        return data + packed([x << 1 | p for x, p in zip(xs, ps)], 12)
    data += ecf_columns(xs)
    for p, count in runs(ps):
        data += bytes([p << 7 | min(count, 127)]) + (struct.pack("<H", count) if count >= 127 else b"")
    return data


def write_metavision(path, events, size, chunk=4096):
    """Compresses the chunks here, in all three modes, because HDF5 has no plugin for this compression."""
    dtype = np.dtype(
        {"names": ["x", "y", "p", "t"], "formats": ["<u2", "<u2", "<i2", "<i8"], "offsets": [0, 2, 4, 8], "itemsize": 16}
    )
    with h5py.File(path, "w") as file:
        file.attrs["geometry"] = f"{size[0]}x{size[1]}"
        properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        properties.set_chunk((chunk,))
        properties.set_obj_track_times(False)
        properties.set_filter(0x8ECF, h5py.h5z.FLAG_OPTIONAL, ())
        space = h5py.h5s.create_simple((len(events),), (h5py.h5s.UNLIMITED,))
        group = file.create_group("CD")
        dataset = h5py.h5d.create(group.id, b"events", h5py.h5t.py_create(dtype), space, properties)
        for number, start in enumerate(range(0, len(events), chunk)):
            dataset.write_direct_chunk((start,), ecf(events[start : start + chunk], number % 3))
        group.create_dataset("indexes", data=np.zeros(3, dtype=[("id", "u8"), ("ts", "i8")]))


def codec(**storage):
    return lambda path, events, size: write_e2calib(path, events, size, **storage)


WRITERS = {
    "hdf5-dsec": write_dsec,
    "hdf5-m3ed": write_m3ed,
    "hdf5-mvsec": write_mvsec,
    "hdf5-metavision": write_metavision,
    "hdf5-matlab": write_matlab,
    "hdf5-across": write_across,
    "hdf5-unnamed": write_unnamed,
    "hdf5-plain": codec(),
    "hdf5-gzip": codec(compression="gzip", shuffle=True, fletcher32=True),
    "hdf5-blosclz": codec(**BLOSC("blosclz", 9, BLOSC.SHUFFLE)),
    "hdf5-blosclz-bits": codec(chunks=(1001,), **BLOSC("blosclz", 9, BLOSC.BITSHUFFLE)),
    "hdf5-lz4-bits": codec(**BLOSC("lz4", 5, BLOSC.BITSHUFFLE)),
    "hdf5-zlib": codec(**BLOSC("zlib", 5, BLOSC.NOSHUFFLE)),
    "hdf5-zstd-bits": codec(**BLOSC("zstd", 5, BLOSC.BITSHUFFLE)),
    "hdf5-lz4-filter": codec(**hdf5plugin.LZ4()),
    "hdf5-zstd-filter": codec(**hdf5plugin.Zstd()),
    "hdf5-blosc2": codec(**hdf5plugin.Blosc2("zstd", 5, hdf5plugin.Blosc2.SHUFFLE)),
    "hdf5-bitshuffle": codec(**hdf5plugin.Bitshuffle(cname="lz4")),
    "hdf5-snappy": codec(**BLOSC("snappy", 5, BLOSC.SHUFFLE)),
}
