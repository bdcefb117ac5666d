"""Writes bags with image topics: the bags with rosbags, the compressed images with OpenCV.

Standard input is JSON: {"folder"}. In the folder come images.bag (ROS 1), images.db3 and images.mcap (ROS 2) of the same topics, all of
one picture: a dark disc on bright paper. Standard output is JSON: {"center": [x, y], "time" (us), "size": [width, height],
"topics": [[name, grey]]}, grey being the picture in hexadecimal as OpenCV decodes it, null behind a colour filter.
"""

import json
import pathlib
import sys

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Bag
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Folder
from rosbags.typesys import Stores, get_typestore

WIDTH, HEIGHT = 64, 48
CENTER, RADIUS = (30.7, 22.2), 13.0
# Blue, green and red of the paper in warm light.
PAPER = np.array([130.0, 220.0, 180.0])
TIME = 1_700_000_000_123_456
STEPS = 16


def picture():
    """Draws the image in blue, green and red; each pixel is the mean over its area."""
    offsets = (np.arange(STEPS) + 0.5) / STEPS - 0.5
    x = (np.arange(WIDTH)[:, None] + offsets).ravel() - CENTER[0]
    y = (np.arange(HEIGHT)[:, None] + offsets).ravel() - CENTER[1]
    inside = np.hypot(x[None, :], y[:, None]) < RADIUS
    dark = inside.reshape(HEIGHT, STEPS, WIDTH, STEPS).mean(axis=(1, 3))
    return np.round(PAPER * (1 - 0.85 * dark[:, :, None])).astype(np.uint8)


def mosaic(colours, order):
    """Pixel values behind a Bayer pattern; the order of the filters is row by row in a square of 2 x 2."""
    raw = np.empty((HEIGHT, WIDTH), np.uint8)
    for place, letter in enumerate(order):
        row, column = divmod(place, 2)
        raw[row::2, column::2] = colours[row::2, column::2, "bgr".index(letter)]
    return raw


def plain(colours):
    """Yields encoding, step and bytes of each Image message."""
    for order in ("rggb", "bggr", "gbrg", "grbg"):
        raw = mosaic(colours, order)
        yield f"/{order}8", f"bayer_{order}8", WIDTH, raw
        # A camera with 12 bits per pixel.
        yield f"/{order}16", f"bayer_{order}16", 2 * WIDTH, raw.astype("<u2") * 16


def compressed(colours):
    """Format and bytes of each CompressedImage message, and the expected image."""
    grey = cv2.cvtColor(colours, cv2.COLOR_BGR2GRAY)
    for name, form, ending, pixels in (
        ("/jpeg", "jpeg", ".jpg", grey),
        ("/color_jpeg", "bgr8; jpeg compressed bgr8", ".jpg", colours),
        ("/png", "png", ".png", grey),
        ("/color_png", "rgb8; png compressed bgr8", ".png", colours),
        ("/raw_png", "bayer_rggb8; png compressed ", ".png", mosaic(colours, "rggb")),
    ):
        _, data = cv2.imencode(ending, pixels, [cv2.IMWRITE_JPEG_QUALITY, 95] if ending == ".jpg" else [])
        answer = None if name == "/raw_png" else cv2.imdecode(data, cv2.IMREAD_GRAYSCALE).tobytes().hex()
        yield name, form, data.ravel(), answer


def messages(store, ros):
    """Name, type and message of each topic."""
    types, colours = store.types, picture()
    stamp = types["builtin_interfaces/msg/Time"](sec=TIME // 1_000_000, nanosec=TIME % 1_000_000 * 1000)
    header = types["std_msgs/msg/Header"](**({"seq": 0} if ros == 1 else {}), stamp=stamp, frame_id="camera")
    for name, encoding, step, pixels in plain(colours):
        data = np.frombuffer(pixels.tobytes(), np.uint8)
        kind = "sensor_msgs/msg/Image"
        yield name, kind, types[kind](header, HEIGHT, WIDTH, encoding, 0, step, data)
    for name, form, data, _ in compressed(colours):
        kind = "sensor_msgs/msg/CompressedImage"
        yield name, kind, types[kind](header, form, data)


def write(writer, store, ros, serialize):
    with writer:
        for name, kind, message in messages(store, ros):
            writer.write(writer.add_connection(name, kind, typestore=store), TIME * 1000, serialize(message, kind))


def main():
    folder = pathlib.Path(json.load(sys.stdin)["folder"])
    store = get_typestore(Stores.ROS1_NOETIC)
    write(Bag(folder / "images.bag"), store, 1, store.serialize_ros1)
    store = get_typestore(Stores.ROS2_HUMBLE)
    for plugin, ending in ((StoragePlugin.SQLITE3, ".db3"), (StoragePlugin.MCAP, ".mcap")):
        target = folder / f"of{ending}"
        write(Folder(target, version=9, storage_plugin=plugin), store, 2, store.serialize_cdr)
        (file,) = target.glob(f"*{ending}")
        file.rename(folder / f"images{ending}")
    colours = picture()
    topics = [(name, None) for name, *_ in plain(colours)]
    topics += [(name, answer) for name, _, _, answer in compressed(colours)]
    json.dump({"center": CENTER, "time": TIME, "size": [WIDTH, HEIGHT], "topics": topics}, sys.stdout)


main()
