#!/bin/sh
# One would expect that cv2.fisheye.estimateNewCameraMatrixForUndistortRectify with balance 1 keeps every pixel of the source, as
# cv2.getOptimalNewCameraMatrix with alpha 1 does. It looks at the middles of the four edges only. The corners of an ordinary fisheye
# lie outside of the result, so whoever undistorts events or pictures with this matrix loses them without a word.
# Seen with opencv-python-headless 5.0.0.93: all four corners of 346 x 260 are 7.8 px beyond the left or right edge; with alpha 1 of
# the other function the corners of a similar lens are inside.
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
width, height = 346, 260
camera = numpy.array([[330.0, 0, 172.5], [0, 330, 129.5], [0, 0, 1]])
corners = numpy.array([[[x, y]] for x in (0.0, width - 1.0) for y in (0.0, height - 1.0)])


def outside(pixels):
    x, y = pixels.reshape(-1, 2).T
    return numpy.max([-x, x - (width - 1), -y, y - (height - 1)], axis=0)


fisheye = numpy.array([0.1, -0.05, 0.02, -0.005])
new = cv2.fisheye.estimateNewCameraMatrixForUndistortRectify(camera, fisheye, (width, height), numpy.eye(3), balance=1.0)
of_fisheye = outside(cv2.fisheye.undistortPoints(corners, camera, fisheye, None, new))
pinhole = numpy.array([-0.35, 0.15, 0.0, 0.0, 0.0])
new, _ = cv2.getOptimalNewCameraMatrix(camera, pinhole, (width, height), 1.0)
of_pinhole = outside(cv2.undistortPoints(corners, camera, pinhole, None, new))
print("expected: no corner outside of the new picture (px, positive is outside)")
print("fisheye, balance 1:", of_fisheye.round(2))
print("pinhole, alpha 1:  ", of_pinhole.round(2))
as_described = of_fisheye.min() > 5 and of_pinhole.max() < 0.5
sys.exit(0 if as_described else "the behaviour has changed")
PYTHON
