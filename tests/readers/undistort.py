"""Undistorts with OpenCV.

Standard input is a JSON object {"matrix", "distortion", "fisheye", "new_matrix", "points", "picture", "alpha"}. Standard
output is a JSON object {"points": undistorted points in pixels of the new camera, "picture": rows of the undistorted
picture, "optimal": the matrix of getOptimalNewCameraMatrix for alpha, of the exact inverse of the distortion}.
"""

import json
import sys

import cv2
import numpy as np

task = json.load(sys.stdin)
matrix, distortion = np.array(task["matrix"]), np.array(task["distortion"])
new, points = np.array(task["new_matrix"]), np.array(task["points"], dtype=float).reshape(-1, 1, 2)
picture = cv2.imread(task["picture"], cv2.IMREAD_UNCHANGED)
height, width = picture.shape[:2]
often = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
answer = {}
if task["fisheye"]:
    undistorted = cv2.fisheye.undistortPoints(points, matrix, distortion, P=new, criteria=often)
    maps = cv2.fisheye.initUndistortRectifyMap(matrix, distortion, np.eye(3), new, (width, height), cv2.CV_32FC1)
else:
    undistorted = cv2.undistortPoints(points, matrix, distortion, P=new, criteria=often)
    maps = cv2.initUndistortRectifyMap(matrix, distortion, None, new, (width, height), cv2.CV_32FC1)
    optimal, _ = cv2.getOptimalNewCameraMatrix(matrix, distortion, (width, height), task["alpha"])
    answer["optimal"] = optimal.tolist()
answer["points"] = undistorted.reshape(-1, 2).tolist()
answer["picture"] = cv2.remap(picture, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT).tolist()
json.dump(answer, sys.stdout)
