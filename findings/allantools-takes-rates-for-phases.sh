#!/bin/sh
# One would expect that the Allan deviation of a gyroscope's samples is what allantools computes from them.
# All its functions take the numbers for phases, that is for angles, unless data_type="freq" is given. Samples of a gyroscope or an
# accelerometer are rates. The noise density that is read at tau = 1 s for a Kalibr imu.yaml is then wrong by a factor that depends
# on the rate: 24 at 200 Hz. Nothing warns, and the curve looks like one.
# Seen with allantools 2024.6 on white noise of known density.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check allantools==2024.6 numpy==2.2.6 scipy==1.15.3
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys

import allantools
import numpy

print("allantools", allantools.__version__)
rate, density = 200.0, 0.01
samples = numpy.random.default_rng(1).normal(0.0, density * numpy.sqrt(rate), int(600 * rate))
found = {}
for name, options in (("default", {}), ("freq", {"data_type": "freq"})):
    found[name] = allantools.oadev(samples, rate=rate, taus=[1.0], **options)[1][0]
    print(f"density {density}, allantools {name}: {found[name]:.5f} at 1 s")
as_described = abs(found["freq"] / density - 1.0) < 0.05 and found["default"] / density > 20.0
sys.exit(0 if as_described else "the behaviour has changed")
PYTHON
