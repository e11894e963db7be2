"""Readers of files and messages for fuzzing, each with its valid files in ``tests/corpus``."""

from __future__ import annotations

import asyncio
import json
import re
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import warpdiff as wd
from warpdiff.apps.report.measured_curve import read_curve
from warpdiff.apps.viewer import controls
from warpdiff.apps.viewer.server import _HostileError, _Page
from warpdiff.scene.mesh_import import prepare_surface

if TYPE_CHECKING:
    from collections.abc import Callable

CORPUS = Path(__file__).resolve().parents[2] / "tests" / "corpus"
# Mesh files that refer to another file, by the suffix of the other file. If the other file is damaged, it is read
# through the mesh file.
_BESIDE = {".mtl": ("mesh.obj",), ".png": ("mesh.obj", "buffer.gltf"), ".bin": ("buffer.gltf",)}


@dataclass(frozen=True)
class Target:
    """Reader of one kind of file.

    Attributes:
        name: Name of the reader, and of the folder of its valid files.
        read: Function of a path that reads the file and checks the result.
        reads: Names of the public functions or methods, or titles of the registered formats, that this reader tests.
        errors: Accepted exceptions. ``MemoryError`` is accepted if its message states the free memory.
        is_named: Whether the message of an error must name the file. Instead, it may ask for an argument that replaces
            a value missing in the damaged file.
    """

    name: str
    read: Callable[[Path], object]
    reads: tuple[str, ...]
    errors: tuple[type[Exception], ...] = (ValueError,)
    is_named: bool = True

    @property
    def folder(self) -> Path:
        """Folder of the valid files."""
        return CORPUS / self.name


class InvalidResultError(Exception):
    """Error for a result that a reader must not return, neither for a valid nor for a damaged file."""


def _check(is_valid: object, what: str) -> None:
    if not is_valid:
        raise InvalidResultError(what)


def _heights(path: Path) -> None:
    integers = re.search("uint|i4", path.name)
    has_pitch = path.suffix == ".npz" or path.name.startswith("export")
    for channel in wd.HeightField.channels(path)[:1] or (None,):
        heightfield = wd.HeightField.load(
            path, pitch_um=None if has_pitch else 0.1, height_range_um=0.3 if integers else None, channel=channel
        )
        _check(np.isfinite(heightfield.heights_um[~heightfield.missing]).all(), "values are not finite")


def _mesh(path: Path) -> None:
    names = ("scene-plain.gltf",) if path.name == "scene-plain.bin" else _BESIDE.get(path.suffix, (path.name,))
    main = next(file for name in names if (file := path.with_name(name)).is_file())
    if main.suffix in (".gltf", ".glb"):
        for tangents in ((1.0, 0.2, 0.1), None):
            surface = prepare_surface(main, tangents=tangents)
            _check(np.isfinite(surface.vertices).all(), "values are not finite")
            _check(np.isfinite(surface.tangents).all(), "values are not finite")
    else:
        _check(np.isfinite(prepare_surface(main, tangents="x").vertices).all(), "values are not finite")


def _camera(path: Path) -> None:
    view = wd.View((0, 1, 3), (0, 0, 0), width=8, height=6)
    shots = wd.camera_path(path, wd.DirectionalLight((0, 1, 0)), view, count=3)
    _check(len(shots) == 3, "the number of shots is wrong")


class _Connection:
    """Stand-in for the WebSocket connection between the viewer's server and its web page."""

    class transport:  # noqa: N801 (the name of the attribute in the package websockets)
        """Stand-in for the network transport of the WebSocket connection."""

        abort = staticmethod(lambda: None)


class _Studio:
    """Stand-in for the rendering thread of the viewer, which draws nothing."""

    def session(self, send: Any) -> Any:
        """Return ``send``, which sends messages to the page, as a stand-in for the session of a page of the viewer."""
        return send

    def acknowledge(self, session: Any) -> None:
        """Accept that a page has shown a picture."""

    def request(self, _: Any, request: Any) -> None:
        """Check that the values of an accepted request of a page can be written as JSON, which excludes NaN."""
        json.dumps(request.values, allow_nan=False)

    def saved(self, _: Any, suffix: str) -> bytes:
        """Return a fixed content for a file that the page asks to save."""
        return suffix.encode()


_CONTROLS = controls.controls()
# Event loop for all messages. A new loop for each message would need more time than the message.
_RUNNER = asyncio.Runner()


def _message(path: Path) -> None:
    """Let the viewer's server handle the content of a file as the message of a page."""
    raw = path.read_bytes()
    message = raw.decode("utf-8", errors="replace")

    async def take() -> None:
        page = _Page(_Connection(), _CONTROLS, _Studio())  # type: ignore[arg-type]
        for _ in range(2):
            await page._take(message)
        await asyncio.sleep(0)
        while not page._queue.empty():
            _check(page._queue.get_nowait(), "a message is empty")

    _RUNNER.run(take())


# Height field of the dots of grating maps that are read from files.
_CELL = wd.gratings.sinusoidal(1.0, 0.1)

TARGETS = (
    Target("gltf", _mesh, ("warpdiff.shade",)),
    Target("mesh", _mesh, ("warpdiff.shade",)),
    Target("text", _heights, ("text: matrix, or points x, y, z", "HeightField.load")),
    Target("x3p", _heights, ("X3P (ISO 25178-72)",)),
    Target("npy", _heights, ("NumPy array",)),
    Target("npz", _heights, ("file of `HeightField.save`",)),
    Target("image", _heights, ("grey image of 8 or 16 bit, or of floats",)),
    Target("index", wd.Material.from_file, ("Material.from_file",)),
    Target("spectrum", wd.Spectrum.from_csv, ("Spectrum.from_csv",)),
    Target("measured", wd.Measured.from_csv, ("Measured.from_csv",)),
    Target("dots", lambda path: wd.GratingMap.load(path, _CELL), ("GratingMap.load",)),
    Target("curve", read_curve, ("report",)),
    Target("camera", _camera, ("camera_path",)),
    Target("plan", wd.Plan.load, ("Plan.load",)),
    Target("lobes", wd.BakedLobes.load, ("BakedLobes.load",)),
    Target("spectra", wd.BakedSpectrum.load, ("BakedSpectrum.load",)),
    Target("picture", wd.Image.load, ("Image.load",)),
    Target("environment", wd.Environment.load, ("Environment.load",)),
    Target("message", _message, ("viewer",), (_HostileError,), is_named=False),
    *([Target("gds", wd.measure_layout, ("measure_layout",))] if find_spec("gdstk") else ()),
)  # fmt: skip
BY_NAME = {target.name: target for target in TARGETS}
