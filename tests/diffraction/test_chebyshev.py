"""Chebyshev interpolation reproduces polynomials and the values at its nodes."""

import numpy as np
import pytest

from warpdiff.diffraction import chebyshev


@pytest.mark.parametrize("count", [1, 2, 9])
def test_polynomials_are_reproduced_exactly(count, rng):
    low, high = -0.5, 3.0
    nodes, at = chebyshev.nodes(low, high, count), np.linspace(low, high, 33)
    polynomial = np.polynomial.Polynomial(rng.normal(size=count))
    result = chebyshev.cardinals(at, low, high, count) @ polynomial(nodes)
    np.testing.assert_allclose(result, polynomial(at), atol=1e-10 * np.abs(polynomial(at)).max())
    np.testing.assert_allclose(chebyshev.cardinals(nodes, low, high, count), np.eye(count), atol=1e-12)


def test_series_and_values_are_each_others_inverse(rng):
    values = rng.normal(size=12)
    np.testing.assert_allclose(chebyshev.to_series(12) @ np.zeros(12), 0.0)
    np.testing.assert_allclose(values @ chebyshev.to_series(12) @ chebyshev.terms(12), values, atol=1e-12)
