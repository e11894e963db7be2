"""Licences of the installed dependencies, compared with a list of accepted licences: ``python -m bench.dev.licences``.

The packages are those that warpdiff requires, directly or through others, and those of its extras that are installed.
"""

from __future__ import annotations

import argparse
import re
import sys
from importlib import metadata
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

# Licences under which a dependency may be used by a program of any licence. The list has SPDX identifiers and the names
# of these licences in older metadata, in lower case.
ACCEPTED = {
    "0bsd", "apache-2.0", "bsd-2-clause", "bsd-3-clause", "cc0-1.0", "isc", "mit", "mit-0", "mit-cmu", "mpl-2.0",
    "boost software license 1.0 (bsl-1.0)", "psf-2.0", "python-2.0", "unlicense", "zlib", "hpnd", "bsl-1.0",
    "blueoak-1.0.0", "ncsa", "3-clause bsd",
    "apache", "apache 2", "apache 2.0", "apache license 2.0", "apache license, version 2.0", "apache software license",
    "bsd", "bsd license", "bsd 3-clause", "new bsd", "modified bsd", "isc license", "isc license (iscl)", "mit license",
    "mozilla public license 2.0 (mpl 2.0)", "python software foundation license", "the unlicense (unlicense)",
    "historical permission notice and disclaimer (hpnd)", "cc0 1.0 universal (cc0 1.0) public domain dedication",
}  # fmt: skip
# Licences of packages that replace those in the packages' metadata. They were read from the licence files. The metadata
# of meent state no licence. Those of docutils name the GPL of an Emacs mode, which its wheel does not contain.
BY_FILE = {"docutils": "BSD-2-Clause", "meent": "MIT"}
# Additions to licences, such as "with Classpath-exception". They only permit more than the licence, and are ignored
# here.
_EXCEPTIONS = re.compile(r" with [\w.-]+", re.IGNORECASE)


def licence_of(package: metadata.Distribution) -> str:
    """Return the licence of a package: from a list of licence files, or from its metadata."""
    head = package.metadata
    if by_file := BY_FILE.get(str(head["Name"]).lower()):
        return by_file
    expression = head.get("License-Expression")
    if expression:
        return str(expression)
    classifiers = [text.split(" :: ")[-1] for text in head.get_all("Classifier") or () if text.startswith("License ::")]
    names = [name for name in classifiers if name != "OSI Approved"]
    if names:
        return " AND ".join(names)
    text = str(head.get("License") or "").strip()
    return text if len(text) < 60 else text.splitlines()[0].strip()


def is_accepted(licence: str) -> bool:
    """Whether a licence expression can be met with accepted licences only: one side of OR, and each side of AND."""
    plain = _EXCEPTIONS.sub("", licence.strip().lower())
    # Innermost parentheses that contain "and" or "or" are evaluated first. Parentheses in names of licences contain
    # neither.
    while plain not in ACCEPTED and (group := re.search(r"\(([^()]*\s(?:and|or)\s[^()]*)\)", plain)):
        plain = plain.replace(group[0], "mit" if is_accepted(group[1]) else "refused")
    if plain in ACCEPTED:
        return True
    for word, test in ((r"\s+or\s+", any), (r"\s+and\s+", all)):
        parts = re.split(word, plain)
        if len(parts) > 1:
            return test(is_accepted(part) for part in parts)
    return plain.strip("()") in ACCEPTED


def required(name: str, extras: Iterable[str] = ()) -> Iterator[str]:
    """Yield the names of the packages that a package and its extras require and that this Python needs."""
    from packaging.requirements import Requirement

    for text in metadata.requires(name) or ():
        requirement = Requirement(text)
        marker = requirement.marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            yield requirement.name


def installed(root: str = "warpdiff") -> tuple[dict[str, metadata.Distribution], list[str]]:
    """Return the installed packages that a package requires, and the names of those that are not installed."""
    extras = metadata.metadata(root).get_all("Provides-Extra") or []
    packages: dict[str, metadata.Distribution] = {}
    missing: set[str] = set()
    waiting = list(required(root, extras))
    while waiting:
        name = re.sub(r"[-_.]+", "-", waiting.pop()).lower()
        if name in packages or name in missing or name == root:
            continue
        try:
            packages[name] = metadata.distribution(name)
        except metadata.PackageNotFoundError:
            missing.add(name)
            continue
        waiting += required(name)
    return packages, sorted(missing)


def main() -> int:
    """Print a table of the packages and their licences. Return 1 if a licence is not accepted."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    packages, missing = installed()
    refused = []
    for name, package in sorted(packages.items()):
        licence = licence_of(package)
        print(f"{name} {package.version}: {licence or 'unknown'}")
        if not is_accepted(licence):
            refused.append(f"{name} ({licence or 'unknown'})")
    if missing:
        print(f"not installed, not checked: {', '.join(missing)}")
    if refused:
        print(f"licences that are not accepted: {', '.join(refused)}", file=sys.stderr)
    return int(bool(refused))


if __name__ == "__main__":
    sys.exit(main())
