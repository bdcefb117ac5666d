"""Licences of everything that is linked into the program that build.sh makes: `licences.py TARGET`.

Names, versions and licences of the crates, each licence text once, and the notice that the licence of the C libraries requires.
"""

import json
import pathlib
import subprocess
import sys

# Both are linked statically; evcal's sources and this recipe let anyone link it again with others.
C_LIBRARIES = """\
glibc, the C library of the system that built this program: LGPL-2.1-or-later (/usr/share/common-licenses/LGPL-2.1).
libusb, as the crate libusb1-sys brings it: LGPL-2.1-or-later.
zstd, as the crate zstd-sys brings it: BSD-3-Clause.

The first two are linked statically. To run evcal with other versions of them, build it from its sources:
tools/package/build.sh is how this program was made, and without `crt-static` and `PKG_CONFIG=false` it takes the
libraries of the system.
"""


def linked(target):
    """The packages in the program: name and version to what cargo knows of it."""
    features = ["--no-default-features", "--features", "cli"]
    tree = subprocess.run(
        ["cargo", "tree", "-p", "evcal", *features, "--locked", "--target", target, "-e", "normal,no-proc-macro",
         "--prefix", "none", "--format", "{p}"],
        check=True, capture_output=True, text=True,
    ).stdout
    wanted = {tuple(line.split()[:2]) for line in tree.splitlines() if line}
    metadata = json.loads(subprocess.run(
        ["cargo", "metadata", "--format-version", "1", "--locked"], check=True, capture_output=True, text=True,
    ).stdout)
    return sorted(
        (package for package in metadata["packages"] if (package["name"], "v" + package["version"]) in wanted),
        key=lambda package: (package["name"], package["version"]),
    )


def main():
    texts = {}
    print("evcal is made of these crates:\n")
    for package in linked(sys.argv[1]):
        name = f"{package['name']} {package['version']}"
        print(f"{name}: {package['license'] or 'see its licence file'}")
        folder = pathlib.Path(package["manifest_path"]).parent
        files = sorted(path for pattern in ("LICEN[SC]E*", "COPYING*", "NOTICE*") for path in folder.glob(pattern))
        for path in files:
            if path.is_file():
                texts.setdefault(path.read_text(errors="replace").strip(), []).append(name)
    print("\nand of these libraries in C:\n\n" + C_LIBRARIES)
    for text, names in sorted(texts.items(), key=lambda item: item[1]):
        print("=" * 100 + "\n" + ", ".join(dict.fromkeys(names)) + "\n\n" + text + "\n")


main()
