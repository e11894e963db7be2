"""Skies and rooms as lights: a picture of all directions, in latitude and longitude."""

from __future__ import annotations

import copy
import functools
import math
from dataclasses import KW_ONLY, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import forks, memory, openimageio, validation
from warpdiff.core.files import check_there
from warpdiff.lights.light_types import MOST_POWER, DirectionalLight, Lobe, PointLight, orthonormal_pair
from warpdiff.lights.sky_maps import SkyMaps, Sun, blurred_grids, extract_suns, linear, maps_of
from warpdiff.optics import colorimetry
from warpdiff.optics.spectra import Spectrum, colour_science
from warpdiff.scene.camera import View

if TYPE_CHECKING:
    import os

    from numpy.typing import ArrayLike, NDArray


# Of radiances: squares of colours are float32.
_MOST_RADIANCE = 1e9
_FEWEST_DIRECTIONS, _MOST_DIRECTIONS = 16, 32_768
# Those of a tolerance of 1: what is left falls about as their number grows.
_DIRECTIONS_AT_ONE = 820.0
_BYTES_PER_PIXEL, _BYTES_SEEN = 24.0, 400.0
_NM = np.arange(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM + 1, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Environment:
    """Light from all directions, by a picture of them in latitude and longitude, +y up.

    The middle column lies at −z and azimuth grows to the right, towards +x; row 0 is +y. A perfect mirror shows the
    picture's own colours. Lights take windows of the kind ``"averaged"``, and footprints.

    Attributes:
        radiance_rgb: Linear sRGB radiance, shape (height, width, 3); negative components count as 0.
        rotation_deg: By so much the environment is turned about +y, counter-clockwise as seen from above [degrees].
        scale: Linear factor.
        directions: A pixel's colour is a sum over so many directions at most, 16 to 32768, of which some two thirds lie
            above its horizon; they are close together near the mirror direction. None is 820 over the picture's
            tolerance.
    """

    radiance_rgb: ArrayLike = field(repr=False)
    _: KW_ONLY
    rotation_deg: float = 0.0
    scale: float = 1.0
    directions: int | None = None

    def __post_init__(self) -> None:
        given = validation.finite_array(self.radiance_rgb, "radiance_rgb", most=_MOST_RADIANCE)
        if given.ndim != 3 or given.shape[2] != 3 or min(given.shape[:2]) < 2:
            raise ValueError(f"radiance_rgb must have shape (height, width, 3), 2 × 2 at least, got {given.shape}")
        radiance = np.maximum(given, 0.0).astype(np.float32)
        if not radiance.any():
            raise ValueError("radiance_rgb must hold light somewhere, got none above 0")
        radiance.setflags(write=False)
        object.__setattr__(self, "radiance_rgb", radiance)
        object.__setattr__(
            self, "rotation_deg", validation.number(self.rotation_deg, "rotation_deg", least=-360.0, most=360.0)
        )
        object.__setattr__(self, "scale", validation.number(self.scale, "scale", least=0.0, most=_MOST_RADIANCE))
        if self.directions is not None:
            count = validation.count(self.directions, "directions", least=_FEWEST_DIRECTIONS)
            if count > _MOST_DIRECTIONS:
                raise ValueError(f"directions must be at most {_MOST_DIRECTIONS}, got {count}")
            object.__setattr__(self, "directions", count)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        rotation_deg: float = 0.0,
        scale: float = 1.0,
        directions: int | None = None,
    ) -> Environment:
        """An environment of an EXR or HDR file in latitude and longitude, of linear sRGB.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: It is no such picture.
        """
        file = validation.path(path, "path")
        check_there(file)
        with openimageio.in_use() as oiio:
            image = oiio.ImageInput.open(str(file))
            if image is None:
                oiio.geterror()
                raise ValueError(f"path: {str(file)!r} cannot be read as an image; give an EXR or HDR file")
            try:
                spec = image.spec()
                if spec.nchannels < 3:
                    raise ValueError(f"path: {str(file)!r} has {spec.nchannels} channels; give one of R, G and B")
                memory.require_memory(
                    _BYTES_PER_PIXEL * spec.width * spec.height, f"path: {str(file)!r} of {spec.width} × {spec.height}",
                    "take {share} of its pixels",
                )  # fmt: skip
                samples = image.read_image(0, 0, 0, 3, "float")
                if samples is None or image.has_error:
                    image.geterror()
                    raise ValueError(f"path: {str(file)!r} is damaged; export the image again")
            finally:
                image.close()
        try:
            return cls(np.asarray(samples), rotation_deg=rotation_deg, scale=scale, directions=directions)
        except ValueError as error:
            raise ValueError(str(error).replace("radiance_rgb", f"path: {str(file)!r}", 1)) from None

    def seen(self, view: View) -> NDArray[np.float32]:
        """What a view sees of it where nothing is before it: linear sRGB, shape (height, width, 3), a ``background=``.

        It is as bright as a perfect mirror shows it. Pictures by ``ior=``, which are relative to what is reflected at
        normal incidence, go with a ``scale`` divided by that.
        """
        validation.instance(view, View, "view")
        memory.require_memory(
            _BYTES_SEEN * view.width * view.height, f"view of {view.width} × {view.height} pixels",
            "take {share} of its pixels",
        )  # fmt: skip
        frame = view.frame()
        x = frame.half_width * (2.0 * (np.arange(view.width) + 0.5) / view.width - 1.0)
        y = frame.half_height * (1.0 - 2.0 * (np.arange(view.height) + 0.5) / view.height)
        across = x[None, :, None] * frame.right + y[:, None, None] * frame.up
        radiance = np.asarray(self.radiance_rgb, dtype=np.float64)
        along = -frame.back + (0.0 if frame.orthographic else 1.0) * across
        return np.asarray(self.scale * linear(radiance, along, math.radians(self.rotation_deg)), dtype=np.float32)

    @forks.cached_property
    def _maps(self) -> tuple[NDArray[np.float32], tuple[int, ...], float, list[Sun]]:
        """Texels, sides and the first blur of a :class:`SkyLight`, but for its scale, and suns.

        They take a second, and do not depend on how the environment is turned.
        """
        grid, suns = extract_suns(np.asarray(self.radiance_rgb))
        return *maps_of(blurred_grids(grid)), suns


def rotated(environment: Environment, rotation_deg: float, scale: float, directions: int | None) -> Environment:
    """The same radiances, otherwise turned, scaled and summed: what takes long is done once."""
    result = copy.copy(environment)
    vars(result).update(rotation_deg=rotation_deg, scale=scale, directions=directions, _maps=environment._maps)
    return result


Light = DirectionalLight | PointLight | Environment


def lobes_of_sky(environment: Environment, sigma_um: float, tolerance: float) -> list[Lobe]:
    """An environment as lights of windows of a deviation, for pictures of a tolerance: the sky, and its suns.

    Of radiance L from a solid angle dω comes ρ L dω 4πσ²/λ² (the absolute reflectance over ρ), so that L/λ² is what
    a directional light's illuminant is. Spectra are those of the RGB under D65 by Mallett and Yuksel's functions
    (Spectral Primary Decomposition for Rendering with sRGB Reflectance, 2019).
    """
    chosen = min(round(_DIRECTIONS_AT_ONE / tolerance), _MOST_DIRECTIONS)
    texels, sides, blur, suns = environment._maps
    (red, green, blue), per_radiance = _spectra()
    of_luminance = per_radiance.sum() / colorimetry.RGB_TO_XYZ[1].sum()
    scale = environment.scale * 4.0 * math.pi * sigma_um**2
    powers = texels * (scale * np.append(per_radiance, of_luminance))
    powers_of_suns = [scale * float(sun.rgb @ per_radiance) for sun in suns]
    strongest = max([4.0 * math.pi * float(powers[:, :3].max()), *powers_of_suns])
    if strongest > MOST_POWER:
        raise ValueError(
            f"light: radiance_rgb times scale of an Environment is too bright: it has a power of up to "
            f"{strongest:g}, and {MOST_POWER:g} is the most; give a smaller scale"
        )
    count = environment.directions or chosen
    turn = math.radians(environment.rotation_deg)
    sky = SkyMaps((red, green, blue), powers.astype(np.float32), sides, blur, turn, count)
    result = [Lobe((0.0, 1.0, 0.0), green, 1.0, sky=sky)]
    for sun, power in zip(suns, powers_of_suns, strict=True):
        x, y, z = (float(each) for each in sun.towards)
        towards = math.cos(turn) * x + math.sin(turn) * z, y, math.cos(turn) * z - math.sin(turn) * x
        values = sum(float(c) * np.asarray(each.values) for c, each in zip(sun.rgb, (red, green, blue), strict=True))
        illuminant = Spectrum(_NM, np.asarray(values) / sun.rgb.max(), name="a sun of the environment")
        result.append(Lobe(towards, illuminant, power, sun.deviation * orthonormal_pair(np.asarray(towards))))
    return result


@functools.cache
def _spectra() -> tuple[tuple[Spectrum, Spectrum, Spectrum], NDArray[np.float64]]:
    """The illuminants L/λ² of red, green and blue light, and ∫ L ȳ/λ² dλ [1/µm²] of radiances of 1 in linear sRGB."""
    colour: Any = colour_science()
    shape = colour.SpectralShape(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM, 1)
    basis = np.maximum(colour.recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019.copy().align(shape).values, 0.0)
    per_square = 1e6 / _NM**2
    bright = colorimetry.colour_products("D65")[:, 1]
    white = colour.SDS_ILLUMINANTS["D65"].copy().align(shape).values
    red, green, blue = (Spectrum(_NM, each * white * per_square, name="environment") for each in basis.T)
    per_radiance = colorimetry.RGB_TO_XYZ[1] * ((bright * per_square) @ basis) / (bright @ basis)
    return (red, green, blue), per_radiance
