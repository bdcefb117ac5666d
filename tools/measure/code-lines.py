#!/usr/bin/env python3
"""Counts the lines of Rust in each part of the repository, without blank lines, comments and tests.

    python3 tools/measure/code-lines.py

Tests are folders `tests`, files `tests.rs` and modules below `#[cfg(test)]`.
"""
import pathlib
import subprocess

ROOT = pathlib.Path(__file__).resolve().parents[2]


def is_test(path):
    return "tests" in path.parts[:-1] or path.name == "tests.rs" or "fixtures" in path.parts


def lines(text):
    """The lines of code of a file. Test modules and their closing braces are not indented."""
    count, inside, pending, comment = 0, False, False, False
    for line in text.splitlines():
        if inside:
            inside = line != "}"
            continue
        if line == "#[cfg(test)]":
            pending = True
            continue
        if pending:
            pending = False
            inside = line.startswith("mod ") and line.endswith("{")
            continue
        bare = line.strip()
        if comment:
            comment = "*/" not in bare
        elif bare.startswith("/*"):
            comment = "*/" not in bare
        elif bare and not bare.startswith("//"):
            count += 1
    return count


def main():
    files = subprocess.run(["git", "ls-files", "*.rs"], cwd=ROOT, capture_output=True, text=True, check=True)
    parts = {}
    for name in files.stdout.split():
        path = pathlib.PurePath(name)
        if is_test(path) or not (ROOT / path).exists():
            continue
        part = "/".join(path.parts[:2]) if path.parts[0] == "host" else path.parts[0]
        parts[part] = parts.get(part, 0) + lines((ROOT / path).read_text())
    for part, count in sorted(parts.items()):
        print(f"{count:7} {part}")
    print(f"{sum(parts.values()):7} all")


if __name__ == "__main__":
    main()
