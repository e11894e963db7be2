"""NumPy's linear algebra keeps to one thread where it is told to, and has its threads back afterwards."""

import threading

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import warpdiff as wd
from warpdiff.core.blas_threads import on_one_thread
from warpdiff.planning import planner


def threads():
    """Of the libraries that are there."""
    return [each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"]


@pytest.fixture(autouse=True)
def two_threads():
    with threadpool_limits(limits=2, user_api="blas"):
        if 2 not in threads():
            pytest.skip("NumPy's library has no threads here")
        yield


def test_one_thread_within_and_all_of_them_afterwards():
    before = threads()
    with on_one_thread():
        assert set(threads()) == {1}
        with pytest.raises(ValueError, match="within"), on_one_thread():
            raise ValueError("within")
        assert set(threads()) == {1}
    assert threads() == before


def test_calls_from_two_threads_leave_it_as_it_was():
    before, entered, leave = threads(), threading.Event(), threading.Event()

    @on_one_thread()
    def stay():
        entered.set()
        leave.wait(60.0)

    other = threading.Thread(target=stay)
    with on_one_thread():
        other.start()
        entered.wait(60.0)
    leave.set()
    other.join()
    assert threads() == before


def test_plans_are_made_on_one_thread(monkeypatch):
    seen = []
    monkeypatch.setattr(planner, "_ample", lambda *a, make=planner._ample, **k: seen.append(threads()) or make(*a, **k))
    wd.plan(wd.gratings.fingers(size_um=6.4, seed=1), coherence=wd.Coherence(sigma_um=3.25), tolerance=3e-2)
    assert seen
    assert {1} == set(seen[0])
