"""Kernel calls on the CPU: every element passes through all kernels once, for any slice size and number of threads.

A slice is a group of consecutive elements that one thread processes in one launch of a kernel.
"""

import gc
import sys
import threading
import weakref

import numpy as np
import pytest
import warp as wp

from warpdiff.core.threads import parallel_for
from warpdiff.device.devices import resolve_device
from warpdiff.device.kernel_calls import KernelCall, Pipeline, launch, launch_pipeline
from warpdiff.kernels import compile_options
from warpdiff.kernels.structs import Cells, Sampling

THREADS = (1, 2, 5)
# The kernels of these tests have the same compile options as the package. With other options, Warp would compile its
# own headers again.
wp.set_module_options(compile_options.options())


def test_progress_is_complete_for_an_empty_pipeline():
    shares = []
    launch_pipeline([], 0, device=resolve_device("cpu"), threads=2, progress=shares.append)
    assert shares == [1.0]


@wp.kernel
def add_in_runs(values: wp.array(dtype=wp.int32), first: wp.int32, run: wp.int32):
    for i in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        values[i] += 1


@wp.kernel
def double(values: wp.array(dtype=wp.int32), first: wp.int32):
    values[first + wp.tid()] *= 2


@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize("size", [0, 1, 1000, 100_003])
def test_every_element_passes_through_all_kernels_in_order(threads, size):
    device = resolve_device("cpu")
    values = wp.array(np.arange(size), dtype=wp.int32, device=device)
    steps = [KernelCall(add_in_runs, [values], [], in_runs=True), KernelCall(double, [values], [])]
    for _ in range(2):
        launch_pipeline(steps, size, device=device, threads=threads)
    np.testing.assert_array_equal(values.numpy(), 4 * np.arange(size) + 6)
    expected = values.numpy().copy()
    among = range(size // 3, size // 2)
    expected[among.start : among.stop] = 2 * expected[among.start : among.stop] + 2
    launch_pipeline(steps, among, device=device, threads=threads, slice_size=7)
    np.testing.assert_array_equal(values.numpy(), expected)


def test_all_blocks_except_the_last_are_complete():
    device = resolve_device("cpu")
    blocks, values = wp.zeros(3, dtype=wp.int32, device=device), wp.ones(13, dtype=wp.int32, device=device)
    steps = [KernelCall(add_in_runs, [blocks], [], in_runs=True, block=5), KernelCall(double, [values], [])]
    launch_pipeline(steps, 13, device=device, threads=2, slice_size=1)
    np.testing.assert_array_equal(blocks.numpy(), 1)
    np.testing.assert_array_equal(values.numpy(), 2)


def test_threads_launch_one_pipeline_over_separate_elements():
    values = wp.zeros(64, dtype=wp.int32, device="cpu")
    chain = Pipeline([KernelCall(add_in_runs, [values], [], in_runs=True), KernelCall(double, [values], [])])
    both = threading.Barrier(2)

    def add(first):
        both.wait(60.0)
        for k in range(first, 64, 2):
            chain.launch(range(k, k + 1))

    parallel_for(add, [0, 1], threads=2)
    np.testing.assert_array_equal(values.numpy(), 2)


@wp.kernel
def gather_all(
    sampling: Sampling, cells: Cells, place: wp.vec2d, factor: wp.float32, adds: wp.bool,
    values: wp.array2d(dtype=wp.float64), first: wp.int32, none: wp.array(dtype=wp.int32),
    values_out: wp.array(dtype=wp.float64),
):  # fmt: skip
    i = first + wp.tid()
    offset = sampling.places[0]
    if adds and none.shape[0] == 0:
        values_out[i] += wp.float64(factor) * values[i, 1] + place[1] + offset[0] + wp.float64(cells.across)


def test_kernels_receive_arguments_of_any_type():
    device = resolve_device("cpu")
    sums = wp.zeros(3, dtype=wp.float64, device=device)
    values = wp.array([[0.0, 1.0], [0.0, 2.0], [0.0, 3.0]], dtype=wp.float64, device=device)
    expected = np.zeros(3)
    for sample in range(2):
        sampling, cells = Sampling(), Cells()
        cells.across = sample
        sampling.places = wp.array([[0.25, 0.0]], dtype=wp.vec2d, device=device)
        for none in (None, wp.empty(0, dtype=wp.int32, device=device)):
            inputs = [sampling, cells, wp.vec2d(0.0, 0.5), np.float32(1.5), True, values]
            step = KernelCall(gather_all, inputs, [none, sums])
            launch_pipeline([step], 3, device=device, threads=1)
            expected += 1.5 * values.numpy()[:, 1] + 0.75 + sample
    np.testing.assert_array_equal(sums.numpy(), expected)


def test_arrays_of_another_type_are_refused():
    device = resolve_device("cpu")
    launch(double, 4, [wp.zeros(4, dtype=wp.int32, device=device)], [], device=device, threads=1)
    with pytest.raises(RuntimeError, match="dtype"):
        launch(double, 4, [wp.zeros(4, dtype=wp.float64, device=device)], [], device=device, threads=1)


@wp.kernel
def count_marks(values: wp.array(dtype=wp.int64), first: wp.int32):
    values[first + wp.tid()] += wp.int64(1)


def test_threads_may_be_the_first_to_launch_a_kernel():
    """If four threads launch a kernel for the first time simultaneously, the kernel must run for all four of them."""
    values = wp.zeros(4, dtype=wp.int64, device="cpu")
    together = threading.Barrier(4)

    def add(index):
        together.wait(60.0)
        chain = Pipeline([KernelCall(count_marks, [values], [])])
        for _ in range(100):
            chain.launch(range(index, index + 1))

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        parallel_for(add, range(4), threads=4)
    finally:
        sys.setswitchinterval(interval)
    np.testing.assert_array_equal(values.numpy(), 100)


def test_launched_arrays_can_be_deleted():
    values = wp.zeros(4, dtype=wp.int32, device="cpu")
    reference = weakref.ref(values)
    launch(triple, 4, [values], [], device=resolve_device("cpu"), threads=1)
    np.testing.assert_array_equal(values.numpy(), 0)
    del values
    gc.collect()
    assert reference() is None


@wp.kernel
def triple(values: wp.array(dtype=wp.int32), first: wp.int32):
    values[first + wp.tid()] *= 3
