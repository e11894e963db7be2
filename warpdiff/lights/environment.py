"""Environments: lights from all directions, such as skies and interiors, from a latitude-longitude image."""

from __future__ import annotations

import copy
import functools
import math
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from annotated_types import Interval, Unit

from warpdiff.core import files, forks, memory, openimageio, validation
from warpdiff.core.caching import LruCache
from warpdiff.core.options import Checked
from warpdiff.core.read_only import ReadOnlyArrays
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.lights.base import MOST_POWER, Light, LightPart, Lobe, LobeSet, orthonormal_pair
from warpdiff.lights.clear_sky import SUN_AZIMUTH, clear_sky_radiance
from warpdiff.lights.sky_grid import SkyGrid, Sun, extract_suns, sample_grid
from warpdiff.optics import colorimetry
from warpdiff.optics.colorimetry import VISIBLE_NM
from warpdiff.optics.spectra import Spectrum, colour_science
from warpdiff.request.signatures import checked
from warpdiff.scene.camera import View

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.lights.light_pass import LightPass, PassContext
    from warpdiff.optics.coherence import Coherence


# Largest radiance, linear sRGB. The value is limited by kernels, which square colours in float32; float32 ends at 3e38.
_MOST_RADIANCE = 1e9
# Names of the accepted formats in OpenImageIO.
_FORMATS = ("openexr", "hdr")
# Range of the option ``directions``. It is limited because fewer directions show noise, and because time is
# proportional to the number of directions.
_FEWEST_DIRECTIONS, _MOST_DIRECTIONS = 16, 32_768
# Number of directions per pixel in pictures with ``refine=False``. The value was chosen so that the noise of such
# pictures is about 7 %; time is proportional to it.
_DEFAULT_DIRECTIONS = 64
# Approximate memory per pixel [bytes] that is required to load an image, and to compute a background. If the numbers
# are doubled, images that would fit into memory are refused with a ``MemoryError``.
_BYTES_PER_PIXEL, _BYTES_OF_BACKGROUND = 24.0, 400.0
# Largest linear factor of the sun of a clear sky. The value was chosen so that the sun's radiance remains below the
# largest radiance.
_MOST_SUN = 1e3
# An environment caches its sky and suns for each coherence window and number of directions with which it is used. This
# is the largest number of cached versions. It is limited by memory: a version uses 6 MB on the host and 7 MB on the
# device.
_MOST_PARTS = 4


@dataclass(frozen=True, eq=False, repr=False)
class Environment(ReadOnlyArrays, Checked, Light):
    """Light from all directions, described by a latitude-longitude image, with +y up.

    The middle column points towards −z, and azimuth increases to the right, towards +x; the first row is at +y. A
    perfect mirror shows the colours of the image unchanged. Environments require a coherence window of the kind
    ``"averaged"``, and pictures whose pixels show means over footprints.

    Attributes:
        radiance_rgb: Linear sRGB radiance, shape (height, width, 3), up to 1e9; negative components count as 0.
        rotation_deg: Rotation about +y, counter-clockwise from above.
        scale: Linear factor of the radiance.
        directions: Number of random directions per pixel in pictures with ``refine=False``; None is 64. In refined
            pictures, the tolerance determines the number of directions.

    Examples:
        >>> import warpdiff as wd
        >>> import numpy as np
        >>> wd.Environment(np.ones((16, 32, 3)), scale=0.5)
        Environment(16 × 32 pixels, rotation_deg=0, scale=0.5, directions=None)
    """

    radiance_rgb: ArrayLike
    _: KW_ONLY
    rotation_deg: Annotated[float, Interval(ge=-360.0, le=360.0), Unit("°")] = 0.0
    scale: Annotated[float, Interval(ge=0.0, le=_MOST_RADIANCE)] = 1.0
    directions: Annotated[int, Interval(ge=_FEWEST_DIRECTIONS, le=_MOST_DIRECTIONS)] | None = None

    def __post_init__(self) -> None:
        radiance = validation.finite_array(self.radiance_rgb, "radiance_rgb", most=_MOST_RADIANCE)
        if radiance.ndim != 3 or radiance.shape[2] != 3 or min(radiance.shape[:2]) < 2:
            raise ArgumentValueError(
                f"{ref('radiance_rgb')} must have shape (height, width, 3), at least 2 × 2, got {radiance.shape}"
            )
        radiance = np.maximum(radiance, 0.0).astype(np.float32)
        if not radiance.any():
            raise ArgumentValueError(f"{ref('radiance_rgb')} must have a component above 0, got none")
        radiance.setflags(write=False)
        object.__setattr__(self, "radiance_rgb", radiance)
        super().__post_init__()

    def __repr__(self) -> str:
        height, width = np.shape(self.radiance_rgb)[:2]
        return (
            f"Environment({height} × {width} pixels, rotation_deg={self.rotation_deg:g}, scale={self.scale:g}, "
            f"directions={self.directions})"
        )

    def __getstate__(self) -> dict[str, Any]:
        # The cache ``_parts`` is neither copied nor pickled, because it contains arrays on a device, which belong to
        # this process.
        return {name: value for name, value in vars(self).items() if name != "_parts"}

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], *, rotation_deg: float = 0.0, scale: float = 1.0,
        directions: int | None = None,
    ) -> Environment:  # fmt: skip
        r"""Load an environment from an EXR or HDR file in linear sRGB.

        Args:
            path: Latitude-longitude image.
            rotation_deg: Rotation about +y, counter-clockwise from above [degrees], −360 to 360.
            scale: Linear factor of the radiance, 0 to 1e9.
            directions: Number of random directions per pixel in pictures with ``refine=False``, 16 to 32768; None is
                64.

        Raises:
            FileNotFoundError: The file does not exist.
            ValueError: The file is damaged, is not an EXR or HDR image, or has fewer than three channels.

        Examples:
            >>> import pathlib, tempfile
            >>> import warpdiff as wd
            >>> grey = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n" + 8 * bytes([128, 128, 128, 129])
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     path = pathlib.Path(folder, "grey.hdr")
            ...     _ = path.write_bytes(grey)
            ...     wd.Environment.load(path, scale=0.5)
            Environment(2 × 4 pixels, rotation_deg=0, scale=0.5, directions=None)
        """
        file = validation.path(path, "path")
        files.check_file(file)
        with openimageio.in_use() as oiio:
            image = openimageio.opened(oiio, file, _FORMATS)
            if image is None:
                openimageio.error_text(oiio)
                raise ArgumentValueError(
                    f"{ref('path')}: {str(file)!r} cannot be read as an image; give an EXR or HDR file"
                )
            try:
                spec = image.spec()
                if spec.nchannels < 3:
                    raise ArgumentValueError(
                        f"{ref('path')}: {str(file)!r} has {spec.nchannels} channel(s); give an image with R, G and B"
                    )
                memory.require_memory(
                    _BYTES_PER_PIXEL * spec.width * spec.height, f"path: {str(file)!r} of {spec.width} × {spec.height}",
                    "take {share} of its pixels",
                )  # fmt: skip
                samples = image.read_image(0, 0, 0, 3, "float")
                if samples is None or image.has_error:
                    openimageio.error_text(image)
                    raise ArgumentValueError(f"{ref('path')}: {str(file)!r} is damaged; export the image again")
            finally:
                image.close()
        with files.holding("radiance_rgb", file):
            return cls(np.asarray(samples), rotation_deg=rotation_deg, scale=scale, directions=directions)

    @classmethod
    @checked
    def clear_sky(
        cls, sun_direction: ArrayLike, *, sun: Annotated[float, Interval(ge=0.0, le=_MOST_SUN)] = 1.0,
        ground_albedo: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.2, scale: float = 1.0,
        directions: int | None = None,
    ) -> Environment:  # fmt: skip
        """Make a clear sky with a sun of 0.53° in diameter over diffuse ground, from formulas, without a file.

        The sky is type 12 of the CIE standard general sky (CIE S 011, ISO 15469), in the colour of daylight of 15,000
        K. The sun has the colour of daylight of 5,500 K. Without the sun, the illuminance of the sky on the horizontal
        is π, so that white paper that faces up has a luminance of 1. For a sun at the altitude h, the illuminance of
        the sun, normal to its direction, divided by the illuminance of the sky is
        127.5 exp(−0.21 / sin h) / (0.8 + 15.5 √sin h) (IES, 1984). This ratio is 6.8 at 45° and 0.5 at 3°. The sun's
        disc has a luminance of 320,000 at 45°, relative to the white paper. The sun's azimuth is in ``rotation_deg`` of
        the result::

            body, sky = wd.meshes.snake(), wd.Environment.clear_sky((1.0, 0.8, 0.3))
            view = wd.View.fit(body, width=480, height=260)
            image = wd.shade(body, wd.gratings.fingers(), sky, view, ior=math.inf, refine=False)
            image.save("outdoors.png", background=sky.background(view))

        Args:
            sun_direction: Direction towards the sun, above the horizon, +y up, shape (3,), of any length.
            sun: Linear factor of the sun; 0 is a sky without a sun.
            ground_albedo: Fraction of the light of sky and sun that the ground reflects.
            scale: Linear factor of the radiance, 0 to 1e9.
            directions: Number of random directions per pixel in pictures with ``refine=False``, 16 to 32768; None is
                64.

        Raises:
            ValueError: An argument is not accepted, or the sun is not above the horizon.

        Examples:
            >>> import warpdiff as wd
            >>> wd.Environment.clear_sky((1.0, 0.8, 0.3))
            Environment(512 × 1024 pixels, rotation_deg=-106.523, scale=1, directions=None)
        """
        towards = validation.unit_directions(validation.vector(sun_direction, "sun_direction"), "sun_direction")[0][0]
        x, y, z = towards.tolist()
        if y <= 0.0:
            raise ArgumentValueError(
                f"{ref('sun_direction')} must be above the horizon, with a y above 0, got {(x, y, z)}; raise the sun"
            )
        # The altitude is rounded to 1e-6 rad. Otherwise suns that differ only in azimuth would have spectra that differ
        # by rounding, and each sun would need a colour table of its own.
        altitude = max(round(math.atan2(y, math.hypot(x, z)), 6), 1e-6)
        radiance = clear_sky_radiance(altitude, sun, ground_albedo)
        turn = math.remainder(SUN_AZIMUTH - math.atan2(x, -z), 2.0 * math.pi)
        return cls(radiance, rotation_deg=math.degrees(turn), scale=scale, directions=directions)

    def background(self, view: View) -> NDArray[np.float32]:
        """Return the environment behind the mesh, as visible through a camera, for ``Image.save(background=)``.

        The background is as bright as its reflection in a perfect mirror. Pictures with ``ior=`` are relative to the
        reflectance at normal incidence: divide the background by that reflectance.

        Args:
            view: Camera through which the environment is visible.

        Returns:
            Linear sRGB, shape (height, width, 3).
        """
        validation.instance(view, View, "view")
        memory.require_memory(
            _BYTES_OF_BACKGROUND * view.width * view.height, f"view of {view.width} × {view.height} pixels",
            "take {share} of its pixels",
        )  # fmt: skip
        frame = view.frame()
        x = frame.half_width * (2.0 * (np.arange(view.width) + 0.5) / view.width - 1.0)
        y = frame.half_height * (1.0 - 2.0 * (np.arange(view.height) + 0.5) / view.height)
        across = x[None, :, None] * frame.right + y[:, None, None] * frame.up
        radiance = np.asarray(self.radiance_rgb, dtype=np.float64)
        along = -frame.back + (0.0 if frame.orthographic else 1.0) * across
        return np.asarray(self.scale * sample_grid(radiance, along, math.radians(self.rotation_deg)), dtype=np.float32)

    @forks.cached_property
    def _grid(self) -> tuple[NDArray[np.float32], list[Sun]]:
        """Radiances of the sky without its suns on the latitude-longitude grid, and the suns.

        Environments that differ only in rotation or scale share these values. The values do not depend on the coherence
        window.
        """
        grid, suns = extract_suns(np.asarray(self.radiance_rgb))
        return grid.astype(np.float32), suns

    @forks.cached_property
    def _parts(self) -> LruCache[tuple[LightPart, ...]]:
        """Cache of the environment's parts, its sky and its suns, by coherence window and number of directions."""
        return LruCache(most=_MOST_PARTS)

    def parts(self, coherence: Coherence, *, single_lobe: bool, name: str) -> Sequence[LightPart]:  # noqa: ARG002 (of discs)
        """Return the sky and the suns, from a cache; :class:`warpdiff.lights.base.Light` describes the arguments."""
        if coherence.kind != "averaged" or coherence.sigma_um is None:
            raise ArgumentValueError(
                f"{ref(name)} must not be an Environment for {ref('coherence')} of kind {coherence.kind!r}; use an "
                "averaged window"
            )
        count = self.directions or _DEFAULT_DIRECTIONS
        make = functools.partial(_make_parts, self, coherence.sigma_um, count)
        return self._parts.get_or_make((coherence.sigma_um, count), make)


def with_settings(environment: Environment, rotation_deg: float, scale: float, directions: int | None) -> Environment:
    """Return a copy of an environment with other, already checked settings; both share their radiances."""
    result = copy.copy(environment)
    vars(result).update(rotation_deg=rotation_deg, scale=scale, directions=directions, _grid=environment._grid)
    return result


@dataclass(frozen=True, eq=False)
class SkyPart(LightPart):
    """Sky of an environment, without its suns; it illuminates from the whole hemisphere.

    Attributes:
        grid: Grid with the powers of the sky by direction.
    """

    grid: SkyGrid
    has_lobes = False
    has_extent = True

    def __post_init__(self) -> None:
        # The fields of a frozen dataclass cannot be assigned. The attributes that are computed from the grid of the sky
        # are therefore set through ``vars``.
        vars(self).update(spectra=self.grid.spectra, sample_count=self.grid.directions)

    def make_pass(self, context: PassContext) -> LightPass:
        """Return the pass that draws random directions to the sky."""
        from warpdiff.lights.sky_pass import SkyPass

        return SkyPass(self.grid, context)


def _make_parts(environment: Environment, sigma_um: float, directions: int) -> tuple[LightPart, ...]:
    """Return the sky and the suns as parts of a light, with powers for a coherence window.

    ``sigma_um`` is the standard deviation of the window, written σ here, and λ is the wavelength.

    Spectral radiance L(λ) of the sky in a solid angle dω adds ρ L dω 4πσ²/λ² to the reflected radiance. Here 4πσ²/λ²
    converts the relative reflectance ρ to an absolute BRDF. The spectrum L/λ² is therefore used like the illuminant of
    a directional light. Spectra of RGB colours under D65 are sums of basis functions (Mallett and Yuksel, Spectral
    Primary Decomposition for Rendering with sRGB Reflectance, 2019).
    """
    grid, suns = environment._grid
    primaries, per_radiance = _spectra()
    scale = environment.scale * 4.0 * math.pi * sigma_um**2
    powers = grid * (scale * per_radiance).astype(np.float32)
    powers_of_suns = [scale * float(sun.rgb @ per_radiance) for sun in suns]
    strongest = max([4.0 * math.pi * float(powers.max()), *powers_of_suns])
    if strongest > MOST_POWER:
        raise ArgumentValueError(
            f"{ref('lights')}: an Environment has a power of {strongest:g}, and must have at most {MOST_POWER:g}; give "
            f"a smaller {ref('scale')}"
        )
    turn = math.radians(environment.rotation_deg)
    result: list[LightPart] = [SkyPart(SkyGrid(primaries, powers, turn, directions))]
    for sun, power in zip(suns, powers_of_suns, strict=True):
        x, y, z = sun.towards.tolist()
        to_light = math.cos(turn) * x + math.sin(turn) * z, y, math.cos(turn) * z - math.sin(turn) * x
        values = sum(float(c) * np.asarray(primary.values) for c, primary in zip(sun.rgb, primaries, strict=True))
        illuminant = Spectrum(VISIBLE_NM, np.asarray(values) / sun.rgb.max(), name="a sun of the environment")
        deviations = sun.deviation * orthonormal_pair(np.asarray(to_light))
        result.append(LobeSet((Lobe(to_light, illuminant, power, deviations, is_of_sky=True),)))
    return tuple(result)


@functools.cache
def _spectra() -> tuple[tuple[Spectrum, Spectrum, Spectrum], NDArray[np.float64]]:
    """Return the spectra L/λ² of red, green and blue light of the sRGB primaries, and the power of each, shape (3,).

    L(λ) is the spectral radiance of a primary under D65, λ the wavelength [µm], and ȳ the luminous efficiency. The
    power is ∫ L ȳ/λ² dλ [1/µm²], for L with a scale such that ∫ L ȳ dλ is the luminance of the primary. The luminances
    of the three primaries add up to 1.
    """
    colour: Any = colour_science()
    shape = colour.SpectralShape(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM, 1)
    basis = np.maximum(colour.recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019.copy().align(shape).values, 0.0)
    per_square = 1e6 / VISIBLE_NM**2
    bright = colorimetry.colour_products("D65")[:, 1]
    white = colour.SDS_ILLUMINANTS["D65"].copy().align(shape).values
    red, green, blue = (Spectrum(VISIBLE_NM, primary * white * per_square, name="environment") for primary in basis.T)
    per_radiance = colorimetry.RGB_TO_XYZ[1] * ((bright * per_square) @ basis) / (bright @ basis)
    return (red, green, blue), per_radiance
