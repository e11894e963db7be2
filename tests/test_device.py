"""Work on several threads: every item once, what this thread does meanwhile, and errors of either."""

import threading
import time

import numpy as np
import pytest
import warp as wp

from warpdiff.device import Step, launch_in_turn, resolve_device, side_by_side

THREADS = (1, 2, 5)


@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize("count", [0, 1, 2, 40])
def test_every_item_is_worked_on_once_and_what_is_to_be_done_meanwhile_is_done_here(threads, count):
    done, meanwhile = [], []
    side_by_side(done.append, range(count), threads=threads, meanwhile=lambda: meanwhile.append(threading.get_ident()))
    assert sorted(done) == list(range(count))
    assert meanwhile == [threading.get_ident()]


def test_others_work_while_this_thread_does_something_else():
    begun = threading.Event()
    # Would wait in vain if items came after it.
    side_by_side(lambda _: begun.set(), [0], threads=2, meanwhile=lambda: begun.wait(60.0))
    assert begun.is_set()


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

    def meanwhile():
        if where == "meanwhile":
            raise ValueError("of this thread")

    with pytest.raises(ValueError, match="of an item" if where == "work" else "of this thread"):
        side_by_side(work, range(8), threads=threads, meanwhile=meanwhile)
    assert at_work == ([3] if where == "work" else [])


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
