"""Figures of `evcal live` for docs/live.md. To be run on an otherwise idle computer.

    python3 tools/measure/live.py checkpoints EVCAL FOLDER [SEEDS]    when it stops, reported and true error
    python3 tools/measure/live.py about EVCAL FOLDER [SEEDS]          "about" against the error reported afterwards
    python3 tools/measure/live.py page EVCAL FOLDER BROWSER           age of drawn states, CPU and memory of the page
    python3 tools/measure/live.py long EVCAL FOLDER BROWSER           the same over ten minutes at 2 Mev/s (6 GB in FOLDER)

Simulates the recordings in FOLDER first, unless they are there.
"""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "report"))
from browser import Browser, Tab

BOARD = "acircles:9x4:55mm:r17.5mm"
# Duration of the measurement of a page (s).
WATCHED = 15
TICKS = 100
# Twenty seconds at 1.32 Mev/s, repeated and played faster: ten minutes at 1.98 Mev/s.
REPEATED, SPEED = 45, 1.5
# Interval of the samples during the ten minutes (s).
LOOK = 60


def run(*command):
    return subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True).stdout


def simulated(evcal, folder, seed, motion):
    out = folder / f"{motion}-{seed}"
    if not out.exists():
        run(evcal, "simulate", "-o", str(out), "--format", "dvraw", "--motion", motion, "--duration", "26s", "--seed", str(seed))
    return out


def live(evcal, recording, out, *options):
    command = [evcal, "live", "--replay", str(recording), "--board", BOARD, "-o", str(out), "--force", "--accept-any"]
    return [*command, *options]


def whole_objects(text):
    decoder, at, objects = json.JSONDecoder(), 0, []
    while text[at:].strip():
        at += len(text[at:]) - len(text[at:].lstrip())
        found, at = decoder.raw_decode(text, at)
        objects.append(found)
    return objects


def checkpoints(evcal, folder, seeds):
    """Recordings in which the board covers the image, and one in which it is always frontal."""
    print("| recording | ended by itself | result: stated 95 % | true |")
    print("|---|---|---|---|")
    for motion, seed in [*(("slow", seed) for seed in range(1, seeds + 1)), ("head-on", 1)]:
        recording = simulated(evcal, folder, seed, motion)
        out = folder / f"{motion}-{seed}-live"
        *hints, result = whole_objects(run(*live(evcal, recording / "events.dvraw", out, "--speed", "max", "--no-page", "--json")))
        stop = hints[-1]
        ended = "no: " + ", ".join(stop["missing"])
        # Hints have a resolution of one second, and the recording ended after the last one.
        if not stop["missing"] or stop["t"] < 24:
            ended = f"after {stop['t']:.0f} s"
        error = json.loads(run(evcal, "evaluate", str(out), "--truth", str(recording), "--json"))["projection_difference"]["rms_px"]
        bound = result["uncertainty"]["projection_rms_95"]
        print(f"| {motion}, seed {seed} | {ended} | {bound:.4f} px | {error:.4f} px |", flush=True)


def about(evcal, folder, seeds):
    """Checkpoints after 4, 8 and 16 s, and the estimates shown before them."""
    settings = folder / "early.toml"
    settings.write_text("[live]\nshortest = 6.0\ntarget = 0.0001\n")
    print("| recording | at | about | stated | ratio |")
    print("|---|---|---|---|---|")
    for seed in range(1, seeds + 1):
        recording = simulated(evcal, folder, seed, "slow") / "events.dvraw"
        options = ["--settings", str(settings), "--speed", "max", "--no-page", "--json"]
        process = subprocess.Popen(live(evcal, recording, folder / "about-live", *options), stdout=subprocess.PIPE, text=True)
        text, estimates, reported_at = "", [], None
        for line in process.stdout:
            text += line
            try:
                hint = json.loads(text)
            except json.JSONDecodeError:
                continue
            if "checkpoint" not in hint:
                # The recording is over, and this is the calibration.
                break
            text, point = "", hint["checkpoint"]
            if point and point["t"] != reported_at:
                reported_at = point["t"]
                before = [about for t, about in estimates if t <= reported_at and about]
                if before:
                    row = f"{before[-1]:.4f} px | {point['stated']:.4f} px | {before[-1] / point['stated']:.2f}"
                    print(f"| slow, seed {seed} | {reported_at:.1f} s | {row} |", flush=True)
                if reported_at > 15:
                    break
            estimates.append((hint["t"], hint["about"]))
        process.kill()
        process.wait()


def usage(process):
    """Seconds of CPU by name of thread, and memory (MB)."""
    seconds = {}
    for task in Path(f"/proc/{process}/task").iterdir():
        try:
            name, rest = (task / "stat").read_text().split("(", 1)[1].rsplit(")", 1)
        except OSError:
            continue
        fields = rest.split()
        seconds[name] = seconds.get(name, 0.0) + (int(fields[11]) + int(fields[12])) / TICKS
    memory = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{process}/status").read_text())[1]
    return seconds, int(memory) / 1000


def measure(command, browser_program):
    """CPU (fractions of a core) and memory over some seconds; ages of the states that a page drew."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    browser = tab = None
    try:
        if browser_program:
            url = re.search(r"http://\S+", process.stderr.readline())[0]
            browser = Browser(browser_program)
            tab = Tab(browser, url, 1440, 900, "light")
            tab.wait("window.evcal && evcal.shown > 20")
            tab.script("evcal.ages.length = evcal.outlines.length = 0")
        else:
            time.sleep(3)
        (before, _), began = usage(process.pid), time.monotonic()
        time.sleep(WATCHED)
        (after, memory), span = usage(process.pid), time.monotonic() - began
        shares = {name: (seconds - before.get(name, 0.0)) / span for name, seconds in after.items()}
        ages = tab.script("[evcal.ages, evcal.outlines]") if tab else [[], []]
        return shares, memory, *ages
    finally:
        if browser:
            browser.close()
        process.kill()
        process.wait()


def without_checkpoints(folder):
    """Disables checkpoints, which are measured separately."""
    settings = folder / "no-checkpoints.toml"
    settings.write_text("[live]\nshortest = 15000.0\n")
    return settings


def middle_and_end(name, ages):
    ages = sorted(ages)
    if ages:
        print(f"{name}: median {ages[len(ages) // 2]:.0f} ms, 95 % {ages[len(ages) * 95 // 100]:.0f} ms, {len(ages)} of them")


def page(evcal, folder, browser_program):
    recording = simulated(evcal, folder, 1, "fast") / "events.dvraw"
    settings = without_checkpoints(folder)
    command = live(evcal, recording, folder / "page-live", "--settings", str(settings))
    without, alone, _, _ = measure([*command, "--no-page"], None)
    with_page, served, ages, outlines = measure([*command, "--port", "0", "--no-open"], browser_program)
    print(f"all of evcal: {100 * sum(without.values()):.1f} % of a core without a page, {100 * sum(with_page.values()):.1f} % with one")
    print(f"thread of the server: {100 * with_page.get('page', 0.0):.1f} % of a core")
    print(f"memory: {alone:.1f} MB without a page, {served:.1f} MB with one")
    middle_and_end(f"state made -> drawn, in {WATCHED} s", ages)
    print("an event waits up to 33 ms more for the state that it is in")
    middle_and_end("middle of the window with the board -> its outline drawn", outlines)


def repeated(evcal, folder):
    """An EVT 3.0 file that repeats the body of a simulated one, and the simulated file."""
    once, again = folder / "once.raw", folder / "repeated.raw"
    if not again.exists():
        simulation = folder / "fast-21"
        if not simulation.exists():
            run(evcal, "simulate", "-o", str(simulation), "--motion", "fast", "--duration", "20s", "--seed", "21")
        run(evcal, "convert", str(simulation / "events.aedat4"), str(once))
        content = once.read_bytes()
        end = content.index(b"% end\n") + len(b"% end\n")
        with open(again, "wb") as file:
            file.write(content[:end])
            for _ in range(REPEATED):
                file.write(content[end:])
    return once, again


def long(evcal, folder, browser_program):
    once, recording = repeated(evcal, folder)
    # The cost of reading and detection, without the page.
    before = os.times()
    run(evcal, "detect", str(once), "--board", BOARD, "-o", str(folder / "once.csv"))
    after = os.times()
    searched = after.children_user + after.children_system - before.children_user - before.children_system
    print(f"evcal detect: {searched:.2f} s for 20 s of the recording")
    options = ["--settings", str(without_checkpoints(folder)), "--speed", str(SPEED), "--port", "0", "--no-open"]
    process = subprocess.Popen(live(evcal, recording, folder / "long-live", *options), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    browser = Browser(browser_program)
    try:
        url = re.search(r"http://\S+", process.stderr.readline())[0]
        tab = Tab(browser, url, 1440, 900, "light")
        tab.wait("window.evcal && evcal.shown > 20")
        began, last = time.monotonic(), None
        print("| played (s) | in (s) | memory (MB) | CPU, share of 1 s at this rate: all, server | beyond reading and detection |")
        print("|---|---|---|---|---|")
        # Ends one sample before the end of the recording.
        while tab.script("evcal.state.t") < REPEATED * 20 - LOOK * SPEED:
            time.sleep(LOOK)
            (seconds, memory), played = usage(process.pid), tab.script("evcal.state.t")
            if last:
                span = (played - last[1]) / SPEED
                share = {name: (value - last[0].get(name, 0.0)) / span for name, value in seconds.items()}
                beyond = sum(share.values()) - searched / 20 * SPEED
                row = f"{100 * sum(share.values()):.1f} %, {100 * share.get('page', 0.0):.1f} % | {100 * beyond:.1f} %"
                print(f"| {played:.0f} | {time.monotonic() - began:.0f} | {memory:.1f} | {row} |", flush=True)
            last = (seconds, played)
        print(f"{tab.script('evcal.shown')} states drawn")
    finally:
        browser.close()
        process.kill()
        process.wait()


if __name__ == "__main__":
    what, evcal, folder, *rest = sys.argv[1:]
    Path(folder).mkdir(parents=True, exist_ok=True)
    if what in ("checkpoints", "about"):
        {"checkpoints": checkpoints, "about": about}[what](evcal, Path(folder), int(rest[0]) if rest else 5)
    else:
        {"page": page, "long": long}[what](evcal, Path(folder), rest[0])
