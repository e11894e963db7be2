"""The package without the parts of Python that exist only on POSIX systems, as on Windows, and with Windows' newlines.

The tests hide these parts on this system. Other differences between operating systems are listed in
``docs/contributing/operating_systems.md``.
"""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = sorted(path for folder in ("warpdiff", "kernels") for path in (ROOT / folder).rglob("*.py"))
# Modules of the standard library that Windows lacks, most of which macOS has.
POSIX_MODULES = ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "syslog", "posix", "curses", "readline")
# Attributes that Windows lacks, by module. macOS lacks ``sched_getaffinity`` and ``epoll``, too.
POSIX_NAMES = {
    "os": ("fork", "register_at_fork", "sched_getaffinity", "getuid", "geteuid", "getgid", "getpgid", "killpg",
           "setsid", "mkfifo", "nice", "fchmod", "sysconf", "wait", "WIFSIGNALED"),
    "select": ("poll", "epoll"),
    "signal": ("SIGHUP", "SIGALRM", "SIGKILL", "SIGPIPE", "SIGUSR1", "SIGCHLD", "alarm", "setitimer"),
}  # fmt: skip
# Packages that are imported before anything is hidden. The test is of warpdiff without POSIX modules, not of its
# dependencies.
PRELOADED = (
    "numpy", "scipy.signal", "scipy.sparse.linalg", "scipy.optimize", "warp", "trimesh", "PIL.Image", "OpenImageIO",
    "colour", "websockets.asyncio.server", "mapbox_earcut", "tqdm", "asyncio", "multiprocessing", "concurrent.futures",
    "tempfile", "logging", "webbrowser", "zipfile", "hashlib", "importlib.metadata", "random", "secrets", "argparse",
    "urllib.request", "socket",
)  # fmt: skip
HIDE = f"""
import importlib, os, select, signal, sys
for name in {PRELOADED!r}:
    importlib.import_module(name)
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name in {POSIX_MODULES!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
for name in {POSIX_MODULES!r}:
    sys.modules.pop(name, None)
sys.meta_path.insert(0, Hidden())
for module, names in {POSIX_NAMES!r}.items():
    for name in names:
        vars(sys.modules[module]).pop(name, None)
"""
# Files that the test does not import by name: adapters to the optional packages of the same name, and ``__init__.py``,
# which Python imports with its package.
ADAPTERS = ("__init__.py", "jax.py", "torch.py")
MODULES = [
    ".".join(("warpdiff", *path.relative_to(ROOT).with_suffix("").parts)).replace("warpdiff.warpdiff", "warpdiff")
    for path in SOURCES if path.name not in ADAPTERS
]  # fmt: skip
IMPORT_ALL = f"""
for name in {MODULES!r}:
    importlib.import_module(name)
print(sum(name in sys.modules for name in {MODULES!r}))
"""
USE = """
import numpy as np
import warpdiff as wd
from warpdiff.core import memory
assert memory.available() > 0.0
field = wd.HeightField([[0.0, 0.1] * 4] * 8, 0.1)
field.save("field.npz")
assert np.array_equal(wd.HeightField.load("field.npz").heights_um, field.heights_um)
assert wd.reflectance(field, [0, 0, 1], [0, 0, 1], method="direct").shape == (3,)
from warpdiff.__main__ import main
sys.argv = ["warpdiff", "info", "field.npz"]
sys.exit(main())
"""


def run(code, cwd):
    done = subprocess.run(
        [sys.executable, "-W", "error::ImportWarning", "-c", code], cwd=cwd, capture_output=True, text=True,
        check=False, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.skipif(os.name != "posix", reason="nothing is to be hidden")
def test_every_module_can_be_imported_without_posix_modules(tmp_path):
    assert len(MODULES) > 200
    assert int(run(HIDE + IMPORT_ALL, tmp_path).split()[-1]) == len(MODULES)


@pytest.mark.skipif(os.name != "posix", reason="nothing is to be hidden")
def test_fields_files_and_commands_work_without_posix_modules(tmp_path):
    assert "0.1 µm" in run(HIDE + USE, tmp_path)


def guarded(tree):
    """Return the syntax nodes inside of ``try`` statements that handle ``ImportError`` or ``AttributeError``."""
    statements = [
        node for node in ast.walk(tree) if isinstance(node, ast.Try)
        and any(re.search("ImportError|AttributeError", ast.unparse(each.type or node)) for each in node.handlers)
    ]  # fmt: skip
    return {inner for statement in statements for part in statement.body for inner in ast.walk(part)}


def unguarded_uses(text):
    """Return the uses of POSIX-only modules and names in a source text that no check or ``try`` statement guards."""
    tree = ast.parse(text)
    safe, result = guarded(tree), []
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names if alias.name in POSIX_MODULES]
        elif isinstance(node, ast.ImportFrom) and node.module in POSIX_MODULES:
            names = [node.module]
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            known = POSIX_NAMES.get(node.value.id, ())
            has_check = f'hasattr({node.value.id}, "{node.attr}")' in text
            names = [f"{node.value.id}.{node.attr}"] if node.attr in known and not has_check else []
        if node not in safe:
            result += names
    return result


def test_unguarded_uses_are_recognised():
    assert unguarded_uses("import fcntl\nos.fork()\nimport os") == ["fcntl", "os.fork"]
    assert unguarded_uses("try:\n    import resource\nexcept ImportError:\n    pass") == []
    assert unguarded_uses('if hasattr(os, "fork"):\n    os.fork()') == []


def test_no_posix_module_or_name_is_used_without_a_guard():
    assert len(SOURCES) > 200
    uses = {path.name: unguarded_uses(path.read_text(encoding="utf-8")) for path in SOURCES}
    assert not {name: found for name, found in uses.items() if found}


def texts_without_encoding(text):
    """Return the calls in a source text that name no encoding to read or write a text, or no newlines to write it.

    Windows would use a legacy encoding.
    """
    result = []
    for node in ast.walk(ast.parse(text)):
        if not (isinstance(node, ast.Call) and isinstance(node.func, (ast.Attribute, ast.Name))):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id
        stated = {keyword.arg for keyword in node.keywords}
        # ``write_text`` would write Windows' newlines, so that files would differ between systems.
        is_named = {"encoding", "newline"} <= stated if name == "write_text" else "encoding" in stated
        modes = [each.value for each in node.args if isinstance(each, ast.Constant) and isinstance(each.value, str)]
        is_module = isinstance(node.func, ast.Attribute) and ast.unparse(node.func.value) in FOREIGN_READERS
        is_text = (name == "open" and not any("b" in mode for mode in modes)) or name == "write_text"
        is_text = is_text or (name == "read_text" and not node.args and not node.keywords)
        if is_text and not is_named and not is_module:
            result.append(ast.unparse(node))
    return result


# Objects with a method ``open`` that reads no text, so that it has no encoding: image and archive libraries, and
# modules of the operating system.
FOREIGN_READERS = ("os", "archive", "output", "oiio.ImageInput", "Image", "PIL.Image")
# Files whose calls need no encoding: readers of Linux files in ASCII, and of standard streams that are replaced by the
# null device.
ASCII_FILES = {"memory.py", "process.py"}


def test_texts_are_read_and_written_in_a_named_encoding():
    calls = ["Path('a').write_text('ä', encoding='utf-8')", "open('a')", "open('a', 'rb')"]
    assert texts_without_encoding("\n".join(calls)) == calls[:2]
    uses = {path.name: texts_without_encoding(path.read_text(encoding="utf-8")) for path in SOURCES}
    assert not {name: calls for name, calls in uses.items() if calls and name not in ASCII_FILES}
