"""Powers ⟨|P|²⟩ of scattering vectors in NumPy and float64, for each kind of coherence.

P is the sum of exp(2πiτ(ux + vy + wh)) over the surface, with a window and relative to a flat mirror. (u, v, w) is the
scattering vector: minus the sum of the unit vectors to light and viewer. τ is 1/λ.

For a coherence window or a light source, the Fourier coefficients H_rs(κ) of exp(2πiκh), with heights h, are computed
by FFTs at Chebyshev nodes in κ = w/λ. The nodes are dense enough that interpolation errors are rounding errors. All
coefficients within nine standard deviations of the frequency (u, v)/λ are included.

For a replicated patch, the height samples of one patch are summed at Chebyshev nodes in 1/λ, and the sums are
interpolated between the nodes. The factor by which the power of several periods differs from the power of one period
has a closed form.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

# Distance from the frequency (u, v)/λ within which Fourier coefficients contribute, in standard deviations of the
# Gaussian that weights them. Farther coefficients have weights below exp(−9²/2) = 3e-18.
WIDTHS = 9.0
# Exponent at which the Gaussian weight of Fourier coefficients is truncated. The value is derived: the exponent at the
# distance `WIDTHS`.
DEPTH = WIDTHS**2 / 2.0
# Range of wavenumbers 1/λ [1/µm] of all integrals, from 780 nm to 380 nm.
REDDEST, BLUEST = 1.0 / 0.78, 1.0 / 0.38
# The quadrature over τ = 1/λ divides the range of τ into cells. The initial length of a cell is at most
# `WIDTHS_PER_CELL` standard deviations in τ of the Gaussian weight of a Fourier coefficient, and at most
# `PERIODS_PER_CELL` periods of exp(2πiτwh).
WIDTHS_PER_CELL = 6.0
PERIODS_PER_CELL = 1.2
# Number of wavenumbers τ = 1/λ at which powers are computed together. Fourier coefficients near the frequency τ·(u, v)
# at any of these wavenumbers are evaluated at all of them. With more wavenumbers, most of these coefficients would
# contribute at only a few of them, which wastes time.
BLOCK = 128
# For a replicated patch: largest number of wavenumbers that are evaluated at once, and largest number of height samples
# per partial sum. Both values are limited by memory.
MOST_NODES = 1 << 16
MOST_SAMPLES = 1 << 14
# Least luminance Y, relative to a mirror, for which the integral over λ must converge. The value is limited by the
# truncation of the Gaussian weights at nine standard deviations. The truncation causes steps of the integrand of about
# this size, at which no quadrature converges.
LEAST = 1e-10


class Step(NamedTuple):
    """Limit of interference (coherence), with the attributes of a ``wd.Coherence`` that the reference uses.

    A ``wd.Coherence`` has the same attributes and can replace this object.
    """

    kind: str = "averaged"
    sigma_um: float | None = None
    spread: float = 0.0
    periods: tuple[int, int] | None = None
    centre_um: tuple[float, float] | None = None


def step_of(coherence, sigma, centre):
    """Return a coherence object from the name of its kind, and from σ and centre (y, x) of its window [µm].

    If ``coherence`` is a coherence object already, it is returned unchanged.
    """
    return Step(coherence, sigma, centre_um=centre) if isinstance(coherence, str) else coherence


def sum_for(heightfield, step, scattering_vectors, shortest, longest):
    """Return an object that computes the diffracted power ⟨|P|²⟩ for a scattering vector and for wavelengths.

    The scattering vector must be one of ``scattering_vectors``, shape (n, 3), and the wavelengths must be between
    ``shortest`` and ``longest`` [µm].
    """
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
    """Diffracted power ⟨|P|²⟩ for a coherence window or a light source, by Fourier coefficients of a height field.

    H_rs(κ) is the Fourier coefficient of exp(2πiκh), with heights h and κ = w/λ, at the order (r, s).
    """

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
        # `rows` has the real and imaginary parts of each Fourier coefficient at all Chebyshev nodes in κ. Its shape is
        # (my, mx, 2, nodes).
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
        """Return the largest length of a quadrature cell in τ = 1/λ, and the least luminance of a converged integral.

        With this length, cells resolve the Gaussian of each Fourier coefficient that the frequency τ·(u, v) passes as τ
        changes.
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
            # For an averaged coherence window, `width` is the standard deviation in τ = 1/λ of the Gaussian weight of a
            # coefficient. For a centred window, amplitudes have a Gaussian weight that is wider by √2. The power is a
            # product of two amplitudes and has the same width as for an averaged window.
            width = 1.0 / (2.0 * math.sqrt(2.0) * math.pi * self.step.sigma_um * max(length, 1e-9))
        turns = 2.0 * abs(scattering_vector[2]) * self.height
        return min(WIDTHS_PER_CELL * width, PERIODS_PER_CELL / max(turns, 1e-9)), LEAST

    def power(self, scattering_vector, to_light, tau):
        """Return diffracted powers ⟨|P|²⟩ for a scattering vector (u, v, w) at wavenumbers τ [1/µm], shape (m,)."""
        order = np.argsort(tau)
        result = np.empty(len(tau))
        for start in range(0, len(tau), BLOCK):
            block = order[start : start + BLOCK]
            result[block] = self._power(scattering_vector, self.metric(to_light), tau[block])
        return result

    def _power(self, scattering_vector, metric, tau):
        """Return diffracted powers ⟨|P|²⟩ for a scattering vector at a few ascending wavenumbers τ = 1/λ, shape (m,).

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
            # Along an axis with one height sample, the surface is constant, and only the diffraction order 0 exists.
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
    """Diffracted power |P|² of a height field that is repeated a given number of times, with coherent repetitions."""

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
        """Return the largest length of a quadrature cell in τ = 1/λ, and the least luminance of a converged integral.

        With this length, cells resolve the maxima of the interference between the repeated patches.
        """
        turns = 2.0 * abs(scattering_vector[2]) * self.extent[2]
        turns += sum(
            abs(u) * n * length for u, n, length in zip(scattering_vector[:2], self.periods, self.lengths, strict=True)
        )
        return PERIODS_PER_CELL / max(turns, 1e-9), LEAST**2 / math.prod(self.periods) ** 2

    def power(self, scattering_vector, to_light, tau):  # noqa: ARG002
        """Return diffracted powers |P|² for a scattering vector (u, v, w) at wavenumbers τ = 1/λ [1/µm], shape (m,)."""
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
        """Return the mean of exp(2πiτ(ux + vy + wh)) over the samples (x, y, h) of one patch, without a common phase.

        The mean is interpolated between Chebyshev nodes in τ = 1/λ. ``position`` is 0 at the lower and 1 at the upper
        end of the range of τ.
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
            # A Chebyshev node in τ is the middle of its panel plus an offset, so that the exponential at the node is a
            # product of two factors. The middles are equally spaced, so that the factors for the middles are computed
            # by recurrence. The offsets are symmetric, so that the factors for the second half of the offsets are
            # complex conjugates of those for the first half.
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
