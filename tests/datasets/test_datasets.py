"""Data sets: downloads from a local server, which replaces the network."""

import dataclasses
import functools
import hashlib
import http.server
import sys
import threading
import types

import numpy as np
import pytest
from conftest import write_image

import warpdiff as wd
from warpdiff.datasets import download, registry

NAME = "corn_snake_scan"


class Server(http.server.ThreadingHTTPServer):
    """Local server that serves a folder and counts the requests."""

    requests = 0

    def __init__(self, folder):
        super().__init__(("127.0.0.1", 0), functools.partial(Handler, directory=folder))
        self.address = f"http://127.0.0.1:{self.server_port}/scan.png"


class Handler(http.server.SimpleHTTPRequestHandler):
    def do_GET(self):
        self.server.requests += 1
        super().do_GET()

    def log_message(self, *_arguments):
        pass


@pytest.fixture
def published(rng, tmp_path, monkeypatch):
    """Publish a small scan on a local server; return its samples, the server and the file."""
    folder = tmp_path / "server"
    folder.mkdir()
    samples = rng.integers(0, 256, (40, 40), dtype=np.uint8)
    # The test image has the channels of the published file: all colour channels contain the heights, alpha is opaque.
    write_image(folder / "scan.png", np.dstack([samples] * 3 + [np.full_like(samples, 255)]))
    server = Server(folder)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    contents = (folder / "scan.png").read_bytes()
    dataset = dataclasses.replace(
        registry.info(NAME), address=server.address, sha256=hashlib.sha256(contents).hexdigest(),
        size_bytes=len(contents),
    )  # fmt: skip
    monkeypatch.setitem(registry._DATASETS, NAME, dataset)
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.delenv("WARPDIFF_DATA", raising=False)
    yield types.SimpleNamespace(samples=samples, server=server, file=folder / "scan.png")
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def pooch():
    return pytest.importorskip("pooch", reason="pip install 'warpdiff[data]'")


def check(heightfield, samples):
    np.testing.assert_allclose(heightfield.heights_um, samples * (0.375 / 255), rtol=1e-15)
    assert heightfield.size_um == pytest.approx((65.0, 65.0))


@pytest.mark.usefixtures("pooch")
def test_a_download_is_cached(published):
    for _ in range(2):
        check(wd.datasets.fetch(NAME), published.samples)
    assert published.server.requests == 1


@pytest.mark.usefixtures("pooch")
def test_a_damaged_download_is_replaced(published, tmp_path):
    wd.datasets.fetch(NAME)
    (file,) = (tmp_path / "cache").rglob("*.png")
    file.write_bytes(file.read_bytes()[:-1])
    check(wd.datasets.fetch(NAME), published.samples)
    assert published.server.requests == 2


@pytest.mark.usefixtures("pooch")
def test_without_a_cache_folder_nothing_is_stored(published, tmp_path, monkeypatch):
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", "")
    monkeypatch.setattr(download.tempfile, "tempdir", str(tmp_path / "server"))
    check(wd.datasets.fetch(NAME), published.samples)
    assert [path.name for path in (tmp_path / "server").iterdir()] == ["scan.png"]
    assert not (tmp_path / "cache").exists()


@pytest.mark.usefixtures("pooch")
@pytest.mark.parametrize("fault", ["offline", "absent", "other"])
def test_the_error_of_a_failed_download_names_the_remedy(fault, published, tmp_path, monkeypatch):
    dataset = wd.datasets.info(NAME)
    if fault == "offline":
        dataset = dataclasses.replace(dataset, address="http://127.0.0.1:9/scan.png")  # no server uses this port
        monkeypatch.setitem(registry._DATASETS, NAME, dataset)
    elif fault == "absent":
        published.file.unlink()
    else:
        published.file.write_bytes(b"another file")
    with pytest.raises(OSError, match="could not be downloaded") as caught:
        wd.datasets.fetch(NAME)
    for part in (dataset.address, dataset.sha256, f"{dataset.size_bytes:,} bytes", "elaphe_65um.png", "WARPDIFF_DATA"):
        assert part in str(caught.value)
    assert not list(tmp_path.glob("cache/**/*.png"))
    monkeypatch.setenv("WARPDIFF_DATA", str(tmp_path))
    with pytest.raises(OSError, match="could not be downloaded") as caught:
        wd.datasets.fetch(NAME)
    assert str(caught.value).endswith(f"save it as elaphe_65um.png in the folder {str(tmp_path)!r}")


@pytest.mark.usefixtures("pooch", "published")
def test_a_cache_that_is_not_writable_is_reported(monkeypatch):
    def refused(*_arguments):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pooch.retrieve", refused)
    with pytest.raises(PermissionError, match="WARPDIFF_CACHE_DIR"):
        wd.datasets.fetch(NAME)


@pytest.mark.parametrize("channels", [1, 4], ids=["grey", "as published"])
def test_a_file_in_the_data_folder_is_used_first(channels, published, tmp_path, monkeypatch):
    samples = published.samples[::-1]
    opaque = np.full_like(samples, 255)
    write_image(tmp_path / "elaphe_65um.png", np.dstack(([samples] * 3 + [opaque])[:channels]))
    monkeypatch.setenv("WARPDIFF_DATA", str(tmp_path))
    monkeypatch.setitem(sys.modules, "pooch", None)
    check(wd.datasets.fetch(NAME), samples)
    assert published.server.requests == 0


def test_the_data_folder_must_exist(tmp_path, monkeypatch):
    monkeypatch.setenv("WARPDIFF_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(FileNotFoundError, match="check WARPDIFF_DATA"):
        wd.datasets.fetch(NAME)


@pytest.mark.usefixtures("published")
def test_without_pooch_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pooch", None)
    with pytest.raises(ImportError, match=r"pip install 'warpdiff\[data\]', or download http://"):
        wd.datasets.fetch(NAME)


@pytest.mark.parametrize("contents", [b"", b"\x89PNG\r\n\x1a\n", b"text"], ids=["empty", "truncated", "text"])
def test_a_damaged_file_in_the_data_folder_is_refused(contents, tmp_path, monkeypatch):
    (tmp_path / "elaphe_65um.png").write_bytes(contents)
    monkeypatch.setenv("WARPDIFF_DATA", str(tmp_path))
    with pytest.raises(ValueError, match="cannot be read as an image"):
        wd.datasets.fetch(NAME)


def test_a_file_of_16_bit_is_refused(tmp_path, monkeypatch):
    write_image(tmp_path / "elaphe_65um.png", np.zeros((4, 4, 1), np.uint16))
    monkeypatch.setenv("WARPDIFF_DATA", str(tmp_path))
    with pytest.raises(ValueError, match="mode I;16, must have channels of 8 bit"):
        wd.datasets.fetch(NAME)


@pytest.mark.parametrize("name", ["corn_snake", "", None, 3, ["corn_snake_scan"]])
def test_unknown_names_are_refused(name):
    for function in (wd.datasets.fetch, wd.datasets.info):
        with pytest.raises(ValueError, match="name must be one of 'corn_snake_scan', got"):
            function(name)


def test_the_real_scan_equals_the_result_of_load(scan_path, monkeypatch):
    monkeypatch.setenv("WARPDIFF_DATA", str(scan_path.parent))
    fetched = wd.datasets.fetch(NAME)
    loaded = wd.HeightField.load(scan_path, extent_um=65.0, height_range_um=0.375)
    np.testing.assert_array_equal(fetched.heights_um, loaded.heights_um)
    assert fetched.pitch_um == loaded.pitch_um
