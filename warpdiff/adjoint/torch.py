"""Adapter to PyTorch, ``warpdiff.adjoint.torch.wrap``; ``pip install "warpdiff[torch]"`` installs PyTorch."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
import torch

from warpdiff.adjoint.last_call import LastCall

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from warpdiff.adjoint.linearised import Linearised

# Counter that makes the names of PyTorch operators unique, as PyTorch requires.
_NUMBERS = itertools.count()


def wrap(function: Callable[..., Linearised], wrt: Sequence[str], shape: Sequence[int]) -> Callable[..., torch.Tensor]:
    """Return a PyTorch function that computes a linearised function, for ``backward()`` and ``torch.compile``.

    The value is computed on the CPU and returned on the device of the first tensor.

    Args:
        function: Function of NumPy arrays, one per name in ``wrt``. It returns a ``Linearised`` value.
        wrt: Names of the variables, in the order of the tensors.
        shape: Shape of the value, which ``torch.compile`` requires before the first call.

    Returns:
        Function of float64 tensors. Other types raise ``TypeError``.
    """
    last, name = LastCall(function, wrt, shape), f"warpdiff::value{next(_NUMBERS)}"

    def compute(arrays: list[torch.Tensor]) -> torch.Tensor:
        return torch.from_numpy(last.value([_numpy(array) for array in arrays])).to(arrays[0].device)

    def differentiate(arrays: list[torch.Tensor], adjoint: torch.Tensor) -> list[torch.Tensor]:
        results = last.adjoints([_numpy(array) for array in arrays], _numpy(adjoint))
        return [torch.from_numpy(result).to(array.device) for result, array in zip(results, arrays, strict=True)]

    # PyTorch passes the arguments of this function by name, so that the names of the arguments must be those below.
    def keep(ctx: torch.autograd.function.FunctionCtx, inputs: list[list[torch.Tensor]], output: torch.Tensor) -> None:  # noqa: ARG001
        ctx.save_for_backward(*inputs[0])

    define = torch.library.custom_op
    value = define(name, compute, mutates_args=(), schema="(Tensor[] arrays) -> Tensor")
    schema = "(Tensor[] arrays, Tensor adjoint) -> Tensor[]"
    adjoints = define(f"{name}_adjoints", differentiate, mutates_args=(), schema=schema)
    value.register_fake(lambda arrays: arrays[0].new_empty(last.shape))
    adjoints.register_fake(lambda arrays, _adjoint: [torch.empty_like(array) for array in arrays])
    value.register_autograd(lambda ctx, adjoint: adjoints(list(ctx.saved_tensors), adjoint), setup_context=keep)

    def checked(*arrays: torch.Tensor) -> torch.Tensor:
        last.check([str(array.dtype) for array in arrays], "convert it by double()")
        return value(list(arrays))

    return checked


def _numpy(array: torch.Tensor) -> NDArray[np.float64]:
    return np.asarray(array.detach().cpu().numpy())
