"""Lists the lines of evcal that no fuzzed input reached, by file. After `make fuzz`, on Linux with binutils:

    python3 tools/fuzz-coverage.py [TARGET...]    these targets together; all of them without arguments

The corpus and the inputs that the fuzzer collected below target/fuzz/corpus are read once more. The code is optimised: a line may count as missed
because the compiler merged it with another.
"""

import collections
import os
import pathlib
import re
import subprocess
import sys
import tempfile

repository = pathlib.Path(__file__).resolve().parent.parent
folder = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", repository / "target")) / "fuzz"


def output(*command, **options):
    return subprocess.run(command, check=True, capture_output=True, text=True, **options).stdout


def places(binary):
    """The lines of evcal, including inlined functions, at each location that the fuzzer counts."""
    sections = output("readelf", "-S", "-W", binary)
    found = re.search(r"__sancov_pcs +PROGBITS +(\w+) \w+ (\w+)", sections)
    start, size = (int(number, 16) for number in found.groups())
    # Pairs of an address, which the loader fills in, and flags.
    addresses = [0] * (size // 16)
    for line in output("readelf", "-r", "-W", binary).splitlines():
        fields = line.split()
        if len(fields) == 4 and fields[2].endswith("_RELATIVE"):
            offset = int(fields[0], 16) - start
            if 0 <= offset < size and offset % 16 == 0:
                addresses[offset // 16] = int(fields[3], 16)
    lines = []
    for line in output("addr2line", "-a", "-i", "-e", binary, input="\n".join(map(hex, addresses))).splitlines():
        if line.startswith("0x"):
            lines.append(set())
        elif line.startswith(f"{repository}/"):
            path, _, number = line.split(" ")[0].removeprefix(f"{repository}/").rpartition(":")
            if number.isdigit():
                lines[-1].add((path, int(number)))
    return lines


def reached(binary, target):
    """The numbers of the locations that the inputs of `target` reach."""
    with tempfile.TemporaryDirectory() as scratch:
        control, merged = pathlib.Path(scratch, "control"), pathlib.Path(scratch, "merged")
        merged.mkdir()
        corpora = [path for path in (folder / "corpus" / target, repository / "fuzz/corpus" / target) if path.is_dir()]
        arguments = ["-merge=1", f"-merge_control_file={control}", merged, *corpora]
        output(binary, *arguments, env=dict(os.environ, EVCAL_FUZZ_TARGET=target))
        seen = [line.split()[2:] for line in control.read_text().splitlines() if line.startswith("COV")]
    return {int(place) for line in seen for place in line}


def main():
    host = re.search("host: (.+)", output("rustc", "-vV"))[1]
    binary = folder / host / "release/evcal-fuzz"
    targets = sys.argv[1:] or sorted(path.name for path in (repository / "fuzz/corpus").iterdir())
    hit = set()
    for target in targets:
        places_of_target = reached(binary, target)
        print(f"{target}: {len(places_of_target)} locations", file=sys.stderr)
        hit |= places_of_target
    files = collections.defaultdict(lambda: collections.defaultdict(bool))
    for number, lines in enumerate(places(binary)):
        for path, line in lines:
            files[path][line] |= number in hit
    for path, lines in sorted(files.items()):
        missed = sorted(line for line, is_hit in lines.items() if not is_hit)
        if len(missed) < len(lines):
            print(f"{path}: {len(lines) - len(missed)} of {len(lines)} lines; not: {' '.join(map(str, missed))}")


main()
