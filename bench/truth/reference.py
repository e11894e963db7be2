"""Reference colours of directions and pixels in NumPy and float64; shares no code with the library.

For a coherence window or a light source, the Fourier coefficients H_rs(κ) of exp(2πiκh), with heights h, are computed
by FFTs at Chebyshev nodes in κ = w/λ. The nodes are dense enough that interpolation errors are rounding errors. All
coefficients within nine standard deviations of the frequency (u, v)/λ are included.

For a replicated patch, the height samples of one patch are summed at Chebyshev nodes in 1/λ, and the sums are
interpolated between the nodes. The factor by which several periods differ from one has a closed form. In both cases,
the integral over λ is refined until it converges. Tests compare this reference with the direct sum
(``warpdiff.diffraction.direct_sum``), which is too slow for pictures.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from bench.truth import flat_materials
from bench.truth.brute_force import intersect, pixel_rays, shading_frame
from bench.truth.errors import FLOOR, reference_luminance

# Distance within which Fourier coefficients contribute, in standard deviations of the Gaussian that weights them. The
# value was chosen because exp(−9²/2) = 3e-18 is negligible.
WIDTHS = 9.0
# Exponent at which the Gaussian weight of Fourier coefficients is truncated. The value is derived: the exponent at the
# distance `WIDTHS`.
DEPTH = WIDTHS**2 / 2.0
# Range of wavenumbers 1/λ [1/µm] of all integrals, from 780 nm to 380 nm.
REDDEST, BLUEST = 1.0 / 0.78, 1.0 / 0.38
# The quadrature over τ = 1/λ divides the range into cells. `POINTS` is the number of Gauss-Legendre nodes per cell. The
# initial length of a cell is at most `WIDTHS_PER_CELL` standard deviations in τ of the Gaussian weight of a Fourier
# coefficient, and at most `PERIODS_PER_CELL` periods of exp(2πiτwh). Cells are halved until the integral converges.
POINTS = 8
WIDTHS_PER_CELL = 6.0
PERIODS_PER_CELL = 1.2
# Smallest number of cells of the quadrature over τ = 1/λ.
FEWEST_CELLS = 8
# Largest number of cells of the quadrature over τ = 1/λ. The value is limited by memory; a reference that requires more
# cells is refused.
MOST_CELLS = 1 << 19
# Number of wavenumbers τ = 1/λ that are evaluated together. Fourier coefficients near the frequency τ·(u, v) at any of
# these wavenumbers are evaluated at all of them. The value was chosen: with more wavenumbers, most of these
# coefficients contribute at only a few.
BLOCK = 128
# For a replicated patch: largest number of wavenumbers that are evaluated at once, and largest number of height samples
# per partial sum. Both values are limited by memory.
MOST_NODES = 1 << 16
MOST_SAMPLES = 1 << 14
# Least luminance Y, relative to a mirror, for which the integral over λ must converge. The value is limited by the
# truncation at nine standard deviations. The truncation causes steps of about this size, at which no quadrature
# converges.
LEAST = 1e-10
# Matrix from XYZ to linear sRGB (IEC 61966-2-1).
XYZ_TO_RGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])


class Step(NamedTuple):
    """The attributes of a coherence that the reference uses.

    A ``wd.Coherence`` has the same attributes and can replace this object.
    """

    kind: str = "averaged"
    sigma_um: float | None = None
    spread: float = 0.0
    periods: tuple[int, int] | None = None
    centre_um: tuple[float, float] | None = None


def step_of(coherence, sigma, centre):
    """Return a coherence from its kind and its window's σ [µm] and centre (y, x) [µm]; return an object unchanged."""
    return Step(coherence, sigma, centre_um=centre) if isinstance(coherence, str) else coherence


def sum_for(heightfield, step, scattering_vectors, shortest, longest):
    """Return an object that computes powers ⟨|P|²⟩ of scattering vectors (n, 3) at wavelengths in a range [µm]."""
    return (
        Replicas(heightfield, step)
        if step.kind == "replicas"
        else Coefficients(heightfield, step, scattering_vectors, shortest, longest)
    )


def chebyshev_nodes(count):
    """Return the Chebyshev nodes of the first kind on (−1, 1)."""
    return np.cos(math.pi * (np.arange(count) + 0.5) / count)


def chebyshev_cardinals(position, count):
    """Return the cardinal polynomials of ``count`` Chebyshev nodes at positions (m,), shape (m, count).

    A cardinal polynomial is 1 at one node and 0 at all other nodes.
    """
    order = np.arange(count)
    transform = np.cos(np.outer(order, math.pi * (order + 0.5) / count)) * (2.0 / count)
    transform[0] /= 2.0
    return np.cos(np.arccos(np.clip(position, -1.0, 1.0))[:, None] * order) @ transform


def chebyshev_terms(argument):
    """Return the number of Chebyshev nodes that represent exp(ix), |x| <= ``argument``, to rounding errors."""
    return math.ceil(argument + 4.0 * argument ** (1.0 / 3.0) + 10.0)


class Coefficients:
    """Fourier coefficients H_rs(κ) of a height field, and powers ⟨|P|²⟩ for a coherence window or a light source."""

    def __init__(self, heightfield, step, scattering_vectors, shortest, longest):
        self.step = step
        self.shape, pitch = heightfield.shape, tuple(float(d) for d in heightfield.pitch_um)
        self.lengths = tuple(n * d for n, d in zip(self.shape, pitch, strict=True))
        kappas = np.outer(
            [scattering_vectors[:, 2].min(), scattering_vectors[:, 2].max()], [1.0 / shortest, 1.0 / longest]
        )
        self.low = kappas.min()
        self.half = max(np.ptp(kappas) / 2.0, 1e-9)
        heights = np.asarray(heightfield.heights_um, dtype=np.float64)
        # The middle of the height range is subtracted. This changes only a phase that is common to all Fourier
        # coefficients, and reduces the necessary number of Chebyshev nodes in κ.
        heights = heights - (heights.max() + heights.min()) / 2.0
        self.height = np.abs(heights).max()
        self.terms = chebyshev_terms(2.0 * math.pi * self.half * self.height)
        # Only coefficients near the frequency (u, v)/λ of at least one direction are stored. For the index of an order,
        # `places` has the position of its coefficient in the stored array.
        radius = math.sqrt(DEPTH / self.rate(1.0 / shortest))
        indices, self.places = [], []
        for n, length, across in zip(
            self.shape, self.lengths, (scattering_vectors[:, 1], scattering_vectors[:, 0]), strict=True
        ):
            most = math.ceil((np.abs(across).max() / shortest + radius) * length) + 1
            indices.append(np.arange(n) if 2 * most + 1 >= n else np.arange(-most, most + 1) % n)
            self.places.append(np.zeros(n, dtype=np.int64))
            self.places[-1][indices[-1]] = np.arange(len(indices[-1]))
        # `rows` has the real and imaginary parts of each coefficient at all Chebyshev nodes in κ, shape (my, mx, 2,
        # nodes).
        self.rows = np.empty((len(indices[0]), len(indices[1]), 2, self.terms))
        for node, at in enumerate(chebyshev_nodes(self.terms)):
            sampled = np.fft.ifft2(np.exp(2j * math.pi * (self.low + self.half * (1.0 + at)) * heights))[
                np.ix_(*indices)
            ]
            self.rows[:, :, 0, node], self.rows[:, :, 1, node] = sampled.real, sampled.imag
        centre = step.centre_um
        if centre is None:
            centre = tuple((n // 2) * d for n, d in zip(self.shape, pitch, strict=True))
        self.centre = centre

    def metric(self, to_light):
        """Return the matrix A in the Gaussian weight exp(−a(τ) · (q − q_rs)ᵀ A (q − q_rs)) of a Fourier coefficient.

        The coefficient has the frequency q_rs, and q is the frequency at which the weight is evaluated.
        """
        if self.step.kind != "source":
            return np.eye(2)
        # A disc light in the sky is an ellipse in (u, v): the axis of the ellipse towards the light is shorter by the
        # factor cos θi.
        across = to_light[:2]
        return np.eye(2) + np.outer(across, across) / to_light[2] ** 2

    def rate(self, tau):
        """Return the factor a(τ) [µm²] in the Gaussian weight exp(−a(τ) · (q − q_rs)ᵀ A (q − q_rs)) of a coefficient.

        The Fourier coefficient has the frequency q_rs, and q is the frequency at which the weight is evaluated.
        """
        if self.step.kind == "source":
            return 1.0 / (2.0 * (self.step.spread * tau) ** 2)
        falloff = (4.0 if self.step.kind == "averaged" else 2.0) * (math.pi * self.step.sigma_um) ** 2
        return np.full(np.shape(tau), falloff)

    def resolution(self, scattering_vector, to_light):
        """Return the largest quadrature cell in τ = 1/λ, and the least luminance for which the integral must converge.

        The cell is small enough to resolve the Gaussian of each Fourier coefficient that the frequency τ·(u, v) passes
        as τ changes.
        """
        across = scattering_vector[:2]
        length = math.sqrt(across @ self.metric(to_light) @ across)
        if self.step.kind == "source":
            # The Gaussian weight of a coefficient has the standard deviation τ²·spread/|q| in τ = 1/λ. Here q is the
            # frequency of the coefficient, and spread is the angular spread of the light source. The standard deviation
            # is smallest for the smallest τ and the largest |q| of a coefficient that contributes, |q| = τ (|(u, v)| +
            # 4·spread).
            width = REDDEST * self.step.spread / (length + 4.0 * self.step.spread)
        else:
            # For an averaged coherence window, this is the standard deviation in τ = 1/λ of the Gaussian weight of a
            # coefficient. For a centred window, amplitudes have a Gaussian weight that is wider by √2. The power is a
            # product of two amplitudes and has the same width as for an averaged window.
            width = 1.0 / (2.0 * math.sqrt(2.0) * math.pi * self.step.sigma_um * max(length, 1e-9))
        turns = 2.0 * abs(scattering_vector[2]) * self.height
        return min(WIDTHS_PER_CELL * width, PERIODS_PER_CELL / max(turns, 1e-9)), LEAST

    def power(self, scattering_vector, to_light, tau):
        """Return powers ⟨|P|²⟩ of a scattering vector (u, v, w) at wavenumbers τ = 1/λ [1/µm], shape (m,)."""
        order = np.argsort(tau)
        result = np.empty(len(tau))
        for start in range(0, len(tau), BLOCK):
            block = order[start : start + BLOCK]
            result[block] = self._power(scattering_vector, self.metric(to_light), tau[block])
        return result

    def _power(self, scattering_vector, metric, tau):
        """Return powers ⟨|P|²⟩ of a scattering vector at a few ascending wavenumbers τ = 1/λ, shape (m,).

        Fourier coefficients near the frequency τ·(u, v) at any of the wavenumbers are evaluated at all of them.
        """
        across = scattering_vector[:2]
        radius = math.sqrt(DEPTH / self.rate(tau).min())
        along_axis = np.sqrt(np.diag(np.linalg.inv(metric)))
        ends = np.outer([tau[0], tau[-1]], across)
        bounds = []
        for axis in (0, 1):
            length, low, high = self.lengths[1 - axis], ends[:, axis].min(), ends[:, axis].max()
            first = math.ceil((low - radius * along_axis[axis]) * length)
            last = math.floor((high + radius * along_axis[axis]) * length)
            # Along an axis with one sample, the heights are constant, and only the diffraction order 0 exists.
            bounds.append(np.arange(first, last + 1) if self.shape[1 - axis] > 1 else np.arange(first <= 0 <= last))
        r, s = (grid.ravel() for grid in np.meshgrid(*bounds))
        q = np.stack([r / self.lengths[1], s / self.lengths[0]], axis=1)
        # As τ = 1/λ changes, the frequency τ·(u, v) follows a straight path. `away` is the vector from the nearest
        # point of this path to a coefficient's frequency. The length of `away` is measured in the metric A of the
        # coefficient's Gaussian weight.
        square = across @ metric @ across
        nearest = np.clip(q @ metric @ across / max(square, 1e-30), tau[0], tau[-1])
        away = q - nearest[:, None] * across
        near = np.einsum("ki,ij,kj->k", away, metric, away) <= radius**2
        if not near.any():
            return np.zeros(len(tau))
        r, s, q = r[near], s[near], q[near]
        # As τ = 1/λ changes, the frequency τU with U = (u, v) moves along a straight line. The exponent of the Gaussian
        # weight of a coefficient of the frequency q is the squared distance from q to τU in the metric A. This is the
        # squared distance from q to the line plus the squared distance along the line.
        foot = q @ metric @ across / max(square, 1e-30)
        away = q - foot[:, None] * across
        across_square = np.einsum("ki,ij,kj->k", away, metric, away)
        gaussian = np.exp(-self.rate(tau) * (across_square[:, None] + square * (tau - foot[:, None]) ** 2))
        basis = chebyshev_cardinals((scattering_vector[2] * tau - self.low) / self.half - 1.0, self.terms)
        rows = self.rows[self.places[0][s % self.shape[0]], self.places[1][r % self.shape[1]]].reshape(-1, self.terms)
        value = (rows @ basis.T).reshape(len(r), 2, len(tau))
        if self.step.kind != "centred":
            return np.einsum("ckm,ckm,cm->m", value, value, gaussian)
        turns = s * self.centre[0] / self.lengths[0] + r * self.centre[1] / self.lengths[1]
        phase = np.exp(-2j * math.pi * (turns % 1.0))
        amplitude = np.sum((value[:, 0] + 1j * value[:, 1]) * phase[:, None] * gaussian, axis=0)
        return np.abs(amplitude) ** 2


class Replicas:
    """Replicated height field with coherent periods, and the powers |P|² of scattering vectors."""

    def __init__(self, heightfield, step):
        (ny, nx), (dy, dx) = heightfield.shape, (float(d) for d in heightfield.pitch_um)
        heights = np.asarray(heightfield.heights_um, dtype=np.float64)
        # The origin is moved to the middle of the patch. This changes only a phase that is common to all samples, and
        # reduces the necessary number of Chebyshev nodes in τ = 1/λ.
        x = np.broadcast_to((np.arange(nx) - (nx - 1) / 2.0) * dx, heights.shape)
        y = np.broadcast_to(((np.arange(ny) - (ny - 1) / 2.0) * dy)[:, None], heights.shape)
        z = heights - (heights.max() + heights.min()) / 2.0
        self.samples = np.stack([x.ravel(), y.ravel(), z.ravel()])
        self.extent = np.abs(self.samples).max(axis=1)
        self.lengths, self.periods = (nx * dx, ny * dy), (step.periods[1], step.periods[0])
        self.latest = None, None

    def resolution(self, scattering_vector, to_light):  # noqa: ARG002
        """Return the largest quadrature cell in τ = 1/λ, and the least luminance for which the integral must converge.

        The cell is small enough to resolve the lobes of the replicated periods.
        """
        turns = 2.0 * abs(scattering_vector[2]) * self.extent[2]
        turns += sum(
            abs(u) * n * length for u, n, length in zip(scattering_vector[:2], self.periods, self.lengths, strict=True)
        )
        return PERIODS_PER_CELL / max(turns, 1e-9), LEAST**2 / math.prod(self.periods) ** 2

    def power(self, scattering_vector, to_light, tau):  # noqa: ARG002
        """Return powers |P|² of a scattering vector (u, v, w) at wavenumbers τ = 1/λ [1/µm], shape (m,)."""
        low, high = tau.min(), tau.max()
        span = max(high - low, 1e-9)
        key = (*scattering_vector, low, high)
        if key != self.latest[0]:
            self.latest = key, self._panels(scattering_vector, low, span)
        parts = np.array_split((tau - low) / span, math.ceil(len(tau) / MOST_NODES))
        result = np.abs(np.concatenate([self._patch(part) for part in parts])) ** 2
        for u, n, length in zip(scattering_vector[:2], self.periods, self.lengths, strict=True):
            turns = u * length * tau
            part = math.pi * (turns - np.rint(turns))
            is_integer = np.abs(part) < 1e-12
            safe = np.where(is_integer, 1.0, part)
            result *= np.where(is_integer, 1.0, np.sin(n * safe) / (n * np.sin(safe))) ** 2
        return result

    def _patch(self, position):
        """Return the mean of exp(2πiτ(ux + vy + wh)) over samples (x, y, h) of the patch, except for a common phase.

        ``position`` is the position in the range of wavenumbers τ = 1/λ: 0 at the lower end of the range, 1 at the
        upper end.
        """
        at_nodes = self.latest[1]
        panels, terms = at_nodes.shape
        panel = np.clip((position * panels).astype(np.int64), 0, panels - 1)
        basis = chebyshev_cardinals(2.0 * (position * panels - panel) - 1.0, terms)
        return np.einsum("mk,mk->m", basis, at_nodes[panel])

    def _panels(self, scattering_vector, low, span):
        """Return the mean of exp(2πiτ(ux + vy + wh)) over the patch at Chebyshev nodes in τ, shape (panels, nodes).

        The range of wavenumbers τ = 1/λ, which begins at ``low`` and has the length ``span``, is divided into parts
        (panels) of equal length.
        """
        argument = math.pi * span * (np.abs(scattering_vector) @ self.extent)
        panels = max(1, math.ceil(argument / 5.0))
        terms = chebyshev_terms(argument / panels)
        step = span / panels
        offsets = chebyshev_nodes(terms)[: (terms + 1) // 2] * step / 2.0
        at_nodes = np.zeros((panels, terms), dtype=complex)
        turns = scattering_vector @ self.samples
        for part in np.array_split(turns, math.ceil(len(turns) / MOST_SAMPLES)):
            # The position of a Chebyshev node is the middle of its panel plus an offset, so that the exponential at the
            # node is a product of two factors. The middles are equally spaced, so that the factors of the middles
            # follow by recurrence. The offsets are symmetric, so that the factors of the second half are complex
            # conjugates of the first half.
            to_middles, to_next = exp_i(2.0 * math.pi * (low + step / 2.0) * part), exp_i(2.0 * math.pi * step * part)
            middles = np.empty((panels, len(part)), dtype=complex)
            for panel in range(panels):
                middles[panel] = to_middles
                to_middles = to_middles * to_next
            first = exp_i(2.0 * math.pi * np.outer(offsets, part))
            both = np.concatenate([first, first[: terms // 2][::-1].conj()])
            at_nodes += middles @ both.T
        return at_nodes / len(turns)


def exp_i(phase):
    """Return exp(i·phase), faster than NumPy's complex exponential."""
    result = np.empty(phase.shape, dtype=complex)
    np.cos(phase, out=result.real)
    np.sin(phase, out=result.imag)
    return result


def gain(to_light, to_view, *, ior=1.5, masking=True, source=False):
    """Return the geometry factor (gain) C·M of unit vectors (n, 3) in the local frame, over cos θi for ``source``.

    The gain is 0 where one of the vectors is below the surface.
    """
    illuminated = (to_light[:, 2] > 0.0) & (to_view[:, 2] > 0.0)
    result = np.zeros(len(illuminated))
    i, r = to_light[illuminated], to_view[illuminated]
    half = (i + r) / np.linalg.norm(i + r, axis=1, keepdims=True)
    cos_d = np.sum(r * half, axis=1)
    result[illuminated] = fresnel(cos_d, ior) / fresnel(1.0, ior) * (1.0 + np.sum(i * r, axis=1)) ** 2
    result[illuminated] /= (i[:, 2] + r[:, 2]) ** 2 * r[:, 2]
    if masking:
        shadowing = 2.0 * half[:, 2] * np.minimum(r[:, 2], i[:, 2]) / cos_d
        result[illuminated] *= np.minimum(1.0, shadowing)
    if source:
        result[illuminated] /= i[:, 2]
    return result


def fresnel(cosine, ior):
    """Return the power reflectance by Schlick's approximation."""
    normal = 1.0 if math.isinf(ior) else ((ior - 1.0) / (ior + 1.0)) ** 2
    return normal + (1.0 - normal) * (1.0 - cosine) ** 5


@functools.cache
def products(illuminant):
    """Return the products S·x̄ȳz̄ of an illuminant S and the CIE functions, over ΣSȳ, at 380 to 780 nm, (401, 3)."""
    import colour

    shape = colour.SpectralShape(380, 780, 1)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values
    values = observer * colour.SDS_ILLUMINANTS[illuminant].copy().align(shape).values[:, None]
    return values / values[:, 1].sum()


@functools.lru_cache(maxsize=24)
def quadrature(cells, illuminant):
    """Return wavenumbers τ [1/µm] and weights (m, 3) of a quadrature with cells of equal length in τ.

    In each cell the integrand is a product: a polynomial in τ through the values at the nodes, times the tabulated
    colour products. The colour products are interpolated linearly between wavelengths that are whole numbers of nm. The
    weights integrate the product over λ exactly. Colours are defined as sums over wavelengths that are whole numbers of
    nm, in which the first and the last wavelength count fully. In the integral these two count half. The two ends of
    the range are therefore additional nodes, and the weights of these nodes are half of the colour products.
    """
    x, _ = np.polynomial.legendre.leggauss(POINTS)
    edges = np.linspace(REDDEST, BLUEST, cells + 1)
    half, middles = (edges[1] - edges[0]) / 2.0, (edges[:-1] + edges[1:]) / 2.0
    # The integrand is not smooth at the edges of cells and at wavelengths that are whole numbers of nm, where the
    # tabulated colour products have kinks. The integral is therefore divided at all of these places. In each part the
    # integrand is smooth, and a Gauss rule with 6 points integrates it.
    pieces = np.unique(np.concatenate([1e3 / edges[1:-1], np.arange(380.0, 781.0)]))
    middle = (pieces[:-1] + pieces[1:]) / 2.0
    cell = np.clip(((1e3 / middle - REDDEST) / (2.0 * half)).astype(np.int64), 0, cells - 1)
    to_cardinals = np.linalg.inv(np.polynomial.legendre.legvander(x, POINTS - 1))
    table = products(illuminant)
    weights = np.zeros((3, cells, POINTS))
    for at, share in zip(*np.polynomial.legendre.leggauss(6), strict=True):
        places = middle + at * np.diff(pieces) / 2.0
        measure = share * np.diff(pieces) / 2.0
        cardinals = np.polynomial.legendre.legvander((1e3 / places - middles[cell]) / half, POINTS - 1) @ to_cardinals
        for c in range(3):
            curve = np.interp(places, np.arange(380, 781), table[:, c]) * measure
            for point in range(POINTS):
                weights[c, :, point] += np.bincount(cell, curve * cardinals[:, point], cells)
    nodes = (middles[:, None] + half * x).ravel()
    return np.append(nodes, [BLUEST, REDDEST]), np.concatenate([weights.reshape(3, -1).T, table[[0, -1]] / 2.0])


def reference_spectral(
    heightfield, to_light, to_view, wavelengths_um, coherence="averaged", sigma=16.25, *, ior=1.5, material=None,
    masking=True, centre=None,
):  # fmt: skip
    """Return reflectances ρ of unit vectors (n, 3) in the local frame at m wavelengths, shape (n, m).

    The coherence is a name, such as "averaged", with ``sigma`` [µm], or a coherence object.
    """
    step = step_of(coherence, sigma, centre)
    wavelengths = np.asarray(wavelengths_um, dtype=np.float64)
    ior = math.inf if material is not None else ior
    gains = gain(to_light, to_view, ior=ior, masking=masking, source=step.kind == "source")
    result = np.zeros((len(gains), len(wavelengths)))
    illuminated = np.flatnonzero(gains)
    if illuminated.size == 0:
        return result
    scattering_vectors = -to_light - to_view
    sums = sum_for(heightfield, step, scattering_vectors[illuminated], wavelengths.min(), wavelengths.max())
    for i in illuminated:
        result[i] = gains[i] * sums.power(scattering_vectors[i], to_light[i], 1.0 / wavelengths)
        result[i] *= reflected(material, to_light[i], to_view[i], wavelengths)
    return result


def reflected(material, to_light, to_view, wavelengths_um):
    """Return the Fresnel reflectance for one pair of directions to light and view, or 1 without a material.

    The angle of incidence is half of the angle between the two directions.
    """
    if material is None:
        return 1.0
    half = (to_light + to_view) / np.linalg.norm(to_light + to_view)
    return flat_materials.reflectance(material, wavelengths_um, half @ to_view)


def colours(heightfield, scattering_vectors, to_light, step, *, tolerance, illuminant="D65", material=None):
    """Return XYZ of scattering vectors (n, 3): ∫ ⟨|P|²⟩ S x̄ȳz̄ dλ / ∫ S ȳ dλ for the illuminant S, shape (n, 3).

    The cells of the quadrature are halved until XYZ changes by less than a twentieth of the tolerance.
    """
    result = np.zeros((len(scattering_vectors), 3))
    if len(scattering_vectors) == 0:
        return result
    sums = sum_for(heightfield, step, scattering_vectors, 0.38, 0.78)
    for index, (scattering_vector, light) in enumerate(zip(scattering_vectors, to_light, strict=True)):
        # A narrow peak may lie between the nodes of a quadrature. Two quadratures must therefore agree, the second with
        # cells of half the size. Numbers of cells are powers of 2, so that few different quadratures are computed.
        largest, least = sums.resolution(scattering_vector, light)
        cells = 1 << math.ceil(math.log2(max((BLUEST - REDDEST) / largest, FEWEST_CELLS)) - 1.0)
        before = None
        while True:
            if cells > MOST_CELLS:
                why = "converge" if before is not None else f"fit in {MOST_CELLS} cells"
                raise AssertionError(f"the integral over λ does not {why} for {scattering_vector}, light {light}")
            tau, weights = quadrature(cells, illuminant)
            now = (
                sums.power(scattering_vector, light, tau)
                * reflected(material, light, -scattering_vector - light, 1.0 / tau)
            ) @ weights
            size = max(np.linalg.norm(now), least)
            if before is not None and np.linalg.norm(now - before) <= tolerance / 20.0 * size:
                break
            before, cells = now, 2 * cells
        result[index] = now
    return result


def reference_reflectance(
    heightfield, to_light, to_view, coherence="averaged", sigma=16.25, *, tolerance=1e-3, illuminant="D65", ior=1.5,
    material=None, masking=True, centre=None,
):  # fmt: skip
    """Return XYZ of unit vectors (n, 3) in the local frame, shape (n, 3).

    The coherence is a name, such as "averaged", with ``sigma`` [µm], or a coherence object.
    """
    step = step_of(coherence, sigma, centre)
    ior = math.inf if material is not None else ior
    gains = gain(to_light, to_view, ior=ior, masking=masking, source=step.kind == "source")
    result = np.zeros((len(gains), 3))
    illuminated = gains > 0.0
    xyz = colours(
        heightfield, -(to_light + to_view)[illuminated], to_light[illuminated], step, tolerance=tolerance,
        illuminant=illuminant, material=material,
    )  # fmt: skip
    result[illuminated] = gains[illuminated, None] * xyz
    return result


class Body(NamedTuple):
    """A mesh in world coordinates with normals, tangents, handedness and texture coordinates at its vertices.

    The handedness is −1 where the texture mapping is mirrored, and 1 elsewhere. The texture is sRGB with 8 bits, and
    row 0 of the texture is at v = 1.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    tangents: np.ndarray
    handedness: np.ndarray
    uvs: np.ndarray
    texture: np.ndarray | None = None

    @classmethod
    def of(cls, surface, texture=None):
        """Return the arrays of a mesh that the library has prepared, which are inputs of the reference."""
        fields = (getattr(surface, name) for name in ("normals", "tangents", "handedness", "uvs"))
        place = surface.vertices.astype(np.float64) * surface.radius + surface.centre
        return cls(place, surface.faces, *(field.astype(np.float64) for field in fields), texture)


class Pixels(NamedTuple):
    """Reference colours of pixels.

    Attributes:
        xyz: XYZ, shape (k, 3).
        hit: Whether the ray through the centre of the pixel hits the mesh.
        illuminated: Whether at least one light illuminates the hit.
        unsure: Whether rounding to float32 may change whether the pixel is hit or in shadow.
        cos_geometric: Cosine between the last light and the face normal on the viewer's side.
    """

    xyz: np.ndarray
    hit: np.ndarray
    illuminated: np.ndarray
    unsure: np.ndarray
    cos_geometric: np.ndarray


def bilinear(texture, uv):
    """Return linear RGB of an sRGB texture (h, w, 3) at texture coordinates (k, 2), bilinearly interpolated."""
    encoded = np.asarray(texture, dtype=np.float64) / 255.0
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    height, width = linear.shape[:2]
    x, y = uv[:, 0] * width - 0.5, (1.0 - uv[:, 1]) * height - 0.5
    total = 0.0
    for dy in (0, 1):
        for dx in (0, 1):
            column, row = np.floor(x).astype(int) + dx, np.floor(y).astype(int) + dy
            weight = (1.0 - np.abs(x - column)) * (1.0 - np.abs(y - row))
            total = total + weight[:, None] * linear[row % height, column % width]
    return total


def pigment_colour(base, to_light, to_view, heightfield, step, illuminant, ior):
    """Return XYZ of the pigment under the diffracting surface, for base colours (k, 3) in linear RGB."""
    grid = np.arange(380, 781) * 1e-3
    if step.kind == "source":
        weight = np.full(len(grid), 2.0 * step.spread**2)
    elif step.kind == "replicas":
        patch = math.prod(heightfield.shape) * float(heightfield.pitch_um[0]) * float(heightfield.pitch_um[1])
        weight = grid**2 / (math.pi * patch * math.prod(step.periods))
    else:
        weight = grid**2 / (4.0 * math.pi**2 * step.sigma_um**2)
    # A white pigment has the chromaticity of the illuminant. The luminance of this pigment is the mean of `weight` over
    # the wavelengths, with the colour product for Y as weight.
    spectrum = products(illuminant)
    white = (weight @ spectrum[:, 1]) * spectrum.sum(axis=0)
    xyz = (base * (XYZ_TO_RGB @ white)) @ np.linalg.inv(XYZ_TO_RGB).T
    under = (1.0 - fresnel(to_light[:, 2], ior)) * (1.0 - fresnel(to_view[:, 2], ior)) * to_light[:, 2]
    return (under / fresnel(1.0, ior))[:, None] * xyz


def reference_picture(
    body, heightfield, lights, view, pixels, coherence="averaged", sigma=16.25, *, tolerance=1e-3, ior=1.5,
    masking=True, pigment=1.0, shadows=True, smooth=True, chunk=64,
):  # fmt: skip
    """Return reference colours of pixels of a picture. Indices run along rows from the top left.

    Args:
        body: A ``Body``.
        heightfield: Height field.
        lights: Objects with ``to_light``, ``illuminant`` and ``power``.
        view: Camera.
        pixels: Indices of pixels, shape (k,).
        coherence: Name of a kind of coherence, or a coherence object.
        sigma: Standard deviation of the coherence window [µm], if ``coherence`` is a name.
        tolerance: Tolerance of the reference; the integral over λ converges to a twentieth of the tolerance.
        ior: Index of refraction.
        masking: Whether the gain includes the factor for masking and shadowing by the relief.
        pigment: Strength of the pigment under the diffracting surface.
        shadows: Whether shadow rays are traced.
        smooth: Whether normals are interpolated.
        chunk: Number of rays that are intersected with all faces at a time.
    """
    step = step_of(coherence, sigma, None)
    fov = None if view.extent_y else view.fov_y_deg
    size = {"width": view.width, "height": view.height, "fov_y_deg": fov, "extent_y": view.extent_y}
    origins, directions = (a[pixels] for a in pixel_rays(view.eye, view.target, view.up, **size))
    _, face, bary, margin = intersect(origins, directions, body.vertices, body.faces, chunk)
    hit = face >= 0
    unsure = margin < 1e-5
    face, bary, directions = face[hit], bary[hit], directions[hit]
    fields = {"normals": body.normals, "tangents": body.tangents, "handedness": body.handedness}
    t, b, n = shading_frame(face, bary, directions, body.vertices, body.faces, **fields, smooth=smooth)
    corners = body.faces[face]
    places = body.vertices[corners]
    point = np.einsum("kc,kcd->kd", bary, places)
    geometric = np.cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0])
    geometric /= np.linalg.norm(geometric, axis=1, keepdims=True)
    side = np.where(np.sum(geometric * directions, axis=1) > 0.0, -1.0, 1.0)[:, None]
    start = point
    if smooth:
        # Where the surface is convex, shadow rays start outside of the flat face. The starting point is interpolated
        # between the tangent planes at the corners of the face (Hanika 2021, "Hacking the shadow terminator").
        outward = side[:, :, None] * body.normals[corners]
        below = np.minimum(np.sum((point[:, None] - places) * outward, axis=2), 0.0)
        start = np.einsum("kc,kcd->kd", bary, point[:, None] - below[:, :, None] * outward)
    extent = np.linalg.norm(np.ptp(body.vertices, axis=0)) / 2.0
    start = start + 1e-5 * extent * side * geometric
    to_view = np.stack([np.sum(axis * -directions, axis=1) for axis in (t, b, n)], axis=1)

    xyz = np.zeros((len(pixels), 3))
    any_lit = np.zeros(len(pixels), dtype=bool)
    cos_geometric = np.zeros(len(pixels))
    for light in lights:
        world = np.asarray(light.to_light)
        to_light = np.stack([axis @ world for axis in (t, b, n)], axis=1)
        illuminated = (to_light[:, 2] > 0.0) & (to_view[:, 2] > 0.0)
        doubt = np.abs(to_light[:, 2]) < 1e-5
        if shadows:
            rays = np.broadcast_to(world, (np.count_nonzero(illuminated), 3))
            occluded, _, _, nearness = intersect(start[illuminated], rays, body.vertices, body.faces, chunk)
            doubt[illuminated] |= nearness < 1e-4
            illuminated[illuminated] = ~np.isfinite(occluded)
        contribution = np.zeros((len(face), 3))
        contribution[illuminated] = reference_reflectance(
            heightfield, to_light[illuminated], to_view[illuminated], step, tolerance=tolerance,
            illuminant=light.illuminant, ior=ior, masking=masking,
        )  # fmt: skip
        if pigment > 0.0 and body.texture is not None:
            base = bilinear(body.texture, np.einsum("kc,kcd->kd", bary, body.uvs[corners])[illuminated])
            under = pigment_colour(
                base, to_light[illuminated], to_view[illuminated], heightfield, step, light.illuminant, ior
            )
            contribution[illuminated] += pigment * under
        xyz[hit] += light.power * contribution
        any_lit[hit] |= illuminated
        unsure[hit] |= doubt
        cos_geometric[hit] = (side * geometric) @ world
    return Pixels(xyz, hit, any_lit, unsure, cos_geometric)


class PictureError(NamedTuple):
    """Error of a picture, estimated from a random sample of its pixels."""

    median: float
    p99: float
    below: float  # 99th percentile of ‖ΔXYZ‖ / f of the illuminated pixels with Y < f
    share_below: float
    illuminated: int
    unsure: int

    def __str__(self):
        return (
            f"median {self.median:.1e}, P99 {self.p99:.1e}; {100.0 * self.share_below:.1f} % of {self.illuminated} "
            f"illuminated pixels below f with P99 {self.below:.1e}; {self.unsure} pixels excluded at edges"
        )


def stratified(mask, count, seed=0):
    """Return indices of ``count`` random pixels of a mask, evenly distributed over the rows of the mask.

    The pixels of the mask, in row order, are divided into ``count`` equal parts. One pixel is drawn from each part.
    """
    inside = np.flatnonzero(mask)
    edges = np.linspace(0.0, len(inside), count + 1)
    places = np.random.default_rng(seed).uniform(edges[:-1], edges[1:]).astype(int)
    return inside[np.unique(np.minimum(places, len(inside) - 1))]


def picture_error(xyz, truth):
    """Return the error of a picture's XYZ (k, 3) relative to the reference ``truth``, over illuminated pixels."""
    use = truth.illuminated & ~truth.unsure
    exact, moved = truth.xyz[use], np.linalg.norm(xyz[use] - truth.xyz[use], axis=1)
    floor = FLOOR * reference_luminance(exact[:, 1])
    above = exact[:, 1] >= floor
    error = moved[above] / np.maximum(np.linalg.norm(exact[above], axis=1), floor)
    below = np.percentile(moved[~above] / floor, 99.0) if not above.all() else 0.0
    unsure = int(np.count_nonzero(truth.unsure & truth.hit))
    return PictureError(
        float(np.median(error)), float(np.percentile(error, 99.0)), float(below), float(np.mean(~above)), len(exact),
        unsure,
    )  # fmt: skip
