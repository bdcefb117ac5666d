"""Measures dots on rendered sheets with OpenCV.

Standard input is a JSON list of {"file", "layout", "columns", "rows"}: a grey picture of a sheet. Standard output is a
JSON list of {"width", "height", "centers", "radii"}: the size of the picture, centres of the dots in the order of
findCirclesGrid and their radii, in pixels, (0, 0) being the corner of the picture.
"""

import json
import sys

import cv2
import numpy as np


def measure(task):
    picture = cv2.imread(task["file"], cv2.IMREAD_GRAYSCALE)
    assert picture is not None, task["file"]
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
    height, width = picture.shape
    return {"width": width, "height": height, "centers": centers, "radii": radii}


json.dump([measure(task) for task in json.load(sys.stdin)], sys.stdout)
