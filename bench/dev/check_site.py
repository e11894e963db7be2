"""Check of the built documentation site in Chromium: every page, on a desktop and on a telephone.

::

    make docs
    python -m pip install -e '.[browser]'
    python -m bench.dev.check_site docs/_build/html

A page fails if it scrolls sideways, lacks a picture, shows the source text of a formula, loads anything from another
host, or writes an error to the console. The search box must find pages for each word of ``SEARCHES``.
``--screenshots FOLDER`` saves a picture of each page. The exit code is 1 if anything fails.
"""

from __future__ import annotations

import argparse
import functools
import http.server
import os
import shutil
import sys
import threading
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from playwright import sync_api

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

# Widths of the browser window: a small desktop and a telephone [CSS pixels].
WIDTHS = (1280, 400)
HEIGHT = 900
SEARCHES = ("coherence", "glTF", "tolerance")
# Time limit of each step of the check [ms]. The value was chosen for busy machines; if it is doubled, failures are only
# reported later.
WAIT_MS = 120_000
FLAGS = [
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync"),
]
# JavaScript function that returns the faults of a page. Pictures that load only when they become visible are loaded
# first, so that missing pictures are reported.
FAULTS = """async () => {
    for (const image of document.images) image.loading = "eager";
    await Promise.all([...document.images].map(image => image.decode().catch(() => null)));
    const missing = [...document.images].filter(image => image.naturalWidth === 0);
    const faults = missing.map(image => `no picture ${image.src}`);
    const width = document.documentElement.scrollWidth;
    if (width > innerWidth) {
        const wide = [...document.querySelectorAll("main *")].filter(e => e.getBoundingClientRect().right > innerWidth);
        faults.push(`scrolls sideways: ${width} of ${innerWidth} pixels, ` +
            wide.slice(0, 3).map(e => `${e.tagName.toLowerCase()}.${e.className}`).join(" "));
    }
    if (/\\\\\\(|\\\\\\[|\\$\\$/.test([...document.querySelectorAll("p, .math")].map(e => e.innerText).join("\\n")))
        faults.push("shows the source text of a formula");
    return faults;
}"""


class _Quiet(http.server.SimpleHTTPRequestHandler):
    """HTTP request handler that writes no log."""

    def log_message(self, *_: Any) -> None:
        pass


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Serve a folder by HTTP on this machine within the ``with`` block, and yield the address of the folder."""
    handler = functools.partial(_Quiet, directory=os.fspath(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


class Tab:
    """Browser page of a fixed width that collects console errors and requests to other hosts."""

    def __init__(self, browser: sync_api.Browser, address: str, width: int) -> None:
        self.address, self.width = address, width
        self.page = browser.new_page(viewport={"width": width, "height": HEIGHT})
        self.page.set_default_timeout(WAIT_MS)
        self.messages: list[str] = []
        self.page.on("console", lambda said: self.messages.append(said.text) if said.type == "error" else None)
        self.page.on("pageerror", lambda error: self.messages.append(str(error)))
        self.page.route(lambda url: not url.startswith((address, "data:", "blob:")), self._refuse)

    def _refuse(self, route: sync_api.Route) -> None:
        self.messages.append(f"requests {route.request.url}")
        route.abort()

    def faults(self, name: str) -> list[str]:
        """Open a page of the site, and return its faults."""
        self.messages.clear()
        self.page.goto(f"{self.address}/{name}")
        return [*self.page.evaluate(FAULTS), *self.messages]

    def results(self, word: str) -> int:
        """Search for a word by the search box of the first page, and return the number of pages in the result."""
        self.page.goto(f"{self.address}/index.html")
        self.page.locator("button.search-button__button:visible, button.search-button:visible").first.click()
        self.page.keyboard.type(word)
        self.page.keyboard.press("Enter")
        self.page.wait_for_url("**/search.html?q=*")
        self.page.wait_for_function("document.querySelector('#search-results .search-summary')?.innerText")
        return self.page.locator("#search-results ul.search > li").count()


def main(arguments: Sequence[str] | None = None) -> int:
    """Check all pages of a site. Return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m bench.dev.check_site", description="Check the built site.")
    parser.add_argument("site", type=Path, metavar="FOLDER", help="folder of the built site")
    parser.add_argument("--screenshots", type=Path, metavar="FOLDER", help="save a picture of each page")
    options = parser.parse_args(arguments)
    browser_path = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    pages = sorted(path.relative_to(options.site).as_posix() for path in options.site.rglob("*.html"))
    pages = [name for name in pages if not name.startswith("_")]
    if not pages or browser_path is None:
        missing = f"{options.site} has no pages: run make docs" if not pages else "install Chromium, or set CHROMIUM"
        print(f"python -m bench.dev.check_site: {missing}", file=sys.stderr)
        return 2
    failed = 0
    with served(options.site) as address, sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=FLAGS)
        for width in WIDTHS:
            tab = Tab(browser, address, width)
            for name in pages:
                for fault in tab.faults(name):
                    failed += 1
                    print(f"{name} at {width} pixels: {fault}", flush=True)
                if options.screenshots is not None:
                    target = options.screenshots / f"{width}" / f"{name.replace('/', '.')}.png"
                    tab.page.screenshot(path=target, full_page=True)
            for word in SEARCHES:
                count = tab.results(word)
                failed += count == 0
                print(f"search for {word} at {width} pixels: {count} pages", flush=True)
            tab.page.close()
        browser.close()
    print(f"{len(pages)} pages at {' and '.join(map(str, WIDTHS))} pixels: {failed} faults")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
