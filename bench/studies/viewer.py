"""How fast the viewer is in the hand: pictures a second while dragging, how soon they are finer and there.

``python -m bench.studies.viewer`` drives ``warpdiff view`` through its page in headless Chromium, which
renders in software on the same cores, and prints JSON. It takes Chromium and ``pip install 'warpdiff[browser]'``.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

FLAGS = [
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync"),
]
# What the page shows, with when, and when a pointer was let go.
WATCH = """
window.seen = []; window.released = 0;
new MutationObserver(() => {
  const c = document.getElementById('picture');
  if (c) seen.push({at: performance.now(), ...c.dataset, width: c.width, height: c.height});
}).observe(document.getElementById('picture'), {attributes: true, attributeFilter: ['data-count']});
addEventListener('pointerup', () => { released = performance.now(); }, true);
"""
# Of the command, with another limit for pictures that move.
RUN = (
    "import sys, warpdiff.viewer.session as s; s._MOVING_S = float(sys.argv.pop(1)); "
    "from warpdiff.app import cli; cli.main(sys.argv[1:])"
)
PANEL = 320


def browser_time() -> float:
    """Processor time of the browser that this process has begun [s]."""
    parents, ticks = {}, {}
    for each in Path("/proc").glob("[0-9]*"):
        # A process may end meanwhile.
        with contextlib.suppress(OSError):
            fields = (each / "stat").read_text().rpartition(")")[2].split()
            parents[int(each.name)] = int(fields[1])
            if b"chrom" in (each / "cmdline").read_bytes():
                ticks[int(each.name)] = int(fields[11]) + int(fields[12])

    def is_ours(process: int) -> bool:
        return process == os.getpid() or (process > 1 and is_ours(parents.get(process, 0)))

    return sum(taken for process, taken in ticks.items() if is_ours(process)) / os.sysconf("SC_CLK_TCK")


def begun(moving_s: float | None) -> tuple[subprocess.Popen[str], str]:
    """A viewer, and its address."""
    arguments = ["view", "--no-browser"]
    start = ["-m", "warpdiff"] if moving_s is None else ["-c", RUN, str(moving_s)]
    process = subprocess.Popen(
        [sys.executable, *start, *arguments], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    found = re.match(r"(http://\S+)", process.stdout.readline())
    return process, found[1]


def rest(page) -> None:
    """Wait for the finest picture."""
    page.wait_for_function(
        "() => { const c = document.getElementById('picture').dataset;"
        " return c.last === 'true' && c.generation === c.wanted; }",
        timeout=300_000,
        # By default it asks with every frame of a display, which the browser then draws on cores that the server takes.
        polling=100,
    )


def dragged(browser, address: str, rows: int, seconds: float) -> dict:
    """Figures of a page whose picture is so many rows of 4:3."""
    page = browser.new_page(viewport={"width": rows * 4 // 3 + PANEL, "height": rows})
    page.goto(address)
    page.wait_for_function("() => document.getElementById('picture').dataset.count", timeout=300_000)
    page.locator("#set-height").select_option(label=str(rows))
    rest(page)
    # Renderers of the sizes that pictures have while something moves.
    page.evaluate(WATCH)

    def drag(seconds: float) -> tuple[list, float]:
        box = page.locator("#stage").bounding_box()
        x, y = box["x"] + 0.3 * box["width"], box["y"] + 0.2 * box["height"]
        page.mouse.move(x, y)
        page.mouse.down()
        begin, k = time.perf_counter(), 0
        while time.perf_counter() - begin < seconds:
            k += 1
            page.mouse.move(x + 60.0 * ((k % 80) / 40.0 - 1.0) ** 2, y + 0.3 * (k % 50))
            time.sleep(0.02)
        took = time.perf_counter() - begin
        moving = page.evaluate("() => window.seen.slice()")
        page.mouse.up()
        return moving, took

    drag(2.0)
    rest(page)
    page.evaluate("() => { window.seen.length = 0; }")
    chromium = browser_time()
    moving, took = drag(seconds)
    chromium = (browser_time() - chromium) / took
    rest(page)
    after = page.evaluate("() => window.seen.filter(each => each.at > window.released)")
    released = page.evaluate("() => window.released")
    times = {}
    for each in after:
        if each["tolerance"]:
            times.setdefault(each["tolerance"], (each["at"] - released) / 1000.0)
    served = [json.loads(each["seconds"]) for each in moving]
    busy = sum(sum(each.values()) for each in served)
    parts = (
        {name: 1000.0 * sum(each[name] for each in served) / max(len(served), 1) for name in served[0]}
        if served
        else {}
    )
    sizes = sorted({f"{each['width']} × {each['height']}" for each in moving})
    page.close()
    return {
        "rows": rows,
        "pictures a second": len(moving) / took,
        "sizes while dragging": sizes,
        "server's share of the time": busy / took,
        "server, ms a picture": parts,
        "browser's processor time a second": chromium,
        "seconds after letting go": times,
    }


def main() -> None:
    """Print figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6.0, help="of dragging (default: 6)")
    parser.add_argument("--rows", type=int, nargs="+", default=[240, 480])
    parser.add_argument("--whole", action="store_true", help="while dragging, too, pictures have all their pixels")
    parser.add_argument("--starts", type=int, default=3, help="of warm processes (default: 3)")
    options = parser.parse_args()
    from playwright.sync_api import sync_playwright

    chromium = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        process, address = begun(1e9 if options.whole else None)
        for rows in options.rows:
            print(json.dumps(dragged(browser, address, rows, options.seconds), indent=1, ensure_ascii=False))
        process.send_signal(signal.SIGINT)
        process.wait()
        # A page that is opened once the command has told its address, as it opens one itself.
        starts = []
        for _ in range(options.starts):
            page = browser.new_page(viewport={"width": 640 + PANEL, "height": 480})
            begin = time.perf_counter()
            process, address = begun(None)
            listening = time.perf_counter() - begin
            page.goto(address)
            page.wait_for_function("() => document.getElementById('picture').dataset.count", timeout=300_000)
            starts.append((listening, time.perf_counter() - begin))
            page.close()
            process.send_signal(signal.SIGINT)
            process.wait()
        print(json.dumps({"seconds to listen, to the first picture": starts}))
        browser.close()


if __name__ == "__main__":
    main()
