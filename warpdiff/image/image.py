"""A picture in linear CIE XYZ, and its files."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import files, openimageio, validation
from warpdiff.image import display_transform
from warpdiff.kernels.thresholds import FLOOR, TINY
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.request.plan import Plan

# By layer, what its channels' names in EXR files end in.
_LAYER_CHANNELS = {"normal": "XYZ", "depth": "Z", "geometry": "Y"}
_FORMATS = (".exr", ".png")
# The last chunk of a PNG file: its length, name and checksum. Readers do without it.
PNG_END = b"\0\0\0\0IEND\xaeB`\x82"
# The share of the lit pixels that automatic exposure leaves out.
_TOO_BRIGHT = 1e-4
MOST_STOPS = 30.0
# The odds that a pixel errs by more than the tolerance, where its estimated error is the tolerance, and the power of
# their ratio that they grow by.
_ODDS_AT_TOLERANCE, _ODDS_POWER = 0.01, 4.0
# What pixels may err by that edges pass, of the mesh or of what is lit, over the tolerance.
EDGES_PER_TOLERANCE = 3.0


@dataclass(frozen=True)
class Image:
    """A linear picture: XYZ by pixel, masks, estimated errors, and the plan that it was computed by.

    Attributes:
        xyz: Linear CIE XYZ, shape (height, width, 3), float32, row 0 on top; 0 in the background, and multiplied by
            ``coverage`` where a pixel's samples hit in part.
        mask: Whether anything was hit, shape (height, width).
        illuminated: Whether it was hit and an unshadowed light stands above its horizon, shape (height, width).
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
    illuminated: NDArray[np.bool_]
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
    def auto_exposure(self) -> float:
        """The factor that ``display="aces"`` takes by itself; 1 for a black picture.

        It maps the lit pixels' mean luminance to 0.7 (for other displays: to a half), but for their brightest
        ten-thousandth. Orders may fill a picture or a thousandth of it, and lie next to a mirror's highlight that is a
        thousand times as bright: a percentile would be any of these.
        """
        return self._auto_exposure("aces")

    @np.errstate(under="ignore")
    def _auto_exposure(self, display: str) -> float:
        luminance = np.sort(self.xyz[..., 1][self.illuminated].astype(np.float64))
        kept = luminance[: len(luminance) - math.ceil(_TOO_BRIGHT * len(luminance))]
        # Of fewer than two there is no other.
        mean = float(np.mean(kept if kept.size else luminance)) if luminance.size else 0.0
        return display_transform.MEAN_SHOWN[display] / mean if mean > 0.0 else 1.0

    @np.errstate(under="ignore")
    def display(
        self,
        display: str = "aces",
        *,
        exposure: float | None = None,
        exposure_stops: float = 0.0,
        exposure_from: Image | None = None,
        gamut: str = "srgb",
        background: Image | ArrayLike | None = None,
        exact: bool = True,
    ) -> NDArray[np.float32]:
        """What a display shows, encoded as sRGB is.

        Args:
            display: ``"aces"``: the ACES 2.0 view for standard dynamic range, with chroma compressed before it; bright
                orders are continuous spectra. ``"colorimetric"``: colours that the display has are exact, others lose
                chroma at constant hue, and what is brighter than white is white. ``"clip"``: each channel is cut off.
            exposure: Linear factor; None is :attr:`auto_exposure`, or what fits another display.
            exposure_stops: Doublings of light, on top of it.
            exposure_from: A picture whose automatic exposure is taken, for pictures that belong together.
            gamut: ``"srgb"`` or ``"display-p3"``.
            background: What lies behind: a colour (R, G, B), encoded, each 0 to 1, or a picture of the same size, shown
                alike, or its linear sRGB, shape (height, width, 3), as :meth:`warpdiff.Environment.seen` gives it. It
                is mixed in the display's linear light. None leaves it transparent.
            exact: False looks ACES up in a table, which is several times as fast and differs by 0.1 in the median, 0.6
                at percentile 99 (ΔE2000).

        Returns:
            R, G, B and, without a background, alpha, 0 to 1, shape (height, width, 3 or 4), float32; colours are not
            multiplied by alpha.

        Raises:
            ValueError: A bad argument.
        """
        validation.choice(display, "display", display_transform.DISPLAYS)
        validation.choice(gamut, "gamut", tuple(display_transform.GAMUTS))
        validation.flag(exact, "exact")
        factor = self._exposure(display, exposure, exposure_stops, exposure_from)
        return self._displayed(display, factor, gamut, background, exact=exact)

    def _displayed(
        self, display: str, factor: float, gamut: str, background: Image | ArrayLike | None, *, exact: bool = True
    ) -> NDArray[np.float32]:
        """What :meth:`display` returns, at a linear factor."""
        behind = self._behind(background, display, factor, gamut, exact=exact)
        shown = self._shown(display, factor, gamut, exact=exact)
        if behind is None:
            return np.concatenate([shown, self.coverage[..., None]], axis=2, dtype=np.float32)
        result = np.empty(shown.shape, dtype=np.float32)
        result[...] = colorimetry.srgb_encode(behind)
        whole = self.coverage >= 1.0
        result[whole] = shown[whole]
        part = ~whole & self.mask
        alpha = self.coverage[part][:, None]
        light = alpha * colorimetry.srgb_decode(shown[part])
        light += (1.0 - alpha) * (behind if behind.ndim == 1 else behind[part])
        result[part] = colorimetry.srgb_encode(light)
        return result

    def _exposure(
        self, display: str, exposure: float | None, stops: float, source: Image | None, *, scales: bool = True
    ) -> float:
        """The linear factor that the arguments name; without any, 1 where nothing is to be scaled."""
        stops = validation.number(stops, "exposure_stops", least=-MOST_STOPS, most=MOST_STOPS)
        validation.instance(source, Image, "exposure_from", optional=True)
        if exposure is not None:
            if source is not None:
                raise ValueError("exposure and exposure_from exclude each other, got both")
            factor = validation.positive(exposure, "exposure")
        elif source is not None or scales:
            # Of a picture all but black it may be more than any that can be given, and float32 would overflow.
            factor = min((source or self)._auto_exposure(display), validation.MOST)
        else:
            factor = 1.0
        return float(factor * 2.0**stops)

    def _shown(self, display: str, factor: float, gamut: str, *, exact: bool) -> NDArray[np.float64]:
        """Encoded colours, not multiplied by alpha; 0 where nothing is."""
        seen = self.coverage > 0.0
        straight = self.xyz[seen] / self.coverage[seen][:, None].astype(np.float64)
        shown = np.zeros(self.xyz.shape)
        shown[seen] = display_transform.shown(factor * straight, display, gamut, exact=exact)
        return shown

    def _behind(
        self, background: Image | ArrayLike | None, display: str, factor: float, gamut: str, *, exact: bool
    ) -> NDArray[np.float64] | None:
        """Linear light of a background, (3,) or (height, width, 3)."""
        if background is None:
            return None
        if isinstance(background, Image):
            if background.mask.shape != self.mask.shape:
                raise ValueError(
                    f"background must be a picture of {self.mask.shape[1]} × {self.mask.shape[0]} pixels, "
                    f"got {background.mask.shape[1]} × {background.mask.shape[0]}"
                )
            shown = background._shown(display, factor, gamut, exact=exact)
            return background.coverage[..., None] * colorimetry.srgb_decode(shown)
        given = validation.finite_array(background, "background", most=validation.MOST)
        if given.shape == self.xyz.shape:
            shown = display_transform.shown(factor * colorimetry.rgb_to_xyz(given), display, gamut, exact=exact)
            return colorimetry.srgb_decode(shown)
        if given.shape != (3,):
            raise ValueError(
                f"background must be a colour of shape (3,), or radiances of {self.mask.shape[1]} × "
                f"{self.mask.shape[0]} pixels, got shape {given.shape}"
            )
        colour = given
        if not np.all((colour >= 0.0) & (colour <= 1.0)):
            raise ValueError(f"background must be a colour of components from 0 to 1, got {colour.tolist()}")
        return colorimetry.srgb_decode(colour)

    @np.errstate(under="ignore")
    def save(
        self,
        path: str | os.PathLike[str],
        *,
        display: str = "aces",
        exposure: float | None = None,
        exposure_stops: float = 0.0,
        exposure_from: Image | None = None,
        gamut: str = "srgb",
        background: Image | ArrayLike | None = None,
        bits: int = 8,
    ) -> Path:
        """Write the picture; an existing file is replaced only once the new one is complete.

        Args:
            path: ``.exr`` holds linear float32 channels R, G, B, A and XYZ.X, XYZ.Y, XYZ.Z, unscaled unless an
                exposure is given, multiplied by alpha, and error.Y, which is :attr:`error`; of :attr:`layers`
                those that there are, as normal.X, normal.Y, normal.Z, depth.Z and geometry.Y. ``.png`` is what
                :meth:`display` gives, with alpha, not multiplied, unless there is a background.
            display: As in :meth:`display`, for PNG; EXR is linear. The file says what was done.
            exposure: Linear factor; None is 1 for EXR, and that of :meth:`display` for PNG.
            exposure_stops: As in :meth:`display`.
            exposure_from: As in :meth:`display`.
            gamut: As in :meth:`display`, for PNG.
            background: As in :meth:`display`, for PNG alone.
            bits: 8 or 16, for PNG.

        Returns:
            The path written.

        Raises:
            ValueError: Another suffix, a bad argument.
            OSError: The file cannot be written; one that was there before is untouched.
        """
        import OpenImageIO as oiio  # noqa: N813 (as its own manual does)

        target = check_target(path)
        is_png = target.suffix.lower() == ".png"
        if validation.count(bits, "bits") not in (8, 16):
            raise ValueError(f"bits must be 8 or 16, got {bits!r}")
        validation.choice(display, "display", display_transform.DISPLAYS)
        validation.choice(gamut, "gamut", tuple(display_transform.GAMUTS))
        factor = self._exposure(display, exposure, exposure_stops, exposure_from, scales=is_png)

        height, width = self.mask.shape
        if is_png:
            encoded = self._displayed(display, factor, gamut, background)
            channels: tuple[str, ...] = ("R", "G", "B", "A")[: encoded.shape[2]]
            pixels = np.round(np.float64(encoded) * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)
            spec = oiio.ImageSpec(width, height, len(channels), oiio.UINT8 if bits == 8 else oiio.UINT16)
            spec.attribute("oiio:UnassociatedAlpha", 1)
            spec.attribute("oiio:ColorSpace", "sRGB")
            if (cicp := display_transform.GAMUTS[gamut].cicp) is not None:
                spec.erase_attribute("oiio:ColorSpace")
                spec.attribute("CICP", oiio.TypeDesc("int[4]"), cicp)
            transform = f"{display_transform.description(display, gamut)}; exposure {factor:.6g}"
        else:
            if background is not None:
                raise ValueError(
                    "background is for .png files; .exr holds alpha, and what lies behind is for whoever shows it"
                )
            channels = ("R", "G", "B", "A", "XYZ.X", "XYZ.Y", "XYZ.Z", "error.Y")
            alpha = self.coverage[..., None]
            layers = [factor * self.rgb, alpha, factor * self.xyz, self.error[..., None]]
            for name, suffixes in _LAYER_CHANNELS.items():
                if name in self.layers:
                    channels += tuple(f"{name}.{suffix}" for suffix in suffixes)
                    layers.append(self.layers[name].reshape(height, width, len(suffixes)))
            pixels = np.concatenate(layers, axis=2, dtype=np.float32)
            spec = oiio.ImageSpec(width, height, len(channels), oiio.FLOAT)
            spec.attribute("compression", "zip")
            # Or the writer adds the time, and the same picture would never make the same file.
            spec.attribute("DateTime", "")
            spec.attribute("oiio:ColorSpace", "lin_rec709")
            transform = f"none, linear; exposure {factor:.6g}"
        spec.channelnames = channels
        spec.alpha_channel = channels.index("A") if "A" in channels else -1
        spec.attribute("Software", "warpdiff")
        spec.attribute("ImageDescription", str(self.plan))
        spec.attribute("warpdiff:display", transform)
        spec.attribute("warpdiff:exposure", float(factor))

        _write(target, spec, np.ascontiguousarray(pixels))
        return target


def lengths(xyz: NDArray[np.float32]) -> NDArray[np.float32]:
    """‖XYZ‖ of colours (…, 3): ``np.linalg.norm`` takes three times as long where the last axis is short."""
    return np.asarray(np.sqrt(np.einsum("...c,...c->...", xyz, xyz)))


def relative_errors(errors: NDArray[np.floating[Any]], xyz: NDArray[np.float32]) -> NDArray[np.float32]:
    """Errors ‖ΔXYZ‖ (n,) of what is lit, over max(‖XYZ‖, f · Y*), of its XYZ (n, 3)."""
    luminance = np.sort(xyz[:, 1])
    white = 0.0
    if len(luminance):
        total = np.cumsum(luminance, dtype=np.float64)
        median = luminance[min(np.searchsorted(total, 0.5 * total[-1]), len(total) - 1)]
        white = max(float(luminance[math.ceil(0.99 * len(luminance)) - 1]), float(median))
    floor = max(FLOOR * white, TINY)
    return np.asarray(errors / np.maximum(lengths(xyz), floor), dtype=np.float32)


def share_beyond(error: NDArray[np.float32], tolerance: float) -> float:
    """The share of pixels that are expected to err by more than a tolerance, from their estimated errors."""
    if not error.size:
        return 0.0
    odds = _ODDS_AT_TOLERANCE * (error.astype(np.float64) / tolerance) ** _ODDS_POWER
    return float(np.mean(odds / (1.0 + odds)))


def check_target(path: Any, name: str = "path") -> Path:
    """Return the path of a picture that can be written there, or say why it cannot."""
    target = validation.path(path, name)
    if target.suffix.lower() not in _FORMATS:
        raise ValueError(f"{name} must end in {' or '.join(_FORMATS)}, got {target.name!r}")
    files.check_folder(target.parent, name)
    if target.is_dir():
        raise IsADirectoryError(f"{name}: {target} is a folder; name a file")
    return target


def _write(target: Path, spec: Any, pixels: NDArray[Any]) -> None:
    """Write a file, and make sure of it: the PNG writer reports success on a full disk, the EXR writer at times."""
    # The temporary name ends in the same suffix, which is how the writer of the format is found.
    with openimageio.in_use() as oiio, files.atomic_write(target, suffix=target.suffix.lower()) as temporary:
        output = oiio.ImageOutput.create(str(temporary))
        if output is None or not output.open(str(temporary), spec):
            reason = oiio.geterror() if output is None else output.geterror()
            raise OSError(f"cannot write {target}: {reason}")
        written = output.write_image(pixels)
        if not (output.close() and written):
            raise OSError(f"cannot write {target}: {output.geterror()}")
        if not _holds(oiio, temporary, pixels, spec.channelnames):
            raise OSError(f"cannot write {target}: what was written is not what is in the file; the disk may be full")


def _holds(oiio: Any, path: Path, pixels: NDArray[Any], channels: Sequence[str]) -> bool:
    """Whether a file is whole and holds these pixels, in channels of these names in any order."""
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - len(PNG_END), 0))
        if path.suffix == ".png" and file.read() != PNG_END:
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
