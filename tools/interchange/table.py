"""Prints the table of docs/formats.md: which programs read what evcal writes, and what evcal reads that they write.

Usage: table.py EVCAL [DOCUMENT]. With DOCUMENT, fails if the document does not contain exactly this table.

The events have all pixels and both polarities of a sensor of 346 x 260 pixels, several of one time, and times from
1.000271 s to 5 s. A cell is `equal` if every event is; else it says what differs, and a note says why.
"""

import pathlib
import subprocess
import sys
import tempfile

import numpy as np
from programs import READERS, SIZE, WRITERS, file_name, versioned

COUNT = 20_000
TITLES = {
    "aedat4": "AEDAT4",
    "raw": "RAW, EVT 3.0",
    "evt4": "EVT 4.0",
    "dat": "DAT",
    "es": "Event Stream",
    "bag": "rosbag 1",
    "sqlite": "rosbag2, SQLite",
    "mcap": "MCAP",
    "npz": "npz",
    "h5": "HDF5",
    "csv": "CSV",
    "txt": "text",
}
# Why a cell is not equal: format and program.
NOTES = {
    ("raw", "expelliarmus"): "it counts the upper part of the time wrongly if a file has a word for each 4096 µs, as cameras send",
    ("csv", "evlib"): "it separates fields by spaces only",
    ("es", "faery"): "it does not write the time of the first event",
}


def events():
    random = np.random.default_rng(5)
    t = 1_000_003 + np.cumsum(random.integers(0, 400, COUNT))
    return t, random.integers(0, SIZE[0], COUNT), random.integers(0, SIZE[1], COUNT), random.integers(0, 2, COUNT)


def difference(read, truth):
    """Describes how events differ; `equal` if they do not."""
    if len(read[0]) != len(truth[0]):
        return f"{len(read[0])} of {len(truth[0])} events"
    found = []
    for name, got, real in zip(("t", "x", "y", "p"), read, truth):
        steps = np.unique(got - real)
        if len(steps) == 1 and steps[0] != 0:
            found.append(f"{name} differs by {steps[0]}")
        elif len(steps) > 1:
            found.append(f"{name} differs in {np.count_nonzero(got != real)} events")
    return ", ".join(found) or "equal"


def attempt(action):
    try:
        return action()
    except BaseException as error:  # pyo3's panics are not exceptions
        if isinstance(error, KeyboardInterrupt):
            raise
        print(f"{type(error).__name__}: {error}"[:300], file=sys.stderr)
        return "refused"


def convert(evcal, source, target, *options):
    done = subprocess.run([evcal, "convert", source, target, "--force", *options], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(done.stderr)


def main():
    evcal = pathlib.Path(sys.argv[1]).resolve()
    truth = events()
    rows = {}
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        source = folder / "source.csv"
        rows_of_text = "".join(f"{t},{x},{y},{p}\n" for t, x, y, p in zip(*truth))
        source.write_text(f"t,x,y,p,us,{SIZE[0]}x{SIZE[1]}\n{rows_of_text}")
        for ending, readers in READERS.items():
            file = folder / f"evcal.{ending}"
            convert(evcal, source, file)
            for program, read in readers.items():
                print(f"{ending}: {program} reads", file=sys.stderr)
                cell = attempt(lambda: difference(read(file), truth))
                rows.setdefault((ending, program), {})["reads"] = cell
        for program, (write, endings) in WRITERS.items():
            for ending in endings:
                print(f"{ending}: {program} writes", file=sys.stderr)
                file = file_name(folder, program, ending)
                back = folder / "back.csv"

                def read_back():
                    write(file, *truth)
                    convert(evcal, file, back, "--sensor", f"{SIZE[0]}x{SIZE[1]}")
                    return difference(np.loadtxt(back, delimiter=",", skiprows=1, dtype=np.int64).T, truth)

                rows.setdefault((ending, program), {})["writes"] = attempt(read_back)
    lines = ["| format | program | reads evcal's file | evcal reads its file | |", "|---|---|---|---|---|"]
    for ending, title in TITLES.items():
        for (of, program), cells in rows.items():
            if of == ending:
                note = NOTES.get((ending, program), "")
                reads, writes = cells.get("reads", "–"), cells.get("writes", "–")
                lines.append(f"| {title} | {versioned(program)} | {reads} | {writes} | {note} |")
    table = "\n".join(lines)
    print(table)
    if len(sys.argv) > 2 and f"\n{table}\n" not in pathlib.Path(sys.argv[2]).read_text():
        sys.exit(f"{sys.argv[2]} does not contain this table")


main()
