#!/bin/sh
# One would expect that cv2.fisheye.undistortPoints inverts cv2.fisheye.projectPoints for every point in front of the camera.
# It limits the distorted angle theta (1 + k1 theta^2 + ...) to 90 degrees. A lens with positive k1 reaches that limit far earlier:
# with k1 = 0.1 at a true angle of 73.5 degrees. Beyond it every pixel gets about the same direction, without an error.
# Seen with opencv-python-headless 4.12.0.88: a point at 80 degrees comes back at 75.5. The calibration itself is right.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check opencv-python-headless==4.12.0.88 numpy==2.2.6
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys

import cv2
import numpy

print("opencv", cv2.__version__)
camera = numpy.array([[200.0, 0, 320], [0, 200, 240], [0, 0, 1]])
lens = numpy.array([0.1, 0.02, 0.0, 0.0])
back = {}
for degrees in (60, 70, 75, 80, 85, 89):
    angle = numpy.radians(degrees)
    point = numpy.array([[[numpy.sin(angle), 0, numpy.cos(angle)]]])
    pixel, _ = cv2.fisheye.projectPoints(point, numpy.zeros(3), numpy.zeros(3), camera, lens)
    ray = cv2.fisheye.undistortPoints(pixel, camera, lens)[0, 0]
    back[degrees] = numpy.degrees(numpy.arctan(ray[0]))
    print(f"expected {degrees:5.1f} degrees, undistorted {back[degrees]:7.3f} degrees, pixel {pixel[0, 0, 0]:.1f}")
as_described = all(abs(back[d] - d) < 1e-6 for d in (60, 70)) and all(d - back[d] > 0.5 for d in (75, 80, 85, 89))
sys.exit(0 if as_described else "the behaviour has changed")
PYTHON
