"""The rule of imports: rooms import what their docstrings allow, one way, at the top of their files."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import warpdiff as wd

if not (Path(__file__).resolve().parents[2] / "pyproject.toml").is_file():
    pytest.skip("these tests need the source tree", allow_module_level=True)

import import_graph as graph

# What only some calls take, and what would make every start slower, or is not on every system.
SOME_CALLS = {"colour", "trimesh", "OpenImageIO", "PIL", "resource", "scipy", "distributed", "mitsuba", "drjit"}
# Signals and streams are met before anything slow is imported; some commands import what the others do without; the
# viewer's page loads while Warp is imported.
LATER = {"warpdiff.__main__", "warpdiff.apps.cli", "warpdiff.apps.viewer.command"}
PACKAGE = list(graph.modules())
ROOMS = [name for name in PACKAGE if graph.room_of(name) in graph.rooms()]


def ours(name):
    return [each for each in graph.imports(name) if each.module.partition(".")[0] == "warpdiff"]


def test_every_module_lies_in_a_room_that_bears_no_public_name():
    assert not set(graph.rooms()) & set(wd.__all__), "a module warpdiff.plan would take the place of wd.plan"
    above = {name for name in PACKAGE if name not in ROOMS and graph.room_of(name) != "kernels"}
    assert above == {"warpdiff", "warpdiff.__main__", "warpdiff.gratings", "warpdiff.meshes"}


def test_rooms_import_one_way():
    allowed = {name: set(graph.room(name).may_import) - {"kernels", "the public names"} for name in graph.rooms()}
    assert set().union(*allowed.values()) <= set(graph.rooms())
    graph.order(allowed)


@pytest.mark.parametrize("room", graph.rooms())
def test_rooms_import_what_they_say_and_say_what_they_import(room):
    allowed = {*graph.room(room).may_import, room}
    used = set()
    for name in ROOMS:
        if graph.room_of(name) == room:
            there = {graph.room_of(each.module): each for each in ours(name)}
            assert set(there) <= allowed, f"{name}: {[there[each] for each in set(there) - allowed]}"
            used |= set(there)
    assert used | {room} == allowed, "the docstring allows what nobody imports"


def test_kernels_import_nothing_but_kernels():
    for name in PACKAGE:
        if graph.room_of(name) == "kernels":
            assert {graph.room_of(each.module) for each in ours(name)} <= {"kernels"}, name


# Attributes of Warp's objects that are in no reference of its.
UNDOCUMENTED = (
    r"warp\._[a-z]|\bwp\._[a-z]|\.(hooks|module_exec|adj|params|_length_|_type_|__ctype__|ctype|native_func)\b"
)


def test_only_one_file_uses_what_warp_does_not_document():
    using = {name for name in PACKAGE if re.search(UNDOCUMENTED, graph.modules()[name].read_text(encoding="utf-8"))}
    assert using == {"warpdiff.device.devices"}


def test_modules_import_in_no_circle():
    graph.order(
        {
            name: {each.module for each in ours(name) if each.where == "top" and each.module != name} - {"warpdiff"}
            for name in PACKAGE
        }
    )


@pytest.mark.parametrize("room", [each for each in graph.rooms() if graph.room(each).summary.endswith("; no Warp.")])
def test_what_knows_no_device_never_imports_warp(room):
    for name in ROOMS:
        if graph.room_of(name) == room:
            assert "warp" not in {each.module.partition(".")[0] for each in graph.imports(name)}, name
            assert "warp" not in graph.closure(name), name


def test_those_that_know_no_device():
    silent = {each for each in graph.rooms() if graph.room(each).summary.endswith("; no Warp.")}
    assert silent == {"core", "optics", "surface", "fourier", "plans", "image"}


@pytest.mark.parametrize("name", PACKAGE)
def test_imports_stand_at_the_top(name):
    later = {each.module.partition(".")[0] for each in graph.imports(name) if each.where == "function"}
    assert later <= SOME_CALLS | ({"warpdiff"} if name in LATER else set())
    # Not in the middle of a file either.
    body = ast.parse(graph.modules()[name].read_text(encoding="utf-8")).body
    is_import = [isinstance(node, (ast.Import, ast.ImportFrom)) for node in body]
    begin = next((index for index, each in enumerate(is_import) if each), 0)
    assert not any(is_import[begin + sum(is_import) :]), "imports stand together"


def test_the_page_is_that_of_the_code():
    assert graph.PAGE.read_text(encoding="utf-8") == graph.page(), "run python tests/import_graph.py --write"


def test_files_and_names_that_the_page_speaks_of_are_there():
    written = re.findall(r"`([^`\n]+)`", graph.PAGE.read_text(encoding="utf-8").partition("## The way of one pixel")[2])
    folders = [graph.ROOT, graph.ROOT / "warpdiff"]
    paths = [each for each in written if "/" in each and " " not in each]
    assert len(paths) > 20
    assert not [each for each in paths if not any((folder / each).exists() for folder in folders)]
    code = "".join(graph.modules()[name].read_text(encoding="utf-8") for name in PACKAGE)
    names = {part for each in written if "/" not in each for part in re.findall(r"[A-Za-z_]\w{2,}", each)}
    assert not {each for each in names if not re.search(rf"\b{each}\b", code)}


# Every public name is there, and works, once everything else is imported: none is a module's in its place.
CALLS = """
import importlib, tempfile, warnings
import numpy as np
import warpdiff as wd

for name in NAMES:
    importlib.import_module(name)
warnings.simplefilter("ignore", wd.WarpdiffWarning)
heightfield = wd.HeightField(np.zeros((8, 8)), 0.05)
window = {"coherence": wd.Coherence(sigma_um=1.0), "threads": 1}
up = (0.0, 0.0, 1.0)
light, view = wd.DirectionalLight(up), wd.View((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), width=4, height=3)
disc = wd.meshes.disc()
renderer = wd.Renderer(disc, heightfield, light, view, **window)
folder = tempfile.TemporaryDirectory()
path = folder.name + "/path.csv"
open(path, "w").write("eye_x,eye_y,eye_z,target_x,target_y,target_z\\n0,0,3,0,0,0\\n")
short = {"coherence": window["coherence"], "threads": 1}
lobes = wd.bake(heightfield, tolerance=10.0, **short)
spectrum = wd.bake_spectrum(heightfield, size=16, tolerance=0.1, **short)
called = {
    "BakedLobes": lobes,
    "BakedSpectrum": spectrum,
    "Coherence": window["coherence"].sigma_um,
    "DirectionalLight": light.power,
    "Environment": wd.Environment(np.ones((2, 4, 3))).scale,
    "HeightField": heightfield.pitch_um,
    "Image": wd.shade(disc, heightfield, light, view, **window),
    "Material": wd.Material.metal("Al"),
    "OrderEfficiencies": wd.order_efficiencies(heightfield, up, 550.0),
    "Period": wd.HeightField([np.sin(np.arange(60.0))], 0.1).periods()[0],
    "Plan": wd.plan(heightfield, up, up, **window),
    "Renderer": renderer.image(),
    "Shot": wd.Shot(light, view),
    "Spectrum": wd.Spectrum.blackbody(2856.0),
    "View": view.width,
    "PointLight": wd.PointLight(up).power,
    "WarpdiffWarning": wd.WarpdiffWarning("said"),
    "bake": lobes.bytes,
    "bake_spectrum": spectrum.coherence,
    "brdf": wd.brdf(heightfield, up, up, 550.0, **window),
    "reflectance_map": wd.reflectance_map(heightfield, up, size=4, **window),
    "camera_path": wd.camera_path(path, light, view),
    "export_html": wd.export_html,
    "gratings": wd.gratings.lamellar(2.5, 0.1),
    "light_sweep": wd.light_sweep(light, view, (1.0, 0.0, 1.0)),
    "meshes": disc,
    "order_efficiencies": wd.order_efficiencies(heightfield, up, 550.0),
    "plan": wd.plan(heightfield, **window),
    "reflectance": wd.reflectance(heightfield, up, up, **window),
    "register_mitsuba_bsdf": wd.register_mitsuba_bsdf,
    "sequence": wd.sequence(renderer, wd.turntable(light, view, count=2), folder.name + "/turn"),
    "shade": wd.shade(disc, heightfield, light, view, **window).rgb,
    "spectral_reflectance": wd.spectral_reflectance(heightfield, up, up, 550.0, **window),
    "turntable": wd.turntable(light, view),
}
assert set(called) == set(wd.__all__), set(called) ^ set(wd.__all__)
for name in ("BakedLobes", "BakedSpectrum", "Image", "OrderEfficiencies", "Period", "Plan"):
    assert type(called[name]) is getattr(wd, name)
"""


def test_every_public_name_can_be_called_after_all_modules_are_imported():
    names = [name for name in PACKAGE if name != "warpdiff.__main__"]
    code = CALLS.replace("NAMES", repr(names))
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=False)
    assert found.returncode == 0, found.stderr
