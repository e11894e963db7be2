"""Rules of the source tree: the package layers, checked by import-linter, and rules that it cannot check."""

import ast
import collections
import functools
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
if not (ROOT / "pyproject.toml").is_file():
    pytest.skip("these tests need the source tree", allow_module_level=True)

PACKAGE_MAP = ROOT / "docs" / "contributing" / "package_map.md"
DECISIONS = sorted((ROOT / "docs" / "decisions").glob("*.md"))
SOURCES = {
    ".".join((package, *path.relative_to(ROOT / folder).with_suffix("").parts)).removesuffix(".__init__"): path
    for package, folder in {"warpdiff": "warpdiff", "warpdiff.kernels": "kernels"}.items()
    for path in sorted((ROOT / folder).rglob("*.py"))
}
# Largest number of lines of a Python file. Longer files have several topics; docs/contributing/style.md has the rule.
MOST_LINES = 500
# Packages that must not import Warp, neither directly nor through other packages.
WITHOUT_WARP = ("core", "datasets", "diffraction", "heightfield", "image", "optics", "profiles", "samples")
# Pattern that finds attributes of Warp's objects which Warp's reference does not document.
UNDOCUMENTED = (
    r"warp\._[a-z]|\bwp\._[a-z]|\.(hooks|module_exec|adj|params|_length_|_type_|__ctype__|ctype|native_func)\b"
)


def run(*command):
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, result.stdout + result.stderr


def test_import_linter_finds_no_broken_contract():
    run(Path(sys.executable).with_name("lint-imports"), "--no-cache")


def test_kernels_import_only_kernels_and_packages_below_apps_no_public_names():
    """Kernels may import only kernels, and packages below ``apps`` may not import public names.

    import-linter cannot check this, because in an editable install it treats ``warpdiff.kernels`` as ``warpdiff``.
    """
    for name, path in SOURCES.items():
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        imported = {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
        imported |= {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
        assert "warpdiff" not in imported or name.startswith(("warpdiff.apps", "warpdiff.__main__")), name
        if name.startswith("warpdiff.kernels"):
            assert not [module for module in imported if re.match(r"warpdiff\.(?!kernels\b)", module)], name


def test_packages_without_warp_do_not_load_it():
    names = [name for name in SOURCES if name.split(".")[1:2] and name.split(".")[1] in WITHOUT_WARP]
    run(sys.executable, "-c", f"import sys, {', '.join(names)}; assert 'warp' not in sys.modules")


def test_only_the_device_package_uses_undocumented_parts_of_warp():
    users = {name for name, path in SOURCES.items() if re.search(UNDOCUMENTED, path.read_text(encoding="utf-8"))}
    assert {name.rpartition(".")[0] for name in users} == {"warpdiff.device"}


def python_files():
    """Return all Python files of the repository that belong to it, without environments, builds and generated pages."""
    folders = ("warpdiff", "kernels", "bench", "tests", "examples", "docs/extensions")
    files = [*ROOT.glob("*.py"), *ROOT.glob("docs/*.py")]
    return [*files, *(path for folder in folders for path in sorted((ROOT / folder).rglob("*.py")))]


def test_python_files_have_at_most_500_lines():
    # This file may be longer: the body of the sample snake is one table of measures with the functions that use it.
    exempt = ROOT / "warpdiff" / "samples" / "corn_snake.py"
    lines = {path.relative_to(ROOT): len(path.read_text(encoding="utf-8").splitlines()) for path in python_files()}
    assert len(lines) > 400
    too_long = {str(path): count for path, count in lines.items() if count > MOST_LINES and ROOT / path != exempt}
    assert not too_long, f"split these files by topic: {too_long}"


def test_file_names_are_unique():
    stems = collections.Counter(path.stem for path in SOURCES.values() if path.stem != "__init__")
    assert not [stem for stem, count in stems.items() if count > 1]


@pytest.mark.parametrize("page", [PACKAGE_MAP, *DECISIONS], ids=lambda page: page.stem)
def test_pages_for_contributors_mention_files_and_names_that_exist(page):
    mentions = re.findall(r"`([^`\s]+)`", page.read_text(encoding="utf-8"))
    absent = [
        mention for mention in mentions if not any((folder / mention).exists() for folder in (ROOT, ROOT / "warpdiff"))
    ]
    names = {word for mention in absent if "/" not in mention for word in re.findall(r"[A-Za-z_]\w{2,}", mention)}
    assert not [*(mention for mention in absent if "/" in mention), *(names - words_of_code())]
    assert page != PACKAGE_MAP or len(mentions) - len(absent) > 100


@functools.cache
def words_of_code():
    code = [*SOURCES.values(), *(ROOT / "kernels" / "native").glob("*.h"), *ROOT.glob("*.toml")]
    code += [path for folder in ("bench", "tests") for path in (ROOT / folder).rglob("*.py")]
    return {word for path in code for word in re.findall(r"\w+", path.read_text(encoding="utf-8"))}


def test_pages_that_the_code_refers_to_exist():
    code = [*SOURCES.values(), *(ROOT / "kernels" / "native").glob("*.h"), ROOT / "pyproject.toml"]
    pages = {page for path in code for page in re.findall(r"\bdocs/[\w/-]+\.md", path.read_text(encoding="utf-8"))}
    assert pages
    assert not [page for page in pages if not (ROOT / page).is_file()]


# Script that calls every public name after all modules are imported. No module may shadow a public name.
CALLS = """
import tempfile, warnings
import numpy as np
import warpdiff as wd
from warpdiff.lights.base import Light

warnings.simplefilter("ignore", wd.WarpdiffWarning)
heightfield = wd.HeightField(np.zeros((8, 8)), 0.05)
settings = {"coherence": wd.Coherence(sigma_um=1.0), "threads": 1}
up = (0.0, 0.0, 1.0)
light, view = wd.DirectionalLight(up), wd.View((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), width=4, height=3)
disc = wd.meshes.disc()
renderer = wd.Renderer(disc, heightfield, light, view, **settings)
folder = tempfile.TemporaryDirectory()
path = folder.name + "/path.csv"
open(path, "w").write("eye_x,eye_y,eye_z,target_x,target_y,target_z\\n0,0,3,0,0,0\\n")
lobes = wd.bake(heightfield, delta_e=10.0, **settings)
spectrum = wd.bake_spectrum(heightfield, size=16, tolerance=0.1, **settings)
called = {
    "BakedLobes": lobes, "BakedSpectrum": spectrum, "Coherence": settings["coherence"].sigma_um,
    "HeightField": heightfield.pitch_um, "Image": wd.shade(disc, heightfield, light, view, **settings),
    "Material": wd.Material.metal("Al"), "OrderEfficiencies": wd.order_efficiencies(heightfield, up, 550.0),
    "Periods": wd.HeightField([np.sin(np.arange(60.0))], 0.1).periods(),
    "Period": wd.HeightField([np.sin(np.arange(60.0))], 0.1).periods()[0],
    "Plan": wd.plan(heightfield, up, up, **settings),
    "Renderer": renderer.image(), "Report": renderer.image().report,
    "Comparison": wd.compare(renderer.image(), renderer.image()), "compare": wd.compare([[up]], [[up]], tolerance=0.1),
    "ReflectanceSpectra": wd.reflectance_spectra(heightfield, up, up, 550.0, **settings),
    "Roughness": heightfield.roughness(), "ScanReport": wd.report(heightfield, folder.name + "/a", **settings),
    "report": wd.report(heightfield, folder.name + "/b", sigmas_um=[1.0], **settings),
    "Shot": wd.Shot(light, view), "Table": wd.Table({"number": [1]}),
    "Spectrum": wd.Spectrum.blackbody(2856.0),
    "ToleranceError": wd.ToleranceError("text"), "View": view.width, "WarpdiffWarning": wd.WarpdiffWarning("text"),
    "bake": lobes.bytes, "bake_spectrum": spectrum.coherence, "brdf": wd.brdf(heightfield, up, up, 550.0, **settings),
    "camera_path": wd.camera_path(path, light, view), "datasets": wd.datasets.info("corn_snake_scan"),
    "direction": wd.direction(0.0), "export_html": wd.export_html,
    "gratings": wd.gratings.lamellar(2.5, 0.1), "light_sweep": wd.light_sweep(light, view, (1.0, 0.0, 1.0)),
    "meshes": disc, "order_efficiencies": wd.order_efficiencies(heightfield, up, 550.0),
    "order_angles": wd.order_angles(heightfield, up, 550.0), "plot": wd.plot.height_map,
    "plan": wd.plan(heightfield, **settings), "reflectance": wd.reflectance(heightfield, up, up, **settings),
    "reflectance_map": wd.reflectance_map(heightfield, up, size=4, **settings),
    "reflectance_spectra": wd.reflectance_spectra(heightfield, up, up, 550.0, **settings),
    "to_srgb": wd.to_srgb([0.1, 0.2, 0.3]),
    "measure_layout": wd.measure_layout, "register_mitsuba_bsdf": wd.register_mitsuba_bsdf,
    "sequence": wd.sequence(renderer, wd.turntable(light, view, count=2), folder.name + "/turn"),
    "shade": wd.shade(disc, heightfield, light, view, **settings).rgb,
    "spectral_reflectance": wd.spectral_reflectance(heightfield, up, up, 550.0, **settings),
    "turntable": wd.turntable(light, view),
}
trapezoid = wd.profiles.Trapezoid(0.1, 0.5, 0.02, 2.0)
orders = wd.Measured.orders(up, 550.0, [(0, m) for m in range(-2, 3)], [0.0, 0.01, 0.02, 0.01, 0.0])
fitted = wd.fit(trapezoid, orders, sd=1e-3, starts=1)
target = wd.Target.equal([(0, -1), (0, 1)], up, 550.0)
designed = wd.design(wd.profiles.Pixels(0.5, np.zeros((1, 4))), target, starts=1)
called |= {
    "RigorousEfficiencies": wd.RigorousEfficiencies, "rigorous_order_efficiencies": wd.rigorous_order_efficiencies,
    "Design": designed, "Target": target, "design": designed,
    "adjoint": wd.adjoint.order_efficiencies(heightfield, up, 550.0).value, "profiles": trapezoid, "fit": fitted,
    "Fit": fitted, "Measured": orders, "Minimum": fitted.minima[0], "Surface": wd.Surface(heightfield),
}
lights = {name for name in wd.__all__ if isinstance(value := getattr(wd, name), type) and issubclass(value, Light)}
assert {"DirectionalLight", "Environment", "PointLight"} <= lights
assert set(called) ^ lights == set(wd.__all__), set(called) ^ lights ^ set(wd.__all__)
classes = "BakedLobes", "BakedSpectrum", "Comparison", "Image", "OrderEfficiencies", "Period", "Periods", "Plan"
classes += ("Design", "Fit", "Measured", "Minimum", "Target")
for name in (*classes, "ReflectanceSpectra", "Report", "Roughness", "ScanReport", "Table"):
    assert type(called[name]) is getattr(wd, name)
"""


# This test is slow, because it starts a process that imports all modules and compiles kernels.
@pytest.mark.slow
def test_every_public_name_can_be_called_after_all_modules_are_imported():
    names = [name for name in SOURCES if name != "warpdiff.__main__"]
    run(sys.executable, "-c", f"import {', '.join(names)}\n{CALLS}")
