"""Class ``Image``: pictures in linear CIE XYZ, with functions that read and write picture files."""

from __future__ import annotations

import io
import json
import sys
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from warpdiff.core import files, validation
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.image import display_transform
from warpdiff.image.picture_files import (
    CHANNELS,
    NAMES,
    SPECTRAL_METADATA,
    FilePart,
    check_target,
    read_exr,
    spectral_channel,
    wavelength_of,
    write_parts,
)
from warpdiff.optics import colorimetry
from warpdiff.request.layer_formats import layer_format, layer_of
from warpdiff.request.plan import plan_text
from warpdiff.request.settings import Display, DisplaySettings, GamutSettings
from warpdiff.request.signatures import accepts

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping
    from pathlib import Path

    import PIL.Image
    from numpy.typing import ArrayLike, NDArray

    from warpdiff.image.report import Report
    from warpdiff.request.keywords import DisplayKeywords, GamutKeywords
    from warpdiff.request.plan import Plan


@dataclass(frozen=True, eq=False)
class Image:
    """Picture in linear CIE XYZ, with masks, estimated errors and the plan of its computation.

    Attributes:
        xyz: Linear CIE XYZ, shape (height, width, 3), float32, row 0 at the top; multiplied by ``coverage``, so that
            the background is 0.
        mask: Whether any sample of a pixel hits the mesh, shape (height, width).
        illuminated: Whether any sample of a pixel hits a point that an unshadowed light illuminates, shape (height,
            width).
        coverage: Fraction of a pixel's samples that hit the mesh, 0 to 1, shape (height, width), float32; alpha in
            files.
        error: Estimated relative error of each pixel, ‖ΔXYZ‖ / max(‖XYZ‖, 1e-3 · Y*), the measure to which
            ``tolerance`` refers, shape (height, width), float32; 0 where nothing is illuminated.
            :func:`warpdiff.compare` defines Y*.
        plan: Plan of the computation. For several surfaces, a mapping from parts of the mesh to plans. None for a
            picture that :meth:`load` has read.
        report: Report on the picture's errors and refinement; None for a picture that :meth:`load` has read.
        layers: Further outputs by name, as requested from :func:`warpdiff.shade`, shape (height, width) or (height,
            width, components), at the hit of the ray through each pixel's centre. Names of layers of a single light end
            in the index of the light, as ``"light.0"``. ``docs/how-to/layers_and_exr_files.md`` lists all layers.
        names: Names of the objects for which numbers in layers stand, by the name of the layer: number i in the layer
            ``"geometry"`` stands for the geometry ``names["geometry"][i]``.
        wavelengths_nm: Wavelengths of ``spectra`` [nm], shape (m,); None without spectra.
        spectra: Radiance at the wavelengths, shape (height, width, m), float32, multiplied by ``coverage``: the sum
            over the lights of power · ρ(λ) S(λ) / S̄, with the reflectance ρ, the illuminant S, and its mean S̄ with
            the weight ȳ(λ). For the illuminant ``"E"``, S(λ) / S̄ is 1. None without ``wavelengths_nm=``.

    Examples:
        >>> import warpdiff as wd
        >>> body, grating = wd.meshes.tube(), wd.gratings.sinusoidal(2.0, 0.1)
        >>> light, view = wd.DirectionalLight((0.3, 1.0, 0.8)), wd.View.fit(body, width=32, height=18)
        >>> image = wd.shade(body, grating, light, view, tolerance=0.1)
        >>> image.xyz.shape, image.error.shape
        ((18, 32, 3), (18, 32))
        >>> image.save("tube.png").name
        'tube.png'
    """

    xyz: NDArray[np.float32]
    mask: NDArray[np.bool_]
    illuminated: NDArray[np.bool_]
    coverage: NDArray[np.float32]
    error: NDArray[np.float32]
    plan: Plan | Mapping[str, Plan] | None
    report: Report | None = None
    layers: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    wavelengths_nm: NDArray[np.float64] | None = None
    spectra: NDArray[np.float32] | None = None

    def __repr__(self) -> str:
        height, width = self.mask.shape
        errors = self.error[self.illuminated]
        error = f", estimated error {np.percentile(errors, 99):.2g} at the 99th percentile" if errors.size else ""
        return f"Image({width} × {height} pixels, {100.0 * errors.size / self.mask.size:.0f} % illuminated{error})"

    def _repr_png_(self) -> bytes:
        with io.BytesIO() as file:
            self._as_pillow().save(file, "PNG")
            return file.getvalue()

    def _as_pillow(self) -> PIL.Image.Image:
        """Return the picture as a Pillow image, with the default settings of PNG files."""
        import PIL.Image

        return PIL.Image.fromarray(_quantised(self.display(), 8))

    def show(self) -> None:
        """Show the picture with the default display transform.

        In a Jupyter notebook the picture appears below the cell, otherwise in the system's viewer of PNG files.

        Raises:
            RuntimeError: The system has no viewer.
        """
        ipython = sys.modules.get("IPython")
        if ipython is not None and hasattr(ipython.get_ipython(), "kernel"):
            ipython.display.display(self)
            return
        from PIL import ImageShow

        if not ImageShow.show(self._as_pillow(), title="warpdiff"):
            raise RuntimeError("no viewer of PNG files was found on this system; save the picture by Image.save")

    @property
    @np.errstate(under="ignore")
    def rgb(self) -> NDArray[np.float32]:
        """Linear sRGB, shape (height, width, 3), float32; colours outside the gamut have negative components."""
        return colorimetry.xyz_to_rgb(self.xyz).astype(np.float32)

    @property
    @np.errstate(under="ignore")
    def auto_exposure(self) -> float:
        """Automatic exposure factor of ``display="aces"``; 1 for a black picture.

        The factor scales the mean luminance of the illuminated pixels to 0.7 (for other display transforms to 0.5). The
        brightest 0.01 % of these pixels are excluded, because the mirror reflection of a light may be a thousand times
        as bright as the diffraction orders. A mean is used and not a percentile: diffraction orders may cover between
        0.1 % and all of a picture, so that no percentile suits every picture.
        """
        return display_transform.auto_exposure(self.xyz[..., 1][self.illuminated], "aces")

    @accepts(GamutSettings)
    @np.errstate(under="ignore")
    def display(
        self, display: Display = "aces", *, exposure_from: Image | None = None,
        background: Image | ArrayLike | None = None, exact: bool = True, **settings: Unpack[GamutKeywords],
    ) -> NDArray[np.float32]:  # fmt: skip
        """Transform the picture to display RGB, with the transfer function of sRGB.

        Args:
            display: Display transform. ``"aces"`` is the ACES 2.0 view for standard dynamic range after compression of
                chroma, which shows bright diffraction orders as smooth colour gradients. ``"colorimetric"`` is exact
                for colours within the gamut, reduces the chroma of others at constant hue, and shows everything
                brighter than white as white. ``"clip"`` clips each channel.
            exposure_from: Picture whose automatic exposure is used, so that several pictures get the same exposure.
            background: Background, mixed in the display's linear light: an encoded colour (R, G, B) with components
                from 0 to 1, a picture of the same size, or linear sRGB of shape (height, width, 3), as from
                :meth:`warpdiff.Environment.background`. None leaves the background transparent.
            exact: Whether ACES is computed for each pixel. False interpolates in a table of ACES colours, which is
                several times as fast; the result differs by 0.1 ΔE2000 in the median and by 0.6 ΔE2000 at the 99th
                percentile.

        Returns:
            R, G, B and, without a background, alpha, each 0 to 1, shape (height, width, 3 or 4), float32; colours are
            not multiplied by alpha.

        Raises:
            ValueError: An argument is not accepted.
        """
        validation.flag(exact, "exact")
        shown = DisplaySettings(display=display, **settings)
        return self._displayed(shown, self._exposure(shown, exposure_from), background, exact=exact)

    def _displayed(
        self, shown: DisplaySettings, factor: float, background: Image | ArrayLike | None, *, exact: bool = True
    ) -> NDArray[np.float32]:
        """Return display RGB for a linear exposure factor; the other arguments are those of :meth:`display`."""
        behind = self._behind(background, shown, factor, exact=exact)
        encoded = self._encoded(shown, factor, exact=exact)
        if behind is None:
            return np.concatenate([encoded, self.coverage[..., None]], axis=2, dtype=np.float32)
        result = np.empty(encoded.shape, dtype=np.float32)
        result[...] = colorimetry.srgb_encode(behind)
        whole = self.coverage >= 1.0
        result[whole] = encoded[whole]
        part = ~whole & self.mask
        alpha = self.coverage[part][:, None]
        light = alpha * colorimetry.srgb_decode(encoded[part])
        light += (1.0 - alpha) * (behind if behind.ndim == 1 else behind[part])
        result[part] = colorimetry.srgb_encode(light)
        return result

    def _exposure(self, shown: DisplaySettings, source: Image | None, *, scales: bool = True) -> float:
        """Return the linear exposure factor from the arguments of :meth:`display`.

        Args:
            shown: Options of the display.
            source: Picture whose automatic exposure is used, or None.
            scales: Whether the exposure is automatic if the options state none. If False, the factor is 1 in this case.
        """
        validation.instance(source, Image, "exposure_from", optional=True)
        if shown.exposure is not None and source is not None:
            raise ArgumentValueError(f"{ref('exposure')} and {ref('exposure_from')} exclude each other, got both")
        if shown.exposure is None and source is None and not scales:
            shown = replace(shown, exposure=1.0)
        picture = source or self
        return display_transform.exposure_factor(shown, picture.xyz[..., 1][picture.illuminated])

    def _encoded(self, shown: DisplaySettings, factor: float, *, exact: bool) -> NDArray[np.float64]:
        """Return display RGB with the display's transfer function, not multiplied by alpha; 0 in the background."""
        covered = self.coverage > 0.0
        straight = self.xyz[covered] / self.coverage[covered][:, None].astype(np.float64)
        encoded = np.zeros(self.xyz.shape)
        encoded[covered] = display_transform.encode(factor * straight, shown, exact=exact)
        return encoded

    def _behind(
        self, background: Image | ArrayLike | None, shown: DisplaySettings, factor: float, *, exact: bool
    ) -> NDArray[np.float64] | None:
        """Return ``background`` in the display's linear light, shape (3,) or (height, width, 3); None if it is None."""
        if background is None:
            return None
        height, width = self.mask.shape
        if isinstance(background, Image):
            if background.mask.shape != self.mask.shape:
                raise ArgumentValueError(
                    f"{ref('background')} must be a picture of {width} × {height} pixels, "
                    f"got {background.mask.shape[1]} × {background.mask.shape[0]}"
                )
            encoded = background._encoded(shown, factor, exact=exact)
            return background.coverage[..., None] * colorimetry.srgb_decode(encoded)
        colour = validation.finite_array(background, "background", most=validation.MOST)
        if colour.shape == self.xyz.shape:
            encoded = display_transform.encode(factor * colorimetry.rgb_to_xyz(colour), shown, exact=exact)
            return colorimetry.srgb_decode(encoded)
        if colour.shape != (3,):
            raise ArgumentValueError(
                f"{ref('background')} must be a colour of shape (3,), or radiances of {width} × {height} pixels, "
                f"got shape {colour.shape}"
            )
        if not np.all((colour >= 0.0) & (colour <= 1.0)):
            raise ArgumentValueError(
                f"{ref('background')} must be a colour of components from 0 to 1, got {colour.tolist()}"
            )
        return colorimetry.srgb_decode(colour)

    @accepts(DisplaySettings)
    @np.errstate(under="ignore")
    def save(
        self, path: str | os.PathLike[str], *, exposure_from: Image | None = None,
        background: Image | ArrayLike | None = None, **settings: Unpack[DisplayKeywords],
    ) -> Path:  # fmt: skip
        """Write the picture to a file; an existing file is replaced once the new one is complete.

        Args:
            path: File with the suffix ``.exr`` or ``.png``. EXR holds linear float32 channels, multiplied by alpha: R,
                G, B, A, XYZ.X, XYZ.Y, XYZ.Z, the estimated error as error.Y, and one part per layer of the picture,
                with channels such as normal.X. PNG holds display RGB, not multiplied by alpha, and alpha unless there
                is a background. The metadata of PNG files state the transform and the exposure. The metadata of EXR
                files state how the same call would display the picture as PNG: see
                ``docs/how-to/layers_and_exr_files.md``.
            exposure_from: Picture whose automatic exposure is used, so that several pictures get the same exposure.
            background: Background of PNG files, mixed in the display's linear light: an encoded colour (R, G, B) with
                components from 0 to 1, a picture of the same size, or linear sRGB of shape (height, width, 3). None
                leaves the background transparent.

        Returns:
            The path of the file.

        Raises:
            ValueError: The suffix is not ``.exr`` or ``.png``, or an argument is not accepted.
            OSError: The file cannot be written; an existing file is unchanged.
        """
        target = check_target(path)
        shown = DisplaySettings(**settings)
        if target.suffix.lower() == ".png":
            write_parts(target, [self._png_part(shown, self._exposure(shown, exposure_from), background)])
            return target
        if background is not None:
            raise ArgumentValueError(
                f"{ref('background')} must be None for .exr files, which hold alpha; composite the background yourself"
            )
        if shown.bits != DisplaySettings.bits:
            raise ArgumentValueError(
                f"{ref('bits')} is for .png files, got {shown.bits} for an .exr file, which holds float32: leave it out"
            )
        factor = self._exposure(shown, exposure_from, scales=False)
        write_exr(self, target, shown, factor=factor, preview=self._exposure(shown, exposure_from))
        return target

    def _png_part(self, shown: DisplaySettings, factor: float, background: Image | ArrayLike | None) -> FilePart:
        """Return the picture as the only part of a PNG file; ``factor`` is the linear exposure factor."""
        encoded = self._displayed(shown, factor, background)
        cicp = display_transform.GAMUTS[shown.gamut].cicp
        metadata = self._metadata() | {
            "oiio:UnassociatedAlpha": 1,
            **({"oiio:ColorSpace": "sRGB"} if cicp is None else {"CICP": cicp}),
            "warpdiff:display": f"{display_transform.description(shown)}; exposure {factor:.6g}",
            "warpdiff:exposure": factor,
        }
        channels = ("R", "G", "B", "A")[: encoded.shape[2]]
        return FilePart(channels, _quantised(encoded, shown.bits), metadata=metadata)

    def _exr_parts(self, shown: DisplaySettings, factor: float, preview: float) -> list[FilePart]:
        """Return the parts of an EXR file: colours and errors, then one part per layer.

        The arguments are those of :func:`write_exr`.
        """
        colours = [factor * self.rgb, self.coverage[..., None], factor * self.xyz, self.error[..., None]]
        # Some metadata attributes must be equal in all parts of an EXR file.
        common: dict[str, str | float | tuple[float, ...]] = {
            "compression": "zip",
            # The attribute "DateTime" is set to an empty text. Otherwise OpenImageIO would store the current time, and
            # two files of the same picture would differ.
            "DateTime": "",
            "oiio:ColorSpace": "lin_rec709",
            "chromaticities": display_transform.SRGB_CHROMATICITIES,
        }
        metadata = (
            self._metadata()
            | common
            | {
                "warpdiff:display": f"none, linear; exposure {factor:.6g}",
                "warpdiff:exposure": factor,
                "warpdiff:preview": f"{display_transform.description(shown)}; white point D65; exposure "
                f"{preview / factor:.6g}",
                "warpdiff:preview_display": shown.display,
                "warpdiff:preview_gamut": shown.gamut,
                "warpdiff:preview_exposure": preview / factor,
            }
        )
        channels: tuple[str, ...] = CHANNELS
        if self.spectra is not None and self.wavelengths_nm is not None:
            channels += tuple(spectral_channel(wavelength) for wavelength in self.wavelengths_nm.tolist())
            colours.append(factor * self.spectra)
            metadata |= SPECTRAL_METADATA
        pixels = np.concatenate(colours, axis=2, dtype=np.float32)
        parts = [FilePart(channels, pixels, "picture" if self.layers else "", metadata)]
        for name, values in self.layers.items():
            layer, names = layer_format(name), self.names.get(name)
            suffixes, data = layer.channels, values.reshape(*self.mask.shape, len(layer.channels))
            if layer.is_colour:
                suffixes = ("R", "G", "B", *suffixes)
                data = factor * np.concatenate([colorimetry.xyz_to_rgb(values), data], axis=2)
            parts.append(
                FilePart(
                    tuple(f"{name}.{suffix}" for suffix in suffixes), data.astype(np.float32), name,
                    common if names is None else common | {NAMES: json.dumps(names, ensure_ascii=False)},
                )
            )  # fmt: skip
        return parts

    def _metadata(self) -> dict[str, str | float | tuple[float, ...]]:
        """Return the metadata of every file: program, plan, report, and history of the height field."""
        metadata: dict[str, str | float | tuple[float, ...]] = {"Software": "warpdiff"}
        if self.plan is not None:
            metadata["ImageDescription"] = f"{plan_text(self.plan)}\n\n{self.report}"
        if self.report is not None and self.report.history:
            metadata["warpdiff:history"] = " ".join(self.report.history)
        return metadata

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Image:
        """Read a picture from an EXR file that :meth:`save` wrote.

        Args:
            path: EXR file that :meth:`save` wrote.

        Returns:
            The picture with the values of the file. XYZ includes the exposure factor with which the picture was saved,
            1 by default. ``mask`` is True where ``coverage`` is more than 0. ``illuminated`` is True where XYZ or
            ``error`` is not 0 within the mask. ``plan`` and ``report`` are None, because files do not contain them.

        Raises:
            FileNotFoundError: The file does not exist.
            ValueError: The file is damaged, or was not written by :meth:`save`.
        """
        file = validation.path(path, "path")
        files.check_file(file)
        channels, names = read_exr(file)
        xyz = np.stack([channels[f"XYZ.{component}"] for component in "XYZ"], axis=2)
        coverage, error = channels["A"], channels["error.Y"]
        layers: dict[str, NDArray[Any]] = {}
        for name in dict.fromkeys(filter(None, map(layer_of, channels))):
            layer = layer_format(name)
            planes = [channels[key] for suffix in layer.channels if (key := f"{name}.{suffix}") in channels]
            if len(planes) < len(layer.channels):
                raise ArgumentValueError(
                    f"{ref('path')}: {str(file)!r} lacks channels of the layer {name!r}; save the picture again"
                )
            layers[name] = layer.shaped(np.stack(planes, axis=2), coverage.shape)
        by_wavelength = sorted((nm, name) for name in channels if (nm := wavelength_of(name)) is not None)
        wavelengths = spectra = None
        if by_wavelength:
            wavelengths = np.array([nm for nm, _ in by_wavelength])
            spectra = np.stack([channels[name] for _, name in by_wavelength], axis=2)
        mask = coverage > 0.0
        illuminated = mask & (xyz.any(axis=2) | (error != 0.0))
        return cls(
            xyz, mask, illuminated, coverage, error, plan=None, layers=layers, names=names, wavelengths_nm=wavelengths,
            spectra=spectra,
        )  # fmt: skip


def write_exr(image: Image, target: Path, shown: DisplaySettings, *, factor: float, preview: float) -> None:
    """Write a picture to an EXR file.

    Args:
        image: Picture to write.
        target: File to write, after a check of its path.
        shown: Options of the display, which the metadata of the file state.
        factor: Linear factor by which the colours in the file are multiplied.
        preview: Linear exposure factor with which the options ``shown`` display the picture.
    """
    write_parts(target, image._exr_parts(shown, factor, preview))


def _quantised(encoded: NDArray[np.float32], bits: int) -> NDArray[np.uint8 | np.uint16]:
    """Return display RGB from 0 to 1 as unsigned integers of 8 or 16 bits for a PNG file."""
    return np.asarray(np.round(np.float64(encoded) * (2**bits - 1)), dtype=np.uint8 if bits == 8 else np.uint16)
