"""Measures dots, rulers and the QR code on rendered sheets with OpenCV.

Standard input is a JSON list of {"file", "layout", "columns", "rows", "rulers"}: a grey picture of a sheet, and for each ruler the
axis along which it lies and the pixels of its ends. Standard output is a JSON list of {"width", "height", "centers", "radii", "code",
"rulers"}: the size of the picture, centres of the dots in the order of findCirclesGrid and their radii, in pixels, (0, 0) being the
corner of the picture, the text of the QR code, and the length of each ruler in pixels. Without a layout, no dots are searched.
"""

import json
import sys

import cv2
import numpy as np


def decoded(picture):
    """Returns the text of the only QR code, which is at the bottom right."""
    height, width = picture.shape
    corner = picture[height * 3 // 4 :, width * 2 // 3 :]
    # The detector wants modules of several pixels.
    for scale in (1, 2, 3, 4):
        enlarged = cv2.resize(corner, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        text, _, _ = cv2.QRCodeDetector().detectAndDecode(enlarged)
        if text:
            return text
    return ""


def length(picture, axis, start, end):
    """Returns the distance of the two end lines of a ruler, each searched within 3 % of the length around its place."""
    ink = 1 - picture.astype(float) / 255
    around = int(0.03 * (end[axis] - start[axis]))

    def line(place):
        x, y = int(place[0]), int(place[1])
        # The ends of the ticks, beyond the ticks between them.
        strip = ink[y, x - around : x + around] if axis == 0 else ink[y - around : y + around, x]
        places = np.arange(len(strip)) + 0.5 + (x, y)[axis] - around
        return (strip * places).sum() / strip.sum()

    return float(line(end) - line(start))


def measure(task):
    picture = cv2.imread(task["file"], cv2.IMREAD_GRAYSCALE)
    assert picture is not None, task["file"]
    height, width = picture.shape
    measured = {"width": width, "height": height, "code": decoded(picture)}
    measured["rulers"] = [length(picture, *ruler) for ruler in task["rulers"]]
    if task["layout"] not in ("acircles", "circles"):
        return measured
    parameters = cv2.SimpleBlobDetector_Params()
    parameters.minArea, parameters.maxArea = 300, 1e6
    parameters.minDistBetweenBlobs = 5
    detector = cv2.SimpleBlobDetector_create(parameters)
    size = (task["columns"], task["rows"])
    flag = cv2.CALIB_CB_ASYMMETRIC_GRID if task["layout"] == "acircles" else cv2.CALIB_CB_SYMMETRIC_GRID
    found, grid = cv2.findCirclesGrid(picture, size, flags=flag, blobDetector=detector)
    assert found, "findCirclesGrid finds no grid"
    centers, radii = [], []
    ink = 1 - picture.astype(float) / 255
    _, labels, blobs, _ = cv2.connectedComponentsWithStats((picture < 128).astype(np.uint8))
    for x, y in grid.reshape(-1, 2):
        # Includes the whole grey edge of the dot and no neighbouring print.
        half = int(0.55 * blobs[labels[int(y), int(x)], cv2.CC_STAT_WIDTH]) + 3
        left, top = max(int(round(x)) - half, 0), max(int(round(y)) - half, 0)
        patch = ink[top : int(round(y)) + half, left : int(round(x)) + half]
        rows, columns = np.indices(patch.shape)
        area = patch.sum()
        centers.append([left + 0.5 + (patch * columns).sum() / area, top + 0.5 + (patch * rows).sum() / area])
        radii.append(float(np.sqrt(area / np.pi)))
    return measured | {"centers": centers, "radii": radii}


json.dump([measure(task) for task in json.load(sys.stdin)], sys.stdout)
