"""A picture in linear CIE XYZ, and its files."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import checks, file_writing
from warpdiff.kernels.limits import FLOOR, TINY
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from warpdiff.plans.plan import Plan

# By layer, what its channels' names in EXR files end in.
_LAYER_CHANNELS = {"normal": "XYZ", "depth": "Z", "geometry": "Y"}
_FORMATS = (".exr", ".png")
# The last chunk of a PNG file: its length, name and checksum. Readers do without it.
_PNG_END = b"\0\0\0\0IEND\xaeB`\x82"
# The share of the lit pixels that automatic exposure leaves out.
_TOO_BRIGHT = 1e-4


@dataclass(frozen=True)
class Image:
    """A linear picture: XYZ by pixel, masks, estimated errors, and the plan that it was computed by.

    Attributes:
        xyz: Linear CIE XYZ, shape (height, width, 3), float32, row 0 on top; 0 in the background, and multiplied by
            ``coverage`` where a pixel's samples hit in part.
        mask: Whether anything was hit, shape (height, width).
        lit: Whether it was hit and an unshadowed light stands above its horizon, shape (height, width).
        coverage: Share of the pixel's samples that hit something, 0 to 1, float32; alpha in files.
        error: Estimated error of each pixel, ‖ΔXYZ‖ over max(‖XYZ‖, 1e-3 · Y*) as ``tolerance`` has it, shape (height,
            width), float32; 0 where nothing is lit.
        plan: What was computed and why.
        layers: What the pixels' central rays meet, as far as :func:`warpdiff.shade` was asked for it. ``"normal"``: the
            unit shading normal on the viewer's side, world frame, shape (height, width, 3), float32, 0 where nothing is
            met. ``"depth"``: the distance along the ray, from the eye or the plane through it [the mesh's unit], shape
            (height, width), float32, else infinite. ``"geometry"``: which of the scene's geometries it is, in the order
            of its nodes, shape (height, width), int32, else −1.
    """

    xyz: NDArray[np.float32]
    mask: NDArray[np.bool_]
    lit: NDArray[np.bool_]
    coverage: NDArray[np.float32]
    error: NDArray[np.float32]
    plan: Plan
    layers: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    @property
    @np.errstate(under="ignore")
    def rgb(self) -> NDArray[np.float32]:
        """Linear sRGB, shape (height, width, 3), float32; colours out of gamut have negative components."""
        return colorimetry.xyz_to_rgb(self.xyz).astype(np.float32)

    @property
    @np.errstate(under="ignore")
    def auto_exposure(self) -> float:
        """The factor that maps the lit pixels' mean luminance to a half; 1 for a black picture.

        Their brightest ten-thousandth does not count. Orders may fill a picture or a thousandth of it, and lie next to
        a mirror's highlight that is a thousand times as bright: a percentile would be any of these.
        """
        luminance = np.sort(self.xyz[..., 1][self.lit].astype(np.float64))
        kept = luminance[: len(luminance) - math.ceil(_TOO_BRIGHT * len(luminance))]
        # Of fewer than two there is no other.
        mean = float(np.mean(kept if kept.size else luminance)) if luminance.size else 0.0
        return 0.5 / mean if mean > 0.0 else 1.0

    @np.errstate(under="ignore")
    def save(self, path: str | os.PathLike[str], *, exposure: float | None = None, bits: int = 8) -> Path:
        """Write the picture; an existing file is replaced only once the new one is complete.

        Args:
            path: ``.exr`` holds linear float32 channels R, G, B, A and XYZ.X, XYZ.Y, XYZ.Z, unscaled unless
                ``exposure`` is given, multiplied by alpha, and error.Y, which is :attr:`error`; of :attr:`layers`
                those that there are, as normal.X, normal.Y, normal.Z, depth.Z and geometry.Y. ``.png`` is sRGB with
                alpha, not multiplied.
            exposure: Linear factor; None is 1 for EXR and :attr:`auto_exposure` for PNG.
            bits: 8 or 16, for PNG.

        Returns:
            The path written.

        Raises:
            ValueError: Another suffix, a bad exposure or number of bits.
            OSError: The file cannot be written; one that was there before is untouched.
        """
        import OpenImageIO as oiio  # noqa: N813 (as its own manual does)

        target = check_target(path)
        suffix = target.suffix.lower()
        if checks.count(bits, "bits") not in (8, 16):
            raise ValueError(f"bits must be 8 or 16, got {bits!r}")
        if exposure is None:
            exposure = self.auto_exposure if suffix == ".png" else 1.0
        else:
            exposure = checks.positive(exposure, "exposure")

        height, width = self.mask.shape
        alpha = self.coverage[..., None]
        if suffix == ".exr":
            channels: tuple[str, ...] = ("R", "G", "B", "A", "XYZ.X", "XYZ.Y", "XYZ.Z", "error.Y")
            layers = [exposure * self.rgb, alpha, exposure * self.xyz, self.error[..., None]]
            for name, suffixes in _LAYER_CHANNELS.items():
                if name in self.layers:
                    channels += tuple(f"{name}.{suffix}" for suffix in suffixes)
                    layers.append(self.layers[name].reshape(height, width, len(suffixes)))
            pixels = np.concatenate(layers, axis=2, dtype=np.float32)
            spec = oiio.ImageSpec(width, height, len(channels), oiio.FLOAT)
            spec.attribute("compression", "zip")
            spec.attribute("oiio:ColorSpace", "lin_rec709")
        else:
            channels = ("R", "G", "B", "A")
            # PNG holds colours that are not multiplied by alpha.
            straight = exposure * colorimetry.xyz_to_rgb(self.xyz) / np.where(alpha > 0.0, alpha, 1.0)
            encoded = np.concatenate([colorimetry.srgb_encode(straight), alpha], axis=2)
            levels = 2**bits - 1
            pixels = np.round(encoded * levels).astype(np.uint8 if bits == 8 else np.uint16)
            spec = oiio.ImageSpec(width, height, len(channels), oiio.UINT8 if bits == 8 else oiio.UINT16)
            spec.attribute("oiio:UnassociatedAlpha", 1)
            spec.attribute("oiio:ColorSpace", "sRGB")
        spec.channelnames = channels
        spec.alpha_channel = 3
        spec.attribute("Software", "warpdiff")
        spec.attribute("ImageDescription", str(self.plan))
        spec.attribute("warpdiff:exposure", float(exposure))

        _write(target, spec, np.ascontiguousarray(pixels))
        return target


def relative_errors(
    errors: NDArray[np.floating[Any]], xyz: NDArray[np.float32], lit: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Errors ‖ΔXYZ‖, of any shape, over max(‖XYZ‖, f · Y*), of XYZ (…, 3); Y* is that of what is lit."""
    luminance = np.sort(xyz[..., 1][lit])
    white = 0.0
    if len(luminance):
        total = np.cumsum(luminance, dtype=np.float64)
        median = luminance[min(np.searchsorted(total, 0.5 * total[-1]), len(total) - 1)]
        white = max(float(luminance[math.ceil(0.99 * len(luminance)) - 1]), float(median))
    floor = max(FLOOR * white, TINY)
    return np.asarray(errors / np.maximum(np.linalg.norm(xyz, axis=-1), floor), dtype=np.float32)


def check_target(path: Any, name: str = "path") -> Path:
    """Return the path of a picture that can be written there, or say why it cannot."""
    target = checks.path(path, name)
    if target.suffix.lower() not in _FORMATS:
        raise ValueError(f"{name} must end in {' or '.join(_FORMATS)}, got {target.name!r}")
    file_writing.check_folder(target.parent, name)
    if target.is_dir():
        raise IsADirectoryError(f"{name}: {target} is a folder; name a file")
    return target


def _write(target: Path, spec: Any, pixels: NDArray[Any]) -> None:
    """Write a file, and make sure of it: the PNG writer reports success on a full disk, the EXR writer at times."""
    import OpenImageIO as oiio  # noqa: N813 (as its own manual does)

    # The temporary name ends in the same suffix, which is how the writer of the format is found.
    with _without_exr_threads(), file_writing.replacing(target, suffix=target.suffix.lower()) as temporary:
        output = oiio.ImageOutput.create(str(temporary))
        if output is None or not output.open(str(temporary), spec):
            reason = oiio.geterror() if output is None else output.geterror()
            raise OSError(f"cannot write {target}: {reason}")
        written = output.write_image(pixels)
        if not (output.close() and written):
            raise OSError(f"cannot write {target}: {output.geterror()}")
        if not _holds(temporary, pixels, spec.channelnames):
            raise OSError(f"cannot write {target}: what was written is not what is in the file; the disk may be full")


def _holds(path: Path, pixels: NDArray[Any], channels: Sequence[str]) -> bool:
    """Whether a file is whole and holds these pixels, in channels of these names in any order."""
    import OpenImageIO as oiio  # noqa: N813 (as its own manual does)

    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - len(_PNG_END), 0))
        if path.suffix == ".png" and file.read() != _PNG_END:
            return False
    straight = oiio.ImageSpec()
    straight.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(path), straight)
    if source is None:
        # Or it is printed when the process ends.
        oiio.geterror()
        return False
    names = list(source.spec().channelnames)
    found = source.read_image(0, 0, 0, pixels.shape[2], "unknown")
    source.close()
    if found is None or found.dtype != pixels.dtype or sorted(names) != sorted(channels):
        return False
    return bool(found[..., [names.index(name) for name in channels]].tobytes() == pixels.tobytes())


@contextlib.contextmanager
def _without_exr_threads() -> Iterator[None]:
    """Write and read EXR files on this thread: a child of a fork would wait for ever for others that OpenEXR keeps."""
    import OpenImageIO as oiio  # noqa: N813 (as its own manual does)

    before = oiio.get_int_attribute("exr_threads")
    oiio.attribute("exr_threads", -1)
    try:
        yield
    finally:
        oiio.attribute("exr_threads", before)
