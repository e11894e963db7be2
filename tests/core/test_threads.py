"""Parallel loops process every item once and raise errors; ``single_threaded_blas`` limits linear algebra."""

import threading
import time

import numpy as np
import pytest
from conftest import slow
from threadpoolctl import threadpool_info, threadpool_limits

import warpdiff as wd
from warpdiff.core.threads import _pool, cores, parallel_for, single_threaded_blas
from warpdiff.planner import bounds
from warpdiff.scene.mesh_import import prepare_surface

THREADS = (1, 2, 5)


@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize("count", [0, 1, 2, 40])
def test_every_item_is_processed_once(threads, count):
    done = []
    parallel_for(done.append, range(count), threads=threads)
    assert sorted(done) == list(range(count))


@pytest.mark.parametrize("threads", THREADS)
def test_an_error_is_raised_after_all_threads_have_stopped(threads):
    at_work = []

    def work(index):
        at_work.append(index)
        time.sleep(0.01)
        if index == 3:
            raise ValueError("of an item")
        at_work.remove(index)

    with pytest.raises(ValueError, match="of an item"):
        parallel_for(work, range(8), threads=threads)
    assert at_work == [3]


@pytest.mark.parametrize("threads", THREADS)
def test_after_an_error_no_further_items_are_processed(threads):
    done = []

    def work(index):
        if index == 1:
            raise KeyboardInterrupt
        time.sleep(0.01)
        done.append(index)

    with pytest.raises(KeyboardInterrupt):
        parallel_for(work, range(1000), threads=threads)
    assert len(done) < 20


def test_nested_loops_need_no_free_thread():
    """A parallel loop inside another one must end even if no other thread of the pool is free to process its items."""
    done = []

    def work(_):
        parallel_for(done.append, range(5), threads=cores() + 1)

    ended = threading.Thread(target=lambda: parallel_for(work, range(20), threads=cores() + 1), daemon=True)
    ended.start()
    ended.join(60.0)
    assert not ended.is_alive()
    assert sorted(done) == sorted(20 * list(range(5)))


@pytest.mark.parametrize("threads", THREADS)
def test_progress_is_reported_by_one_thread_at_a_time_which_may_start_loops(threads):
    shares, nested = [], []

    def report(share):
        parallel_for(nested.append, range(4), threads=threads)
        shares.append(share)

    parallel_for(lambda _: None, range(8), threads=threads, progress=report)
    assert shares == [(k + 1) / 8 for k in range(8)]
    assert sorted(nested) == sorted(8 * list(range(4)))


@pytest.mark.parametrize("threads", THREADS)
def test_an_error_in_the_progress_function_ends_the_loop(threads):
    done = []

    def fail(_):
        raise KeyError("of progress")

    def work(item):
        time.sleep(0.01)
        done.append(item)

    with pytest.raises(KeyError, match="of progress"):
        parallel_for(work, range(1000), threads=threads, progress=fail)
    assert len(done) < 20
    parallel_for(done.append, [-1], threads=threads)
    assert done[-1] == -1


@pytest.mark.parametrize("threads", [2, 31])
def test_loops_work_if_threads_cannot_be_started(threads, monkeypatch):
    """A parallel loop must process all items even if no thread can be started, for example for lack of memory."""

    def fail(_):
        raise RuntimeError("can't start new thread")

    _pool.cache_clear()
    monkeypatch.setattr(threading.Thread, "start", fail)
    done = []
    parallel_for(done.append, range(10), threads=threads)
    assert sorted(done) == list(range(10))
    _pool.cache_clear()


@pytest.mark.permanent("varied calls and thread counts: memory and threads remain constant")
def test_threads_do_not_accumulate(tries):
    """The number of idle threads must not exceed the number of cores, whatever numbers of threads were requested."""
    before = threading.active_count()
    tries.number = 39
    for threads in range(1, 40):
        parallel_for(lambda _: time.sleep(1e-4), range(threads), threads=threads)
    most = time.monotonic() + 10.0
    while threading.active_count() > before + cores() and time.monotonic() < most:
        time.sleep(0.01)
    assert threading.active_count() <= before + cores()


def blas_threads():
    """Return for each loaded library of linear algebra the number of threads that it uses."""
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


@pytest.fixture
def two_threads():
    with threadpool_limits(limits=2, user_api="blas"):
        if 2 not in blas_threads():
            pytest.skip("the linear-algebra library of NumPy has no threads")
        yield


@pytest.mark.usefixtures("two_threads")
def test_blas_uses_one_thread_within_the_context_and_all_after_it():
    before = blas_threads()
    with single_threaded_blas():
        assert set(blas_threads()) == {1}
        with pytest.raises(ValueError, match="within"), single_threaded_blas():
            raise ValueError("within")
        assert set(blas_threads()) == {1}
    assert blas_threads() == before


@pytest.mark.usefixtures("two_threads")
def test_overlapping_contexts_of_two_threads_restore_the_number_of_threads():
    before, entered, leave = blas_threads(), threading.Event(), threading.Event()

    @single_threaded_blas()
    def stay():
        entered.set()
        leave.wait(60.0)

    other = threading.Thread(target=stay)
    with single_threaded_blas():
        other.start()
        entered.wait(60.0)
    # The other thread has not left its ``single_threaded_blas`` context, so linear algebra must still use one thread.
    assert set(blas_threads()) == {1}
    leave.set()
    other.join()
    assert blas_threads() == before


@pytest.mark.usefixtures("two_threads")
def test_plans_are_made_on_one_thread(monkeypatch):
    counts = []
    make = bounds.upper_bound_plan
    monkeypatch.setattr(bounds, "upper_bound_plan", lambda *a, **k: counts.append(blas_threads()) or make(*a, **k))
    wd.plan(wd.gratings.fingers(size_um=6.4, seed=1), coherence=wd.Coherence(sigma_um=3.25), tolerance=3e-2)
    assert counts
    assert {1} == set(counts[0])


def taken_by_others(work):
    """Return the CPU time that all other threads use during ``work()``, relative to that of the calling thread."""
    work()

    def of_others():
        return time.process_time() - time.thread_time()

    # Threads of the linear-algebra library stay active for a short time after a computation, so wait until they are
    # idle.
    while (before := of_others()) and (time.sleep(0.05) or of_others() - before > 1e-3):
        pass
    before, begin = of_others(), time.thread_time()
    work()
    return (of_others() - before) / (time.thread_time() - begin)


@pytest.mark.usefixtures("two_threads")
@pytest.mark.filterwarnings("ignore:orders up to")
@pytest.mark.parametrize("what", [slow("direct sums"), slow("orders"), "colours", "meshes"])
def test_large_matrices_are_processed_by_one_thread(what, rng):
    """Work on large arrays must use only the calling thread, because linear algebra is limited to one thread.

    If threads of the linear-algebra library were active during a fork, parent or child could wait forever.
    """
    rough = wd.HeightField(0.01 * rng.standard_normal((200, 200)), 0.05)
    coarse = wd.HeightField.of_known_scale(0.01 * rng.standard_normal((20, 20)), 4.0)
    tube = wd.meshes.tube(segments_along=300, segments_around=300)
    ones = np.ones((300, 400), np.float32)
    xyz = rng.random((*ones.shape, 3), np.float32)
    plan = wd.plan(wd.HeightField(np.zeros((4, 4)), 0.05), method="direct")
    image = wd.Image(xyz=xyz, mask=ones > 0, illuminated=ones > 0, coverage=ones, error=ones, plan=plan)

    def moved():
        tube.vertices[0, 0] += 1e-3
        prepare_surface(tube)

    work = {
        "direct sums": lambda: wd.spectral_reflectance(rough, (0, 0, 1), (0.1, 0.2, 1.0), [500.0], method="direct"),
        "orders": lambda: wd.order_efficiencies(coarse, (0, 0, 1), [400.0, 500.0]),
        "colours": lambda: image.display("colorimetric"),
        "meshes": moved,
    }[what]
    assert taken_by_others(work) < 0.1
