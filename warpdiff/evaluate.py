"""The reflectance at arrays of directions: XYZ, spectra, the absolute BRDF, and maps over the hemisphere."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff import checks, direct, optics, spectrum
from warpdiff.coherence import Coherence
from warpdiff.device import launch, resolve_device, resolve_threads
from warpdiff.image import Image
from warpdiff.planning import Plan, broadcast_directions, check_request, deflection_range, plan_for_range, warn_outside
from warpdiff.tables import quadrature_for, table_for

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield import HeightField

# The direct method halves its step in 1/λ until XYZ moves by less than this share of the tolerance.
_DIRECT_SETTLED = 0.05
_DIRECT_MOST_WAVELENGTHS = 20_000


def spectral_reflectance(
    hf: HeightField,
    to_light: ArrayLike,
    to_view: ArrayLike,
    wavelengths_nm: ArrayLike,
    *,
    tolerance: float = 1e-2,
    method: str = "auto",
    coherence: Coherence | None = None,
    ior: float = 1.5,
    masking: bool = True,
    plan: Plan | None = None,
    strict: bool = True,
    device: Any = None,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> NDArray[Any]:
    """Relative reflectance ρ(λ): 1 for a flat mirror seen in the mirror direction at normal incidence.

    ρ = C·M·⟨|P|²⟩ (Single 2014, eq. 3.16, with the corrections of ``docs/decisions.md``). It is a ratio of radiances,
    without a further cosine, and is not bounded by 1.

    Args:
        hf: The height field.
        to_light: Directions to the light in the local frame, shape (3,) or (n, 3); normalised here.
        to_view: Directions to the viewer, the same; one and many broadcast.
        wavelengths_nm: Wavelengths [nm], shape (m,) or one number.
        tolerance: Largest |Δρ| against max(ρ, 1e-3 · 99th percentile of the call).
        method: ``"auto"``, a series (``"jacobi-anger"``, ``"taylor"``, ``"taylor-uncentred"``), or ``"direct"``
            (float64, slow and certain).
        coherence: The window; None is averaged with σ = 16.25 µm.
        ior: Index of refraction, > 1; ``math.inf`` is a perfect mirror.
        masking: Whether V-cavity masking and shadowing is included.
        plan: An explicit plan in place of ``tolerance``, ``method`` and ``coherence``; implies ``strict=False``.
        strict: Raise where the tolerance cannot be met, rather than warn.
        device: ``"cpu"`` (None) or a CUDA device.
        threads: Threads on the CPU; None is one a core.
        progress: Called with the share that is done, 0 to 1, from whichever thread did it, one at a time.

    Returns:
        ρ, shape (n, m), or (m,) for single directions; float32, float64 for ``"direct"``; 0 where a direction is
        at or below the horizon.
    """
    check_call(
        hf, tolerance=tolerance, method=method, coherence=coherence, masking=masking, strict=strict, device=device,
        threads=threads, progress=progress,
    )  # fmt: skip
    wavelengths = spectrum.check_wavelengths(wavelengths_nm)
    lights, views, single = broadcast_directions(to_light, to_view)
    normal = optics.normal_reflectance(ior)
    used = _plan(
        hf, lights, views, tolerance=tolerance, method=method, coherence=coherence, plan=plan, strict=strict,
        wavelengths_nm=wavelengths,
    )  # fmt: skip
    if used.method == "direct":
        gains = optics.gain(lights, views, normal=normal, masking=masking)
        result: NDArray[Any] = np.zeros((len(lights), len(wavelengths)))
        lit = gains > 0.0
        power = direct.window_power(hf, used.coherence, -(lights + views)[lit], wavelengths * 1e-3, progress=progress)
        result[lit] = gains[lit, None] * power
    else:
        result = _run(
            hf, lights, views, normal, masking, used, 1e3 / wavelengths,
            device=device, threads=threads, progress=progress,
        )  # fmt: skip
    return result[0] if single else result


def reflectance(
    hf: HeightField,
    to_light: ArrayLike,
    to_view: ArrayLike,
    *,
    illuminant: str = "D65",
    tolerance: float = 1e-2,
    method: str = "auto",
    coherence: Coherence | None = None,
    ior: float = 1.5,
    masking: bool = True,
    plan: Plan | None = None,
    strict: bool = True,
    device: Any = None,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> NDArray[Any]:
    """Colour of the reflectance: ∫ ρ S x̄ȳz̄ dλ / ∫ S ȳ dλ over 380 to 780 nm (Single 2014, eq. 3.20).

    Args:
        hf: The height field.
        to_light: Directions to the light in the local frame, shape (3,) or (n, 3); normalised here.
        to_view: Directions to the viewer, the same; one and many broadcast.
        illuminant: A name in colour-science's ``SDS_ILLUMINANTS``.
        tolerance: Error of XYZ against max(‖XYZ‖, 1e-3 · 99th percentile of Y), in 99 % of the call's directions.
        method: ``"auto"``, a series (``"jacobi-anger"``, ``"taylor"``, ``"taylor-uncentred"``), or ``"direct"``
            (float64, slow and certain).
        coherence: The window; None is averaged with σ = 16.25 µm.
        ior: Index of refraction, > 1; ``math.inf`` is a perfect mirror.
        masking: Whether V-cavity masking and shadowing is included.
        plan: An explicit plan in place of ``tolerance``, ``method`` and ``coherence``; implies ``strict=False``.
        strict: Raise where the tolerance cannot be met, rather than warn.
        device: ``"cpu"`` (None) or a CUDA device.
        threads: Threads on the CPU; None is one a core.
        progress: Called with the share that is done, 0 to 1, from whichever thread did it, one at a time.

    Returns:
        CIE XYZ, shape (n, 3), or (3,) for single directions; float32, float64 for ``"direct"``; a flat mirror at
        normal incidence gives the illuminant's white, Y = 1.
    """
    check_call(
        hf, tolerance=tolerance, method=method, coherence=coherence, masking=masking, strict=strict, device=device,
        threads=threads, progress=progress,
    )  # fmt: skip
    spectrum.check_illuminant(illuminant)
    lights, views, single = broadcast_directions(to_light, to_view)
    result, _ = _reflectance(
        hf, lights, views, illuminant=illuminant, tolerance=tolerance, method=method, coherence=coherence, ior=ior,
        masking=masking, plan=plan, strict=strict, device=device, threads=threads, progress=progress,
    )  # fmt: skip
    return result[0] if single else result


def brdf_map(
    hf: HeightField,
    to_light: ArrayLike,
    *,
    size: int = 512,
    illuminant: str = "D65",
    tolerance: float = 1e-2,
    method: str = "auto",
    coherence: Coherence | None = None,
    ior: float = 1.5,
    masking: bool = True,
    plan: Plan | None = None,
    strict: bool = True,
    device: Any = None,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Image:
    """Colour of the reflectance over all view directions, seen from above.

    The picture is the unit disc of (sin θr cos φr, sin θr sin φr): x to the right, y up.

    Args:
        hf: The height field.
        to_light: Direction to the light in the local frame, shape (3,), above the horizon.
        size: Width and height of the picture [pixels].
        illuminant: As in :func:`reflectance`.
        tolerance: As in :func:`reflectance`; the disc's pixels are the directions of the call.
        method: As in :func:`reflectance`.
        coherence: As in :func:`reflectance`.
        ior: As in :func:`reflectance`.
        masking: As in :func:`reflectance`.
        plan: As in :func:`reflectance`.
        strict: As in :func:`reflectance`.
        device: As in :func:`reflectance`.
        threads: As in :func:`reflectance`.
        progress: As in :func:`reflectance`.

    Returns:
        The map; its mask is the inside of the disc.
    """
    check_call(
        hf, tolerance=tolerance, method=method, coherence=coherence, masking=masking, strict=strict, device=device,
        threads=threads, progress=progress,
    )  # fmt: skip
    spectrum.check_illuminant(illuminant)
    light, single = checks.directions(to_light, "to_light")
    if not single:
        raise ValueError(f"to_light must have shape (3,) for a map, got {np.shape(to_light)}")
    if light[0, 2] <= optics.HORIZON:
        raise ValueError(f"to_light must lie above the horizon (z > 0), got {np.asarray(to_light).tolist()}")
    size = checks.count(size, "size", least=2)
    axis = (2.0 * np.arange(size) + 1.0) / size - 1.0
    x, y = np.meshgrid(axis, -axis)
    radius2 = x * x + y * y
    mask = radius2 < 1.0
    views = np.stack([x[mask], y[mask], np.sqrt(1.0 - radius2[mask])], axis=1)
    values, used = _reflectance(
        hf, np.broadcast_to(light, views.shape), views, illuminant=illuminant, tolerance=tolerance, method=method,
        coherence=coherence, ior=ior, masking=masking, plan=plan, strict=strict, device=device, threads=threads,
        progress=progress,
    )  # fmt: skip
    xyz = np.zeros((size, size, 3), dtype=np.float32)
    xyz[mask] = values
    return Image(xyz=xyz, mask=mask, lit=mask, coverage=mask.astype(np.float32), plan=used)


def brdf(
    hf: HeightField,
    to_light: ArrayLike,
    to_view: ArrayLike,
    wavelengths_nm: ArrayLike,
    *,
    tolerance: float = 1e-2,
    method: str = "auto",
    coherence: Coherence | None = None,
    ior: float = 1.5,
    plan: Plan | None = None,
    strict: bool = True,
    device: Any = None,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> NDArray[Any]:
    """Absolute BRDF [1/sr] (Stam 1999), never masked.

    R(θd) · (1 + ωi·ωr)² / (cos θi cos θr λ² w²) · 4πσ² ⟨|P|²⟩, where 4πσ² ⟨|P|²⟩ is |∫ g e^{ik(wh + ux + vy)}|² / ∫ g².
    It is reciprocal. Scalar diffraction does not conserve energy exactly: the sum over the orders exceeds R a little
    for shallow profiles, and a lot for short periods at grazing angles.

    Args:
        hf: The height field.
        to_light: As in :func:`spectral_reflectance`.
        to_view: As in :func:`spectral_reflectance`.
        wavelengths_nm: As in :func:`spectral_reflectance`.
        tolerance: As in :func:`spectral_reflectance`.
        method: As in :func:`spectral_reflectance`.
        coherence: As in :func:`spectral_reflectance`.
        ior: As in :func:`spectral_reflectance`.
        plan: As in :func:`spectral_reflectance`.
        strict: As in :func:`spectral_reflectance`.
        device: As in :func:`spectral_reflectance`.
        threads: As in :func:`spectral_reflectance`.
        progress: As in :func:`spectral_reflectance`.

    Returns:
        Shape (n, m), or (m,) for single directions; float32, float64 for ``"direct"``.
    """
    relative = spectral_reflectance(
        hf, to_light, to_view, wavelengths_nm, tolerance=tolerance, method=method, coherence=coherence, ior=ior,
        masking=False, plan=plan, strict=strict, device=device, threads=threads, progress=progress,
    )  # fmt: skip
    lights, _, single = broadcast_directions(to_light, to_view)
    sigma = (plan.coherence if plan is not None else coherence or Coherence()).sigma_um
    wavelengths_um = spectrum.check_wavelengths(wavelengths_nm) * 1e-3
    cos_i = np.where(lights[:, 2] > optics.HORIZON, lights[:, 2], 1.0)
    scale = optics.normal_reflectance(ior) * 4.0 * math.pi * sigma**2 / (cos_i[:, None] * wavelengths_um**2)
    return np.asarray(relative * (scale[0] if single else scale).astype(relative.dtype))


def _plan(
    hf: HeightField,
    lights: NDArray[np.float64],
    views: NDArray[np.float64],
    *,
    tolerance: float,
    method: str,
    coherence: Coherence | None,
    plan: Plan | None,
    strict: bool,
    wavelengths_nm: NDArray[np.float64] | None,
) -> Plan:
    """The given plan, or one for these directions."""
    max_uv, max_w = deflection_range(-lights - views, (lights[:, 2] > 0.0) & (views[:, 2] > 0.0))
    if plan is not None:
        check_plan(plan, coherence, colour=wavelengths_nm is None)
        lambda_min_nm = spectrum.LAMBDA_MIN_NM if wavelengths_nm is None else float(wavelengths_nm.min())
        warn_outside(plan, hf, max_uv, max_w, lambda_min_nm)
        return plan
    return plan_for_range(
        hf, max_uv, max_w, tolerance=tolerance, method=method, coherence=coherence or Coherence(), strict=strict,
        wavelengths_nm=wavelengths_nm,
    )  # fmt: skip


def check_call(
    hf: Any,
    *,
    tolerance: Any,
    method: Any,
    coherence: Any,
    masking: Any,
    strict: Any,
    device: Any,
    threads: Any,
    progress: Any,
) -> None:
    """Refuse what the evaluating functions have in common, before anything is computed."""
    check_request(hf, tolerance=tolerance, method=method, coherence=coherence, strict=strict)
    checks.flag(masking, "masking")
    checks.callback(progress, "progress")
    resolve_threads(threads)
    resolve_device(device)


def check_plan(plan: Plan, coherence: Coherence | None, *, colour: bool) -> Plan:
    """Return an explicit plan if the call can use it."""
    if not isinstance(plan, Plan):
        raise TypeError(f"plan must be a warpdiff.Plan, such as warpdiff.plan(hf) returns, got {type(plan).__name__}")
    if coherence is not None and coherence != plan.coherence:
        raise ValueError("coherence differs from the one in plan=; give one of them, or dataclasses.replace the plan's")
    if colour and plan.wavelengths == 0:
        raise ValueError("plan has no wavelengths, it was made for given ones; make one with warpdiff.plan(hf)")
    return plan


def _reflectance(
    hf: HeightField,
    lights: NDArray[np.float64],
    views: NDArray[np.float64],
    *,
    illuminant: str,
    tolerance: float,
    method: str,
    coherence: Coherence | None,
    ior: float,
    masking: bool,
    plan: Plan | None,
    strict: bool,
    device: Any,
    threads: int | None,
    progress: Callable[[float], None] | None,
) -> tuple[NDArray[Any], Plan]:
    """XYZ of broadcast unit directions, shape (n, 3), and the plan."""
    normal = optics.normal_reflectance(ior)
    used = _plan(
        hf, lights, views, tolerance=tolerance, method=method, coherence=coherence, plan=plan, strict=strict,
        wavelengths_nm=None,
    )  # fmt: skip
    if used.method == "direct":
        gains = optics.gain(lights, views, normal=normal, masking=masking)
        return direct_colour(hf, -lights - views, gains, used, illuminant, progress=progress), used
    result = _run(
        hf, lights, views, normal, masking, used, illuminant,
        device=device, threads=threads, progress=progress,
    )  # fmt: skip
    return result, used


def direct_colour(
    hf: HeightField,
    deflections: NDArray[np.float64],
    gains: NDArray[np.float64],
    plan: Plan,
    illuminant: str,
    *,
    progress: Callable[[float], None] | None = None,
) -> NDArray[np.float64]:
    """XYZ by the direct sum: the step in 1/λ is halved until XYZ settles to a twentieth of the tolerance."""
    result = np.zeros((len(gains), 3))
    lit = np.flatnonzero(gains > 0.0)
    for done, i in enumerate(lit):
        count = plan.wavelengths
        wavelengths = spectrum.wavelengths_uniform_in_wavenumber(count)
        values = direct.window_power(hf, plan.coherence, deflections[i : i + 1], wavelengths * 1e-3)[0]
        colour = values @ spectrum.quadrature_weights(wavelengths, illuminant)
        while 2 * count < _DIRECT_MOST_WAVELENGTHS:
            count = 2 * count - 1
            finer = spectrum.wavelengths_uniform_in_wavenumber(count)
            refined = np.empty(count)
            refined[::2] = values
            refined[1::2] = direct.window_power(hf, plan.coherence, deflections[i : i + 1], finer[1::2] * 1e-3)[0]
            values, before = refined, colour
            colour = values @ spectrum.quadrature_weights(finer, illuminant)
            if np.linalg.norm(colour - before) <= _DIRECT_SETTLED * plan.tolerance * np.linalg.norm(colour):
                break
        result[i] = gains[i] * colour
        if progress is not None:
            progress((done + 1) / len(lit))
    return result


def _run(
    hf: HeightField,
    lights: NDArray[np.float64],
    views: NDArray[np.float64],
    normal: float,
    masking: bool,
    plan: Plan,
    what: NDArray[np.float64] | str,
    *,
    device: Any,
    threads: int | None,
    progress: Callable[[float], None] | None,
) -> NDArray[np.float32]:
    """Evaluate on a device: ρ at each of ``what``, wavenumbers [1/µm], or XYZ under ``what``, an illuminant."""
    target = resolve_device(device)
    workers = resolve_threads(threads)
    import warp as wp

    from warpdiff.kernels import directions as kernels

    max_uv, max_w = deflection_range(-lights - views, (lights[:, 2] > 0.0) & (views[:, 2] > 0.0))
    largest = 1e3 / spectrum.LAMBDA_MIN_NM if isinstance(what, str) else float(what.max())
    table = table_for(hf, plan, max_uv, max_w, largest, device=target, threads=workers)
    count = len(lights)
    reflection = kernels.Reflection()
    reflection.normal_reflectance = normal
    reflection.masking = masking
    deflections = wp.empty(count, dtype=wp.vec3d, device=target)
    gains = wp.empty(count, dtype=wp.float32, device=target)
    launch(
        kernels.deflect_directions, count,
        [wp.array(lights, dtype=wp.vec3d, device=target), wp.array(views, dtype=wp.vec3d, device=target), reflection],
        [deflections, gains], device=target, threads=workers,
    )  # fmt: skip
    if isinstance(what, str):
        kernel = table.integrate
        samples = quadrature_for(hf, plan, what, device=target)
        result = wp.zeros(count, dtype=wp.vec3f, device=target)
    else:
        kernel = table.sample
        samples = wp.array(what, dtype=wp.float64, device=target)
        result = wp.empty((count, len(what)), dtype=wp.float32, device=target)
    inputs = [table.arguments, deflections, gains, samples]
    launch(kernel, count, inputs, [result], device=target, threads=workers, progress=progress)
    return np.asarray(result.numpy())
