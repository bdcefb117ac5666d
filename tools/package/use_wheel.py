"""Calibrates /tmp/events.dvraw with the installed package, and compares with /tmp/truth.json and with /tmp/program.json, the
calibration of the program from the .deb. Run by test-wheel.sh."""

import sys

import evcal

# The latter two may differ in the last digits of sines and cosines, because their C libraries differ.
LIMITS = {"/tmp/truth.json": 0.05, "/tmp/program.json": 0.001}

result = evcal.calibrate("/tmp/events.dvraw", board=sys.argv[1])
differences = {other: evcal.evaluate(result, other)["rms"] for other in LIMITS}
for other, rms in differences.items():
    print(f"wheel: {rms:.6f} px rms from {other}")
sys.exit(any(rms > LIMITS[other] for other, rms in differences.items()))
