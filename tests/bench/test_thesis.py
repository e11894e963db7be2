"""The period of the blazed grating, as ``bench.reproduce.thesis`` measures it from the angles of the first order."""

import numpy as np
import pytest

import warpdiff as wd
from bench.reproduce import thesis


@pytest.mark.parametrize("coherence", [None, wd.Coherence("source")])
def test_the_blazed_grating_has_a_period_of_2500_nm(coherence):
    periods = thesis.blazed_period(coherence=coherence)
    assert len(periods) == 401
    assert np.abs(periods - 2500.0).max() < 1.0


def test_the_grating_equation_reproduces_the_view_angles():
    angles = thesis.view_angles(2000.0, 1000.0, 3, np.array(500.0))
    assert thesis.periods_at(angles, np.array(500.0)) == pytest.approx([2000.0, 1500.0, 1000.0])
