"""Simulates events from images, as video-to-event emulators do, with a pixel model that differs from `evcal simulate`.

    python3 tools/measure/frame_events.py FOLDER [--seed 1] [--pixels bright|dark] [--vignetting 0.5] [--lens radtan|kannala-brandt]
                                          [--seconds 4] [--speed 1.0]

Shares nothing with evcal but the board: 8-bit images are drawn 2000 times per second (nine samples per pixel, blurred). Each pixel
passes the logarithm of its grey value through a low-pass, which is slower in the dark, and sends an event for each threshold
crossed since its last event (Hu, Liu, Delbruck, "v2e: from video frames to realistic DVS events", 2021;
thresholds, spreads and rates are taken from its presets). Writes events.npz, and truth.json for `evcal evaluate`. Needs
numpy.
"""

import argparse
import json
from pathlib import Path

import numpy as np

WIDTH, HEIGHT = 346, 260
# acircles:9x4:55mm:r17.5mm, on paper with a margin (m).
ROWS, COLUMNS, SPACING, RADIUS, MARGIN = 9, 4, 0.055, 0.0175, 0.05
SAMPLES = 3
RATE = 2000
# Blur of the optics in pixels.
BLUR = 0.6
PAPER, INK, WALL = 210.0, 35.0, 110.0

LENSES = {
    "radtan": {"fx": 331.6, "fy": 331.1, "cx": 176.9, "cy": 134.2, "k1": -0.352, "k2": 0.149, "p1": -0.0004, "p2": 0.0005, "k3": -0.03},
    "kannala-brandt": {"fx": 198.4, "fy": 198.0, "cx": 171.2, "cy": 131.4, "k1": -0.018, "k2": 0.006, "k3": -0.003, "k4": 0.0006},
}
# Threshold, its spread over pixels, bandwidth at full white (Hz; 0: without limit), leaks and noise (events per second), dead time (s).
PIXELS = {
    "bright": {"threshold": 0.2, "spread": 0.03, "bandwidth": 300.0, "leak": 0.1, "noise": 1.0, "dead": 0.0005},
    "dark": {"threshold": 0.2, "spread": 0.05, "bandwidth": 30.0, "leak": 0.1, "noise": 5.0, "dead": 0.0005},
}


def distorted(model, lens, x, y):
    """Projects points of the plane z = 1 to pixels."""
    r2 = x * x + y * y
    if model == "radtan":
        radial = 1 + r2 * (lens["k1"] + r2 * (lens["k2"] + r2 * lens["k3"]))
        p1, p2 = lens["p1"], lens["p2"]
        u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    else:
        r = np.sqrt(r2) + 1e-12
        theta = np.arctan(r)
        t2 = theta * theta
        scale = theta * (1 + t2 * (lens["k1"] + t2 * (lens["k2"] + t2 * (lens["k3"] + t2 * lens["k4"])))) / r
        u, v = x * scale, y * scale
    return lens["fx"] * u + lens["cx"], lens["fy"] * v + lens["cy"]


def directions(model, lens):
    """Rays of all samples of all pixels, shape (3, pixels, samples), by Newton's method with numeric derivatives."""
    offsets = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    u = (np.arange(WIDTH)[:, None] + offsets).ravel()
    v = (np.arange(HEIGHT)[:, None] + offsets).ravel()
    u, v = (grid.ravel() for grid in np.meshgrid(u, v))
    x, y = (u - lens["cx"]) / lens["fx"], (v - lens["cy"]) / lens["fy"]
    step = 1e-6
    for _ in range(30):
        a, b = distorted(model, lens, x, y)
        ax, bx = distorted(model, lens, x + step, y)
        ay, by = distorted(model, lens, x, y + step)
        ax, bx, ay, by = (ax - a) / step, (bx - b) / step, (ay - a) / step, (by - b) / step
        a, b, determinant = a - u, b - v, ax * by - ay * bx
        # Limits the step, for cases in which distortion is strong.
        x, y = x - np.clip((by * a - ay * b) / determinant, -0.3, 0.3), y - np.clip((ax * b - bx * a) / determinant, -0.3, 0.3)
    a, b = distorted(model, lens, x, y)
    assert max(abs(a - u).max(), abs(b - v).max()) < 1e-6
    rays = np.stack([x, y, np.ones_like(x)]).astype(np.float32).reshape(3, HEIGHT, SAMPLES, WIDTH, SAMPLES)
    return rays.transpose(0, 1, 3, 2, 4).reshape(3, HEIGHT * WIDTH, SAMPLES * SAMPLES)


def turn(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


class Motion:
    """Motion of the board in front of the camera: six coordinates, each a sum of three sines."""

    def __init__(self, generator, lens, speed):
        self.rates = generator.uniform(0.25, 0.8, (6, 3)) * speed
        self.phases = generator.uniform(0, 2 * np.pi, (6, 3))
        self.half = np.array([0.55 * WIDTH / 2 / lens["fx"], 0.55 * HEIGHT / 2 / lens["fy"]])
        # Distance at which the board's height fills the image.
        self.near = 0.5 * ((ROWS - 1) * SPACING + 2 * RADIUS) / (0.5 * HEIGHT / lens["fy"])

    def wave(self, index, t):
        return np.sin(2 * np.pi * self.rates[index] * t + self.phases[index]).sum() / 2.2

    def pose(self, t):
        """Rotation and translation from the board to the camera."""
        x, y, z, roll, tip, tilt = (self.wave(index, t) for index in range(6))
        distance = self.near * (1.25 + 0.35 * z)
        rotation = turn(2, np.radians(30) * roll) @ turn(0, np.radians(32) * tip) @ turn(1, np.radians(32) * tilt)
        middle = np.array([(2 * COLUMNS - 1) * SPACING / 2, (ROWS - 1) * SPACING / 2, 0.0])
        place = distance * np.array([self.half[0] * x, self.half[1] * y, 1.0])
        return rotation, place - rotation @ middle


def drawn(rays, inverse, size):
    """Grey values of rays, shape (3, any), and a mask of rays less than two samples from an edge."""
    # Intersection of a ray with the plane z = 0 of the board.
    x, y, w = inverse @ rays
    # Rays that do not intersect get a very large distance.
    w = np.maximum(w, np.float32(1e-6))
    x, y = x / w, y / w
    columns, rows = x / np.float32(SPACING), y / np.float32(SPACING)
    diagonal, other = np.round((columns + rows) / 2), np.round((columns - rows) / 2)
    column, row = diagonal + other, diagonal - other
    # Rows and columns of asymmetric grids: row r has its circles at 2 c + r % 2.
    there = (row >= 0) & (row < ROWS) & (column >= 0) & (column < 2 * COLUMNS)
    distance = np.hypot(x - column * np.float32(SPACING), y - row * np.float32(SPACING)) - np.float32(RADIUS)
    ink = np.where(there, np.clip(0.5 - distance / size, 0, 1), 0)
    inside = np.minimum(
        np.minimum(x + MARGIN, (2 * COLUMNS - 1) * SPACING + MARGIN - x), np.minimum(y + MARGIN, (ROWS - 1) * SPACING + MARGIN - y)
    )
    paper = np.clip(0.5 + inside / size, 0, 1)
    grey = WALL + paper * (PAPER - WALL + ink * (INK - PAPER))
    near = 2 * SAMPLES * size
    return grey, (np.abs(distance) < near) | (np.abs(inside) < near)


def picture(rays, focal_length, rotation, translation):
    """Grey values in floating point, before vignetting."""
    inverse = np.linalg.inv(np.column_stack([rotation[:, 0], rotation[:, 1], translation])).astype(np.float32)
    # Approximate size of a sample on the board (m), over which edges are smoothed.
    size = np.float32(np.linalg.norm(translation) / focal_length / SAMPLES)
    grey, near = drawn(rays[:, :, SAMPLES * SAMPLES // 2], inverse, size)
    samples, _ = drawn(rays[:, near].reshape(3, -1), inverse, size)
    grey[near] = samples.reshape(-1, SAMPLES * SAMPLES).mean(axis=1)
    grey = grey.reshape(HEIGHT, WIDTH)
    weights = np.exp(-0.5 * (np.arange(-2, 3) / BLUR) ** 2)
    weights /= weights.sum()
    for axis in (0, 1):
        padded = np.pad(grey, [(2, 2) if axis == one else (0, 0) for one in (0, 1)], mode="edge")
        grey = sum(w * np.take(padded, range(k, k + grey.shape[axis]), axis=axis) for k, w in enumerate(weights))
    return grey


def logarithm(grey):
    return np.where(grey < 20, grey * (np.log(20) / 20), np.log(np.maximum(grey, 20)))


def events(arguments, lens, generator):
    pixels = PIXELS[arguments.pixels]
    rays = directions(arguments.lens, lens)
    motion = Motion(generator, lens, arguments.speed)
    shape = (HEIGHT, WIDTH)
    thresholds = np.maximum(generator.normal(pixels["threshold"], pixels["spread"], (2, *shape)), 0.01)
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    s2 = ((columns - (WIDTH - 1) / 2) ** 2 + (rows - (HEIGHT - 1) / 2) ** 2) / (((WIDTH - 1) / 2) ** 2 + ((HEIGHT - 1) / 2) ** 2)
    light = 1 - arguments.vignetting * s2
    step = 1.0 / RATE
    low, base, free = None, None, np.zeros(shape)
    found = []
    for number in range(int(arguments.seconds * RATE) + 1):
        t = number * step
        grey = np.round(np.clip(picture(rays, lens["fx"], *motion.pose(t)) * light, 0, 255))
        new = logarithm(grey)
        if low is None:
            low, base = new.copy(), new.copy()
            continue
        share = 1.0
        if pixels["bandwidth"]:
            share = np.minimum((grey + 20) / 275 * step * 2 * np.pi * pixels["bandwidth"], 1)
        low += share * (new - low)
        base -= step * pixels["leak"] * thresholds[1]
        change = low - base
        counts = [np.floor(np.maximum(change, 0) / thresholds[1]).astype(int), np.floor(np.maximum(-change, 0) / thresholds[0]).astype(int)]
        base += counts[0] * thresholds[1] - counts[1] * thresholds[0]
        most = max(counts[0].max(), counts[1].max())
        for index in range(most):
            at = t - step + step * (index + 1) / most
            for polarity, count in ((1, counts[0]), (0, counts[1])):
                fires = (count > index) & (at >= free)
                free[fires] = at + pixels["dead"]
                y, x = np.nonzero(fires)
                found.append((np.full(len(x), round(at * 1e6)), x, y, np.full(len(x), polarity)))
        # Noise, stronger in the dark.
        chance = generator.random(shape)
        probability = pixels["noise"] * step * (1 - 0.75 * grey / 255)
        for polarity, fires in ((1, chance < probability / 2), (0, chance > 1 - probability / 2)):
            y, x = np.nonzero(fires)
            found.append((np.full(len(x), round(t * 1e6)), x, y, np.full(len(x), polarity)))
            base[fires] += (2 * polarity - 1) * thresholds[polarity][fires]
    t, x, y, p = (np.concatenate(part) for part in zip(*found))
    order = np.argsort(t, kind="stable")
    return {"t": t[order].astype(np.int64), "x": x[order].astype(np.uint16), "y": y[order].astype(np.uint16), "p": p[order].astype(bool)}


def main():
    parser = argparse.ArgumentParser(description="Events made from pictures.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pixels", choices=PIXELS, default="bright")
    parser.add_argument("--vignetting", type=float, default=0.0, help="share of light that the corners lack")
    parser.add_argument("--lens", choices=LENSES, default="radtan")
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--speed", type=float, default=1.0)
    arguments = parser.parse_args()
    lens = LENSES[arguments.lens]
    made = events(arguments, lens, np.random.default_rng(arguments.seed))
    arguments.folder.mkdir(parents=True, exist_ok=True)
    np.savez(arguments.folder / "events.npz", **made)
    truth = {"sensor": {"width": WIDTH, "height": HEIGHT}, "camera": {"model": arguments.lens, "parameters": lens}}
    (arguments.folder / "truth.json").write_text(json.dumps(truth, indent=2) + "\n")
    print(f"{len(made['t'])} events in {arguments.folder / 'events.npz'}")


if __name__ == "__main__":
    main()
