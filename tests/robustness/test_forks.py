"""Child processes of a process that has rendered: each one renders the same picture, or raises a clear error."""

import functools
import importlib
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import threading
import time
import types
from pathlib import Path

import numpy as np
import pytest
import warp
from threadpoolctl import threadpool_limits

import warpdiff as wd
from warpdiff.core import forks
from warpdiff.core.threads import parallel_for
from warpdiff.device import devices

if not hasattr(os, "fork"):
    pytest.skip("this system cannot fork processes", allow_module_level=True)

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning"),
    pytest.mark.permanent("forks, process pools, callbacks that render or raise"),
]
_MOST_S = 90.0
HERE = Path(__file__).parent


@pytest.fixture(autouse=True)
def _linear_algebra_has_threads(monkeypatch):
    """Give linear algebra two threads, as users have; the test command allows only one thread."""
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    with threadpool_limits(limits=2, user_api="blas"):
        yield


def picture(angle=0.0):
    """Render a tiny picture with a table of colours, means over pixels (footprints) and shadows, on two threads."""
    return _scene()(wd.View((3.1 * np.sin(angle), 1.6, 3.1 * np.cos(angle)), (0.0, 0.0, 0.0), width=40, height=30))


@functools.cache
def _scene():
    heightfield = wd.gratings.fingers(size_um=6.4, seed=1)
    mesh = wd.meshes.tube(segments_along=24, segments_around=16)
    light = wd.DirectionalLight((0.1, 0.9, 1.2))
    options = {"coherence": wd.Coherence(sigma_um=2.0), "tolerance": 0.2, "threads": 2}
    return lambda view: wd.shade(mesh, heightfield, light, view, **options).xyz


def in_child(work):
    """Return the exit code of a forked child: 0 if ``work()`` is true. The child is killed if it hangs."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            code = 0 if work() else 2
        finally:
            os._exit(code)
    for _ in range(int(_MOST_S / 0.02)):
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.02)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    pytest.fail("the child hangs")


def test_a_child_renders_the_same_picture_as_its_parent():
    expected = picture()
    assert in_child(lambda: np.array_equal(picture(), expected)) == 0
    np.testing.assert_array_equal(picture(), expected)


def save_on_both_sides_of_forks(folder):
    """Save pictures in a parent process and in its forked child, twice.

    At the second fork, the child inherits the state that the parent's first save has left.
    """
    colours = np.random.default_rng(0).random((64, 64, 3)).astype(np.float32)
    mask, error = np.ones((64, 64), dtype=np.bool_), np.zeros((64, 64), dtype=np.float32)
    plan = wd.plan(wd.HeightField(np.zeros((4, 4)), 0.05))
    image = wd.Image(xyz=colours, mask=mask, illuminated=mask, coverage=mask.astype(np.float32), error=error, plan=plan)
    for suffix in (".exr", ".png"):
        parents, childs = Path(folder) / f"parent{suffix}", Path(folder) / f"child{suffix}"
        for _ in range(2):
            image.save(parents)
            assert in_child(lambda path=childs: image.save(path)) == 0
        assert childs.stat().st_size == parents.stat().st_size


# This test is slow, because it starts processes that import all modules and compile kernels.
@pytest.mark.slow
def test_a_child_saves_pictures_as_its_parent_does(tmp_path):
    """Files that a forked child saves must be as large as those of its parent.

    The test runs in a separate process, because other tests may have started OpenEXR's threads in this process.
    """
    code = "import sys, test_forks as t; t.save_on_both_sides_of_forks(sys.argv[1])"
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], cwd=HERE, check=True, timeout=_MOST_S)


# This test is slow, because it starts processes that import all modules and compile kernels.
@pytest.mark.slow
def test_a_child_may_be_the_first_to_render():
    """A child that is forked before any kernel is loaded must render, and so must a child of this child."""
    code = (
        "import test_forks as t\n"
        "first = lambda: t.in_child(lambda: t.picture().any()) == 0 and t.picture().any()\n"
        "assert t.in_child(first) == 0"
    )
    subprocess.run([sys.executable, "-c", code], cwd=HERE, check=True, timeout=_MOST_S)


# With the start methods "spawn" and "forkserver", each process of a pool begins with a fresh interpreter. It does not
# inherit the state of the parent. A pool of one process suffices to test this.
@pytest.mark.parametrize(
    ("method", "processes"), [("fork", 2), pytest.param("spawn", 1, marks=pytest.mark.slow), ("forkserver", 1)]
)
def test_pools_of_any_start_method_render_the_same_pictures(method, processes):
    angles = (0.0, 0.3)
    expected = [picture(angle) for angle in angles]
    with multiprocessing.get_context(method).Pool(processes) as pool:
        pictures = pool.map_async(picture, angles).get(timeout=_MOST_S)
    np.testing.assert_array_equal(pictures, expected)


def test_a_child_forked_while_other_threads_render_renders_the_same_picture():
    expected = picture()
    ended = threading.Event()

    def draw():
        while not ended.is_set():
            picture(0.2)

    threads = [threading.Thread(target=draw) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        for _ in range(3):
            assert in_child(lambda: np.array_equal(picture(), expected)) == 0
    finally:
        ended.set()
        for thread in threads:
            thread.join()


def test_no_cached_property_uses_the_lock_of_functools():
    """No module may use ``cached_property`` of functools.

    In Python 3.11 all objects share the lock of ``cached_property``. A forked child could wait for this lock forever.
    """
    sources = sorted(Path(wd.__file__).parent.rglob("*.py"))
    users = [path for path in sources if re.search(r"functools\b.*cached_property", path.read_text(encoding="utf-8"))]
    assert users == [Path(forks.__file__)]


_WHILE_COMPILING = """
import sys, threading, time
import test_forks as t
import warp as wp
from warpdiff.device import devices

loaded = threading.Event()

def refused():
    began = time.monotonic()
    try:
        t.picture()
    except RuntimeError as error:
        return "'spawn'" in str(error) and time.monotonic() - began < 1.0
    return False

t.picture()
wp.load_module = lambda *_, **__: loaded.wait(20.0)
devices.load([type("Kernel", (), {"module": "slow"})], wp.get_device("cpu"))
began = time.monotonic()
assert t.in_child(refused) == 0
assert time.monotonic() - began < 3.0
loaded.set()
assert t.in_child(lambda: t.picture().any()) == 0
"""


# This test is slow, because it starts processes that import all modules and compile kernels.
@pytest.mark.slow
def test_a_child_of_a_process_that_compiles_must_be_spawned():
    subprocess.run([sys.executable, "-c", _WHILE_COMPILING], cwd=HERE, check=True, timeout=_MOST_S)


_WHILE_WITHIN = """
import sys, threading, time
import OpenImageIO as oiio
import test_forks as t
from warpdiff.core.openimageio import in_use

def within(wait):
    entered = threading.Event()
    def stay():
        with in_use():
            entered.set()
            wait()
    thread = threading.Thread(target=stay)
    thread.start()
    entered.wait()
    return thread

def used():
    with in_use():
        return True

def refused():
    try:
        return not used()
    except RuntimeError as error:
        return "'spawn'" in str(error)

before = oiio.get_int_attribute("exr_threads")
# The fork waits for a short call, also if others begin meanwhile, ...
short = within(lambda: time.sleep(0.5))
assert t.in_child(used) == 0
# ... but not for ever.
leave = threading.Event()
long = within(lambda: leave.wait(60.0))
assert oiio.get_int_attribute("exr_threads") == -1
began = time.monotonic()
assert t.in_child(refused) == 0
assert time.monotonic() - began < 3.0 and long.is_alive()
# Whoever leaves last gives back what was set.
within(lambda: time.sleep(0.01)).join()
assert oiio.get_int_attribute("exr_threads") == -1
leave.set()
long.join()
assert oiio.get_int_attribute("exr_threads") == before
assert t.in_child(used) == 0
"""


def test_a_fork_waits_for_pictures_that_are_read_shown_or_written():
    """A fork must wait until other threads have read, shown or written their pictures.

    Otherwise it would copy locks that another thread holds, such as those of OpenColorIO. In the child, they would stay
    locked forever.
    """
    subprocess.run([sys.executable, "-c", _WHILE_WITHIN], cwd=HERE, check=True, timeout=_MOST_S)


# This test is slow, because it starts processes that import all modules and compile kernels.
@pytest.mark.slow
def test_a_fork_waits_for_imports_and_kernels():
    """If a process forks while another thread imports packages and loads kernels, the child must not hang.

    The child must render, or raise an error that proposes the start method "spawn".
    """
    code = (
        "import threading, time\n"
        "import test_forks as t\n"
        "thread = threading.Thread(target=t.picture)\n"
        "thread.start()\n"
        "time.sleep({})\n"
        "def drawn():\n"
        "    try:\n"
        "        return t.picture().any()\n"
        "    except RuntimeError as error:\n"
        "        return \"'spawn'\" in str(error)\n"
        "assert t.in_child(drawn) == 0\n"
        "thread.join()"
    )
    for after in (0.05, 0.7):
        command = [sys.executable, "-c", code.format(after)]
        subprocess.run(command, cwd=HERE, check=True, timeout=_MOST_S)


def test_a_fork_within_threaded_work_ends_with_an_error_in_the_child():
    done, children = [], []

    def slowly(item):
        if threading.current_thread() is threading.main_thread() and not children:
            children.append(os.fork())
        time.sleep(0.1)
        done.append(item)

    try:
        parallel_for(slowly, range(4), threads=2)
    except RuntimeError as error:
        if children == [0]:
            os._exit(0 if "'spawn'" in str(error) else 1)
        raise
    if children == [0]:
        os._exit(2)
    assert os.waitstatus_to_exitcode(os.waitpid(children[0], 0)[1]) == 0
    assert sorted(done) == [0, 1, 2, 3]


_THREADS_AT_FORK = """
import os
import OpenImageIO as oiio

# Functions registered first are called last.
os.register_at_fork(before=lambda: counts.append(len(os.listdir("/proc/self/task"))))
import warpdiff.core.openimageio

oiio.attribute("threads", 8)
counts = []
child = os.fork()
if child == 0:
    os._exit(oiio.get_int_attribute("threads"))
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == oiio.get_int_attribute("threads") == 8
assert counts == [1], counts
"""


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="this system does not list threads")
@pytest.mark.parametrize(
    ("locks", "lock"),
    [({}, None), ({"_module_locks": None}, object()), ({"_module_locks": {"warp": object()}}, None)],
)
def test_forks_work_without_the_private_locks_of_python_and_warp(locks, lock, monkeypatch):
    """Forks must work if private locks of Python and Warp do not exist, as may be in other versions.

    Forks then do not wait for these locks.
    """
    expected = picture()
    private = {name: value for name, value in vars(importlib._bootstrap).items() if name != "_module_locks"}
    monkeypatch.setattr(importlib, "_bootstrap", types.SimpleNamespace(**private, **locks))
    codegen = {name: value for name, value in vars(warp._src.codegen).items() if name != "_codegen_lock"}
    monkeypatch.setitem(sys.modules, "warp._src.codegen", types.SimpleNamespace(**codegen, _codegen_lock=lock))
    assert forks.importing() == []
    assert devices.codegen_lock() is None
    assert in_child(lambda: np.array_equal(picture(), expected)) == 0
    assert np.array_equal(picture(), expected)


def test_threads_of_image_files_end_before_a_fork():
    """Threads that read image files must end before a fork.

    A thread that starts holds a lock. A child forked at that time would wait for this lock forever when it reads an
    image file.
    """
    subprocess.run([sys.executable, "-c", _THREADS_AT_FORK], cwd=HERE, check=True, timeout=_MOST_S)
