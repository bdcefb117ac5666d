"""Opens a page of `evcal board --blink` in a headless browser: the board has its size on a screen that was measured, changes as often as
asked, and a key ends it. Leaves pictures of the page and of the board:

    python3 tools/report/check-blinking.py EVCAL BROWSER FOLDER
"""

import json
import subprocess
import sys
from pathlib import Path

from browser import Browser, Tab

BOARD, SQUARE = "checkerboard:5x8:15mm", 15
# Pixels per millimetre of the screen.
SCALE = 6
RATE = 10

# Numbers of the times at which the board appeared or vanished during two seconds.
CHANGES = """new Promise(done => {
  const board = document.querySelector('#board svg'), begin = performance.now();
  let changes = 0, last = board.style.visibility;
  const look = now => {
    if (board.style.visibility !== last) { changes++; last = board.style.visibility; }
    if (now - begin < 2000) requestAnimationFrame(look); else done(changes);
  };
  requestAnimationFrame(look);
})"""


def main(evcal, browser, folder):
    page = Path(folder).resolve() / "blinking.html"
    board = [evcal, "board", "--board", BOARD, "--blink", str(page), "--force", "--json"]
    assert json.loads(subprocess.run(board, check=True, stdout=subprocess.PIPE).stdout)["written"] == [str(page)]
    browser = Browser(browser)
    try:
        tab = Tab(browser, page.as_uri(), 1440, 900, "light")
        tab.wait("document.readyState === 'complete' && !!document.getElementById('start')")
        tab.picture(Path(folder) / "blinking-panel.png", whole=False)
        tab.script(f"scale.value = {SCALE}; scale.dispatchEvent(new Event('input')); rate.value = '{RATE}'")
        card = tab.script("document.getElementById('card').getBoundingClientRect().width")
        assert abs(card - 85.6 * SCALE) < 0.1, card
        # The squares, from their outline.
        squares = tab.script(
            "(() => { const {width, height} = document.querySelector('#board path').getBoundingClientRect(); return [width, height]; })()"
        )
        assert all(abs(side - count * SQUARE * SCALE) < 0.1 for side, count in zip(sorted(squares), (6, 9))), squares
        assert tab.script("document.getElementById('warning').textContent") == ""
        tab.click("start")
        tab.wait("document.body.classList.contains('running')")
        changes = tab.script(CHANGES)
        assert abs(changes - 2 * RATE) <= 2, changes
        tab.wait("document.querySelector('#board svg').style.visibility !== 'hidden'")
        tab.picture(Path(folder) / "blinking-board.png", whole=False)
        tab.key("x", 88)
        tab.wait("!document.body.classList.contains('running')", 5)
        # A board that is larger than the screen is named.
        tab.script("scale.value = 16; scale.dispatchEvent(new Event('input'))")
        assert "larger than the screen" in tab.script("document.getElementById('warning').textContent")
        said = [event for event in browser.events if event.get("method") in ("Runtime.exceptionThrown", "Log.entryAdded")]
        assert not said, said
    finally:
        browser.close()
    print(f"test-report: {page}: {changes} changes in 2 s, the board has its size")


main(*sys.argv[1:])
