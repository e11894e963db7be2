"""Finds the packages, and makes the wheel and the sdist reproducible, with a software bill of materials in the wheel.

The packages are those below ``warpdiff/``, and ``kernels/``, which is installed as ``warpdiff.kernels``. An editable
install puts the checkout on the import path. There ``warpdiff/__init__.py`` finds ``kernels/`` itself. The import hook
that setuptools installs otherwise comes too late: a folder named ``warpdiff`` beside a script, such as a clone, would
be imported as a namespace package without contents.

Two builds of the same files with the same environment variable ``SOURCE_DATE_EPOCH`` and the same version of setuptools
have the same bytes. Without the variable, the files of the sdist have the date of the build.
"""

import gzip
import hashlib
import io
import json
import os
import re
import sys
import tarfile
import tomllib
import uuid
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.sdist import sdist

ROOT = Path(__file__).parent
# Data of others in the package, by path: name, licence (SPDX), and origin.
BUNDLED = {
    "warpdiff/optics/metals.json": (
        "refractive indices of metals, refractiveindex.info database", "CC0-1.0", "https://refractiveindex.info"
    ),
    "warpdiff/optics/d65.npy": (
        "products of CIE illuminant D65 and the CIE 1931 observer, computed with colour-science", "BSD-3-Clause",
        "https://www.colour-science.org",
    ),
}  # fmt: skip


def bill_of_materials(project: dict, root: Path) -> str:
    """Return the software bill of materials as CycloneDX 1.6 in JSON: bundled data, and required packages (PEP 770).

    The text depends only on the project's metadata and on the bundled files. It contains no date.
    """
    name, version = project["name"], project["version"]
    reference = f"pkg:pypi/{name}@{version}"
    bundled = [
        {
            "type": "data", "bom-ref": path, "name": title, "licenses": [{"license": {"id": licence}}],
            "hashes": [{"alg": "SHA-256", "content": hashlib.sha256((root / path).read_bytes()).hexdigest()}],
            "externalReferences": [{"type": "website", "url": address}],
        }
        for path, (title, licence, address) in BUNDLED.items()
    ]  # fmt: skip
    required = []
    for requirement in project["dependencies"]:
        package, versions = re.fullmatch(r"([\w.-]+)\s*(.*)", requirement).groups()
        purl = f"pkg:pypi/{re.sub(r'[-_.]+', '-', package).lower()}"
        required.append({
            "type": "library", "bom-ref": purl, "name": package, "purl": purl, "scope": "required",
            "properties": [{"name": "python:requirement", "value": versions}],
        })  # fmt: skip
    components = bundled + required
    content = {
        "metadata": {
            "component": {
                "type": "library", "bom-ref": reference, "name": name, "version": version, "purl": reference,
                "description": project["description"], "licenses": [{"license": {"id": project["license"]}}],
            }
        },
        "components": components,
        "dependencies": [{"ref": reference, "dependsOn": [component["bom-ref"] for component in components]}],
    }  # fmt: skip
    number = uuid.uuid5(uuid.NAMESPACE_URL, json.dumps(content, sort_keys=True))
    head = {"bomFormat": "CycloneDX", "specVersion": "1.6", "serialNumber": f"urn:uuid:{number}", "version": 1}
    return json.dumps(head | content, indent=2) + "\n"


class Wheel(bdist_wheel):
    """Wheel with a software bill of materials, whose files have the same permissions on every system."""

    def write_wheelfile(self, wheelfile_base: str, *arguments: str, **options: str) -> None:
        """Write the file ``WHEEL``, after which the wheel is packed, and the bill of materials."""
        super().write_wheelfile(wheelfile_base, *arguments, **options)
        folder = Path(wheelfile_base, "sboms")
        folder.mkdir(exist_ok=True)
        project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        text = bill_of_materials(project, ROOT)
        (folder / "warpdiff.cdx.json").write_text(text, encoding="utf-8", newline="\n")
        # An editable install writes the file into a folder of the caller, whose other files stay unchanged.
        packed = Path(self.bdist_dir)
        if Path(wheelfile_base).is_relative_to(packed):
            for path in packed.rglob("*"):
                path.chmod(0o755 if path.is_dir() else 0o644)


class SourceArchive(sdist):
    """Archive of the source files without the owner, the permissions and the times of the files on this machine."""

    def make_archive(self, base_name: str, *arguments: str, **options: str) -> str:
        """Return the path of the archive, which is written again with normalised metadata."""
        path = Path(super().make_archive(base_name, *arguments, **options))
        with tarfile.open(path) as archive:
            members = sorted(archive.getmembers(), key=lambda member: member.name)
            contents = [archive.extractfile(member).read() if member.isfile() else b"" for member in members]
        newest = max(int(member.mtime) for member in members)
        time = int(os.environ.get("SOURCE_DATE_EPOCH", newest))
        # The header of a .gz file has the name of the file and a time. Both are empty here.
        with (
            path.open("wb") as raw,
            gzip.GzipFile("", "wb", mtime=0, fileobj=raw) as packed,
            tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as archive,
        ):
            for member, content in zip(members, contents, strict=True):
                archive.addfile(normalised(member, time), io.BytesIO(content))
        return str(path)


def normalised(member: tarfile.TarInfo, time: int) -> tarfile.TarInfo:
    """Return an entry of an archive with the given time [s since 1970], and without owner and permissions."""
    result = tarfile.TarInfo(member.name)
    result.size, result.type, result.linkname, result.mtime = member.size, member.type, member.linkname, time
    result.mode = 0o755 if member.isdir() else 0o644
    return result


LIBRARY = find_packages(include=["warpdiff", "warpdiff.*"])
COMMANDS = {"bdist_wheel": Wheel, "sdist": SourceArchive}
if "editable_wheel" in sys.argv:
    setup(packages=LIBRARY, package_dir={"": "."}, cmdclass=COMMANDS)
else:
    KERNELS = [f"warpdiff.{name}" for name in find_packages(include=["kernels", "kernels.*"])]
    FOLDERS = {"warpdiff": "warpdiff", "warpdiff.kernels": "kernels"}
    setup(packages=LIBRARY + KERNELS, package_dir=FOLDERS, cmdclass=COMMANDS)
