#!/bin/sh
# One would expect that the numbers of one IMU sample are in one system of units.
# The fields of dv_processing.IMU are in g and degrees per second, as in AEDAT4 files; the methods getAccelerations and
# getAngularVelocities return m/s^2 and rad/s. Whoever prints the one and calibrates with the other is off by 9.8 and 57.3.
# The factor is 9.81007 m/s^2, not the standard gravity of 9.80665: 0.035 % more, which an estimate of the scale factor finds again.
# Seen with dv-processing 2.0.4.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check dv-processing==2.0.4 numpy==2.2.6
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys

import dv_processing

print("dv-processing", dv_processing.__version__)
sample = dv_processing.IMU(1000, 25.0, 0.0, 0.0, 1.0, 90.0, 0.0, 0.0, 0.0, 0.0, 0.0)
acceleration, rate = sample.getAccelerations()[2], sample.getAngularVelocities()[0]
print("field accelerometerZ", sample.accelerometerZ, "method getAccelerations", acceleration)
print("field gyroscopeX", sample.gyroscopeX, "method getAngularVelocities", rate)
print(f"g is {acceleration / sample.accelerometerZ:.5f} m/s^2; standard gravity is 9.80665")
as_described = (
    sample.accelerometerZ == 1.0
    and sample.gyroscopeX == 90.0
    and abs(acceleration - 9.81007) < 1e-4
    and abs(rate - 1.5707963) < 1e-5
)
sys.exit(0 if as_described else "the behaviour has changed")
PYTHON
