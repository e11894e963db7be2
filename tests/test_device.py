"""Work on several threads: every item once, what this thread does meanwhile, and errors of either."""

import threading
import time

import numpy as np
import pytest
import warp as wp

from warpdiff.device import Step, Work, begin_in_turn, launch_in_turn, resolve_device, side_by_side

THREADS = (1, 2, 5)


@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize("count", [0, 1, 2, 40])
def test_every_item_is_worked_on_once(threads, count):
    done = []
    side_by_side(done.append, range(count), threads=threads)
    assert sorted(done) == list(range(count))
    with Work(done.append, range(count), threads=threads):
        done.append(-1)
    assert sorted(done) == sorted([*range(count), *range(count), -1])


def test_others_work_while_this_thread_does_something_else():
    begun = threading.Event()
    # Would wait in vain if items came after it.
    with Work(lambda _: begun.set(), [0], threads=2):
        assert begun.wait(60.0)


@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize("where", ["work", "meanwhile"])
def test_an_error_is_raised_once_nothing_is_at_work_any_more(threads, where):
    at_work = []

    def work(index):
        at_work.append(index)
        time.sleep(0.01)
        if where == "work" and index == 3:
            raise ValueError("of an item")
        at_work.remove(index)

    def both():
        with Work(work, range(8), threads=threads):
            if where == "meanwhile":
                raise ValueError("of this thread")

    with pytest.raises(ValueError, match="of an item" if where == "work" else "of this thread"):
        both()
    assert at_work == ([3] if where == "work" else [])


@pytest.mark.parametrize("threads", THREADS)
def test_an_error_ends_work(threads):
    done = []

    def work(index):
        if index == 1:
            raise KeyboardInterrupt
        time.sleep(0.01)
        done.append(index)

    with pytest.raises(KeyboardInterrupt):
        side_by_side(work, range(1000), threads=threads)
    assert len(done) < 20
    abandoned = Work(work, range(2, 1000), threads=threads)
    abandoned.abandon()
    assert len(done) < 40


def test_progress_is_told_of_nothing():
    told = []
    launch_in_turn([], 0, device=resolve_device("cpu"), threads=2, progress=told.append)
    assert told == [1.0]


@wp.kernel(enable_backward=False)
def add_in_runs(values: wp.array(dtype=wp.int32), first: wp.int32, run: wp.int32):
    for i in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        values[i] += 1


@wp.kernel(enable_backward=False)
def double(values: wp.array(dtype=wp.int32), first: wp.int32):
    values[first + wp.tid()] *= 2


@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize("size", [0, 1, 1000, 100_003])
def test_slices_take_every_element_through_all_kernels_in_turn(threads, size):
    device = resolve_device("cpu")
    values = wp.array(np.arange(size), dtype=wp.int32, device=device)
    steps = [Step(add_in_runs, [values], [], in_runs=True), Step(double, [values], [])]
    for _ in range(2):
        launch_in_turn(steps, size, device=device, threads=threads)
    np.testing.assert_array_equal(values.numpy(), 4 * np.arange(size) + 6)
    expected = values.numpy().copy()
    among = range(size // 3, size // 2)
    expected[among.start : among.stop] = 2 * expected[among.start : among.stop] + 2
    begin_in_turn(steps, among, device=device, threads=threads, least_slice=7).finish()
    np.testing.assert_array_equal(values.numpy(), expected)


def test_what_is_prepared_is_launched_by_each_thread_with_indices_of_its_own():
    device = resolve_device("cpu")
    values = wp.zeros(64, dtype=wp.int32, device=device)
    step = Step(add_in_runs, [values], [], in_runs=True)
    step.prepare(device)
    both = threading.Barrier(2)

    def launch(first):
        both.wait(60.0)
        for k in range(first, 64, 2):
            step.launch(k, 1, device)

    side_by_side(launch, [0, 1], threads=2)
    np.testing.assert_array_equal(values.numpy(), 1)
