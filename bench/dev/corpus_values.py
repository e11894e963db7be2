"""Functions that collect, by name, the values of a result that ``bench/dev/corpus.py`` compares."""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.dev.public_names import plan_numbers

if TYPE_CHECKING:
    from pathlib import Path

# Values by name, and a test case: a function that returns the values of a result for a number of threads.
Values = dict[str, Any]
Case = Callable[[int], Values]

IMAGE_ARRAYS = ("xyz", "mask", "illuminated", "coverage", "error")


def image_values(image: Any) -> Values:
    """Return a picture's arrays and layers, its numbers of wavelengths and terms (plan), and its report."""
    return map_values(image) | plan_values(image.plan, getattr(image, "report", None))


def map_values(image: Any) -> Values:
    """Return the arrays of a picture or of a reflectance map, with the numbers of its plan (wavelengths, terms)."""
    arrays = {name: getattr(image, name) for name in IMAGE_ARRAYS} | dict(image.layers or {})
    return arrays | plan_values(image.plan)


def plan_values(plan: Any, report: Any = None) -> Values:
    """Return the numbers of a plan (wavelengths, terms), and those of the report of a picture if there is one."""
    numbers = plan_numbers(plan, report)
    return {f"plan.{name}": str(value) if value is None else value for name, value in numbers.items()}


def named(prefix: str, values: Values) -> Values:
    """Return values by name, with a prefix added to each name."""
    return {f"{prefix}.{name}": value for name, value in values.items()}


def attributes(owner: Any, names: tuple[str, ...]) -> Values:
    """Return the values of the named attributes of an object."""
    return {name: getattr(owner, name) for name in names}


def archive_values(path: Path) -> Values:
    """Return the arrays of a .npz file that the package wrote."""
    with np.load(path) as archive:
        return dict(archive)


def pixel_values(path: Path) -> Values:
    """Return the pixels and channel names of a .png or .exr file that the package wrote."""
    import OpenImageIO as oiio  # noqa: N813 (as its own manual does)

    file = oiio.ImageInput.open(str(path))
    spec = file.spec()
    values = {
        "pixels": file.read_image(0, 0, 0, spec.nchannels, "unknown"),
        "channels": np.array(list(spec.channelnames)),
        "exposure": spec.get_float_attribute("warpdiff:exposure"),
    }
    file.close()
    return values


def page_values(path: Path) -> Values:
    """Return the packed arrays of an exported web page, and all numbers of its JSON header in their order."""
    page = path.read_text(encoding="utf-8")
    header = re.search(r'<script type="application/json"[^>]*>(.*?)</script>', page, re.DOTALL)
    data = re.search(r'<script type="text/plain"[^>]*>([A-Za-z0-9+/=\s]{1000,})</script>', page)
    if header is None or data is None:
        raise ValueError(
            f"{path.name} must contain a JSON header and a script of base64 data, but one of them is missing"
        )
    packed = np.frombuffer(zlib.decompress(base64.b64decode(data[1])), dtype=np.uint8)
    return {"packed": packed, "header": np.array(_numbers_in(json.loads(header[1])))}


def _numbers_in(value: Any) -> list[float]:
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return [number for item in value for number in _numbers_in(item)]
    return [float(value)] if isinstance(value, (int, float)) else []
