"""Compares two folders that evcal calibrate wrote; same-results.sh calls it.

    python3 tools/measure/same_results.py events|rig NAME OLD NEW

Of events alone every file must be the same. Of a rig, prints the largest difference of a value in its σ, and of a σ.
"""
import json
import math
import pathlib
import sys

# What made the result, not what it is.
MAKERS = {"program", "command", "version", "host", "created", "date", "threads"}
TEXTS = {".yaml", ".yml", ".txt", ".csv", ".json", ".xml", ".mrcal", ".cameramodel"}


def without_makers(value):
    if isinstance(value, dict):
        return {key: without_makers(part) for key, part in value.items() if key not in MAKERS}
    return [without_makers(part) for part in value] if isinstance(value, list) else value


def same(old, new):
    """Returns the names of the files that differ."""
    different = []
    names = {path.relative_to(root) for root in (old, new) for path in root.rglob("*") if path.suffix in TEXTS}
    for name in sorted(names):
        texts = [(root / name).read_bytes() if (root / name).exists() else None for root in (old, new)]
        if name.name == "calibration.json" and None not in texts:
            texts = [json.dumps(without_makers(json.loads(text))) for text in texts]
        if texts[0] != texts[1]:
            different.append(str(name))
    return different


def angle(first, second):
    """Returns the angle between the rotations of two transforms (rad)."""
    trace = sum(first[row][column] * second[row][column] for row in range(3) for column in range(3))
    skew = [sum(first[k][i] * second[k][j] - first[k][j] * second[k][i] for k in range(3)) for i, j in ((0, 1), (1, 2), (2, 0))]
    return math.atan2(math.sqrt(sum(part * part for part in skew)), trace - 1)


def differences(old, new, path=""):
    """Yields (path, difference in σ, ratio of the σ) of all numbers with a σ."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in old.keys() & new.keys():
            of_key = old.get(key + "_sigma", old.get("sigma") if key == "value" else None)
            of_new = new.get(key + "_sigma", new.get("sigma") if key == "value" else None)
            if key.startswith("T_") and "rotation_sigma" in old and isinstance(old[key], list):
                sigma, later = (max(part["rotation_sigma"]) for part in (old, new))
                yield f"{path}.{key}", angle(old[key], new[key]) / sigma, later / sigma
                if "translation_sigma" in old:
                    columns = ([row[3] for row in part[key][:3]] for part in (old, new))
                    yield from paired(*columns, old["translation_sigma"], new["translation_sigma"], f"{path}.translation")
            elif of_key is not None and of_new is not None:
                yield from paired(old[key], new[key], of_key, of_new, f"{path}.{key}")
            else:
                yield from differences(old[key], new[key], f"{path}.{key}")
    elif isinstance(old, list) and isinstance(new, list):
        for index, (first, second) in enumerate(zip(old, new)):
            yield from differences(first, second, f"{path}[{index}]")


def paired(old, new, sigma, later, path):
    if isinstance(old, list):
        if not isinstance(sigma, list):
            # One σ belongs to a direction (rad).
            old, new = ([value / math.hypot(*vector) for value in vector] for vector in (old, new))
            sigma, later = [sigma] * len(old), [later] * len(old)
        for index, four in enumerate(zip(old, new, sigma, later)):
            yield from paired(*four, f"{path}[{index}]")
    elif all(isinstance(one, (int, float)) for one in (old, new, sigma, later)) and sigma > 0:
        yield path, abs(new - old) / sigma, later / sigma


def main():
    kind, name, old, new = sys.argv[1], sys.argv[2], *map(pathlib.Path, sys.argv[3:])
    different = same(old, new)
    if not different:
        print(f"{name}: the same")
        return 0
    files = [json.loads((root / "calibration.json").read_text()) for root in (old, new)]
    found = [one for one in differences(*files) if one[1] != 0 or one[2] != 1]
    value = max(found, key=lambda one: one[1], default=("no value", 0, 1))
    sigma = max(found, key=lambda one: abs(math.log(one[2])) if one[2] > 0 else math.inf, default=("no σ", 0, 1))
    print(f"{name}: DIFFERS in {', '.join(different)}; at most {value[1]:.4f} σ ({value[0]}), σ × {sigma[2]:.4f} ({sigma[0]})")
    return 1 if kind == "events" or value[1] > 0.1 else 0


if __name__ == "__main__":
    sys.exit(main())
