"""Projects points with OpenCV and computes the derivatives of the pixels.

Standard input is a JSON list of {"matrix", "distortion", "fisheye", "points"}, with points in camera coordinates. Standard
output is a JSON list of {"pixels", "derivatives"}: the derivatives of u and v for each point, with respect to x, y, z of the point, fx, fy, cx, cy and
the coefficients.
"""

import json
import sys

import cv2
import numpy as np


def answer(task):
    points, none = np.array(task["points"]).reshape(-1, 1, 3), np.zeros(3)
    project = cv2.fisheye.projectPoints if task["fisheye"] else cv2.projectPoints
    pixels, derivatives = project(points, none, none, np.array(task["matrix"]), np.array(task["distortion"]))
    # First columns of the translation (the camera is at the origin), fx and the coefficients.
    translation, focal, distortion = (11, 0, 4) if task["fisheye"] else (3, 6, 10)
    columns = np.r_[
        translation : translation + 3, focal : focal + 4, distortion : distortion + len(task["distortion"])
    ]
    return {"pixels": pixels.reshape(-1, 2).tolist(), "derivatives": derivatives[:, columns].reshape(len(points), 2, -1).tolist()}


json.dump([answer(task) for task in json.load(sys.stdin)], sys.stdout)
