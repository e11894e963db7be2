"""Fixtures and helpers of all tests: measured input files, devices, directions and height fields."""

from __future__ import annotations

import gc
import os
from pathlib import Path
from typing import TYPE_CHECKING

import endurance
import numpy as np
import pytest

if TYPE_CHECKING:
    import trimesh

# The tests set the folder of the disk cache to an empty name. This disables the cache, so that tests do not write to
# the user's folder.
os.environ["WARPDIFF_CACHE_DIR"] = ""
DATA = Path(os.environ.get("WARPDIFF_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")


def _data_file(name: str) -> Path:
    path = DATA / name
    if not path.is_file():
        pytest.skip(f"{name} is not in {DATA}; set WARPDIFF_DATA to the folder with the real inputs")
    return path


def public_members(kind: type) -> dict[str, object]:
    """Return the public members of a class by name, including those of its base classes in this package."""
    owners = [owner for owner in kind.__mro__ if owner is kind or owner.__module__.startswith("warpdiff.")]
    names = {name: value for owner in reversed(owners) for name, value in vars(owner).items()}
    return {name: value for name, value in names.items() if not name.startswith("_")}


@pytest.fixture(scope="session")
def scan_path() -> Path:
    """Return the path of an atomic force microscope scan of snake skin; skip the test without that file."""
    return _data_file("elaphe_65um.png")


@pytest.fixture(scope="session")
def fuze_path() -> Path:
    """Return the path of a textured bottle mesh; skip the test without that file."""
    return _data_file("fuze.obj")


@pytest.fixture(scope="session")
def scan(scan_path):
    """Return the snake-skin scan (65 µm wide), with a quadratic surface subtracted."""
    import warpdiff as wd

    return wd.HeightField.load(scan_path, extent_um=65.0, height_range_um=0.375).levelled(order=2)


@pytest.fixture(scope="session")
def fingers():
    """Return a surface, 12.8 µm wide, of random finger-like bumps. Its orders overlap for short coherence windows."""
    import warpdiff as wd

    return wd.gratings.fingers(size_um=12.8, seed=4)


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a random generator with a fixed seed, or with the seed of the soak test."""
    return np.random.default_rng(20140 + endurance.SEED)


@pytest.fixture(scope="session", params=["cpu", "cuda"])
def device(request) -> str:
    """Run the test on the CPU, and also on a CUDA device if the machine has one."""
    if request.param == "cuda":
        import warp as wp

        wp.config.log_level = wp.LOG_ERROR
        if not wp.is_cuda_available():
            pytest.skip("no CUDA device on this machine")
    return request.param


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Import the tests without garbage collection, and exempt all objects of the imports from later collections.

    A garbage collection visits 400,000 objects of Warp, of other packages and of the tests, which takes 0.24 s of
    processor time. The import of the tests would cause 16 garbage collections.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


def pytest_unconfigure():
    """Let the exit of the interpreter free all objects: OpenImageIO's binding would report them as leaks."""
    gc.unfreeze()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    """Store the name ``row`` of each mark ``permanent(row)``, under which the report of a soak test counts attempts."""
    for item in items:
        if marker := item.get_closest_marker("permanent"):
            item.user_properties.append(("row", marker.args[0]))


def pytest_report_header() -> str | None:
    """Return a header line with the random seed if this run is a soak test."""
    return f"seed of the soak: {endurance.SEED}" if endurance.IS_SOAK else None


def slow(*values):
    """Mark a slow case of a parametrized test. Faster cases of the same test run in the default test command."""
    return pytest.param(*values, marks=pytest.mark.slow)


def _shares(item) -> int:
    marker = item.get_closest_marker("permanent")
    return marker.kwargs.get("shares", 1) if marker else 1


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Divide the remaining time of a soak test among the tests that have not run yet."""
    if endurance.IS_SOAK:
        left = item.session.items[item.session.items.index(item) :]
        endurance.begin(_shares(item), sum(map(_shares, left)))


@pytest.fixture
def tries(record_property):
    """Return a counter of attempts for the report of a soak test. A test without this counter counts as one attempt."""
    counted = endurance.Tries()
    yield counted
    record_property("tried", counted.number)


def hemisphere(rng: np.random.Generator, count: int, lowest: float = 0.05) -> np.ndarray:
    """Return ``count`` random unit vectors (count, 3) with z >= ``lowest``, uniformly distributed in z."""
    z = rng.uniform(lowest, 1.0, count)
    phi = rng.uniform(0.0, 2.0 * np.pi, count)
    s = np.sqrt(1.0 - z * z)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1)


def launch(kernel, dim, inputs=(), outputs=(), *, device="cpu") -> None:
    """Compile a kernel by the threads of the library, and launch it.

    Each thread reads Warp's headers before its first compilation, which takes 1 to 2 s of processor time. The threads
    of the library have read them already; the main thread has not.
    """
    import warp as wp

    from warpdiff.device import devices

    devices.load_now([kernel], devices.resolve_device(device))
    wp.launch(kernel, dim, inputs, outputs, device=device)


def write_image(path: Path, pixels: np.ndarray) -> None:
    """Write pixels (height, width, channels) to an image file with the same number type."""
    import OpenImageIO as oiio  # noqa: N813 (the abbreviation of its manual)

    buffer = oiio.ImageBuf(np.ascontiguousarray(pixels))
    assert buffer.write(str(path)), buffer.geterror()


def coherence_of(kind: str, sigma_um=None, angular_diameter_deg=3.0, periods=(2, 3)):
    """Return a coherence model (how far light interferes): a window, a source diameter or a number of periods."""
    import warpdiff as wd

    if kind == "source":
        return wd.Coherence(kind, angular_diameter_deg=angular_diameter_deg)
    return wd.Coherence(kind, periods=periods) if kind == "replicas" else wd.Coherence(kind, sigma_um)


def noise(shape: tuple[int, int], pitch=(0.1, 0.05)):
    """Return a height field of normally distributed heights with a standard deviation of 0.05 µm."""
    import warpdiff as wd

    return wd.HeightField(np.random.default_rng(7).normal(0.0, 0.05, shape), pitch)


def relative_errors(found: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Return the errors (n,) of colours (n, 3), relative to the larger of the exact norm and a floor.

    The floor is 0.001 of the 99th percentile of the exact luminances Y.
    """
    floor = 1e-3 * np.percentile(exact[:, 1], 99.0)
    return np.linalg.norm(found - exact, axis=1) / np.maximum(np.linalg.norm(exact, axis=1), floor)


@pytest.fixture(scope="session")
def square() -> trimesh.Trimesh:
    """Return a flat square of side 2 in the plane z = 0, whose texture direction u is +x."""
    # trimesh is imported here, because importing it takes 0.5 s and delays the start of parallel test runs.
    import trimesh

    corners = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    texture = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [1, 1], [0, 1]])
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], visual=texture, process=False)


def at_angle(theta_deg: float | np.ndarray) -> np.ndarray:
    """Return unit vectors in the xz-plane at the given angles from the normal; positive angles point towards +x."""
    theta = np.radians(theta_deg)
    return np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1)


@pytest.fixture
def unreadable_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let reads of whole files fail with an error of the operating system, as on a damaged disk."""

    def refuse(_: object) -> bytes:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr("pathlib.Path.read_bytes", refuse)
