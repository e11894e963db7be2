"""Work on several threads: every item once, and errors."""

import threading
import time

import pytest

from warpdiff.core.threads import _kept, cores, parallel_for

THREADS = (1, 2, 5)


@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize("count", [0, 1, 2, 40])
def test_every_item_is_worked_on_once(threads, count):
    done = []
    parallel_for(done.append, range(count), threads=threads)
    assert sorted(done) == list(range(count))


@pytest.mark.parametrize("threads", THREADS)
def test_an_error_is_raised_once_nothing_is_at_work_any_more(threads):
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
def test_an_error_ends_work(threads):
    done = []

    def work(index):
        if index == 1:
            raise KeyboardInterrupt
        time.sleep(0.01)
        done.append(index)

    with pytest.raises(KeyboardInterrupt):
        parallel_for(work, range(1000), threads=threads)
    assert len(done) < 20


def test_work_within_work_needs_no_free_thread():
    """All threads that stay may wait for the one that begins more work."""
    done = []

    def work(_):
        parallel_for(done.append, range(5), threads=cores() + 1)

    ended = threading.Thread(target=lambda: parallel_for(work, range(20), threads=cores() + 1), daemon=True)
    ended.start()
    ended.join(60.0)
    assert not ended.is_alive()
    assert sorted(done) == sorted(20 * list(range(5)))


@pytest.mark.parametrize("threads", THREADS)
def test_progress_is_told_by_one_at_a_time_which_may_work_itself(threads):
    told, nested = [], []

    def tell(done):
        parallel_for(nested.append, range(4), threads=threads)
        told.append(done)

    parallel_for(lambda _: None, range(8), threads=threads, progress=tell)
    assert told == [(k + 1) / 8 for k in range(8)]
    assert sorted(nested) == sorted(8 * list(range(4)))


@pytest.mark.parametrize("threads", THREADS)
def test_progress_that_fails_ends_work(threads):
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
def test_threads_that_do_not_begin_are_done_without(threads, monkeypatch):
    """As in an address space in which there is no room for another stack."""

    def fail(_):
        raise RuntimeError("can't start new thread")

    _kept.cache_clear()
    monkeypatch.setattr(threading.Thread, "start", fail)
    done = []
    parallel_for(done.append, range(10), threads=threads)
    assert sorted(done) == list(range(10))
    _kept.cache_clear()


@pytest.mark.permanent("varied calls and thread counts: memory and threads that stay")
def test_threads_do_not_pile_up(tries):
    """Whatever numbers of them were asked for."""
    before = threading.active_count()
    tries.number = 39
    for threads in range(1, 40):
        parallel_for(lambda _: time.sleep(1e-4), range(threads), threads=threads)
    most = time.monotonic() + 10.0
    while threading.active_count() > before + cores() and time.monotonic() < most:
        time.sleep(0.01)
    assert threading.active_count() <= before + cores()
