"""NumPy's linear algebra keeps to one thread where it is told to, and has its threads back afterwards."""

import threading
import time

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import warpdiff as wd
from warpdiff.core.threads import single_threaded_blas
from warpdiff.planner import strategy
from warpdiff.scene.mesh_import import prepare_surface


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
    with single_threaded_blas():
        assert set(threads()) == {1}
        with pytest.raises(ValueError, match="within"), single_threaded_blas():
            raise ValueError("within")
        assert set(threads()) == {1}
    assert threads() == before


def test_calls_from_two_threads_leave_it_as_it_was():
    before, entered, leave = threads(), threading.Event(), threading.Event()

    @single_threaded_blas()
    def stay():
        entered.set()
        leave.wait(60.0)

    other = threading.Thread(target=stay)
    with single_threaded_blas():
        other.start()
        entered.wait(60.0)
    # Who is still within would have its sums shared out otherwise, and forks wait for these for ever.
    assert set(threads()) == {1}
    leave.set()
    other.join()
    assert threads() == before


def test_plans_are_made_on_one_thread(monkeypatch):
    seen = []
    monkeypatch.setattr(
        strategy, "_ample", lambda *a, make=strategy._ample, **k: seen.append(threads()) or make(*a, **k)
    )
    wd.plan(wd.gratings.fingers(size_um=6.4, seed=1), coherence=wd.Coherence(sigma_um=3.25), tolerance=3e-2)
    assert seen
    assert {1} == set(seen[0])


def taken_by_others(work):
    """Share of a call's CPU time that other threads took."""
    work()

    def of_others():
        return time.process_time() - time.thread_time()

    # Those of the library spin for a while after a call.
    while (before := of_others()) and (time.sleep(0.05) or of_others() - before > 1e-3):
        pass
    before, begin = of_others(), time.thread_time()
    work()
    return (of_others() - before) / (time.thread_time() - begin)


@pytest.mark.filterwarnings("ignore:orders up to")
@pytest.mark.parametrize("what", ["direct sums", "orders", "colours", "meshes"])
def test_what_takes_large_matrices_is_not_shared_out(what, rng):
    """A fork meanwhile would wait for ever, in the parent or in the child."""
    rough = wd.HeightField(0.01 * rng.standard_normal((200, 200)), 0.05)
    coarse = wd.HeightField(0.01 * rng.standard_normal((20, 20)), 4.0)
    tube = wd.meshes.tube(segments_along=300, segments_around=300)
    seen = np.ones((300, 400), np.float32)
    xyz = rng.random((*seen.shape, 3), np.float32)
    plan = wd.plan(wd.HeightField(np.zeros((4, 4)), 0.05))
    image = wd.Image(xyz=xyz, mask=seen > 0, illuminated=seen > 0, coverage=seen, error=seen, plan=plan)

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
