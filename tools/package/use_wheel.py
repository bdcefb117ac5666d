"""Calibrates /tmp/events.dvraw with the installed package, and compares with /tmp/truth.json. Run by test-wheel.sh."""

import sys

import evcal

result = evcal.calibrate("/tmp/events.dvraw", board=sys.argv[1])
result.write("/tmp/calibration")
rms = evcal.evaluate(result, "/tmp/truth.json")["rms"]
print("wheel: rms", rms, "px")
# As the program from the .deb.
sys.exit(rms > 0.05)
