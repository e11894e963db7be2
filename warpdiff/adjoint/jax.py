"""Adapter to JAX, ``warpdiff.adjoint.jax.wrap``; ``pip install "warpdiff[jax]"`` installs JAX."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import numpy as np

from warpdiff.adjoint.last_call import LastCall
from warpdiff.core.warnings import warn

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from warpdiff.adjoint.linearised import Linearised


def wrap(function: Callable[..., Linearised], wrt: Sequence[str], shape: Sequence[int]) -> Callable[..., jax.Array]:
    """Return a JAX function that computes a linearised function, for ``jax.jit``, ``jax.grad`` and ``jax.vmap``.

    Forward derivatives (``jax.jvp``) raise ``TypeError``. JAX does not permit errors in Python functions that it calls:
    an error of ``function`` therefore becomes a warning, and the value becomes NaN.

    Args:
        function: Function of NumPy arrays, one per name in ``wrt``. It returns a ``Linearised`` value.
        wrt: Names of the variables, in the order of the arrays.
        shape: Shape of the value, which JAX requires before the first call.

    Returns:
        Function of float64 arrays, which ``jax.config.update("jax_enable_x64", True)`` enables. Other types raise
        ``TypeError``.
    """
    last = LastCall(function, wrt, shape)
    result = jax.ShapeDtypeStruct(last.shape, np.dtype(np.float64))

    def compute(*arrays: jax.Array) -> jax.Array:
        return _callback(lambda *values: last.value(values), result, *arrays)

    def backward(arrays: tuple[jax.Array, ...], adjoint: jax.Array) -> tuple[jax.Array, ...]:
        results = tuple(jax.ShapeDtypeStruct(array.shape, array.dtype) for array in arrays)
        return tuple(
            _callback(lambda *values: tuple(last.adjoints(values[:-1], values[-1])), results, *arrays, adjoint)
        )

    call = jax.custom_vjp(compute)
    call.defvjp(lambda *arrays: (call(*arrays), arrays), backward)

    def checked(*arrays: jax.Array) -> jax.Array:
        last.check([str(jax.numpy.result_type(array)) for array in arrays], "enable jax_enable_x64, and convert it")
        return call(*arrays)

    return checked


def _callback(function: Callable[..., object], results: object, *arrays: jax.Array) -> jax.Array:
    """Call a function of NumPy arrays. If it raises an error, issue a warning and return NaN in all results."""

    def safe(*values: jax.Array) -> object:
        try:
            return function(*map(np.asarray, values))
        except (ValueError, TypeError, MemoryError) as error:
            warn(f"the result is NaN: {error}")
            return jax.tree.map(lambda array: np.full(array.shape, np.nan), results)

    return jax.pure_callback(safe, results, *arrays, vmap_method="sequential")
