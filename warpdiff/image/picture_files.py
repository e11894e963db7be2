"""Files of pictures: writing and reading of EXR and PNG files. Each written file is read again and compared.

A part of a file is an image with named channels. An EXR file may have several parts, and a PNG file has one.
"""

from __future__ import annotations

import contextlib
import json
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import files, memory, openimageio
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

# Channels of the first part of every EXR file.
CHANNELS = ("R", "G", "B", "A", "XYZ.X", "XYZ.Y", "XYZ.Z", "error.Y")
# Name of the metadata attribute of a layer whose values are numbers of geometries or materials. The attribute lists, in
# JSON, the names for which the numbers stand.
NAMES = "warpdiff:names"
# Metadata of spectral EXR files in the layout of Fichet et al. 2021. The layout has no unit for relative radiances.
SPECTRAL_METADATA = {
    "spectralLayoutVersion": "1.0",
    "emissiveUnits": "W.m^-2.sr^-1",
    "warpdiff:spectra": "radiance relative to that of a source of constant spectrum with the luminance Y = 1",
}
# Matches the name of a channel with the radiance at a wavelength in nm, which has a decimal comma.
_SPECTRAL = re.compile(r"S0\.(\d{1,6}(?:,\d{1,9})?)nm")
_FORMATS = (".exr", ".png")
# Last bytes of a complete PNG file: the chunk IEND with length, name and checksum. A file without these bytes is
# incomplete, but many readers accept it.
_PNG_END = b"\0\0\0\0IEND\xaeB`\x82"
# Memory for reading an EXR file [bytes per sample]: four for a float32 sample, and four for a copy in which each
# channel is contiguous.
_BYTES_PER_SAMPLE = 8
# OpenImageIO's names of element types, by the type of a Python number, for metadata that are tuples.
_ELEMENTS = {int: "int", float: "float"}


@dataclass(frozen=True, eq=False)
class FilePart:
    """Part of a picture file: an image with named channels and metadata. PNG files have one part.

    Attributes:
        channels: Names of the channels.
        pixels: Samples, shape (height, width, channels); float32, or integers of a PNG file.
        name: Name of the part; empty for a file with a single part.
        metadata: Texts, numbers, and tuples of numbers by name, in the notation of OpenImageIO.
    """

    channels: tuple[str, ...]
    pixels: NDArray[Any]
    name: str = ""
    metadata: Mapping[str, str | float | tuple[float, ...]] = field(default_factory=dict)

    def spec(self, oiio: Any) -> Any:
        """Return the header of this part of a picture file as OpenImageIO's ``ImageSpec``."""
        height, width, count = self.pixels.shape
        spec = oiio.ImageSpec(width, height, count, str(self.pixels.dtype).replace("float32", "float"))
        spec.channelnames = self.channels
        spec.alpha_channel = self.channels.index("A") if "A" in self.channels else -1
        if self.name:
            spec.attribute("oiio:subimagename", self.name)
        for name, value in self.metadata.items():
            if isinstance(value, tuple):
                spec.attribute(name, oiio.TypeDesc(f"{_ELEMENTS[type(value[0])]}[{len(value)}]"), value)
            else:
                spec.attribute(name, value)
        return spec


def spectral_channel(wavelength_nm: float) -> str:
    """Return the name of the channel of a wavelength, such as ``S0.550,000000nm`` (Fichet et al. 2021)."""
    return f"S0.{wavelength_nm:.6f}nm".replace(".", ",").replace(",", ".", 1)


def wavelength_of(channel: str) -> float | None:
    """Return the wavelength of a channel [nm], or None if the channel has no spectral name."""
    match = _SPECTRAL.fullmatch(channel)
    return None if match is None else float(match[1].replace(",", "."))


def check_target(path: Any, name: str = "path") -> Path:
    """Return the checked path of a picture file; raise an error if no picture can be written there.

    Args:
        path: Path that the user gave.
        name: Name of the argument for error messages.
    """
    return files.check_output(path, _FORMATS, name)


def write_parts(target: Path, parts: Sequence[FilePart]) -> None:
    """Write the parts of a picture file, read the file again and compare it with the parts.

    The comparison is necessary because writers may report success on a full disk: the PNG writer always, the EXR writer
    sometimes.
    """
    # OpenImageIO selects the file format by the suffix. The temporary file therefore has the suffix of the final file.
    with openimageio.in_use() as oiio, files.atomic_write(target, suffix=target.suffix.lower()) as temporary:
        output = oiio.ImageOutput.create(str(temporary))
        specs = tuple(part.spec(oiio) for part in parts)
        if output is None or not output.open(str(temporary), specs if len(specs) > 1 else specs[0]):
            reason = openimageio.error_text(oiio) if output is None else openimageio.error_text(output)
            raise OSError(f"cannot write {target}: {reason}")
        written = output.write_image(np.ascontiguousarray(parts[0].pixels))
        for spec, part in zip(specs[1:], parts[1:], strict=True):
            written = written and output.open(str(temporary), spec, "AppendSubimage")
            written = written and output.write_image(np.ascontiguousarray(part.pixels))
        if not (output.close() and written):
            raise OSError(f"cannot write {target}: {openimageio.error_text(output)}")
        if not _is_written(oiio, temporary, parts):
            raise OSError(f"cannot write {target}: the file does not hold what was written; the disk may be full")


def ends_as_png(path: Path) -> bool:
    """Return whether a file ends as a complete PNG file. Only its last bytes are read."""
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - len(_PNG_END), 0))
        return file.read() == _PNG_END


def _is_written(oiio: Any, path: Path, parts: Sequence[FilePart]) -> bool:
    """Whether a file is complete and contains the parts; the channels of a part may have any order."""
    if path.suffix == ".png" and not ends_as_png(path):
        return False
    straight = oiio.ImageSpec()
    straight.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(path), straight)
    if source is None:
        openimageio.error_text(oiio)
        return False
    try:
        return all(_holds(source, index, part) for index, part in enumerate(parts))
    finally:
        source.close()


def _holds(source: Any, index: int, part: FilePart) -> bool:
    """Whether the part of a file with the given index has the channels and the samples of ``part``."""
    if not source.seek_subimage(index, 0):
        return False
    names = list(source.spec().channelnames)
    samples = source.read_image(index, 0, 0, len(names), "unknown")
    if samples is None:
        openimageio.error_text(source)
        return False
    if samples.dtype != part.pixels.dtype or sorted(names) != sorted(part.channels):
        return False
    order = [names.index(name) for name in part.channels]
    return bool(samples[..., order].tobytes() == part.pixels.tobytes())


def read_exr(file: Path) -> tuple[dict[str, NDArray[np.float32]], dict[str, tuple[str, ...]]]:
    """Return the channels of all parts of an EXR file of :meth:`warpdiff.Image.save`, and names for its layers.

    The first mapping has channels of shape (height, width) by name. The second mapping has, by the name of a layer, the
    names of the geometries or materials for which the numbers in the layer stand.
    """
    with openimageio.in_use() as oiio:
        source = openimageio.opened(oiio, file, ("openexr",))
        if source is None:
            openimageio.error_text(oiio)
            raise ArgumentValueError(
                f"{ref('path')}: {str(file)!r} cannot be read as an EXR file; name one of Image.save"
            )
        try:
            specs: list[Any] = []
            while source.seek_subimage(len(specs), 0):
                specs.append(source.spec())
            openimageio.error_text(source)
            names = tuple(specs[0].channelnames)
            if not {*CHANNELS} <= {*names}:
                raise ArgumentValueError(
                    f"{ref('path')}: {str(file)!r} has the channels {', '.join(names)}; "
                    f"name an EXR file of Image.save, which has {', '.join(CHANNELS)}"
                )
            width, height = specs[0].width, specs[0].height
            memory.require_memory(
                _BYTES_PER_SAMPLE * sum(spec.width * spec.height * spec.nchannels for spec in specs),
                f"{ref('path')}: {str(file)!r} of {width} × {height} pixels", "take {share} of its pixels",
            )  # fmt: skip
            channels: dict[str, NDArray[np.float32]] = {}
            known: dict[str, tuple[str, ...]] = {}
            for index, spec in enumerate(specs):
                pixels = source.read_image(index, 0, 0, spec.nchannels, "float")
                if pixels is None or source.has_error or pixels.shape[:2] != (height, width):
                    openimageio.error_text(source)
                    raise ArgumentValueError(f"{ref('path')}: {str(file)!r} is damaged; save the picture again")
                planes = np.ascontiguousarray(np.moveaxis(pixels, 2, 0))
                channels |= dict(zip(spec.channelnames, planes, strict=True))
                with contextlib.suppress(ValueError, TypeError):
                    # The file may have no list of names of geometries or materials, or another text instead. The
                    # numbers in the layer then stay without names.
                    known[spec.getattribute("oiio:subimagename")] = tuple(
                        map(str, json.loads(spec.getattribute(NAMES)))
                    )
        finally:
            source.close()
    return channels, known
