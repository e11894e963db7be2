"""Virtual environment with the wheel of one commit, whose pictures and times are a baseline for other commits.

::

    python -m bench.dev.baseline --folder baseline
    python -m bench.dev.baseline --folder head --commit HEAD --versions-of baseline

The script exports the files of the commit to a temporary folder, and builds the wheel there, without uncommitted files.
The script prints the path of the environment's Python program. With ``--versions-of``, libraries are installed in the
versions of another environment. With other versions of the libraries, results may differ in their last bit.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tarfile
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Hash of the last commit whose public names are those of version 0.1.0.
BASELINE = "435cbd29d7812b4a0b884249204b87c1858a2e49"


def build(folder: Path, commit: str, versions_of: Path | None) -> Path:
    """Build the wheel of a commit and install it into a new environment.

    Return the path of the Python program of the environment.
    """
    if folder.exists() and any(folder.iterdir()):
        raise SystemExit(f"error: --folder must be empty or not exist yet, got {folder}")
    venv.create(folder, with_pip=True)
    python = python_in(folder)
    with tempfile.TemporaryDirectory() as name:
        temporary = Path(name)
        export(commit, temporary / "source")
        constraints = temporary / "constraints.txt"
        constraints.write_text("" if versions_of is None else versions(python_in(versions_of)))
        _pip(python, "wheel", "--no-deps", "--wheel-dir", temporary / "wheel", temporary / "source")
        (wheel,) = (temporary / "wheel").glob("warpdiff-*.whl")
        _pip(python, "install", "--constraint", constraints, wheel)
    return python


def export(commit: str, folder: Path) -> None:
    """Write all files of a commit into a folder."""
    archive = folder.with_suffix(".tar")
    subprocess.run(["git", "-C", ROOT, "archive", "--output", archive, commit], check=True)  # noqa: S607
    with tarfile.open(archive) as files:
        files.extractall(folder, filter="data")


def versions(python: Path) -> str:
    """Return the versions of all libraries in an environment, as constraints for ``pip install``."""
    frozen = subprocess.run([python, "-m", "pip", "freeze"], check=True, capture_output=True, text=True).stdout
    return "".join(f"{line}\n" for line in frozen.splitlines() if "==" in line and not line.startswith("warpdiff"))


def python_in(folder: Path) -> Path:
    """Return the path of the Python program of an environment."""
    return folder.absolute() / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def _pip(python: Path, *arguments: object) -> None:
    # The messages of pip go to stderr, so that stdout contains only the path that the script prints.
    subprocess.run([python, "-m", "pip", "--quiet", *map(str, arguments)], check=True, stdout=sys.stderr)


def main() -> None:
    """Build an environment and print the path of its Python."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--folder", type=Path, required=True, help="new folder for the environment")
    parser.add_argument(
        "--commit", default=BASELINE, help="commit to build the wheel from (default: the last one of version 0.1.0)"
    )
    parser.add_argument(
        "--versions-of", type=Path, metavar="FOLDER", help="environment whose library versions are installed"
    )
    options = parser.parse_args()
    print(build(options.folder, options.commit, options.versions_of))


if __name__ == "__main__":
    main()
