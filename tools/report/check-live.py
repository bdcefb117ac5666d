"""Opens the page of `evcal live --replay` in a headless browser, as a phone and a desktop show it, in light and dark,
with the keyboard alone. Fails on anything in the console, on any request to elsewhere, on a page wider than the screen,
on text of low contrast, and when the page does not come to its result. Leaves pictures, of which live.png is the one in the README:

    python3 tools/report/check-live.py EVCAL BROWSER FOLDER && cp FOLDER/live.png docs/pictures/live.png
"""

import re
import subprocess
import sys
import time
from pathlib import Path

from browser import Browser, Tab

RECORDING = "fixtures/board/events.dvraw"
BOARD = "acircles:9x4:55mm:r17.5mm"
# Seconds of the recording per second: slow enough to check four pages while it plays.
SPEED = "0.07"
LEAST_CONTRAST = 4.5
# Time (s) until a page that was loaded again shows states.
LONGEST_RELOAD = 1.0

CONTRAST = """(() => {
  const channels = (color) => color.match(/[\\d.]+/g).map(Number);
  const luminance = (color) => channels(color).slice(0, 3).map((value) => value / 255)
    .map((value) => value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4)
    .reduce((sum, value, index) => sum + value * [0.2126, 0.7152, 0.0722][index], 0);
  const behind = (element) => {
    for (let at = element; at; at = at.parentElement) {
      const color = getComputedStyle(at).backgroundColor;
      if ((channels(color)[3] ?? 1) > 0) return color;
    }
    return 'rgb(255, 255, 255)';
  };
  const poor = [];
  for (const element of document.querySelectorAll('body *')) {
    const hasText = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    if (!hasText || !element.checkVisibility() || ['SCRIPT', 'NOSCRIPT'].includes(element.tagName)) continue;
    const style = getComputedStyle(element);
    const ink = element.namespaceURI.endsWith('svg') ? style.fill : style.color;
    const [a, b] = [luminance(ink), luminance(behind(element))].sort((x, y) => y - x);
    const contrast = (a + 0.05) / (b + 0.05);
    if (contrast < %f) poor.push(`${element.tagName} ${element.textContent.trim().slice(0, 30)}: ${contrast.toFixed(2)}`);
  }
  return poor;
})()""" % LEAST_CONTRAST

# Shares of the picture's pixels that are not the colour of the paper.
DRAWN = """(() => {
  const canvas = document.getElementById('picture');
  const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
  let drawn = 0;
  for (let index = 0; index < data.length; index += 4) {
    drawn += Math.abs(data[index] - data[0]) + Math.abs(data[index + 1] - data[1]) + Math.abs(data[index + 2] - data[2]) > 60;
  }
  return drawn / (data.length / 4);
})()"""

# The picture of the documents: many boards, and the ghost separate from the board, both mostly in view.
WORTH_A_PICTURE = """(() => {
  const { ghost, board, sensor, coverage, sigma } = evcal.state;
  if (!ghost || !board || coverage.boards < 120 || sigma === null || ghost.distance < 1.5) return false;
  return [...ghost.corners, ...board.corners].every(([x, y]) => x > -26 && y > -26 && x < sensor[0] + 26 && y < sensor[1] + 26);
})()"""

# Keeps the drawn pictures with their times. When a board was found, evcal.dark becomes the share of its circles that are darker in the
# middle than around, in the picture of its time: a busy computer shows later pictures by then.
WATCH_CIRCLES = """(() => {
  const [kept, most] = [[], 64];
  let seen = null;
  const share = (pixels, circles) => {
    const grey = (x, y) => pixels.getImageData(Math.round(x), Math.round(y), 1, 1).data[0];
    const around = [[1.7, 0], [-1.7, 0], [0, 1.7], [0, -1.7]];
    const inside = [[0.4, 0], [-0.4, 0], [0, 0.4], [0, -0.4]];
    const mean = ([x, y, radius], places) => places.reduce((sum, [right, down]) => sum + grey(x + right * radius, y + down * radius), 0) / 4;
    return circles.filter((circle) => mean(circle, inside) + 40 < mean(circle, around)).length / circles.length;
  };
  setInterval(() => {
    const { board, sensor, t } = evcal.state;
    if (kept.at(-1)?.t !== t) {
      const pixels = new OffscreenCanvas(...sensor).getContext('2d', { willReadFrequently: true });
      pixels.drawImage(document.getElementById('picture'), 0, 0, ...sensor);
      kept.push({ t, pixels });
      if (kept.length > most) kept.shift();
    }
    if (!board || board.t === seen) return;
    seen = board.t;
    const [nearest] = kept.toSorted((a, b) => Math.abs(a.t - seen) - Math.abs(b.t - seen));
    if (board.circles.length > 20 && Math.abs(nearest.t - seen) < 0.01) evcal.dark = share(nearest.pixels, board.circles);
  }, 4);
})()"""

# The longest hints and reasons: none may move the picture or be cut.
LONGEST_TEXTS = """(() => {
  const [hint, nothing, picture] = ['hint', 'nothing', 'picture'].map((name) => document.getElementById(name));
  const before = [hint.textContent, nothing.textContent];
  const places = [];
  for (const [order, reason] of [
    ['up', ''],
    ['turn it counterclockwise', 'hardly any events: is the lens cap off, and is there light?'],
    ['to the lower right', 'circles, but not those of the board: is it flat, and is it described right?'],
    ['swing it left and right', 'a board of another kind: 9 rows of 4 circles, asymmetric, where 7 rows of 6 were stated; is it the right one?'],
  ]) {
    hint.textContent = order;
    nothing.textContent = reason;
    const isCut = hint.scrollWidth > hint.clientWidth + 1 || nothing.scrollHeight > nothing.clientHeight + 1;
    places.push([picture.getBoundingClientRect().top + scrollY, isCut]);
  }
  [hint.textContent, nothing.textContent] = before;
  return places;
})()"""
# The outline is drawn where the board is, or not at all: share of the picture's width that it was moved ahead.
FARTHEST = 1 / 60

failures = []


def check(condition, text):
    if not condition:
        failures.append(text)
        print(f"test-live: {text}")


def check_layout(tab, name):
    wide, visible = tab.script("[document.documentElement.scrollWidth, innerWidth]")
    check(wide <= visible, f"{name}: the page is {wide} px wide")
    for poor in tab.script(CONTRAST):
        check(False, f"{name}: low contrast: {poor}")


def watch(browser, url, pictures):
    """The page while the board is in view."""
    tabs = []
    for width, height, scheme in [(390, 844, "light"), (390, 844, "dark"), (1440, 900, "light"), (1440, 900, "dark")]:
        name = f"{width} px {scheme}"
        tab = Tab(browser, url, width, height, scheme)
        tab.wait("window.evcal && evcal.phase === 'recording' && evcal.state.ghost && evcal.state.board && evcal.shown > 5")
        check_layout(tab, name)
        check(tab.script(DRAWN) > 0.02, f"{name}: next to nothing is drawn")
        hint = tab.script("document.getElementById('hint').textContent")
        check(len(hint) > 1, f"{name}: no hint")
        places = tab.script(LONGEST_TEXTS)
        check(len({top for top, _ in places}) == 1, f"{name}: hints move the picture: {places}")
        check(not any(is_cut for _, is_cut in places), f"{name}: hints are cut: {places}")
        drawn = tab.script("[evcal.drawn, evcal.state.sensor[0]]")
        check(drawn[0] is None or drawn[0] <= FARTHEST * drawn[1], f"{name}: the outline is moved ahead by {drawn[0]} px")
        tab.picture(pictures / f"live-{width}-{scheme}.png")
        tabs.append(tab)
    return tabs


def check_keys(tab, other, pictures):
    """Keys, clicks and the memory of a page that is loaded again; ends the recording."""
    pressed = "document.getElementById('%s').ariaPressed"
    tab.key("g", 71)
    check(tab.script(pressed % "grey") == "true", "G shows no grey picture")
    tab.script(WATCH_CIRCLES)
    tab.wait("evcal.dark > 0.9", 20)
    check(tab.script("document.querySelector('#sight .on').checkVisibility()") is False, "ON events are explained in the grey picture")
    tab.picture(pictures / "live-grey.png")
    tab.key(" ", 32)
    check(tab.script(pressed % "mirror") == "true", "Space does not mirror")
    tab.wait("document.body.dataset.mirrored === 'true'", 5)
    sides = tab.script("[evcal.hint, evcal.state.hint.mirrored, document.getElementById('tilts').textContent]")
    check(sides[0] == sides[1] and sides[2].startswith("right nearer"), f"mirrored: {sides}")
    tab.key("s", 83)
    check(tab.script(pressed % "sound") == "true", "S gives no sound")
    # A busy computer may delay one of them.
    for _ in range(3):
        began = time.monotonic()
        tab.call("Page.reload")
        tab.wait("window.evcal && evcal.shown > 2", 10)
        seconds = time.monotonic() - began
        if seconds <= LONGEST_RELOAD:
            break
    check(seconds <= LONGEST_RELOAD, f"the page is there {seconds:.2f} s after it was loaded again")
    check(tab.script(pressed % "mirror") == "true", "mirrored is forgotten")
    check(other.script(pressed % "mirror") == "false", "another tab is mirrored as well")
    check(tab.script(pressed % "grey") == "true", "the grey picture is forgotten")
    tab.key("f", 70)
    tab.wait(pressed % "frames" + " === 'true'", 5)
    other.wait(pressed % "frames" + " === 'true'", 5)
    # The keys are the page's again after a click on a button.
    tab.click("sound")
    check(tab.script(pressed % "sound") == "true", "a click gives no sound")
    tab.key("Enter", 13)
    tab.wait("evcal.phase === 'calibrating' && evcal.state.step && evcal.state.step.text")
    seen = tab.script(
        "[evcal.hint, document.getElementById('step').checkVisibility(), document.getElementById('missing').checkVisibility()]"
    )
    check(seen == ["calibrating …", True, False], f"while it calibrates: {seen}")


def main(evcal, program, folder):
    pictures = Path(folder)
    out = pictures / "live-calibration"
    command = [evcal, "live", "--replay", RECORDING, "--speed", SPEED, "--port", "0", "--no-open", "--board", BOARD]
    live = subprocess.Popen(
        [*command, "-o", str(out), "--force", "--accept-any"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    browser = Browser(program)
    try:
        line = live.stderr.readline()
        found = re.search(r"http://127\.0\.0\.1:(\d+)/#[0-9a-f]{32}", line)
        if not found:
            raise SystemExit(f"test-live: no address in: {line}")
        url = found[0]
        tabs = watch(browser, url, pictures)
        tabs[2].wait(WORTH_A_PICTURE)
        tabs[2].picture(pictures / "live.png")
        check_keys(tabs[-1], tabs[0], pictures)
        for tab, name in ((tabs[0], "390-light"), (tabs[3], "1440-dark")):
            tab.wait("evcal.phase === 'done'")
            # A recording of three seconds is not enough for the target, and then "done" is not said.
            check(tab.script("evcal.hint").startswith("ended: "), f"{name}: {tab.script('evcal.hint')}")
            check_layout(tab, f"{name} done")
            matrix = tab.script("document.getElementById('matrix').textContent")
            check(re.search(r"\[\[33\d\.\d+, 0, 17\d\.\d+\]", matrix), f"{name}: K is {matrix}")
            report = tab.script("fetch(document.getElementById('report').src).then((answer) => answer.text())")
            check("<h1>Calibration of " in report, f"{name}: no report")
            tab.picture(pictures / f"live-{name}-done.png")
            # A frame outside of the window is not painted.
            tab.script("document.getElementById('report').scrollIntoView()")
            tab.picture(pictures / f"live-{name}-report.png", whole=False)
        links = tab.script("[...document.querySelectorAll('#files a')].map((link) => link.textContent)")
        check("camera.yaml" in links and "calibration.json" in links, f"files: {links}")
        camera = tab.script("fetch([...document.querySelectorAll('#files a')].find((link) => link.textContent === 'camera.yaml').href).then((answer) => answer.text())")
        check("346" in camera, f"camera.yaml: {camera[:100]}")
        # With the keyboard alone: Tab to the button, Enter presses it.
        tab.script("document.getElementById('copy').focus()")
        for _ in range(5):
            if tab.script("document.activeElement.id") == "close":
                break
            tab.key("Tab", 9)
        check(tab.script("document.activeElement.id") == "close", "Tab does not come to Close evcal")
        tab.key("Enter", 13)
        check(live.wait(20) == 0, f"evcal ended with {live.returncode}")
        own = (f"http://127.0.0.1:{found[1]}/", "data:", "about:")
        for event in browser.events:
            method, parameters = event.get("method"), event.get("params", {})
            if method in ("Log.entryAdded", "Runtime.exceptionThrown", "Runtime.consoleAPICalled"):
                text = str(parameters)
                # Once evcal has ended, pages that still ask find nobody.
                check("ERR_CONNECTION_REFUSED" in text, f"console: {text[:300]}")
            if method == "Network.requestWillBeSent":
                check(parameters["request"]["url"].startswith(own), f"asked for {parameters['request']['url']}")
    finally:
        browser.close()
        live.kill()
    if failures:
        raise SystemExit(1)
    print(f"test-live: 390 and 1440 px, light and dark, keyboard, result: {pictures}/live-*.png")


main(*sys.argv[1:])
