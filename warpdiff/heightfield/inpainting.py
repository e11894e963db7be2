"""Gap filling: missing heights are replaced by a harmonic (smooth) surface through the samples around each gap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.threads import single_threaded_blas

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray
    from scipy.sparse import csr_array

# The solver for missing heights stops at this residual of the linear equations, relative to the residual at its start.
_CONVERGED = 1e-10
# Maximum number of steps of the conjugate gradient method that fills gaps; about twenty steps suffice.
_MOST_STEPS = 200
# In the equations for missing heights, neighbouring samples along the axis with the coarser pitch have a smaller weight
# than those along the other axis. The smallest permitted ratio of both weights is this number; smaller ratios are
# raised to it. A smaller weight would be lost in rounding errors.
_LEAST_WEIGHT = 1e-10
# Damping factor of the Jacobi iterations, which smooth the errors on each grid of the multigrid method; the usual value
# for five-point Laplacians.
_DAMPING = 2.0 / 3.0
# The multigrid method, which fills gaps, corrects the heights on a grid by a solution on the next coarser grid. This
# number of Jacobi iterations smooths the errors before each correction, and again after it.
_SWEEPS = 2
# A grid of the multigrid method with at most this number of unknown heights has no coarser grid. Its equations are
# solved by an inverse matrix.
_FEW = 400
# Coarser grids of the multigrid method. `_COARSER` is the number of samples that one sample of the next coarser grid
# represents along an axis. If the ratio of the pitches along both axes is above `_MOST_ANISOTROPY`, only the axis with
# the finer pitch is coarsened.
_COARSER, _MOST_ANISOTROPY = 3, 1.8


@np.errstate(under="ignore")
def harmonic(heights: NDArray[np.float64], pitch_um: tuple[float, float]) -> NDArray[np.float64]:
    """Return ``heights`` (ny, nx) with each NaN replaced so that the five-point Laplacian vanishes at these samples.

    The slope across the edges of the grid is zero. At least one sample must be known. The equations are solved by
    conjugate gradients with a multigrid preconditioner (smoothed aggregation: Vaněk, Mandel and Brezina 1996, Computing
    56, 179–196). The number of steps does not depend on the size of the gaps.
    """
    from scipy.sparse import linalg

    gaps = np.isnan(heights)
    result = heights.copy()
    if not gaps.any():
        return result
    known = heights[~gaps]
    # Heights are centred and scaled before the solver starts. Rounding errors then do not depend on an offset of the
    # heights, and squares of heights neither overflow nor underflow.
    mean = float(np.mean(known))
    scale = float(np.max(np.abs(known - mean))) or 1.0
    matrix, target = _equations(gaps, np.where(gaps, 0.0, (heights - mean) / scale), pitch_um)
    with single_threaded_blas():
        cycle = linalg.LinearOperator(matrix.shape, _multigrid(matrix, np.nonzero(gaps), pitch_um))
        solution, _ = linalg.cg(matrix, target, rtol=_CONVERGED, maxiter=_MOST_STEPS, M=cycle)
        filled = mean + scale * solution
    # A harmonic function lies between its smallest and its largest boundary value. Rounding errors may move computed
    # heights outside of this range, so that they are clipped to it.
    result[gaps] = np.clip(filled, known.min(), known.max())
    return result


def _equations(
    gaps: NDArray[np.bool_], heights: NDArray[np.float64], pitch: tuple[float, float]
) -> tuple[csr_array, NDArray[np.float64]]:
    """Return the linear equations for missing heights: the matrix of the negative Laplacian, and a right-hand side.

    For each missing sample, the right-hand side is the weighted sum of the known heights of neighbouring samples.
    """
    from scipy import sparse

    count = int(np.count_nonzero(gaps))
    number = np.full(gaps.shape, -1, dtype=np.int32)
    number[gaps] = np.arange(count, dtype=np.int32)
    diagonal, target = np.zeros(count), np.zeros(count)
    matrix = sparse.csr_array((count, count))
    for axis in (0, 1):
        weight = max((min(pitch) / pitch[axis]) ** 2, _LEAST_WEIGHT)
        before, after = (np.moveaxis(number, axis, 0)[part] for part in (slice(-1), slice(1, None)))
        height_before, height_after = (np.moveaxis(heights, axis, 0)[part] for part in (slice(-1), slice(1, None)))
        for one, other, height in ((before, after, height_after), (after, before, height_before)):
            unknown = one >= 0
            row, column = one[unknown], other[unknown]
            # In one direction, a missing sample has at most one neighbour, so that each index of an equation in `row`
            # occurs once. Additions to an indexed array are correct only if no index occurs twice.
            diagonal[row] += weight
            target[row] += weight * height[unknown]
            both = column >= 0
            row, column = row[both], column[both]
            matrix += sparse.csr_array((np.full(len(row), -weight), (row, column)), shape=(count, count))
    return (matrix + sparse.diags_array(diagonal)).tocsr(), target


@dataclass(frozen=True)
class _Level:
    """Grid of the multigrid method, with the linear equations for the heights on this grid.

    Attributes:
        matrix: Matrix of the equations on this grid.
        jacobi: Inverse of the diagonal of ``matrix``, times the damping factor.
        to_finer: Matrix that interpolates from the next coarser grid to this one.
    """

    matrix: csr_array
    jacobi: NDArray[np.float64]
    to_finer: csr_array


def _multigrid(
    matrix: csr_array, places: tuple[NDArray[np.int64], ...], pitch: tuple[float, float]
) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Return one V-cycle of the multigrid method, as a function that approximately solves the equations of a grid."""
    from scipy import sparse

    levels: list[_Level] = []
    distances = list(pitch)
    while matrix.shape[0] > _FEW:
        extended = [axis for axis in (0, 1) if places[axis].max() > 0]
        nearest = min(distances[axis] for axis in extended)
        blocks = [
            _COARSER if axis in extended and distances[axis] <= _MOST_ANISOTROPY * nearest else 1 for axis in (0, 1)
        ]
        blocked = [place // block for place, block in zip(places, blocks, strict=True)]
        width = int(blocked[1].max()) + 1
        cells, cell = np.unique(blocked[0] * width + blocked[1], return_inverse=True)
        jacobi = _DAMPING / matrix.diagonal()
        constant = sparse.csr_array((np.ones(len(cell)), (np.arange(len(cell)), cell)))
        to_finer = (constant - sparse.diags_array(jacobi) @ (matrix @ constant)).tocsr()
        levels.append(_Level(matrix, jacobi, to_finer))
        matrix = (to_finer.T @ (matrix @ to_finer)).tocsr()
        places = cells // width, cells % width
        distances = [distance * block for distance, block in zip(distances, blocks, strict=True)]
    # The inverse matrix is dense, because SciPy's sparse factorisation leaves a pending error in forked child
    # processes.
    inverse = np.linalg.inv(matrix.toarray())

    def cycle(residual: NDArray[np.float64], depth: int = 0) -> NDArray[np.float64]:
        if depth == len(levels):
            return np.asarray(inverse @ residual)
        level = levels[depth]
        correction = level.jacobi * residual
        for _ in range(_SWEEPS - 1):
            correction += level.jacobi * (residual - level.matrix @ correction)
        correction += level.to_finer @ cycle(level.to_finer.T @ (residual - level.matrix @ correction), depth + 1)
        for _ in range(_SWEEPS):
            correction += level.jacobi * (residual - level.matrix @ correction)
        return correction

    return cycle
