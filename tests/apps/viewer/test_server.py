"""The viewer's server with malformed requests: it serves only its page, and connections do not accumulate."""

import asyncio
import contextlib
import json
import socket
import threading
import time

import pytest

from warpdiff.apps.viewer.controls import checked, controls, defaults, described

websockets = pytest.importorskip("websockets", reason="warpdiff[view] installs websockets")
from websockets.sync.client import connect  # noqa: E402 (optional package)

from warpdiff.apps.viewer import server as view_server  # noqa: E402
from warpdiff.apps.viewer.server import MOST_PAGES, ViewServer  # noqa: E402

KNOWN = controls()


class Studio:
    """Stand-in for the viewer's rendering thread: it renders nothing, and records requests of pages."""

    def __init__(self):
        self.sessions, self.requests = [], []

    def session(self, send):
        self.sessions.append(send)
        return send

    def leave(self, session):
        self.sessions.remove(session)

    def acknowledge(self, session):
        session({"kind": "picture"}, bytes(100_000))

    def request(self, _, request):
        self.requests.append(request)


@contextlib.contextmanager
def serving(host="127.0.0.1"):
    """Run a server of the viewer in a separate thread."""
    studio, ready = Studio(), threading.Event()

    async def begun():
        return studio

    server = ViewServer(KNOWN, begun, host)
    loop = asyncio.new_event_loop()
    task = loop.create_task(server.run(ready.set))

    def run():
        with contextlib.suppress(asyncio.CancelledError):
            loop.run_until_complete(task)

    thread = threading.Thread(target=run)
    thread.start()
    assert ready.wait(10.0)
    try:
        yield server, studio
    finally:
        loop.call_soon_threadsafe(task.cancel)
        thread.join(10.0)
        assert not thread.is_alive()
        loop.close()


def ask(server, text, wait_s=5.0):
    """Send a text or bytes to the server on a new connection, and return its answer."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=wait_s) as connection:
        connection.sendall(text if isinstance(text, bytes) else text.replace("\n", "\r\n").encode())
        answer = b""
        with contextlib.suppress(OSError):
            while part := connection.recv(65536):
                answer += part
    return answer.decode(errors="replace")


def page_of(server, **options):
    address = f"ws://127.0.0.1:{server.port}/socket"
    return connect(address, origin=f"http://127.0.0.1:{server.port}", **options)


def draw(**changes):
    message = {
        "do": "draw", "generation": 1, "values": defaults(KNOWN), "aspect": 1.5, "moving": False, "probe": [0.5, 0.5],
        "camera": None,
    }  # fmt: skip
    return json.dumps(message | changes)


def test_only_the_page_is_served():
    with serving() as (server, _):
        host = f"Host: 127.0.0.1:{server.port}\n"
        served = ask(server, f"GET / HTTP/1.1\n{host}\n")
        assert served.startswith("HTTP/1.1 200")
        assert "default-src 'none'" in served
        assert "http://" not in served.partition("\r\n\r\n")[2].replace("http://www.w3.org", "")
        for path in ("/page.js", "/../etc/passwd", "/%2e%2e/x", "//", "/socket", "/index.html", "*", "/" + "a" * 7000):
            assert ask(server, f"GET {path} HTTP/1.1\n{host}\n").startswith("HTTP/1.1 404"), path
        for named in ("evil.example", "127.0.0.1:1", "127.0.0.1", "localhost.evil.example", "[::1", "", "127.0.0.1:x"):
            assert ask(server, f"GET / HTTP/1.1\nHost: {named}\n\n").startswith("HTTP/1.1 403"), named
        assert ask(server, f"GET / HTTP/1.1\nHost: localhost:{server.port}\n\n").startswith("HTTP/1.1 200")
        for request in (
            "GET / HTTP/1.1\n\n", f"POST / HTTP/1.1\n{host}\n", f"GET / HTTP/1.1\n{host}{host}\n", "\n\n", "GET\n\n",
            f"GET / HTTP/0.9\n{host}\n", f"GET / HTTP/1.1\n{host}X: {'a' * 20000}\n\n",
            f"GET / HTTP/1.1\n{host}" + "X: 1\n" * 500 + "\n", f"GET /{'a' * 20000} HTTP/1.1\n{host}\n",
        ):  # fmt: skip
            assert not ask(server, request).startswith("HTTP/1.1 200"), request[:40]
        for noise in (bytes(range(256)) * 64, b"\x16\x03\x01\x02\x00\x01", b""):
            with contextlib.suppress(OSError):
                assert "200" not in ask(server, noise, wait_s=0.3)


def test_pages_from_other_origins_cannot_open_a_socket():
    with serving() as (server, studio):
        address = f"ws://127.0.0.1:{server.port}/socket"
        for origin in ("https://evil.example", "null", None, f"http://127.0.0.1:{server.port + 1}", "file://"):
            with pytest.raises(websockets.exceptions.InvalidStatus, match="403"):
                connect(address, origin=origin)
        assert not studio.sessions


def test_from_other_machines_a_token_is_required():
    with serving("0.0.0.0") as (server, _):  # noqa: S104 (the test needs an open address)
        assert len(server.token) > 20
        assert server.address.endswith(f"/?token={server.token}")
        host = f"Host: example.org:{server.port}\n"
        for query in ("", "?token=", "?token=x", f"?token={server.token}x", f"?tokens={server.token}", "?token=%ff"):
            assert ask(server, f"GET /{query} HTTP/1.1\n{host}\n").startswith("HTTP/1.1 403"), query
            with pytest.raises(websockets.exceptions.InvalidStatus, match="403"):
                connect(f"ws://127.0.0.1:{server.port}/socket{query}", origin=f"http://127.0.0.1:{server.port}")
        assert ask(server, f"GET /?token={server.token} HTTP/1.1\n{host}\n").startswith("HTTP/1.1 200")
        origin = f"http://127.0.0.1:{server.port}"
        with connect(f"ws://127.0.0.1:{server.port}/socket?token={server.token}", origin=origin) as page:
            assert json.loads(page.recv())["kind"] == "hello"


def test_the_number_of_connections_is_limited():
    with serving() as (server, studio), contextlib.ExitStack() as stack:
        refused = 0
        for _ in range(100):
            try:
                stack.enter_context(page_of(server)).recv(timeout=5.0)
            except websockets.exceptions.InvalidStatus:
                refused += 1
        assert refused == 100 - MOST_PAGES
        assert len(studio.sessions) == MOST_PAGES
        stack.close()
        give_up = time.monotonic() + 5.0
        while studio.sessions and time.monotonic() < give_up:
            time.sleep(0.02)
        assert not studio.sessions
        with page_of(server) as page:
            page.recv(timeout=5.0)


def test_silent_connections_are_closed(monkeypatch):
    monkeypatch.setattr(view_server, "_OPENING_S", 0.3)
    with serving() as (server, _), contextlib.ExitStack() as stack:
        silent = [
            stack.enter_context(socket.create_connection(("127.0.0.1", server.port), timeout=5.0)) for _ in range(100)
        ]
        # Reading ends without an error if the server closes the connection, and with a timeout error otherwise.
        for connection in silent:
            while connection.recv(1000):
                pass


@pytest.mark.parametrize(
    "message",
    ["", "x", "[]", "1", "null", "{}", '{"do": "rm"}', '{"do": "save", "as": "../x"}', "[" * 9000, b"\0\1", "1e999",
     '{"do": ["draw"]}', "{" + '"a":{' * 2000],
)  # fmt: skip
def test_messages_that_no_page_sends_end_the_connection(message):
    with serving() as (server, studio), page_of(server) as page:
        page.recv()
        page.send(message)
        with pytest.raises(websockets.exceptions.ConnectionClosedError, match="1008"):
            page.recv(timeout=5.0)
        assert not studio.requests


def test_messages_beyond_the_size_limit_are_refused():
    with serving() as (server, _), page_of(server) as page:
        page.recv()
        with contextlib.suppress(websockets.exceptions.ConnectionClosed):
            page.send("x" * 50_000_000)
        with pytest.raises(websockets.exceptions.ConnectionClosedError, match="1009"):
            page.recv(timeout=5.0)


def test_invalid_values_are_reported_only_to_their_page():
    with serving() as (server, studio), page_of(server) as page, page_of(server) as other:
        assert json.loads(page.recv())["controls"] == json.loads(json.dumps(described(KNOWN)))
        other.recv()
        legal = defaults(KNOWN)
        fuzz = [None, True, -1, 1e300, 10**400, "x", [], {}, [1, 2, 3], float("nan"), float("-inf"), "x" * 5000]
        cases = [{name: value} for name in ("generation", "aspect", "probe", "camera", "values") for value in fuzz]
        cases += [{"values": legal | {name: value}} for name in legal for value in fuzz]
        cases += [{"values": legal | {"unknown": 1}}, {"values": {"mesh": "file 0"}}]
        camera = {"eye": [0, 0, 3], "target": [0, 0, 0], "up": [0, 1, 0], "fov_y_deg": 30}
        cases += [{"camera": camera | {name: value}} for name in camera for value in fuzz]
        refused = 0
        for case in cases:
            before = len(studio.requests)
            page.send(draw(**case))
            page.send(draw(generation=7))
            # ``case`` is a request whose values may be invalid. The server must still accept the valid request that
            # follows it.
            give_up = time.monotonic() + 5.0
            while time.monotonic() < give_up and not (
                len(studio.requests) > before and studio.requests[-1].generation == 7
            ):
                time.sleep(0.0005)
            assert studio.requests[-1].generation == 7, case
            refused += len(studio.requests) == before + 1
            if len(studio.requests) > before + 1:
                # If the server accepted ``case``, the values of the request must be among those that the controls
                # allow.
                values = studio.requests[before].values
                assert checked(KNOWN, values) == values
        assert refused > 0.75 * len(cases)
        errors = 0
        with contextlib.suppress(TimeoutError):
            while True:
                errors += json.loads(page.recv(timeout=0.2))["kind"] == "error"
        assert errors == refused
        with pytest.raises(TimeoutError):
            other.recv(timeout=0.1)


def test_a_page_that_reads_nothing_is_disconnected():
    with serving() as (server, studio), page_of(server, max_queue=1, close_timeout=0.1) as page:
        with contextlib.suppress(websockets.exceptions.ConnectionClosed, OSError):
            for _ in range(2000):
                page.send('{"do": "shown"}')
        give_up = time.monotonic() + 10.0
        while studio.sessions and time.monotonic() < give_up:
            time.sleep(0.02)
        assert not studio.sessions
        page.socket.close()
