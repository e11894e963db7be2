"""Eight regimes of the stability chart: errors of methods at the limits of their validity.

A regime is a range of one parameter in which methods fail; the parameter is the x axis of a panel (diagram) of the
chart. Errors are 99th percentiles over directions of ‖ΔXYZ‖ / max(‖XYZ‖, f), or of |Δρ| / max(ρ, f) in panels of
spectra. The floor f is a thousandth of the 99th percentile of Y or ρ. For a series expansion in float32, the errors are
those of the library's kernels; for float64, they are those of the same series in NumPy. Colours and spectra are
compared with those of ``bench.truth.reference``, of the direct sum, or of a closed form.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

import warpdiff as wd
from bench.truth import numpy_methods as methods
from bench.truth import reference
from warpdiff.diffraction import direct_sum

# Tolerance of the calls that measure the library's automatic choice, ``method="auto"``.
TOLERANCE = 1e-2
# Slice that selects all values on the x axis of a panel.
ALL = slice(None)
# Tolerance of the calls by which the smallest error that a method can reach is measured.
FINEST = 1e-5
WAVELENGTHS_UM = np.array([0.4, 0.45, 0.55, 0.65, 0.75])
# Names of the curves.
AUTOMATIC = "automatic, tolerance 1e-2"
AUTOMATIC_SOURCE = "automatic, source of 0.53°"
AUTOMATIC_CENTRED = "automatic, centred window"
SERIES = {
    "taylor-uncentred": "Taylor, uncentred", "taylor": "Taylor, centred", "jacobi-anger": "Jacobi–Anger",
    "power": "power", "low-rank": "low-rank",
}  # fmt: skip
PUBLISHED = "Taylor, 37 terms as published"
STEPS = {5.0: "fixed steps of 5 nm", 1.0: "fixed steps of 1 nm"}
FLOOR, ROUNDED = "3 × 3 neighbours by floor", "3 × 3 neighbours by rounding"
SINGLE = "everything in float32"
FACING = "source without foreshortening"
ORDER_WISE = "one point per order"
SAMPLED = "any method on these samples"
RESAMPLED = "resampled to 0.02 µm first"
PQ, PQ64 = "p, q as published", "p, q as published, float64"
PLAIN = "sin Nx / N sin x in float32"
NEAREST = "7 nearest orders"
EQUAL, CUBICS = "equal steps in λ, plain sum", "same number in 1/λ, cubics"
SMALL = ", small patch"
FLOAT64 = ", float64"


class Panel(NamedTuple):
    """One panel of the stability chart: errors of several methods over one parameter.

    Attributes:
        title: Title of the panel.
        axis: Label of the x axis.
        x: Values on the x axis.
        curves: Errors at each x, by the name of the curve; NaN where a method is not evaluated.
        note: Text in the panel: surface and coherence window.
        ticks: Values with a tick on the x axis.
        warned: Indices of the values on the x axis at which the automatic choice refuses or warns, by the name of the
            curve. The error at these values is drawn nevertheless.
    """

    title: str
    axis: str
    x: np.ndarray
    curves: dict[str, list[float]]
    note: str
    ticks: tuple[float, ...]
    warned: dict[str, list[int]]


class Points:
    """Errors by curve and x value, and the x values for which the library refuses to choose a method, or warns."""

    def __init__(self) -> None:
        self._points: list[dict[str, float]] = []
        self.warned: dict[str, list[int]] = {}

    def start(self) -> None:
        """Begin the next value on the x axis of the chart; errors are then added to this value."""
        self._points.append({})

    def add(self, name: str, error: float) -> None:
        """Set the error of a curve at the present value on the x axis, unless it already has a larger error there."""
        self._points[-1][name] = max(error, self._points[-1].get(name, 0.0))

    def automatic(
        self, heightfield: wd.HeightField, lights: np.ndarray, views: np.ndarray, coherence: wd.Coherence,
        exact: np.ndarray, name: str = AUTOMATIC,
    ) -> None:  # fmt: skip
        """Compute colours by the library's automatic choice of a method, and add their error at the present x value."""
        arguments = {"coherence": coherence, "tolerance": TOLERANCE}
        xyz, message = methods.outcome(wd.reflectance, heightfield, lights, views, **arguments)
        if message:
            xyz = methods.best_effort(wd.reflectance, heightfield, lights, views, **arguments)
            at = len(self._points) - 1
            print(f"point {at}, {name}: {message}")
            self.warned.setdefault(name, [])
            self.warned[name] += [at] if at not in self.warned[name] else []
        self.add(name, methods.colour_error(xyz, exact))

    def fixed_steps(
        self, heightfield: wd.HeightField, lights: np.ndarray, views: np.ndarray, coherence: wd.Coherence,
        exact: np.ndarray,
    ) -> None:  # fmt: skip
        """Add the errors of sums over wavelengths at steps of 5 nm, and at steps of 1 nm."""
        for step, label in STEPS.items():
            xyz = methods.fixed_step_colour(heightfield, lights, views, step, coherence)
            self.add(label, methods.colour_error(xyz, exact))

    def neighbourhoods(
        self, heightfield: wd.HeightField, lights: np.ndarray, views: np.ndarray, sigma: float, step_nm: float
    ) -> None:
        """Add the errors of colours from 3 × 3 Fourier coefficients; the reference is colours from all coefficients.

        Both colours use the same wavelengths.
        """
        wavelengths, weights = methods.fixed_steps(step_nm)

        def colour(**keywords: Any) -> np.ndarray:
            spectra = methods.series_reflectance(
                heightfield, lights, views, wavelengths * 1e-3, sigma=sigma, **keywords
            )
            return np.asarray(spectra @ weights)

        exact = colour()
        self.add(FLOOR, methods.colour_error(colour(neighbour_extent=1, floor=True), exact))
        self.add(ROUNDED, methods.colour_error(colour(neighbour_extent=1), exact))

    def panel(self, title: str, axis: str, x: Any, note: str, ticks: tuple[float, ...]) -> Panel:
        """Return the panel with the errors of all values on the x axis."""
        names = dict.fromkeys(name for point in self._points for name in point)
        curves = {name: [point[name] for point in self._points] for name in names}
        return Panel(title, axis, np.asarray(x), curves, note, ticks, self.warned)


def height_range(which: slice = ALL) -> Panel:
    """Return the panel (diagram) of errors over the height range, of all series expansions of exp(2πiκh)."""
    sigma, (lights, views) = 2.0, methods.hemisphere_pairs(48)
    flat, window = wd.gratings.fingers(size_um=6.4, pitch_um=0.08, seed=3), wd.Coherence(sigma_um=sigma)
    x, points = np.geomspace(0.05, 5.0, 13)[which], Points()
    for height in x:
        points.start()
        heightfield = wd.HeightField.of_known_scale(flat.heights_um * (height / flat.height_range_um), flat.pitch_um)
        exact = reference.reference_spectral(heightfield, lights, views, WAVELENGTHS_UM, window)
        request = {
            "heightfield": heightfield,
            "to_light": lights,
            "to_view": views,
            "wavelengths_nm": 1e3 * WAVELENGTHS_UM,
        }
        for name, label in SERIES.items():
            singles = methods.best_effort(
                wd.spectral_reflectance, **request, coherence=window, method=name, tolerance=FINEST
            )
            terms = methods.most_terms(heightfield, name, 2.0 / WAVELENGTHS_UM[0])
            doubles = methods.series_reflectance(
                heightfield, lights, views, WAVELENGTHS_UM, sigma=sigma, method=name, terms=terms
            )
            points.add(label, methods.spectral_error(singles, exact))
            points.add(label + FLOAT64, methods.spectral_error(doubles, exact))
        published = methods.series_reflectance(
            heightfield, lights, views, WAVELENGTHS_UM, sigma=sigma, method="taylor-uncentred",
            terms=methods.PUBLISHED_TERMS, dtype=np.float32,
        )  # fmt: skip
        points.add(PUBLISHED, methods.spectral_error(published, exact))
        rho = wd.spectral_reflectance(**request, coherence=window, tolerance=TOLERANCE)
        points.add(AUTOMATIC, methods.spectral_error(rho, exact))
    ticks = (0.05, 0.1, 0.2, 0.5, 1, 2, 5)
    return points.panel("height range", "height range [µm]", x, "fingers, spectra", ticks)


def window_width(which: slice = ALL) -> Panel:
    """Return the panel (diagram) of errors over the width of the coherence window.

    3 × 3 Fourier coefficients are too few for short windows, and fixed wavelengths are too coarse for long windows.
    """
    heightfield, (lights, views) = methods.finger_rows(25.6), methods.in_plane(48, 1.8)
    x, points = np.geomspace(1.0, 1000.0, 13)[which], Points()
    for sigma in x.tolist():
        points.start()
        window, centred = wd.Coherence(sigma_um=sigma), wd.Coherence("centred", sigma)
        exact = reference.reference_reflectance(heightfield, lights, views, window)
        points.fixed_steps(heightfield, lights, views, window, exact)
        points.neighbourhoods(heightfield, lights, views, sigma, min(1.0, 10.0 / sigma))
        points.automatic(heightfield, lights, views, window, exact)
        exact = reference.reference_reflectance(heightfield, lights, views, centred)
        points.automatic(heightfield, lights, views, centred, exact, AUTOMATIC_CENTRED)
    return points.panel("window", "σ of the window [µm]", x, "line of 25.6 µm", (1, 10, 100, 1000))


def patch_size(which: slice = ALL) -> Panel:
    """Return the panel (diagram) of errors over the patch size. 3 × 3 Fourier coefficients fail for large patches.

    Sums over fixed wavelengths at steps of 5 nm miss diffraction orders, whatever the size of the patch is.
    """
    lights, views = (tilted_up(directions) for directions in methods.hemisphere_pairs(48))
    window, x, points = wd.Coherence(), (2.0, 3.0, 5.0, 8.0, 12.5, 20.0, 32.0, 50.0, 70.0, 100.0)[which], Points()
    for size in x:
        points.start()
        heightfield = wd.gratings.fingers(size_um=size, pitch_um=0.09, length_um=min(3.0, size), seed=4)
        exact = reference.reference_reflectance(heightfield, lights, views, window)
        points.fixed_steps(heightfield, lights, views, window, exact)
        points.neighbourhoods(heightfield, lights, views, 16.25, 1.0)
        points.automatic(heightfield, lights, views, window, exact)
    return points.panel("patch", "side of the patch [µm]", x, "fingers, σ = 16.25 µm", (2, 5, 10, 20, 50, 100))


def tilted_up(directions: np.ndarray) -> np.ndarray:
    """Return directions within 30° of the normal. This limits the number of Fourier coefficients of large patches."""
    moved = directions * [0.5, 0.5, 1.0]
    moved[:, 2] = np.sqrt(1.0 - moved[:, 0] ** 2 - moved[:, 1] ** 2)
    return moved


def order_rate(which: slice = ALL) -> Panel:
    """Return the panel (diagram) of errors over the distance from the mirror direction.

    Fixed wavelengths are too coarse far from the mirror direction. The method with one wavelength per Fourier
    coefficient fails near the mirror direction, where one coefficient dominates at all visible wavelengths.
    """
    x = (0.003, 0.006, 0.012, 0.025, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0, 1.4, 1.8, 1.98)[which]
    heightfield, window, points = wd.gratings.fingers(size_um=25.6, pitch_um=0.09, seed=4), wd.Coherence(), Points()
    for seed, across in enumerate(x):
        points.start()
        lights, views = methods.with_lateral(64, across, seed)
        exact = reference.reference_reflectance(heightfield, lights, views, window)
        points.fixed_steps(heightfield, lights, views, window, exact)
        one_point = methods.order_wise_colour(heightfield, lights, views, sigma=16.25)
        points.add(ORDER_WISE, methods.colour_error(one_point, exact))
        points.automatic(heightfield, lights, views, window, exact)
    ticks = (0.01, 0.03, 0.1, 0.3, 1, 2)
    return points.panel("distance from the mirror", "|(u, v)|", x, "fingers, 25.6 µm", ticks)


def grazing(which: slice = ALL) -> Panel:
    """Return the panel (diagram) of errors over the elevation of light and view above the horizon.

    In float32, the sum 1 + ωi·ωr of the unit vectors ωi to the light and ωr to the viewer loses digits near the
    horizon. One method omits the factor cos θi, by which a light source is foreshortened. The error of this method
    grows towards the horizon without limit.
    """
    window, source = wd.Coherence(), wd.Coherence("source")
    heightfield = wd.gratings.fingers(size_um=6.4, pitch_um=0.08, seed=4)
    x, points = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 15.0, 45.0)[which], Points()
    wavelengths, weights = methods.fixed_steps(1.0)
    for seed, elevation in enumerate(x):
        points.start()
        # Errors of dark colours are relative to the floor f, which is a share of the largest luminances of a call.
        # Directions near the mirror direction have bright colours, which raise the floor and thus hide errors of dark
        # colours. Views near the mirror direction and views in all directions are therefore evaluated by two separate
        # calls, and the larger error is drawn.
        for spread in (0.1, None):
            lights, views = methods.at_elevation(48, elevation, spread, seed)
            same = reference.reference_spectral(heightfield, lights, views, wavelengths * 1e-3, window)
            single = methods.single_precision(heightfield, lights, views, wavelengths * 1e-3, sigma=16.25)
            points.add(SINGLE, methods.colour_error(single @ weights, same @ weights))
            exact = reference.reference_reflectance(heightfield, lights, views, window)
            points.fixed_steps(heightfield, lights, views, window, exact)
            points.automatic(heightfield, lights, views, window, exact)
            exact = reference.reference_reflectance(heightfield, lights, views, source)
            if spread is not None:
                facing = methods.unforeshortened_colour(heightfield, lights, views, source)
                points.add(FACING, methods.colour_error(facing, exact))
            points.automatic(heightfield, lights, views, source, exact, AUTOMATIC_SOURCE)
    axis, ticks = "elevation of both above the horizon [°]", (0.1, 0.3, 1, 3, 10, 45)
    return points.panel("grazing light and view", axis, x, "fingers, 6.4 µm", ticks)


def sine_colour(period: float, depth: float, lights: np.ndarray, views: np.ndarray, sigma: float) -> np.ndarray:
    """Return XYZ of a continuous sine grating in the plane of incidence.

    Order m has the power J_m(πκ·depth)², where J_m is a Bessel function and κ = w/λ.
    """
    tau, weights = reference.quadrature(512, "D65")
    scattering_vectors = -(lights + views)
    total = np.zeros((len(lights), len(tau)))
    theta = 2.0 * math.pi * np.arange(256) / 256
    wave = np.exp(1j * math.pi * depth * scattering_vectors[:, 2][:, None, None] * tau[:, None] * np.sin(theta))
    orders = np.fft.fft(wave, axis=-1) / len(theta)
    for m in range(-40, 41):
        away = scattering_vectors[:, :1] * tau - m / period
        total += np.abs(orders[..., m]) ** 2 * np.exp(-4.0 * (math.pi * sigma * away) ** 2)
    return np.asarray(reference.gain(lights, views)[:, None] * total @ weights)


def pitch(which: slice = ALL) -> Panel:
    """Return the panel (diagram) of errors over the sample spacing (pitch) of the heights.

    If the pitch is too coarse, methods that use the height samples unchanged have large errors by aliasing. Resampling
    to 0.02 µm before the call reduces the error.
    """
    period, depth, sigma = 1.6, 0.3, 3.0
    window, (lights, views) = wd.Coherence(sigma_um=sigma), methods.in_plane(64, 1.9)
    exact = sine_colour(period, depth, lights, views, sigma)
    samples, points = (80, 56, 40, 32, 26, 22, 20, 18, 16, 14, 12, 10, 8, 6, 4)[which], Points()
    for count in samples:
        points.start()
        heightfield = wd.gratings.sinusoidal(period, depth, samples=count)
        points.add(
            SAMPLED, methods.colour_error(reference.reference_reflectance(heightfield, lights, views, window), exact)
        )
        points.automatic(heightfield.resampled(0.02), lights, views, window, exact, RESAMPLED)
        points.automatic(heightfield, lights, views, window, exact)
    limit = 0.38 / (2.0 * np.abs((lights + views)[:, 0]).max())
    note, ticks = f"sine; limit {limit:.2f} µm", (0.02, 0.05, 0.1, 0.2, 0.4)
    return points.panel("pitch at its limit", "pitch [µm]", period / np.array(samples), note, ticks)


def periods(which: slice = ALL) -> Panel:
    """Return the panel (diagram) of errors for replicated patches: a thousand equal periods interfere.

    The phase between neighbouring periods is nearly a whole number of turns. The x axis is the difference from this
    whole number.
    """
    count, wavelength = 1000, 0.5
    heightfield, coherence = methods.finger_rows(6.4, pitch_um=0.08), wd.Coherence("replicas", periods=(1, count))
    x, points = 10.0 ** np.arange(-9.0, -0.4, 0.5)[which], Points()
    for away in x.tolist():
        points.start()
        lights, views = methods.near_resonance(heightfield, away, wavelength)
        scattering_vectors, gain = -(lights + views), reference.gain(lights, views)
        # The phase between neighbouring periods is computed from the same vectors as in the reference. Both phases
        # therefore have the same rounding errors.
        turns = scattering_vectors[:, 0] / wavelength * heightfield.size_um[1]
        exact, patch = (
            direct_sum.window_power(heightfield, kind, scattering_vectors, np.array([wavelength]))[:, 0]
            for kind in (coherence, wd.Coherence("replicas", periods=(1, 1)))
        )
        nearest = np.array(
            [methods.nearest_orders_power(heightfield, vector, wavelength, 3) for vector in scattering_vectors]
        )
        rho = wd.spectral_reflectance(
            heightfield, lights, views, 1e3 * wavelength, coherence=coherence, tolerance=TOLERANCE
        )
        for name, power in {
            PQ: methods.published_replicas(turns, count, np.float32) * patch,
            PQ64: methods.published_replicas(turns, count) * patch,
            PLAIN: methods.plain_replicas(turns, count, np.float32) * patch,
            NEAREST: nearest * (exact / patch),
            AUTOMATIC: rho[:, 0] / gain,
        }.items():
            points.add(name, methods.spectral_error(power, exact))
    axis, ticks = "distance from a resonance [orders]", (1e-9, 1e-7, 1e-5, 1e-3, 1e-1)
    return points.panel(f"{count} periods near resonance", axis, x, "line of 6.4 µm, spectra", ticks)


def wavelength_steps(which: slice = ALL) -> Panel:
    """Return the panel (diagram) of errors over the step between wavelengths, for plain sums over wavelengths."""
    lights, views = methods.hemisphere_pairs(64)
    x, points, cases = (1.0, 2.0, 4.0, 5.0, 8.0, 10.0, 16.0, 20.0, 25.0, 40.0, 50.0)[which], Points(), []
    for name, size, sigma in (("", 25.6, 16.25), (SMALL, 3.2, 2.0)):
        heightfield, window = wd.gratings.fingers(size_um=size, pitch_um=0.09, seed=4), wd.Coherence(sigma_um=sigma)
        cases.append((name, heightfield, window, reference.reference_reflectance(heightfield, lights, views, window)))
    for step in x:
        points.start()
        for name, heightfield, window, exact in cases:
            fixed = methods.fixed_step_colour(heightfield, lights, views, step, window)
            equal = methods.wavenumber_colour(heightfield, lights, views, round(400.0 / step) + 1, window)
            points.add(EQUAL + name, methods.colour_error(fixed, exact))
            points.add(CUBICS + name, methods.colour_error(equal, exact))
            # The automatic choice does not depend on the wavelength step. The curve of the automatic choice is
            # constant, and shows the larger error of the panel's two surfaces.
            points.automatic(heightfield, lights, views, window, exact)
    return points.panel(
        "wavelength steps", "step [nm]", x, "fingers, 25.6 µm, σ 16.25 µm; small: 3.2, 2", (1, 2, 5, 10, 20, 50)
    )


REGIMES = (height_range, window_width, patch_size, order_rate, grazing, pitch, periods, wavelength_steps)
