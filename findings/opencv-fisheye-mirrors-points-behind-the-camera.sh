#!/bin/sh
# One would expect: a fisheye model counts the angle from the axis, so cv2.fisheye.projectPoints has a pixel further out for a point
# beyond 90 degrees, as the formula of Kannala and Brandt has, or it reports such points.
# What happens: it divides by the depth first. A point behind the camera gets the pixel of the opposite point in front of it,
# without a word: 450 pixels away here, and inside the image.
# Seen with opencv-python-headless 4.10.0.84.
# Consequence: overlays, reprojection errors and undistortion of a lens with more than 180 degrees are wrong beyond 90 degrees.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==1.26.4 opencv-python-headless==4.10.0.84
"$folder/venv/bin/python" - <<'PYTHON'
import cv2
import numpy as np

print("OpenCV", cv2.__version__)
focal = 160.0
matrix = np.array([[focal, 0, 320], [0, focal, 240], [0, 0, 1.0]])
# 96 degrees from the axis, to the right.
angle = np.radians(96.0)
point = np.array([[[np.sin(angle), 0.0, np.cos(angle)]]])
pixel = cv2.fisheye.projectPoints(point, np.zeros(3), np.zeros(3), matrix, np.zeros((4, 1)))[0].ravel()
expected = np.array([320 + focal * angle, 240])
opposite = np.array([320 - focal * (np.pi - angle), 240])
print("expected (focal length times angle):", expected)
print("seen:", pixel, "which is the pixel of the point at", -point.ravel())
raise SystemExit(0 if np.allclose(pixel, opposite) and np.linalg.norm(pixel - expected) > 400 else 1)
PYTHON
