"""The wheel, the sdist and the editable install, used from outside of the checkout, and imports of the package."""

import ast
import functools
import hashlib
import inspect
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from conftest import public_members

import warpdiff as wd
from bench.dev.release_check import MOST_WHEEL_BYTES

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ("warpdiff", "kernels", "tests", "bench")

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

# First lines of a test script. Python runs without the site module, so that neither an editable install nor the
# checkout can supply files that the installed package lacks. Dependencies come last on the path.
PRELUDE = """
import sys
target, source, dependencies = sys.argv[1], sys.argv[2], sys.argv[3].split("|")
sys.path[:0] = [target]
sys.path += dependencies
import site
if source != target:
    site.addsitedir(target)
"""
CHECK = f"""{PRELUDE}
from pathlib import Path
import warpdiff as wd
import warpdiff.kernels.coefficient_sum as kernels
method = sys.argv[4]
installed = "warpdiff/" if source == target else ""
expected = {{
    wd: "warpdiff/__init__.py", kernels: installed + "kernels/coefficient_sum.py",
}}
for module, path in expected.items():
    where = Path(source, path).resolve()
    assert Path(module.__file__).resolve() == where, (module.__file__, where)
assert Path(wd.__file__).with_name("py.typed").is_file()
xyz = wd.reflectance(wd.HeightField([[0.0] * 8] * 8, 0.1), [0, 0, 1], [0, 0, 1], method=method)
assert abs(xyz[1] - 1.0) < 1e-2, xyz
print("as", wd.__version__, flush=True)
import runpy
sys.argv = ["warpdiff", "--version"]
runpy.run_module("warpdiff", run_name="__main__", alter_sys=True)
"""


def package_of(requirement: str) -> str:
    """Return the name of the package of a requirement."""
    return re.split(r"[<>=~! \[]", requirement)[0]


def run(command: list[str | Path], cwd: Path) -> str:
    """Return the standard output of a command that must succeed, without network and without ``PYTHON*`` variables."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    # Archives with a stated date have the same bytes whenever they are built.
    environment["SOURCE_DATE_EPOCH"] = "1600000000"
    environment |= {"PIP_NO_INDEX": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1", "PIP_NO_INPUT": "1"}
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, f"{command} failed:\n{done.stdout}\n{done.stderr}"
    return done.stdout


def copy_of_the_tree(folder: Path) -> Path:
    """Copy the source tree to a folder, so that a build leaves no files in the checkout."""
    folder.mkdir()
    for name in SOURCES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", ".*"))
    for path in ROOT.iterdir():
        if path.is_file() and not path.name.startswith("."):
            shutil.copy(path, folder)
    return folder


def build(kind: str, tree: Path, into: Path) -> Path:
    """Build a package by the setuptools hook that pip calls, with the installed version of setuptools."""
    into.mkdir(exist_ok=True)
    code = f"import sys; from setuptools import build_meta; print(build_meta.build_{kind}(sys.argv[1]))"
    return into / run([sys.executable, "-c", code, into], tree).splitlines()[-1]


def install(wheel: Path, target: Path) -> Path:
    """Install a wheel without its dependencies."""
    options = ["--quiet", "--no-deps", "--no-compile", "--target", target]
    run([sys.executable, "-m", "pip", "install", *options, wheel], target.parent)
    return target


def check_installed(target: Path, source: Path, outside: Path, method: str) -> None:
    """Import and use the package that is installed in ``target``; its files must be in ``source``.

    The ``method`` "auto" compiles kernels. Python runs in the folder ``outside``. This folder contains an empty folder
    ``warpdiff``, such as a clone has, which must not be imported instead.
    """
    (outside / "warpdiff" / "kernels").mkdir(parents=True)
    dependencies = [path for path in sys.path if Path(path).is_dir() and Path(path).resolve() != ROOT]
    arguments = [str(target), str(source), "|".join(dependencies), method]
    output = run([sys.executable, "-S", "-c", CHECK, *arguments], outside)
    assert output.split() == ["as", PROJECT["version"], "warpdiff", PROJECT["version"]]
    assert [path.name for path in outside.rglob("*")] == ["warpdiff", "kernels"]


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> Path:
    """Return a copy of the source tree to build from."""
    return copy_of_the_tree(tmp_path_factory.mktemp("source") / "tree")


def shipped(folder: str) -> set[str]:
    """Return the relative paths of all files in one folder of the checkout: code and data files."""
    files = (path for path in (ROOT / folder).rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return {path.relative_to(ROOT / folder).as_posix() for path in files}


def check_wheel(wheel: Path) -> None:
    """Check that a wheel contains the package and no other files."""
    names = set(zipfile.ZipFile(wheel).namelist())
    info = f"warpdiff-{PROJECT['version']}.dist-info"
    expected = {f"warpdiff/{name}" for name in shipped("warpdiff")}
    expected |= {f"warpdiff/kernels/{name}" for name in shipped("kernels")}
    assert {name for name in names if not name.startswith(info)} == expected
    assert not [name for name in names if "bench" in Path(name).parts]
    assert f"{info}/licenses/LICENSE" in names
    scripts = zipfile.ZipFile(wheel).read(f"{info}/entry_points.txt").decode()
    assert "warpdiff = warpdiff.__main__:main" in scripts
    assert wheel.stat().st_size <= MOST_WHEEL_BYTES
    check_bill(json.loads(zipfile.ZipFile(wheel).read(f"{info}/sboms/warpdiff.cdx.json")), wheel)


def check_bill(bill: dict, wheel: Path) -> None:
    """Check that a bill of materials lists each dependency and each bundled data file, with its checksum."""
    assert (bill["bomFormat"], bill["metadata"]["component"]["version"]) == ("CycloneDX", PROJECT["version"])
    libraries = {entry["name"] for entry in bill["components"] if entry["type"] == "library"}
    assert libraries == {package_of(requirement) for requirement in PROJECT["dependencies"]}
    archive = zipfile.ZipFile(wheel)
    data = {name for name in archive.namelist() if name.startswith("warpdiff/") and name.endswith((".npy", ".json"))}
    bundled = {entry["bom-ref"]: entry for entry in bill["components"] if entry["type"] == "data"}
    assert bundled.keys() == data
    for name, entry in bundled.items():
        assert entry["hashes"][0]["content"] == hashlib.sha256(archive.read(name)).hexdigest()
    references = {entry["bom-ref"] for entry in bill["components"]}
    assert set(bill["dependencies"][0]["dependsOn"]) == references


def check_reproducible(tree: Path, sdist: Path, wheel: Path, tmp_path: Path) -> None:
    """Check that other permissions and times of the source files change neither the sdist nor the wheel."""
    copy = tmp_path / "copy"
    shutil.copytree(tree, copy, ignore=shutil.ignore_patterns("build", "*.egg-info"))
    for path in copy.rglob("*.py"):
        path.chmod(0o700)
        os.utime(path, (1.5e9, 1.5e9))
    assert build("sdist", copy, tmp_path / "again").read_bytes() == sdist.read_bytes()
    assert build("wheel", copy, tmp_path / "again").read_bytes() == wheel.read_bytes()


def test_the_sdist_and_the_wheel_built_from_it_are_complete(tree, tmp_path):
    sdist = build("sdist", tree, tmp_path / "dist")
    shutil.unpack_archive(sdist, tmp_path)
    unpacked = tmp_path / f"warpdiff-{PROJECT['version']}"
    for name in ("LICENSE", "README.md", "pyproject.toml", "tests/test_packaging.py", "warpdiff/py.typed"):
        assert (unpacked / name).is_file(), f"{name} is not in the sdist"
    for folder in ("warpdiff", "kernels", "bench"):
        missing = {name for name in shipped(folder) if not (unpacked / folder / name).is_file()}
        assert not missing
    wheel = build("wheel", unpacked, tmp_path / "from_sdist")
    check_wheel(wheel)
    check_reproducible(tree, sdist, wheel, tmp_path)
    # The compiler must find the kernels' header files in a folder whose name has spaces and non-ASCII letters.
    target = install(wheel, tmp_path / "Pakete für mich")
    check_installed(target, target, tmp_path / "outside", "auto")


def test_the_editable_install_uses_the_source_tree(tree, tmp_path):
    # The editable wheel has no install scripts, so unpacking it installs it.
    with zipfile.ZipFile(build("editable", tree, tmp_path / "dist")) as wheel:
        wheel.extractall(tmp_path / "target")
    # With the method "direct", nothing is compiled here. The other tests compile kernels of a source tree already.
    check_installed(tmp_path / "target", tree, tmp_path / "outside", "direct")


@functools.cache
def imported(path: Path) -> set[str]:
    """Return the top-level names that a file imports, at any place in the file."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module.partition(".")[0])
    return names


def test_declared_dependencies_equal_the_imported_packages():
    names = {
        "warp": "warp-lang", "colour": "colour-science", "PIL": "pillow", "annotated_types": "annotated-types",
        "mpl_toolkits": "matplotlib",
    }  # fmt: skip
    used = set().union(
        *(imported(path) for folder in ("warpdiff", "kernels") for path in (ROOT / folder).rglob("*.py"))
    )
    used = {names.get(name, name) for name in used - sys.stdlib_module_names - {"warpdiff"}}
    declared = {package_of(requirement) for requirement in PROJECT["dependencies"]}
    # Packages that only single commands require are optional dependencies.
    extras = PROJECT["optional-dependencies"]
    commands = ("view", "data", "dask", "mitsuba", "plot", "scans", "gltf", "lithography", "jax", "torch", "rigorous")
    optional = {package_of(each) for name in commands for each in extras[name]}
    assert declared == used - optional
    assert optional <= used


def test_kernels_are_never_imported_by_their_folder():
    # The test searches for import statements in the text of the files, because parsing all tests would take two
    # seconds.
    by_folder = re.compile(r"^\s*(from|import) kernels\b", re.MULTILINE)
    assert by_folder.search("import os\n    from kernels.bvh import trace_bvh\n")
    for folder in SOURCES:
        for path in (ROOT / folder).rglob("*.py"):
            assert not by_folder.search(path.read_text()), f"{path}: kernels/ is shipped as warpdiff.kernels"


def test_importing_the_package_loads_no_slow_packages():
    # Code that needs no device must not import Warp. Packages that only some calls require must not be loaded by a
    # plain import.
    slow = {"trimesh", "colour", "OpenImageIO", "PIL", "scipy", "matplotlib", "DracoPy", "mapbox_earcut"}
    light = "gratings", "meshes", "HeightField", "Coherence", "DirectionalLight", "View", "Image", "Plan", "plot"
    steps = ("import sys, warpdiff", f"from warpdiff import {', '.join(light)}; from warpdiff.apps import cli",
             "from warpdiff import *")  # fmt: skip
    code = "".join(f"{step}; print(*sys.modules)\n" for step in steps)
    package, described, whole = (set(line.split()) for line in run([sys.executable, "-c", code], ROOT).splitlines())
    assert "numpy" not in package
    assert not described & {"warp", *slow}
    assert {"warp", "warpdiff.render.shade"} <= whole
    assert not whole & slow


def test_public_names_exist_and_are_documented():
    assert list(wd.__all__) == sorted(wd.__all__)
    for name in wd.__all__:
        public = getattr(wd, name)
        assert inspect.getdoc(public), f"warpdiff.{name} has no docstring"
        members = public_members(public) if inspect.isclass(public) else {}
        if inspect.ismodule(public):
            members = {member: value for member, value in vars(public).items() if not member.startswith("_")}
        for member, value in members.items():
            own = getattr(value, "__module__", "").startswith("warpdiff") or isinstance(value, (property, classmethod))
            if callable(getattr(public, member)) and own:
                assert inspect.getdoc(value), f"warpdiff.{name}.{member} has no docstring"


def test_everything_public_has_one_canonical_path():
    for name in wd.__all__:
        public = getattr(wd, name)
        if not inspect.ismodule(public):
            assert getattr(sys.modules[public.__module__], name) is public


def test_the_version_equals_that_of_the_metadata():
    assert wd.__version__ == PROJECT["version"]
