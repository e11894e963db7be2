"""``bake``: computes the smallest table of a height field's colours that meets a colour difference.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal. Rings are circles of constant |(u, v)| in the polar grid
of a table, and nodes are the samples on the rings.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import warp as wp
from annotated_types import Ge, Interval

from warpdiff.baked import quantisation
from warpdiff.baked.interpolation import grid_for, spline_coefficients
from warpdiff.baked.lobe_table import LARGEST_KAPPA, LARGEST_W, MOST_W_BASIS, BakedLobes
from warpdiff.core import memory
from warpdiff.core.progress import Progress, reporter
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ToleranceError, ref
from warpdiff.diffraction import chebyshev
from warpdiff.optics import colorimetry, reflectance_factors
from warpdiff.optics.materials import reflectance_table
from warpdiff.planner.strategy import directions_of, plan_for
from warpdiff.request.directions import hemisphere_pairs
from warpdiff.request.evaluation import Evaluation
from warpdiff.request.settings import PlanSettings
from warpdiff.request.signatures import checked
from warpdiff.tables.lookup import ColourLookup
from warpdiff.tables.zeroth_order import ZerothOrder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import Material
    from warpdiff.optics.spectra import Spectrum

# Sizes of baked tables in ascending order. A table is a polar grid over (u, v). A size is a pair: the number of rings
# (circles) per doubling of the radius |(u, v)|, and the number of azimuth samples per standard deviation of a lobe,
# which is the peak of a diffraction order over (u, v).
_TABLE_SIZES = ((8, 0.7), (12, 0.8), (16, 0.9), (24, 1.0), (32, 1.2), (48, 1.5), (64, 1.8))
# The grid of a table must resolve lobes (the peaks of diffraction orders over (u, v)) at this wavelength [µm]. Lobes of
# shorter wavelengths are narrower, but contribute little to the visible colour.
_BLUE_UM = 0.43
# A table stores colours as sums of products: a coefficient for (u, v) times a function of w, the normal component of
# the scattering vector. `_FUNCTIONS_SHARE` is the share of the accepted ΔE2000 that the limited number of functions may
# cause. `_RELATIVE_ERROR` is the relative tolerance of the sampled colours XYZ, per unit of the accepted ΔE2000. If it
# is doubled, the errors of these colours cause a larger share of the ΔE2000.
_FUNCTIONS_SHARE, _RELATIVE_ERROR = 0.6, 5e-3
# `_LOOK_UPS` is the typical number of colours that are computed to make a table. `_MOST_S` is the longest accepted time
# for these colours [s on one core]. The time is estimated, and estimates are too long: with a light source of 2° and a
# patch of 12.8 µm, 83 s were estimated and 25 s measured.
_LOOK_UPS, _MOST_S = 3e6, 300.0
# Smallest |w| at which colours are sampled, where w is the component of the scattering vector along the normal. If |w|
# is smaller, light and view are both near the horizon. Such colours are proportional to w² and need no samples.
_SMALLEST_W = 0.06
# A baked table stores functions as equally spaced samples. `_ENTRIES_OF_W` is the number of samples of each function of
# |w|, where w is the normal component of the scattering vector. `_ENTRIES_OF_KAPPA` is that of the power of the zeroth
# order as a function of |κ| = |w|/λ.
_ENTRIES_OF_W, _ENTRIES_OF_KAPPA = 256, 512
# Grid on which the reflectance R(θd, λ) of a material is stored, where θd is half of the angle between the directions
# to the light (ωi) and to the viewer (ωr): number of samples over cos θd, and spacing of the wavelengths [nm].
_ANGLES, _EACH_NM = 65, 5
# The error of a table is measured in validation directions, pairs of a direction to the light and one to the viewer.
# One half of them is uniformly distributed; the other half has bright colours. `_VALIDATION_SIZE` is the size of each
# half. `_CANDIDATES` is the number of random pairs from which both halves are selected, and `_SEED` is the random seed.
_VALIDATION_SIZE, _CANDIDATES, _SEED = 2048, 32_768, 27
# Before the ΔE2000 of a colour is computed, the colour is scaled to the luminance Y = `_SHOWN`. Colours whose luminance
# is below a limit, `_FLOOR` times the reference luminance (about that of the brightest colours), are multiplied by the
# same factor as colours at the limit, so that they remain dark.
_SHOWN, _FLOOR = 0.2, 1e-3
# Measured peak memory while a table of baked lobes is computed [bytes per sample of its polar grid over (u, v)].
_BYTES_A_NODE = 170
# Largest height range of a height field that can be baked [µm]. For larger height ranges, the powers of Fourier
# coefficients oscillate so fast as functions of w that their samples require more than a minute.
_MOST_HEIGHT_UM = 12.0


@checked
def bake(
    heightfield: HeightField, *, illuminant: str | Spectrum = "D65", material: Material | None = None,
    delta_e: Annotated[float, Interval(ge=0.2, le=20.0)] = 2.0, coherence: Coherence | None = None, strict: bool = True,
    device: Any = None, threads: Annotated[int, Ge(1)] | None = None, progress: Progress = None,
) -> BakedLobes:  # fmt: skip
    """Bake the colours of all directions into the smallest table that meets a colour difference.

    Web pages and other renderers can use the table without the height field and without this library.

    Args:
        heightfield: Height field whose colours are baked.
        illuminant: Name of a CIE illuminant or of a light source of colour-science, or a ``Spectrum``.
        material: Opaque material, such as a metal, whose reflectance is baked in; None leaves the reflectance to the
            index of refraction of the renderer.
        delta_e: Accepted ΔE2000 at the 99th percentile of the directions. Before the comparison, a colour is scaled to
            Y = 0.2 if its luminance is at least a thousandth of the reference luminance. All darker colours are scaled
            by the factor that scales this limit to 0.2, so that they remain darker. The reference luminance is about
            that of the brightest directions.
        coherence: Averaged window or source; None is an averaged window of σ = 16.25 µm.
        strict: Whether a colour difference that the largest table does not meet raises ``ToleranceError``; otherwise it
            is a warning.
        device: Warp device, ``"cpu"`` or ``"cuda"``; None is the CPU.
        threads: Threads on the CPU; None is one per core.
        progress: Function that is called with the finished share, 0 to 1; True shows a progress bar.

    Returns:
        Table with its measured error.

    Raises:
        ValueError: An argument is out of its range, the coherence is neither an averaged window nor a source, or the
            material is transparent.
        ToleranceError: The colour difference cannot be met, and ``strict`` is True.
        MemoryError: The table requires more memory than is free.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
        >>> lobes = wd.bake(grating, delta_e=20.0, coherence=wd.Coherence(sigma_um=2.0))
        >>> lobes.reflectance((0, 0, 1), (0.0, 0.0, 1.0)).round(2)
        array([0.48, 0.49, 0.36], dtype=float32)
    """
    settings = PlanSettings(
        tolerance=min(_RELATIVE_ERROR * delta_e, 0.1), coherence=coherence, material=material, strict=strict,
        device=device, threads=threads,
    )  # fmt: skip
    evaluation = Evaluation.of(heightfield, settings, illuminants=(illuminant,))
    if material is not None and not material.is_opaque:
        raise ArgumentValueError(
            f"{ref('material')} must be opaque, got {material}: leave it out, and set the index of refraction where "
            "the lobes are rendered, for web pages by ior= or --ior"
        )
    if not evaluation.coherence.adds_powers:
        raise ArgumentValueError(
            f"{ref('coherence')} must be of kind 'averaged' or 'source', whose powers add, got "
            f"{evaluation.coherence.kind!r}"
        )
    if heightfield.height_range_um > _MOST_HEIGHT_UM:
        raise ArgumentValueError(
            f"{ref('heightfield')} must have a height range of at most {_MOST_HEIGHT_UM:g} µm to be baked, got "
            f"{heightfield.height_range_um:.3g} µm: crop it"
        )
    with memory.as_memory_error("bake()", f"take a larger {ref('delta_e')}, or a smaller {ref('sigma_um')}"):
        return _Bakery(evaluation, illuminant, delta_e).baked(reporter(progress, "bake") or (lambda _: None))


class _Bakery:
    """Computation of baked tables for one height field, with their errors in validation directions."""

    def __init__(self, evaluation: Evaluation, illuminant: str | Spectrum, tolerance: float) -> None:
        self._evaluation, self._illuminant, self._tolerance = evaluation, illuminant, tolerance
        direction_range, sample, _ = directions_of(evaluation)
        plan = plan_for(evaluation, direction_range, sample, _LOOK_UPS)
        seconds = 1e-6 * plan.microseconds * _LOOK_UPS
        if seconds > _MOST_S:
            raise ArgumentValueError(
                f"{ref('coherence')} must be shorter to be baked: a colour with the {evaluation.coherence} requires "
                f"{plan.wavelengths:,} wavelengths, about {seconds:,.0f} s on one core in all"
            )
        self._lookup = ColourLookup(
            evaluation.heightfield, plan, direction_range, zeroth_order=False, device=evaluation.device,
            threads=evaluation.threads,
        )  # fmt: skip
        self._validation_set, self._gains, self._reference, self._bright = self._sampled(_SEED)
        # Colours are sampled at Chebyshev nodes over |w|. The powers of the Fourier coefficients oscillate as functions
        # of w. The number of nodes is computed from the phase of these oscillations at the shortest wavelength, plus a
        # margin that convergence requires.
        phase = math.pi * LARGEST_KAPPA * evaluation.heightfield.height_range_um
        self._ws = chebyshev.nodes(_SMALLEST_W, LARGEST_W, math.ceil(phase + 4.0 * phase ** (1.0 / 3.0) + 4.0))

    def baked(self, progress: Callable[[float], None]) -> BakedLobes:
        """Return the smallest table of colours whose error is within the accepted ΔE2000.

        If no table is that accurate, the function raises an error, or returns the largest table with a warning.
        """
        for result in self._tables(progress):
            if result.error <= self._tolerance:
                break
        progress(1.0)
        if result.error > self._tolerance:
            message = (
                f"{ref('delta_e', self._tolerance)} cannot be met: the largest table reaches {result.error:.2g}; use a "
                f"larger {ref('delta_e')}"
            )
            if self._evaluation.strict:
                raise ToleranceError(f"{message}; {ref('strict', False)} bakes it anyway")
            warn(message)
        return result

    def _tables(self, progress: Callable[[float], None]) -> Iterator[BakedLobes]:
        """Yield baked tables of all sizes, from the smallest to the largest, each with its measured error."""
        principal, evaluation = self._functions(), self._evaluation
        coherence, material = evaluation.coherence, evaluation.illuminated[0].material
        zeroth = ZerothOrder.of_heights(evaluation.heightfield, coherence, (0.0, LARGEST_KAPPA), _ENTRIES_OF_KAPPA)
        width = math.sqrt(zeroth.lobe_variance(_BLUE_UM))
        reflectances = None if material is None else reflectance_table(material, _ANGLES)[:, ::_EACH_NM].copy()
        functions = self._between_nodes(np.linspace(0.0, LARGEST_W, _ENTRIES_OF_W)) @ principal
        for index, (rings, azimuths_per_width) in enumerate(_TABLE_SIZES):
            grid = grid_for(width, rings, azimuths_per_width)
            memory.require_memory(
                _BYTES_A_NODE * grid.nodes, f"a table of {grid.nodes} nodes",
                f"use a larger {ref('delta_e')}, or a smaller {ref('sigma_um')}",
            )  # fmt: skip
            uv, values = grid.places(), np.zeros((grid.nodes, 3, principal.shape[1]), dtype=np.float32)
            for done, (w, row) in enumerate(zip(self._ws, principal, strict=True), start=1):
                values += self._at(uv, w)[:, :, None].astype(np.float32) * row.astype(np.float32)
                progress((index + done / len(self._ws)) / len(_TABLE_SIZES))
            coefficients = spline_coefficients(grid, values)
            for dtype in (np.int8, np.int16):
                table = BakedLobes(
                    coherence, self._illuminant, self._tolerance, 0.0, grid, functions.astype(np.float32),
                    *quantisation.quantise(coefficients, dtype), zeroth.power, reflectances,
                )  # fmt: skip
                yield replace(table, error=self._error(table.colours(self._validation_set, zeroth_order=False)))

    def _sampled(self, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]:
        """Sample pairs of directions to light and viewer: half of them uniform on the hemisphere, half of them bright.

        Returns:
            Scattering vectors, geometry factors and XYZ of the pairs; and the reference luminance. The reference
            luminance is the larger one of two: the 99th percentile of the luminances, and their luminance-weighted
            median.
        """
        lights, views = hemisphere_pairs(_CANDIDATES, seed)
        gains = reflectance_factors.gain(lights, views, normal=self._evaluation.normal_reflectance, masking=True)
        scattering_vectors = -lights - views
        colours = self._colours(scattering_vectors)
        luminance = gains * np.maximum(colours[:, 1], 0.0)
        order = np.argsort(luminance)
        shares = np.cumsum(luminance[order])
        half = luminance[order][np.searchsorted(shares, 0.5 * shares[-1])]
        weights = luminance + _FLOOR * luminance.mean() + 1e-300
        weights[:_VALIDATION_SIZE] = 0.0
        weights /= weights.sum()
        bright = np.random.default_rng(seed).choice(_CANDIDATES, _VALIDATION_SIZE, replace=False, p=weights)
        places = np.concatenate([np.arange(_VALIDATION_SIZE), bright])
        level = max(float(np.percentile(luminance, 99.0)), float(half))
        return scattering_vectors[places], gains[places], colours[places], level

    def _colours(self, scattering_vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return XYZ of scattering vectors, without zeroth order and for geometry factors of 1, shape (n, 3)."""
        count = len(scattering_vectors)
        above = np.tile(np.array([0.0, 0.0, 1.0], dtype=np.float32), (count, 1))
        xyz = wp.zeros(count, dtype=wp.vec3f, device=self._evaluation.device)
        self._lookup.accumulate(
            wp.array(scattering_vectors, dtype=wp.vec3d, device=self._evaluation.device),
            wp.array(above, dtype=wp.vec3f, device=self._evaluation.device),
            wp.ones(count, dtype=wp.float32, device=self._evaluation.device), self._evaluation.illuminated[0], xyz,
        )  # fmt: skip
        return np.asarray(xyz.numpy().astype(np.float64))

    def _between_nodes(self, w: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return weights that interpolate functions of |w| from their Chebyshev nodes to ``w``, shape (n, nodes)."""
        return chebyshev.cardinals(w, _SMALLEST_W, LARGEST_W, len(self._ws))

    def _over_w(self, uv: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return XYZ / w² at points (u, v), shape (n, 2), and at every Chebyshev node of |w|, shape (n, 3, nodes)."""
        return np.stack([self._at(uv, w) for w in self._ws], axis=2)

    def _at(self, uv: NDArray[np.float64], w: float) -> NDArray[np.float64]:
        return self._colours(np.column_stack([uv, np.full(len(uv), -w)])) / w**2

    @single_threaded_blas()
    def _functions(self) -> NDArray[np.float64]:
        """Return the fewest orthonormal functions of |w| whose weighted sums represent all colours, shape (nodes, K).

        Their truncation error is at most the part `_FUNCTIONS_SHARE` of the accepted ΔE2000.
        """
        samples = self._over_w(self._sampled(_SEED + 1)[0][:, :2])
        sizes = np.sqrt(np.mean(samples**2, axis=2, keepdims=True))
        rows = (samples / np.where(sizes > 0.0, sizes, 1.0)).reshape(-1, len(self._ws))
        principal = np.linalg.eigh(rows.T @ rows)[1][:, ::-1]
        validation, w = self._over_w(self._validation_set[:, :2]), -self._validation_set[:, 2]
        between = self._between_nodes(w) * (w * w)[:, None]
        for count in range(1, min(MOST_W_BASIS, len(self._ws)) + 1):
            basis = principal[:, :count]
            colours = np.einsum("ncj,jk,nk->nc", validation, basis, between @ basis)
            if self._error(colours) <= _FUNCTIONS_SHARE * self._tolerance:
                break
        return np.asarray(basis)

    def _error(self, colours: NDArray[Any]) -> float:
        """Return the 99th percentile of ΔE2000 between ``colours`` and reference colours in the validation directions.

        One half of the directions is uniformly distributed; the other half has bright colours. The larger of the two
        percentiles is returned. The zeroth order is excluded, because tables and reference use the same formula for it.
        """
        if self._bright <= 0.0:
            return 0.0
        luminance = self._gains * self._reference[:, 1]
        exposed = (self._gains * _SHOWN / np.maximum(luminance, _FLOOR * self._bright))[:, None]
        differences = colorimetry.colour_difference(exposed * np.maximum(colours, 0.0), exposed * self._reference)
        return max(float(np.percentile(part, 99.0)) for part in np.split(differences, 2))
