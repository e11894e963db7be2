"""Work on several threads: every item once, what this thread does meanwhile, and errors of either."""

import threading
import time

import pytest

from warpdiff.work import Work, side_by_side

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
