"""``warpdiff view``: the interactive viewer, a page in the browser."""

from __future__ import annotations

import asyncio
import threading
import webbrowser
from typing import TYPE_CHECKING, Any

from warpdiff.apps.viewer.controls import defaults
from warpdiff.apps.viewer.server import ViewServer

if TYPE_CHECKING:
    from collections.abc import Callable

    from warpdiff.apps.viewer.page_calls import NamedFiles
    from warpdiff.apps.viewer.session import Studio


def run(
    files: NamedFiles, *, host: str, port: int, opens_browser: bool, say: Callable[[str], None], device: Any = None,
    threads: int | None = None,
) -> None:  # fmt: skip
    """Serve the viewer until it is interrupted.

    Args:
        files: Files that the page offers besides the sample bodies and gratings.
        host: Address to listen on; an address that other machines reach requires a token.
        port: Port; 0 picks a free one.
        opens_browser: Whether to open the page.
        say: Function that is called with the line that contains the page's address.
        device: As in :func:`warpdiff.shade`.
        threads: As in :func:`warpdiff.shade`.
    """

    def begin() -> Studio:
        # These imports take a second, during which the browser loads the page.
        from warpdiff.apps.viewer.session import Studio

        return Studio(files, defaults(files.controls), device=device, threads=threads)

    async def serve() -> None:
        studio = asyncio.ensure_future(asyncio.to_thread(begin))
        server = ViewServer(files.controls, lambda: asyncio.shield(studio), host, port)

        def ready() -> None:
            say(f"{server.address}  (Ctrl-C stops the viewer)")
            if opens_browser:
                threading.Thread(target=webbrowser.open, args=(server.address,), daemon=True).start()

        serving = asyncio.ensure_future(server.run(ready))
        # A studio or server that fails to start raises its error now.
        done, _ = await asyncio.wait({studio, serving}, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
        await serving

    asyncio.run(serve())
