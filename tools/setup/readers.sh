#!/bin/sh
# Installs on Debian the programs that tests read evcal's files with: mrcal and renderers of PDF and SVG from
# Debian, OpenCV, pycolmap, PyYAML, dv-processing, rosbags, mcap and faery from PyPI in an environment of their own below the target folder.
set -eu
cd "$(dirname "$0")/../.."

script=readers
. tools/setup/packages.sh

if is_debian; then
    install_packages python3-venv python3-mrcal poppler-utils librsvg2-bin
else
    echo "readers: this is not Debian or a relative; install mrcal for /usr/bin/python3, pdftoppm and rsvg-convert yourself" >&2
fi

readers="${CARGO_TARGET_DIR:-target}/readers"
install_python_packages "$readers" tests/readers/requirements.txt
