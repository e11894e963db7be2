"""Adapters of ``wd.adjoint`` to JAX and PyTorch: values, gradients, compilation and errors.

A test is skipped if its package is not installed.
"""

import importlib

import numpy as np
import pytest
from conftest import noise

import warpdiff as wd
from warpdiff.adjoint.last_call import LastCall

FIELD = noise((5, 6), (0.1, 0.1))
LIGHT = np.array([0.2, 0.1, 0.9])
VIEW = (0.1, -0.2, 1.0)
NAMES = ("heights_um", "to_light")


def linearised(heights, light):
    surface = wd.HeightField.of_known_scale(heights, FIELD.pitch_um)
    return wd.adjoint.spectral_reflectance(
        surface, light, VIEW, [450.0, 620.0], wrt=NAMES, coherence=wd.Coherence(sigma_um=0.5)
    )


EXACT = linearised(FIELD.heights_um, LIGHT)
WEIGHTS = np.array([1.0, -0.3])
GRADIENT = EXACT.vjp(WEIGHTS)


@pytest.fixture
def jax():
    package = pytest.importorskip("jax")
    package.config.update("jax_enable_x64", True)
    return package


@pytest.fixture
def torch():
    return pytest.importorskip("torch")


def wrapped(package, function=linearised, names=NAMES, shape=(2,)):
    return importlib.import_module(f"warpdiff.adjoint.{package}").wrap(function, names, shape)


def test_jax_has_values_and_gradients(jax):
    function = wrapped("jax")

    def loss(heights, light):
        return jax.numpy.sum(WEIGHTS * function(heights, light))

    np.testing.assert_allclose(jax.jit(function)(FIELD.heights_um, LIGHT), EXACT.value, rtol=1e-14)
    for gradient in (jax.grad(loss, (0, 1)), jax.jit(jax.grad(loss, (0, 1)))):
        for result, name in zip(gradient(FIELD.heights_um, LIGHT), NAMES, strict=True):
            np.testing.assert_allclose(result, GRADIENT[name], rtol=1e-12)
    several = jax.vmap(jax.grad(loss), (0, None))(np.stack([FIELD.heights_um, 0.5 * FIELD.heights_um]), LIGHT)
    np.testing.assert_allclose(several[0], GRADIENT["heights_um"], rtol=1e-12)
    assert np.abs(several[1] - several[0]).max() > 1e-3 * np.abs(several[0]).max()


def test_jax_refuses_single_precision_and_forward_derivatives(jax):
    function = wrapped("jax")
    with pytest.raises(TypeError, match="heights_um must be float64, got float32: enable jax_enable_x64"):
        function(FIELD.heights_um.astype(np.float32), LIGHT)
    with pytest.raises(TypeError, match="takes 2 arrays, heights_um, to_light, got 1"):
        function(FIELD.heights_um)
    with pytest.raises(TypeError, match="custom_vjp"):
        jax.jvp(function, (FIELD.heights_um, LIGHT), (FIELD.heights_um, LIGHT))


def test_errors_in_calls_from_jax_are_warnings(jax):
    function = wrapped("jax", shape=(3,))
    with pytest.warns(wd.WarpdiffWarning, match="shape must be that of the value"):
        assert np.isnan(np.asarray(jax.jit(function)(FIELD.heights_um, LIGHT))).all()


def test_pytorch_has_values_and_gradients(torch):
    function = wrapped("torch")
    tensors = [torch.tensor(array, requires_grad=True) for array in (FIELD.heights_um, LIGHT)]
    value = function(*tensors)
    np.testing.assert_allclose(value.detach().numpy(), EXACT.value, rtol=1e-14)
    (torch.tensor(WEIGHTS) * value).sum().backward()
    for tensor, name in zip(tensors, NAMES, strict=True):
        np.testing.assert_allclose(tensor.grad.numpy(), GRADIENT[name], rtol=1e-12)


def test_pytorch_operators_pass_the_checks_of_pytorch(torch):
    """The PyTorch operators of a linearised function must pass ``torch.library.opcheck``.

    It tests their schema, their shapes for ``torch.compile``, and their derivatives.
    """
    wrapped("torch")
    from warpdiff.adjoint import torch as adapter

    number = next(adapter._NUMBERS)
    adapter.wrap(linearised, NAMES, (2,))
    value = getattr(torch.ops.warpdiff, f"value{number + 1}").default
    tensors = [torch.tensor(array, requires_grad=True) for array in (FIELD.heights_um, LIGHT)]
    torch.library.opcheck(value, (tensors,))
    adjoints = getattr(torch.ops.warpdiff, f"value{number + 1}_adjoints").default
    torch.library.opcheck(adjoints, ([tensor.detach() for tensor in tensors], torch.tensor(WEIGHTS)))


def test_pytorch_refuses_single_precision(torch):
    function = wrapped("torch")
    with pytest.raises(TypeError, match=r"to_light must be float64, got torch.float32: convert it by double"):
        function(torch.tensor(FIELD.heights_um), torch.tensor(LIGHT, dtype=torch.float32))
    with pytest.raises(ValueError, match="shape must be that of the value"):
        wrapped("torch", shape=(3,))(torch.tensor(FIELD.heights_um), torch.tensor(LIGHT))


def test_the_last_value_is_not_computed_again():
    calls = []

    def counted(heights, light):
        calls.append(heights)
        return linearised(heights, light)

    last = LastCall(counted, NAMES, (2,))
    arrays = [FIELD.heights_um.copy(), LIGHT.copy()]
    value = last.value(arrays)
    value[:] = 0.0
    np.testing.assert_array_equal(last.value(arrays), EXACT.value)
    np.testing.assert_array_equal(last.adjoints(arrays, WEIGHTS)[1], GRADIENT["to_light"])
    assert len(calls) == 1
    arrays[1][0] += 0.1
    assert abs(last.value(arrays) - EXACT.value).max() > 0.0
    assert len(calls) == 2
    with pytest.raises(TypeError, match="wrt must be a tuple"):
        LastCall(linearised, "heights_um", (2,))
    with pytest.raises(TypeError, match="function must be a function"):
        LastCall(None, NAMES, (2,))
