#!/bin/sh
# Installs on Debian the programs that tests read evcal's files with: mrcal and renderers of PDF and SVG from
# Debian, OpenCV, PyYAML and dv-processing from PyPI in an environment of their own below the target folder.
set -eu
cd "$(dirname "$0")/.."

packages="python3-venv python3-mrcal poppler-utils librsvg2-bin"
if ! command -v dpkg-query >/dev/null 2>&1; then
    echo "setup-readers: this is not Debian or a relative; install mrcal for /usr/bin/python3, pdftoppm and rsvg-convert yourself" >&2
else
    missing=""
    for package in $packages; do
        dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' || missing="$missing $package"
    done
    if [ -n "$missing" ]; then
        echo "setup-readers: installing$missing"
        root=""
        [ "$(id -u)" -eq 0 ] || root=sudo
        $root apt-get -o DPkg::Lock::Timeout=900 update -q
        # shellcheck disable=SC2086 # one word a package
        $root env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=900 install -q -y --no-install-recommends $missing
    fi
fi

readers="${CARGO_TARGET_DIR:-target}/readers"
wanted=tools/readers/requirements.txt
if ! cmp -s "$wanted" "$readers/installed.txt"; then
    echo "setup-readers: installing the packages of $wanted to $readers"
    rm -rf "$readers"
    mkdir -p "$readers"
    /usr/bin/python3 -m venv "$readers"
    "$readers/bin/pip" install --quiet --disable-pip-version-check --only-binary=:all: --requirement "$wanted"
    cp "$wanted" "$readers/installed.txt"
fi
