"""The published algorithm (Single 2014), as a program in Dr.Jit that LLVM compiles for the CPU.

Dr.Jit is the compiler of Jakob et al. (2022). Directions are vectorised. The loop over wavelengths is a loop in the
compiled code. The loops over neighbouring Fourier coefficients and over terms of the Taylor series are unrolled. The
terms of a coefficient are loaded in packets of contiguous floats, which LLVM transposes. The terms are stored with the
factors 1/n!, so that Horner's rule can evaluate the series. Horner's rule requires 10 % less time than a separate
computation of each power.

The module requires LLVM's shared library. Dr.Jit finds it by its usual names or through ``DRJIT_LIBLLVM_PATH``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.peers.series import PUBLISHED, SETTINGS, Series, series

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    import warpdiff as wd

__all__ = ["PUBLISHED", "SETTINGS", "available", "prepare"]

# Number of terms of a Fourier coefficient's Taylor series that are loaded at a time. The value is limited by the number
# of vector registers.
PACKET = 8
# Number of floats per cache line. The number is derived from cache lines of 64 bytes.
LINE = 16


def available() -> str | None:
    """Return None, or the reason why Dr.Jit cannot run."""
    try:
        import drjit
    except ImportError:
        return "Dr.Jit is not installed: pip install drjit"
    if not drjit.has_backend(drjit.JitBackend.LLVM):
        return "Dr.Jit finds no LLVM: install it, or set DRJIT_LIBLLVM_PATH to libLLVM.so"
    return None


def prepare(heightfield: wd.HeightField, coherence: wd.Coherence, **setting: Any) -> Callable[..., NDArray[np.float32]]:
    """Return a function that computes colours of directions, for one setting of :func:`bench.peers.series.series`.

    Args:
        heightfield: Height field.
        coherence: Gaussian coherence window, of the kind averaged or centred.
        setting: One of ``SETTINGS``: numbers of wavelengths, of terms and of neighbouring Fourier coefficients.

    Returns:
        A function ``shade(scattering_vectors, gains, threads)`` of arrays (n, 3) and (n,) that returns XYZ (n, 3). The
        first call with a new number n of directions compiles the function.
    """
    import drjit as dr
    from drjit.llvm import Float

    made = series(heightfield, coherence, **setting)
    terms = made.rows.shape[2]
    rows = made.rows / np.array([math.factorial(n) for n in range(terms)], dtype=np.float64)
    rows = np.pad(rows, ((0, 0), (0, 0), (0, -terms % PACKET)))
    tables = [Float(_aligned(values.ravel())) for values in (rows, made.wavenumbers, made.colours)]
    dr.eval(*tables)

    def shade(scattering_vectors: NDArray[np.float64], gains: NDArray[np.float64], threads: int) -> NDArray[np.float32]:
        if dr.thread_count() != threads:
            dr.set_thread_count(threads)
        u, v, w, gain = (Float(_aligned(values)) for values in (*scattering_vectors.T, gains))
        xyz = _integral(made, tables, u, v, w)
        colours = [gain * component for component in xyz]
        dr.eval(*colours)
        return np.stack([component.numpy() for component in colours], axis=1)

    return shade


def _aligned(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return a float32 copy of an array that starts at a cache line. Dr.Jit compiles again if the alignment changes."""
    memory = np.empty(len(values) + LINE, dtype=np.float32)
    first = -memory.ctypes.data // memory.itemsize % LINE
    memory[first : first + len(values)] = values
    return memory[first : first + len(values)]


def _integral(made: Series, tables: list[Any], u: Any, v: Any, w: Any) -> tuple[Any, Any, Any]:
    """Return XYZ of directions before multiplication by geometry factors (gains), as Dr.Jit arrays."""
    import drjit as dr
    from drjit.llvm import ArrayXf, Float, Int, UInt

    rows, wavenumbers, colours = tables
    packets = math.ceil(made.rows.shape[2] / PACKET)
    # `factors` has the factors of the Taylor series that depend on the wavelength λ. Its second column is the linear
    # factor 2πa/λ, where a is the scale of the heights. Division by 1/λ gives 2πa.
    scale = float(made.factors[0, 1] / made.wavenumbers[0])
    steps = range(-made.neighbour_extent, made.neighbour_extent + 1)

    def weights(q: Any, near: Any, falloff: float) -> list[Any]:
        return [dr.exp(-falloff * dr.square(near - q + step)) for step in steps]

    def coefficient(at: Any, x: Any) -> list[Any]:
        """Return real and imaginary parts of the Fourier coefficients ``at`` (indices), for x = 2πaw/λ.

        Here a is the scale of the heights, as in :class:`bench.peers.series.Series`.
        """
        parts = []
        for part in (2 * at, 2 * at + 1):
            value = Float(0.0)
            for packet in reversed(range(packets)):
                loaded = dr.gather(ArrayXf, rows, part * packets + packet, shape=(PACKET, dr.width(at)))
                for n in reversed(range(PACKET)):
                    value = dr.fma(value, x, loaded[n])
            parts.append(value)
        return parts

    def add(k: Any, *xyz: Any) -> tuple[Any, ...]:
        wavenumber = dr.gather(Float, wavenumbers, k)
        qy, qx = v * made.lengths_um[0] * wavenumber, u * made.lengths_um[1] * wavenumber
        near_y, near_x = dr.floor(qy + made.shift), dr.floor(qx + made.shift)
        along_y, along_x = weights(qy, near_y, made.falloff[0]), weights(qx, near_x, made.falloff[1])
        middle = (Int(near_y) + made.origin[0]) * made.columns + Int(near_x) + made.origin[1]
        x = w * wavenumber * scale
        power, re, im = Float(0.0), Float(0.0), Float(0.0)
        for weight_y, j in zip(along_y, steps, strict=True):
            for weight_x, m in zip(along_x, steps, strict=True):
                amplitude = coefficient(UInt(middle + (j * made.columns + m)), x)
                weight = weight_y * weight_x
                if made.powers:
                    power = dr.fma(weight, dr.fma(amplitude[0], amplitude[0], amplitude[1] * amplitude[1]), power)
                else:
                    re, im = dr.fma(weight, amplitude[0], re), dr.fma(weight, amplitude[1], im)
        if not made.powers:
            power = re * re + im * im
        return k + 1, *(dr.fma(power, dr.gather(Float, colours, 3 * k + c), total) for c, total in enumerate(xyz))

    count = len(made.wavenumbers)
    start = (UInt(0), Float(0.0), Float(0.0), Float(0.0))
    return dr.while_loop(start, lambda k, *_: k < count, add, mode="symbolic")[1:]
