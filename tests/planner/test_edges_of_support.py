"""Plans near the limits of support: the largest neighbourhood, and the Nyquist limit of the pitch.

The neighbourhood of a direction is the set of Fourier coefficients that contribute to it. The pitch is the distance of
height samples.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

from types import SimpleNamespace

import pytest

import warpdiff as wd
from warpdiff.planner import refusals


@pytest.mark.parametrize(("extent", "supported"), [((100, 99), True), ((100, 100), False)])
def test_neighbourhoods_of_more_than_40000_coefficients_are_refused(fingers, monkeypatch, extent, supported):
    """A neighbourhood of at most 40,000 coefficients must be accepted, and a larger one refused.

    The neighbourhood of a direction is the set of Fourier coefficients that contribute to it.

    Extents of 100 and 99 coefficients to either side give 201 × 199 coefficients, which is within the limit. A
    neighbourhood of 201 × 201 coefficients exceeds it.
    """
    monkeypatch.setattr(refusals.coefficient_table, "neighbour_extent", lambda _plan, _heightfield: extent)
    plan = SimpleNamespace(coherence=wd.Coherence(sigma_um=3.0))
    if supported:
        refusals._check_neighbours(fingers, plan)
    else:
        with pytest.raises(ValueError, match=r"sigma_um=3\.0 is too short.* covers 201 × 201 coefficients"):
            refusals._check_neighbours(fingers, plan)


@pytest.mark.parametrize(
    ("coherence", "method", "radius"),
    [
        (wd.Coherence("centred", sigma_um=4.0, centre_um=(3.0, 3.0)), "low-rank", 0.5),
        (wd.Coherence("centred", sigma_um=4.0, centre_um=(3.0, 3.0)), "direct", 0.0),
        (wd.Coherence(sigma_um=4.0), "low-rank", 0.0),
    ],
    ids=["a window between samples", "a direct sum", "all windows"],
)
def test_directions_beyond_the_nyquist_limit_warn(monkeypatch, recwarn, coherence, method, radius):
    """Directions must cause a warning if |(u, v)| exceeds the highest supported frequency times the wavelength.

    This frequency is the Nyquist frequency, 2/µm for a pitch of 0.25 µm. For coherence windows centred between height
    samples, it is lower by the radius of the neighbourhood.
    """
    heightfield = wd.HeightField([[0.0, 0.1, 0.2, 0.1]], pitch_um=0.25)
    monkeypatch.setattr(refusals.coefficient_table, "radius", lambda _plan: 0.5)
    plan = SimpleNamespace(coherence=coherence, method=method)
    limit = 0.4 * (2.0 - radius)
    within, beyond = (SimpleNamespace(lambda_min_nm=400.0, max_uv=share * limit) for share in (0.999, 1.001))
    refusals.warn_of_aliasing(heightfield, plan, within)
    assert not recwarn.list
    with pytest.warns(wd.WarpdiffWarning, match=rf"supports \|\(u, v\)\| up to {limit:.3g} at 400 nm"):
        refusals.warn_of_aliasing(heightfield, plan, beyond)


@pytest.mark.parametrize(
    ("coherence", "name"),
    [
        (wd.Coherence("source", angular_diameter_deg=1e-15), "angular_diameter_deg"),
        (wd.Coherence(sigma_um=1e15), "sigma_um"),
    ],
)
def test_too_long_a_coherence_is_refused_by_its_argument_name(coherence, name):
    heightfield = wd.gratings.sinusoidal(2.0, 0.1)
    for call in (lambda: wd.plan(heightfield, coherence=coherence), lambda: wd.bake(heightfield, coherence=coherence)):
        with pytest.raises(wd.ToleranceError, match=f"^{name}=1e.?15|^{name}=1000000000000000"):
            call()
