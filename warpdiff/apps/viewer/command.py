"""``warpdiff view``: a page in the browser on which body, light and surface are turned by hand."""

from __future__ import annotations

import asyncio
import threading
import webbrowser
from typing import TYPE_CHECKING, Any

from warpdiff.apps.viewer.controls import controls, defaults
from warpdiff.apps.viewer.server import ViewServer

if TYPE_CHECKING:
    from collections.abc import Callable

    from warpdiff.apps.viewer.page_calls import NamedFiles
    from warpdiff.apps.viewer.session import Studio


def run(
    files: NamedFiles,
    *,
    host: str,
    port: int,
    opens_browser: bool,
    device: Any,
    threads: int | None,
    say: Callable[[str], None],
) -> None:
    """Serve the viewer until it is interrupted.

    Args:
        files: What was named beside the sample bodies and gratings.
        host: The address to listen on; beyond this machine a token is asked for.
        port: 0 takes a free one.
        opens_browser: Whether to open the page.
        device: As in :func:`warpdiff.shade`.
        threads: As in :func:`warpdiff.shade`.
        say: Called with the line that names the address.
    """
    known = controls(*([each.name for each in named] for named in (files.meshes, files.heights, files.environments)))

    def begin() -> Studio:
        # A second's worth of imports, while the browser already loads the page.
        from warpdiff.apps.viewer.session import Studio

        return Studio(files, defaults(known), device=device, threads=threads)

    async def serve() -> None:
        studio = asyncio.ensure_future(asyncio.to_thread(begin))
        server = ViewServer(known, lambda: asyncio.shield(studio), host, port)

        def ready() -> None:
            say(f"{server.address}  (Ctrl-C ends it)")
            if opens_browser:
                threading.Thread(target=webbrowser.open, args=(server.address,), daemon=True).start()

        serving = asyncio.ensure_future(server.run(ready))
        # What cannot begin is told at once.
        done, _ = await asyncio.wait({studio, serving}, return_when=asyncio.FIRST_COMPLETED)
        for each in done:
            each.result()
        await serving

    asyncio.run(serve())
