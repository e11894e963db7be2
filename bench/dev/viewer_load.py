"""Load test of the viewer on this machine: ``python -m bench.dev.viewer_load --minutes 10``.

Fifty clients open the viewer of another process at the same time. The viewer serves at most eight clients; it refuses
the others, which try again. A part of the served clients read slowly, and others send malformed messages. Regular
clients draw pictures and compare each finished picture with the first finished picture of the same settings. The report
has these numbers:

- lost messages: requests of regular clients that the viewer did not answer within a minute,
- wrong pictures: finished pictures whose bytes differ from the first picture of the same settings,
- growth: memory of the server at the end minus its memory at half time [MB].
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import random
import re
import struct
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

from warpdiff.apps.viewer.controls import controls, defaults

ROOT = Path(__file__).resolve().parents[2]
# Number of clients. Every fifth client reads slowly, and every fifth sends malformed messages.
CLIENTS = 50
# Longest time that a client waits for a requested picture to be finished [s]. The limit is this long because eight
# clients share one thread that draws.
_MOST_WAIT_S = 60.0
# Values that the clients send for the controls of the viewer's page, one set per scene. The pictures are small, so that
# clients get many of them.
_SMALL = {"height": 240, "tolerance": 0.1}
SCENES: tuple[dict[str, Any], ...] = (
    _SMALL, _SMALL | {"pigment": 0.4}, _SMALL | {"surface": "sinusoidal", "azimuth_deg": 30.0},
)  # fmt: skip
_MALFORMED = (
    "", "{", "[]", "null", b"\0\1", '{"do": "draw"}', '{"do": "fly"}', '{"do": "draw", "generation": -1}',
    '{"do": "save", "as": "exe"}', "[" * 5000, '{"do": "draw", "generation": 1e400}', "x" * 20_000,
)  # fmt: skip


class Report:
    """Numbers of pictures, lost messages and other events of all clients, and the first picture of each scene."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.first: dict[int, bytes] = {}
        self.problems: list[str] = []

    def compare(self, scene: int, picture: bytes) -> None:
        """Count a finished picture, and compare it with the first picture of the same settings."""
        self.counts["pictures"] += 1
        if self.first.setdefault(scene, picture) != picture:
            self.counts["wrong pictures"] += 1


def message(generation: int, scene: int) -> str:
    """Return the message that requests a picture of a scene."""
    values = defaults(controls()) | SCENES[scene]
    return json.dumps({
        "do": "draw", "generation": generation, "values": values, "aspect": 1.5, "moving": False, "probe": [0.5, 0.5],
        "camera": None,
    })  # fmt: skip


async def draws(socket: Any, rng: random.Random, report: Report) -> None:
    """Request some pictures, and wait until each of them is finished."""
    for generation in range(1, rng.randint(2, 4)):
        scene = rng.randrange(len(SCENES))
        await socket.send(message(generation, scene))
        report.counts["requests"] += 1
        begin = time.monotonic()
        while True:
            left = _MOST_WAIT_S - (time.monotonic() - begin)
            try:
                reply = await asyncio.wait_for(socket.recv(), max(left, 0.1))
            except TimeoutError:
                report.counts["lost messages"] += 1
                return
            head, body = parts(reply)
            if head["kind"] == "picture":
                await socket.send('{"do": "shown"}')
            if head.get("generation") == generation and head.get("last"):
                report.compare(scene, body)
                break
            if head["kind"] == "error":
                report.problems.append(str(head.get("text")))
                report.counts["errors of valid requests"] += 1
                break


def parts(reply: str | bytes) -> tuple[dict[str, Any], bytes]:
    """Return the JSON and the data of a message of the viewer."""
    if isinstance(reply, str):
        return json.loads(reply), b""
    (size,) = struct.unpack_from("<I", reply)
    return json.loads(reply[4 : 4 + size]), reply[4 + size :]


async def reads_slowly(socket: Any, rng: random.Random, report: Report) -> None:
    """Request pictures without reading replies for some seconds."""
    for generation in range(1, 30):
        await socket.send(message(generation, rng.randrange(len(SCENES))))
        await asyncio.sleep(0.2)
    report.counts["slow clients"] += 1


async def sends_malformed(socket: Any, rng: random.Random, report: Report) -> None:
    """Send a malformed message, after which the viewer reports an error or closes the connection."""
    await socket.send(rng.choice(_MALFORMED))
    report.counts["malformed messages"] += 1
    with contextlib.suppress(TimeoutError):
        while True:
            await asyncio.wait_for(socket.recv(), 5.0)


async def client(number: int, port: int, end: float, report: Report) -> None:
    """Open the viewer again and again until the end, as a regular, slow or malformed client depending on ``number``."""
    from websockets.asyncio.client import connect
    from websockets.exceptions import ConnectionClosed, InvalidStatus

    rng = random.Random(number)  # noqa: S311 (not for secrets)
    role = {3: reads_slowly, 4: sends_malformed}.get(number % 5, draws)
    address = f"ws://127.0.0.1:{port}/socket"
    while time.monotonic() < end:
        try:
            async with connect(address, origin=f"http://127.0.0.1:{port}", max_size=None, open_timeout=30) as socket:
                await socket.recv()
                await role(socket, rng, report)
        except InvalidStatus:
            report.counts["refused connections"] += 1
        except ConnectionClosed as error:
            report.counts["closed connections"] += 1
            if role is draws and error.rcvd is not None and error.rcvd.code != 1013:
                report.problems.append(f"a valid client was closed: {error}")
                report.counts["lost messages"] += 1
        except (OSError, TimeoutError) as error:
            report.counts[f"failed connections ({type(error).__name__})"] += 1
        await asyncio.sleep(rng.uniform(0.1, 0.6))


def resident_mb(process: int) -> float:
    """Return the memory of a process [MB]; NaN where the system has no ``/proc``."""
    with contextlib.suppress(OSError):
        text = Path(f"/proc/{process}/status").read_text(encoding="ascii")
        return float(re.findall(r"VmRSS:\s+(\d+)", text)[0]) / 1024.0
    return float("nan")


async def load(port: int, process: int, minutes: float, report: Report) -> tuple[float, float]:
    """Run all clients, and return the memory of the server at half time and at the end [MB]."""
    begin = time.monotonic()
    end = begin + 60.0 * minutes
    tasks = [asyncio.create_task(client(number, port, end, report)) for number in range(CLIENTS)]
    await asyncio.sleep((end - begin) / 2.0)
    half = resident_mb(process)
    await asyncio.sleep(max(end - time.monotonic(), 0.0))
    last = resident_mb(process)
    await asyncio.gather(*tasks)
    return half, last


def main() -> int:
    """Start a viewer and many clients, and print a report. Return 1 if a message was lost or a picture is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="duration (default: 10)")
    options = parser.parse_args()
    command = [sys.executable, "-m", "warpdiff", "view", "--no-browser", "--port", "0"]
    server = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    report = Report()
    try:
        line = server.stdout.readline() if server.stdout else ""
        port = int(re.findall(r":(\d+)/", line)[0])
        half, last = asyncio.run(load(port, server.pid, options.minutes, report))
        is_alive = server.poll() is None
    finally:
        server.terminate()
        server.wait(timeout=30)
    print(f"{CLIENTS} clients, {options.minutes:g} minutes\n")
    for name in ("lost messages", "wrong pictures", "errors of valid requests"):
        report.counts.setdefault(name, 0)
    for name, count in sorted(report.counts.items()):
        print(f"| {name} | {count:,} |")
    print(f"| memory at half time, at the end, growth [MB] | {half:.1f}, {last:.1f}, {last - half:.1f} |")
    for problem in sorted(set(report.problems))[:10]:
        print(f"problem: {problem}")
    failures = sum(report.counts[name] for name in ("lost messages", "wrong pictures", "errors of valid requests"))
    return int(bool(failures) or not is_alive)


if __name__ == "__main__":
    sys.exit(main())
