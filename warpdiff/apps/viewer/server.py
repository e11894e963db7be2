"""Web server of ``warpdiff view``. It serves one HTML page and a web socket, to at most 8 pages at once.

A page loads no other file and connects to no other host. Over the socket, the page sends small JSON messages. The page
receives each picture as one message: four bytes with the length of the JSON part, the JSON part, and the bytes of a
picture file. The server answers requests under these conditions:

- The header ``Host`` names this server, and the ``Origin`` of a socket is this server's page. Other web pages in the
  same browser can therefore not use the viewer.
- If other machines can reach the server, the request contains the server's token.
- A message has at most 16 KiB. A page that does not read its messages is disconnected.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import logging
import secrets
import socket
import struct
import threading
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Response

import warpdiff as wd
from warpdiff.apps.viewer.controls import Control, checked, defaults, described, word
from warpdiff.apps.viewer.page_calls import PageRequest
from warpdiff.core import validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref, spelled

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping

    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request

    from warpdiff.apps.viewer.page_calls import NamedFiles
    from warpdiff.apps.viewer.session import Studio

# Largest number of pages that are open at once. The number is limited because one thread renders for all pages, so that
# each additional page makes all pages slower.
MOST_PAGES = 8
# Largest accepted size of a message from a page [bytes]. The requests of a page have about 2 kB.
_MOST_MESSAGE_BYTES = 16 * 1024
# Largest number of messages that wait to be sent to a page. The number is limited because messages to a page that does
# not read them require memory.
_MOST_QUEUED = 12
# Longest time within which a new connection must send its first request [s]. The time is limited because idle
# connections use resources.
_OPENING_S = 5.0
_LOOPBACK = {"127.0.0.1", "localhost", "::1"}
_FOLDER = Path(__file__).with_name("page")
_ASPECTS = (0.2, 5.0)
# Largest generation (number of a request of a page). JavaScript represents integers exactly only up to this number.
_MOST_GENERATION = 2**53 - 1


class _HostileError(Exception):
    """Error for a message that the viewer's page never sends. It closes the connection."""


def run(
    files: NamedFiles, *, host: str, port: int, opens_browser: bool, say: Callable[[str], None], **options: Any
) -> None:
    """Serve the viewer until it is interrupted.

    Args:
        files: Files that the page offers besides the sample bodies and gratings.
        host: Address to listen on; an address that other machines reach requires a token.
        port: Port; 0 picks a free one.
        opens_browser: Whether to open the page.
        say: Function that is called with the line that contains the page's address.
        options: ``device`` and ``threads``, as in :func:`warpdiff.shade`.
    """

    def begin() -> Studio:
        # Importing these modules requires a second. They are imported in another thread while the browser loads the
        # page.
        from warpdiff.apps.viewer.session import Studio

        return Studio(files, defaults(files.controls), **options)

    async def serve_page() -> None:
        studio = asyncio.ensure_future(asyncio.to_thread(begin))
        server = ViewServer(files.controls, lambda: asyncio.shield(studio), host, port)

        def ready() -> None:
            say(f"{server.address}  (Ctrl-C stops the viewer)")
            if opens_browser:
                threading.Thread(target=webbrowser.open, args=(server.address,), daemon=True).start()

        serving = asyncio.ensure_future(server.run(ready))
        # If the drawing thread or the server could not start, this loop raises the error.
        done, _ = await asyncio.wait({studio, serving}, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
        await serving

    asyncio.run(serve_page())


@dataclass
class ViewServer:
    """HTTP and web socket server of the viewer's page.

    Attributes:
        controls: Controls of the page.
        studio: Function that waits until the ``Studio`` with the drawing thread exists, and returns it.
        host: Address that the server listens on.
        port: Port that the server listens on. If it is 0, the server picks a free port and stores its number here.
        token: Token that requests must contain; empty if only this machine can reach the server.
    """

    controls: dict[str, Control]
    studio: Callable[[], Awaitable[Studio]]
    host: str = "127.0.0.1"
    port: int = 0
    token: str = ""

    def __post_init__(self) -> None:
        if self.host not in _LOOPBACK:
            self.token = secrets.token_urlsafe(16)
        self._pages = 0
        self._logger = logging.getLogger("warpdiff.view")
        # The logger prints nothing. By default, the package websockets would log a traceback for each malformed
        # request.
        self._logger.addHandler(logging.NullHandler())
        self._logger.propagate = False

    @property
    def address(self) -> str:
        """Address of the page, which a user opens in a browser."""
        # An address such as 0.0.0.0 stands for all network interfaces. The printed address then contains this machine's
        # name, which other machines need.
        host = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host  # noqa: S104 (the address is only compared)
        name = f"[{host}]" if ":" in host else host
        return f"http://{name}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    async def run(self, ready: Callable[[], None]) -> None:
        """Run the server until the asyncio task is cancelled; call ``ready`` when the server accepts connections."""
        async with serve(
            self._page, self.host, self.port, process_request=self._answer, max_size=_MOST_MESSAGE_BYTES, max_queue=4,
            compression=None, open_timeout=_OPENING_S, logger=self._logger, server_header=None,
        ) as server:  # fmt: skip
            self.port = next(iter(server.sockets)).getsockname()[1]
            ready()
            await server.serve_forever()

    def _answer(self, _: ServerConnection, request: Request) -> Response | None:
        """Return the response to an HTTP request: the page or an error. Return None to open a web socket."""
        try:
            host, origin = request.headers.get("Host", ""), request.headers.get("Origin")
            upgrade = request.headers.get("Upgrade", "").lower() == "websocket"
        except LookupError:
            return _refused(400, "a header occurs twice")
        url = urlsplit(request.path)
        is_socket = url.path == "/socket" and upgrade
        token = parse_qs(url.query).get("token", [""])[0]
        origins = f"http://{host}", f"https://{host}"
        refusals = [
            # In websockets before version 17, requests have no attribute ``method``. These versions refuse methods
            # other than GET themselves.
            (getattr(request, "method", "GET") != "GET", 405, "the method must be GET"),
            (not self._is_ours(host), 403, "the Host header must name this server"),
            (
                not hmac.compare_digest(token.encode(), self.token.encode()),
                403,
                "the token is missing or wrong: open the address that warpdiff view printed",
            ),
            (not is_socket and (url.path != "/" or upgrade), 404, "there is no such page"),
            (is_socket and origin not in origins, 403, "the Origin header must be this server's page"),
            (is_socket and self._pages >= MOST_PAGES, 503, f"at most {MOST_PAGES} pages can be open: close one"),
        ]
        for is_refused, status, why in refusals:
            if is_refused:
                return _refused(status, why)
        return None if is_socket else self._document(host)

    def _is_ours(self, host: str) -> bool:
        """Whether a ``Host`` header names this server.

        If other machines can reach the server, any name is accepted, because the server does not know all names of its
        machine.
        """
        if self.host not in _LOOPBACK:
            return bool(host)
        with contextlib.suppress(ValueError):
            url = urlsplit(f"//{host}")
            return url.hostname in _LOOPBACK and url.port == self.port
        return False

    def _document(self, host: str) -> Response:
        """Return the viewer's HTML page, into which its style sheet and its script are inserted."""
        nonce = secrets.token_urlsafe(16)
        text = (_FOLDER / "page.html").read_text(encoding="utf-8")
        for name in ("page.css", "page.js"):
            text = text.replace(f"/* {name} */", (_FOLDER / name).read_text(encoding="utf-8"))
        body = text.replace("NONCE", nonce).encode()
        policy = (
            f"default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; img-src blob: data:; "
            f"connect-src 'self' ws://{host} wss://{host}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )
        return _response(200, "text/html; charset=utf-8", body, {"Content-Security-Policy": policy})

    async def _page(self, connection: ServerConnection) -> None:
        """Serve one page over its web socket."""
        # The limit of open pages was checked when the browser requested the connection. It is checked again here,
        # because several requests may have passed that check before the first page was counted as open.
        if self._pages >= MOST_PAGES:
            await connection.close(1013, "too many pages")
            return
        self._pages += 1
        try:
            await _Page(connection, self.controls, await self.studio()).run()
        finally:
            self._pages -= 1


def _response(status: int, kind: str, body: bytes, more: Mapping[str, str]) -> Response:
    headers = {
        "Content-Type": kind, "Content-Length": str(len(body)), "Cache-Control": "no-store", "Connection": "close",
        "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer", **more,
    }  # fmt: skip
    return Response(status, {200: "OK"}.get(status, "Refused"), Headers(headers), body)


def _refused(status: int, why: str) -> Response:
    return _response(status, "text/plain; charset=utf-8", f"warpdiff view: {why}\n".encode(), {})


class _Page:
    """Connection of one page: its web socket and its queue of messages."""

    def __init__(self, connection: ServerConnection, controls: dict[str, Control], studio: Studio) -> None:
        self._connection, self._controls, self._studio = connection, controls, studio
        self._loop = asyncio.get_running_loop()
        self._queue: asyncio.Queue[str | bytes] = asyncio.Queue()
        self._session = studio.session(self._send)

    def _send(self, description: dict[str, Any], data: bytes | None) -> None:
        """Put a message into the queue of messages to the page. The drawing thread calls this method.

        Args:
            description: JSON part of the message.
            data: Bytes of a file that follow the JSON part; None sends only JSON.
        """
        text = json.dumps(description, allow_nan=False)
        message: str | bytes = text
        if data is not None:
            head = text.encode()
            message = struct.pack("<I", len(head)) + head + data
        # After the end of the server, its event loop is closed and raises ``RuntimeError``. The message to the page is
        # then discarded.
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._put, message)

    def _put(self, message: str | bytes) -> None:
        if self._queue.qsize() < _MOST_QUEUED:
            self._queue.put_nowait(message)
        else:
            self._connection.transport.abort()

    async def run(self) -> None:
        """Receive and send messages until the page disconnects."""
        controls = described(self._controls)
        self._put(json.dumps({"kind": "hello", "version": wd.__version__, "controls": controls}))
        writing = asyncio.create_task(self._write())
        try:
            async for message in self._connection:
                await self._take(message)
        except _HostileError as error:
            with contextlib.suppress(ConnectionClosed):
                await self._connection.close(1008, str(error)[:100])
        except ConnectionClosed:
            pass
        finally:
            self._studio.leave(self._session)
            writing.cancel()
            with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
                await writing

    async def _write(self) -> None:
        while True:
            await self._connection.send(await self._queue.get())

    async def _take(self, message: str | bytes) -> None:
        """Handle a message of the page: request a picture, save the last picture, or confirm that one was shown."""
        try:
            content = json.loads(message) if isinstance(message, str) else None
        except (ValueError, RecursionError):
            content = None
        if not isinstance(content, dict):
            raise _HostileError("messages are JSON objects")
        action = content.get("do")
        if action == "shown":
            self._studio.acknowledge(self._session)
        elif action == "draw":
            try:
                self._studio.request(self._session, self._request(content))
            except (ValueError, TypeError) as error:
                self._report(error)
        elif action == "save" and content.get("as") in ("png", "exr"):
            await self._save(content["as"])
        else:
            raise _HostileError("there is no such message")

    def _report(self, error: Exception) -> None:
        text = spelled(error, word(self._controls, defaults(self._controls)))
        self._put(json.dumps({"kind": "error", "text": text}))

    def _request(self, content: dict[str, Any]) -> PageRequest:
        """Check all values in a page's message, and return the message as a request for a picture."""
        generation = validation.count(content.get("generation"), "generation", least=0, most=_MOST_GENERATION)
        aspect = validation.number(content.get("aspect"), "aspect", least=_ASPECTS[0], most=_ASPECTS[1])
        x, y = validation.numbers(content.get("probe"), "probe", length=2)
        if not (min(x, y) >= 0.0 and max(x, y) <= 1.0):
            raise ArgumentValueError(f"{ref('probe')} must lie in the picture, 0 to 1, got {x, y}")
        values, camera = checked(self._controls, content.get("values")), content.get("camera")
        if camera is not None:
            if not isinstance(camera, dict):
                raise ArgumentTypeError(f"{ref('camera')} must be a JSON object, got {type(camera).__name__}")
            eye, target, up, fov = (camera.get(name) for name in ("eye", "target", "up", "fov_y_deg"))
            camera = wd.View(eye, target, up=up, fov_y_deg=fov)  # type: ignore[arg-type]
        return PageRequest(generation, values, camera, aspect, content.get("moving") is True, (x, y))

    async def _save(self, suffix: str) -> None:
        """Send the current picture to the page as a file."""
        try:
            data = await asyncio.to_thread(self._studio.saved, self._session, suffix)
        except (ValueError, OSError, MemoryError) as error:
            self._report(error)
        else:
            self._send({"kind": "file", "name": f"warpdiff.{suffix}"}, data)
