#!/bin/sh
# One would expect that cv2.fisheye.undistortImage without a new camera matrix keeps the camera's own matrix, as cv2.undistort does.
# It takes the identity: the whole result shows the surroundings of one source pixel, a picture of about one colour, and no error.
# Seen with opencv-python-headless 5.0.0.93: of 255 grey values 1 to 4 are left; with the camera's matrix as Knew all remain.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.2.6
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import cv2
import numpy

print("opencv", cv2.__version__)
camera = numpy.array([[330.0, 0, 172.5], [0, 330, 129.5], [0, 0, 1]])
picture = numpy.random.default_rng(0).integers(0, 255, (260, 346), dtype=numpy.uint8)


def values(result):
    return len(numpy.unique(result))


fisheye = values(cv2.fisheye.undistortImage(picture, camera, numpy.zeros(4)))
with_matrix = values(cv2.fisheye.undistortImage(picture, camera, numpy.zeros(4), Knew=camera))
pinhole = values(cv2.undistort(picture, camera, numpy.zeros(5)))
print(f"expected: the same picture, {values(picture)} grey values")
print(f"fisheye: {fisheye}; fisheye with Knew: {with_matrix}; pinhole: {pinhole}")
as_described = fisheye <= 4 and with_matrix > 250 and pinhole > 250
sys.exit(0 if as_described else "the behaviour has changed")
PYTHON
