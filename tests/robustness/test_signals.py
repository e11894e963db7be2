"""Signals end the command line within a time limit, with the documented exit code and without leaving files."""

import os
import signal
import subprocess
import sys
import time

import pytest
from endurance import IS_SOAK

if os.name != "posix":
    pytest.skip("these signals require POSIX", allow_module_level=True)

ROW = "SIGINT, SIGTERM and SIGHUP, at many delays"
NAMES = ("SIGINT", "SIGTERM", "SIGHUP")


@pytest.fixture(autouse=True)
def _default_handlers():
    """Give SIGINT and SIGHUP their default handlers during the test.

    Programs such as nohup ignore these signals, and child processes would inherit this setting.
    """
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGHUP)}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def begun(arguments, folder):
    """Start a Python process with its own folders for caches and temporary files."""
    names = {"WARP_CACHE_PATH": "kernels", "WARPDIFF_CACHE_DIR": "cache", "TMPDIR": "temporary"}
    (folder / "temporary").mkdir()
    return subprocess.Popen(
        [sys.executable, *arguments], cwd=folder,
        env=os.environ | {name: str(folder / value) for name, value in names.items()}, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def left_behind(folder):
    """Return incomplete files: temporary ones, and folders in which kernels are built."""
    paths = [*folder.rglob(".warpdiff-*"), *folder.rglob("*_p*_t*"), *(folder / "temporary").iterdir()]
    return [path for path in paths if path.is_dir() or path.name.startswith(".") or path.parent.name == "temporary"]


# Script that runs a command line. It prints a line when Python has started. The tests wait for this line before their
# delays begin, so that a busy machine, on which Python starts slowly, does not change what the signal interrupts.
ANNOUNCED = """
import runpy, sys
print("begun", flush=True)
runpy.run_module("warpdiff", run_name="__main__", alter_sys=True)
"""
# Delays in seconds before the signal is sent: some signals arrive during imports, others during the compilation of
# kernels.
GRID = [
    *((0.15, "SIGINT"), (0.4, "SIGTERM"), (0.8, "SIGHUP"), (1.6, "SIGTERM")),
]
if IS_SOAK:
    GRID = [(0.15 * 1.16**k, name) for k in range(20) for name in NAMES]


@pytest.mark.permanent(ROW)
@pytest.mark.parametrize(("delay", "name"), GRID)
def test_the_command_line_ends_by_a_signal(delay, name, tmp_path):
    number = getattr(signal, name)
    with begun(["-c", ANNOUNCED, "brdf", "--heightfield", "blazed", "-o", "map.png"], tmp_path) as process:
        assert process.stdout.readline() == "begun\n"
        time.sleep(delay)
        process.send_signal(number)
        begin = time.monotonic()
        error = process.communicate(timeout=60)[1]
    assert process.returncode == 128 + number, error
    # A compilation that has started cannot be interrupted. The command must end soon after it.
    assert time.monotonic() - begin < 30.0
    assert "Traceback" not in error
    assert not left_behind(tmp_path)
    assert not (tmp_path / "map.png").exists()


# Script of a command that catches and ignores all exceptions.
STUBBORN = """
import sys, time
from pathlib import Path
from warpdiff import __main__; from warpdiff.apps import cli
from warpdiff.core.files import atomic_write
def command():
    with atomic_write(Path("picture.png")) as unfinished:
        unfinished.write_text("half")
        try:
            print("begun", flush=True)
            while True:
                time.sleep(0.05)
        except BaseException:
            print("swallowed", flush=True)
        while True:
            time.sleep(0.05)
cli.main = command
sys.exit(__main__.main())
"""


@pytest.mark.permanent(ROW)
@pytest.mark.parametrize("name", NAMES)
def test_a_second_signal_ends_a_command_that_swallows_the_first(name, tmp_path):
    number = getattr(signal, name)
    with begun(["-c", STUBBORN], tmp_path) as process:
        assert process.stdout.readline() == "begun\n"
        assert left_behind(tmp_path)
        process.send_signal(number)
        assert process.stdout.readline() == "swallowed\n"
        process.send_signal(number)
        begin = time.monotonic()
        process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert time.monotonic() - begin < 1.0
    assert not left_behind(tmp_path)


def ended(code, folder):
    """Return the exit code, the output and the error output of a process that runs the code."""
    with begun(["-c", code], folder) as process:
        out, error = process.communicate(timeout=60)
    return process.returncode, out, error


COMMAND = "import signal, sys, time; from warpdiff import __main__; from warpdiff.apps import cli\n"
RUN = "\nsys.exit(__main__.main())"


def test_an_ignored_signal_stays_ignored(tmp_path):
    ignore = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
    raises = "cli.main = lambda: signal.raise_signal(signal.SIGHUP) or 3"
    assert ended(ignore + COMMAND + raises + RUN, tmp_path)[0] == 3


def test_an_interruption_that_is_converted_to_another_error_ends_the_command(tmp_path):
    """An interruption must end the command even if other code converts it to another error.

    The test command converts it to ``ImportError``, as NumPy does while it is imported.
    """
    rotated = "def turned():\n    try: signal.raise_signal(15); time.sleep(60.0)\n"
    rotated += "    except BaseException: raise ImportError('could not import')\ncli.main = turned"
    code, _, error = ended(COMMAND + rotated + RUN, tmp_path)
    assert (code, error) == (143, "")


def test_an_interruption_in_a_finalizer_ends_the_command_without_a_message(tmp_path):
    last = "class Last:\n    def __del__(self): signal.raise_signal(15); time.sleep(0.01)\n"
    assert ended(COMMAND + last + "cli.main = lambda: Last() and time.sleep(60.0)" + RUN, tmp_path) == (143, "", "")


def test_a_signal_after_the_command_has_ended_changes_nothing(tmp_path):
    # Python deletes module globals after it has called all exit functions. The finalizer of this global sends SIGTERM
    # at that late time.
    late = "import signal\nclass Late:\n    def __del__(self, end=signal.raise_signal): end(15)\nlate = Late()\n"
    code, out, error = ended(late + COMMAND + "sys.argv[1:] = ['cache']" + RUN, tmp_path)
    assert code == 0, error
    assert "0 files" in out
    assert not left_behind(tmp_path)


def test_the_library_changes_no_signal_handlers(tmp_path):
    code = "import signal; before = list(map(signal.getsignal, (2, 15, 1))); from warpdiff import *\n"
    code += "reflectance(HeightField([[0.0] * 8] * 8, 0.1), [0, 0, 1], [0, 0, 1], method='direct')\n"
    code += "assert before == list(map(signal.getsignal, (2, 15, 1)))"
    assert ended(code, tmp_path)[0] == 0
