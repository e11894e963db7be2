"""The viewer's server: one page, one web socket, and nothing else, for a few pages at once.

A page loads no other file and asks no other host. Over the socket it sends small JSON messages, and gets pictures as
four bytes of length, that much JSON, and a file. What a request has to be, to be answered at all:

- its ``Host`` names this server, and a socket's ``Origin`` is the page's, so that no other page that the browser has
  open can speak to the viewer, whatever its name resolves to;
- where the server listens beyond this machine, it carries the token that was made for it;
- a message has at most 16 KiB, and what has piled up for a page that reads nothing ends its connection.
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
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Response

import warpdiff as wd
from warpdiff.apps.viewer.controls import Control, checked, described, vector

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping

    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request

    from warpdiff.apps.viewer.session import Studio, Wanted

MOST_PAGES = 8
_MOST_MESSAGE_BYTES = 16 * 1024
_MOST_PILED_UP = 12
_OPENING_S = 5.0
_LOOPBACK = {"127.0.0.1", "localhost", "::1"}
_FOLDER = Path(__file__).with_name("page")
_ASPECTS = (0.2, 5.0)
_MOST_GENERATION = 2**53


class _HostileError(Exception):
    """Raised by a message that no page sends."""


@dataclass
class ViewServer:
    """What is served, and to whom.

    Attributes:
        controls: Of the page.
        studio: Waits for the thread that draws.
        host: The address that it is bound to.
        port: 0 takes a free one, which stands here once it is bound.
        token: What requests must carry; empty on this machine.
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
        # Whoever knocks with nonsense is not told of at length.
        self._logger.addHandler(logging.NullHandler())
        self._logger.propagate = False

    @property
    def address(self) -> str:
        """What to open in a browser."""
        # Whoever opens it elsewhere needs a name of this machine.
        host = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host  # noqa: S104 (it is compared)
        named = f"[{host}]" if ":" in host else host
        return f"http://{named}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    async def run(self, ready: Callable[[], None]) -> None:
        """Serve until cancelled; ``ready`` is called once it listens."""
        async with serve(
            self._page, self.host, self.port, process_request=self._answer, max_size=_MOST_MESSAGE_BYTES, max_queue=4,
            compression=None, open_timeout=_OPENING_S, logger=self._logger, server_header=None,
        ) as server:  # fmt: skip
            self.port = next(iter(server.sockets)).getsockname()[1]
            ready()
            await server.serve_forever()

    def _answer(self, _: ServerConnection, request: Request) -> Response | None:
        """Answer a request, or None where a socket may be opened."""
        try:
            host, origin = request.headers.get("Host", ""), request.headers.get("Origin")
            upgrade = request.headers.get("Upgrade", "").lower() == "websocket"
        except LookupError:
            return _refused(400, "a header stands there twice")
        asked = urlsplit(request.path)
        is_socket = asked.path == "/socket" and upgrade
        given = parse_qs(asked.query).get("token", [""])[0]
        origins = f"http://{host}", f"https://{host}"
        refusals = [
            # Before version 17, websockets refuses other methods itself, and requests have no such attribute.
            (getattr(request, "method", "GET") != "GET", 405, "the method must be GET"),
            (not self._is_ours(host), 403, "another host is meant"),
            (
                not hmac.compare_digest(given.encode(), self.token.encode()),
                403,
                "the token is missing or wrong: open the address that warpdiff view has printed",
            ),
            (not is_socket and (asked.path != "/" or upgrade), 404, "there is no such page"),
            (is_socket and origin not in origins, 403, "another page asks"),
            (is_socket and self._pages >= MOST_PAGES, 503, f"{MOST_PAGES} pages are open already: close one"),
        ]
        for is_refused, status, why in refusals:
            if is_refused:
                return _refused(status, why)
        return None if is_socket else self._document(host)

    def _is_ours(self, host: str) -> bool:
        """Whether a ``Host`` names this server; beyond this machine it has names that it does not know."""
        if self.host not in _LOOPBACK:
            return bool(host)
        with contextlib.suppress(ValueError):
            named = urlsplit(f"//{host}")
            return named.hostname in _LOOPBACK and named.port == self.port
        return False

    def _document(self, host: str) -> Response:
        """The page, with its style and its script in it."""
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
        """Serve one page over its socket."""
        # Several may have been let in at once.
        if self._pages >= MOST_PAGES:
            await connection.close(1013, "too many pages")
            return
        self._pages += 1
        try:
            await _Page(connection, self.controls, await self.studio()).run()
        finally:
            self._pages -= 1


def _response(status: int, kind: str, body: bytes, more: Mapping[str, str]) -> Response:
    headers = Headers(
        {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Cache-Control": "no-store",
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Connection": "close",
            **more,
        }
    )
    return Response(status, {200: "OK"}.get(status, "Refused"), headers, body)


def _refused(status: int, why: str) -> Response:
    return _response(status, "text/plain; charset=utf-8", f"warpdiff view: {why}\n".encode(), {})


class _Page:
    """One page's connection."""

    def __init__(self, connection: ServerConnection, controls: dict[str, Control], studio: Studio) -> None:
        self._connection, self._controls, self._studio = connection, controls, studio
        self._loop = asyncio.get_running_loop()
        self._waiting: asyncio.Queue[str | bytes] = asyncio.Queue()
        self._session = studio.session(self._send)

    def _send(self, description: dict[str, Any], data: bytes | None) -> None:
        """Called by the drawing thread."""
        text = json.dumps(description, allow_nan=False)
        message: str | bytes = text
        if data is not None:
            head = text.encode()
            message = struct.pack("<I", len(head)) + head + data
        # The loop is closed where the server has ended.
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._put, message)

    def _put(self, message: str | bytes) -> None:
        if self._waiting.qsize() < _MOST_PILED_UP:
            self._waiting.put_nowait(message)
        else:
            self._connection.transport.abort()

    async def run(self) -> None:
        """Read and write until the page is gone."""
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
            await self._connection.send(await self._waiting.get())

    async def _take(self, message: str | bytes) -> None:
        """Do what a message says."""
        try:
            told = json.loads(message) if isinstance(message, str) else None
        except (ValueError, RecursionError):
            told = None
        if not isinstance(told, dict):
            raise _HostileError("messages are JSON objects")
        what = told.get("do")
        if what == "shown":
            self._studio.acknowledge(self._session)
        elif what == "want":
            try:
                self._studio.want(self._session, self._wanted(told))
            except (ValueError, TypeError) as error:
                self._put(json.dumps({"kind": "error", "text": str(error)}))
        elif what == "save" and told.get("as") in ("png", "exr"):
            await self._save(told["as"])
        else:
            raise _HostileError("there is no such message")

    def _wanted(self, told: dict[str, Any]) -> Wanted:
        """What a page wants, if it makes sense."""
        generation, aspect, probe, camera = (told.get(name) for name in ("generation", "aspect", "probe", "camera"))
        if type(generation) is not int or not 0 <= generation < _MOST_GENERATION:
            raise ValueError("generation must be a count")
        if not isinstance(aspect, (int, float)) or not _ASPECTS[0] <= aspect <= _ASPECTS[1]:
            raise ValueError(f"aspect must lie within {_ASPECTS[0]} to {_ASPECTS[1]}")
        place = vector([*probe, 0.0] if isinstance(probe, list) else probe, "probe")[:2]
        if not (min(place) >= 0.0 and max(place) <= 1.0):
            raise ValueError("probe must lie in the picture, 0 to 1")
        values = checked(self._controls, told.get("values"))
        seen = None
        if camera is not None:
            if not isinstance(camera, dict):
                raise ValueError("camera must be an object")
            eye, target, up = (vector(camera.get(name), name) for name in ("eye", "target", "up"))
            fov: Any = camera.get("fov_y_deg")
            seen = eye, target, up, fov
            # Refuses what makes no view.
            wd.View(eye, target, up=up, fov_y_deg=fov, width=4, height=3)
        return self._studio.wanted(
            generation, values, seen, float(aspect), moving=told.get("moving") is True, probe=place
        )

    async def _save(self, kind: str) -> None:
        """Send the picture that is shown as a file."""
        try:
            data = await asyncio.to_thread(self._studio.saved, self._session, kind)
        except (ValueError, OSError, MemoryError) as error:
            self._put(json.dumps({"kind": "error", "text": str(error)}))
            return
        self._send({"kind": "file", "name": f"warpdiff.{kind}"}, data)
