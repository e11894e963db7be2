"""Mutation testing (``bench.dev.mutants``): faults in Python files and headers, their random order, and scores."""

import ast
from collections import Counter
from pathlib import Path

import pytest

from bench.dev import mutant_sites, mutants

ROOT = Path(__file__).resolve().parents[2]
SOURCE = '''"""At most 3 - 1."""

SIZE: Annotated[int, 5] = 2
if TYPE_CHECKING:
    from somewhere import a


@cache(maxsize=7)
def nearest(values: "list[9]", *, axis=-1, **options: float) -> int:
    """Not 4 + 4."""
    if values is not None and len(values) < 0.5:
        raise ValueError(f"more than {1 + 1}: " + "too many" * 2)
    return not swap(x, values[1]) + swap(a + b, c - d) * max(values, 0)
'''


@pytest.fixture
def checkout(tmp_path):
    """Return a checkout in which each package has a single file with the text ``SOURCE``."""
    for folder in mutant_sites.PACKAGES.values():
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "one.py").write_text(SOURCE)
    return tmp_path


def test_changes_affect_only_code(checkout):
    changes = list(mutant_sites.mutants_of(checkout, "optics"))
    assert [(change.old, change.new) for change in changes] == [
        ("2", "3"), ("-", ""), ("1", "0"), ("is not", "is"), ("and", "or"), ("<", ">="), ("0.5", "0.55"), ("not", ""),
        ("1", "0"), ("+", "-"), ("+", "-"), ("-", "+"), ("*", "/"), ("max", "min"), ("0", "1"),
    ]  # fmt: skip
    assert [change.names for change in changes] == [("SIZE",)] + 14 * [("nearest",)]
    source = (checkout / "warpdiff/optics/one.py").read_bytes()
    for change in changes:
        ast.parse(change.apply(source))


def test_a_draw_is_stable_if_lines_move_or_are_added(checkout):
    before = mutant_sites.draw(checkout, "seed")[:10]
    for folder in mutant_sites.PACKAGES.values():
        path = checkout / folder / "one.py"
        path.rename(path.with_name("other.py"))
        path.with_name("other.py").write_text("# moved\n" + SOURCE + "\n\nMORE = 1\n")
    after = mutant_sites.draw(checkout, "seed")[:10]
    assert len({change.identity for change in before} & {change.identity for change in after}) >= 8
    assert [change.identity for change in before] != [c.identity for c in mutant_sites.draw(checkout, "else")[:10]]


def test_a_draw_of_some_packages_is_a_part_of_the_whole_draw(checkout):
    some = mutant_sites.draw(checkout, "seed", ["optics", "kernels"])
    assert some == [c for c in mutant_sites.draw(checkout, "seed") if c.package in {"optics", "kernels"}]


def test_each_header_has_two_faults():
    changes = list(mutant_sites.header_mutants(ROOT))
    headers = {path.name for path in (ROOT / mutant_sites.NATIVE).glob("*.h")}
    assert Counter(change.names for change in changes) == dict.fromkeys([(header,) for header in headers], 2)


def test_scores_count_time_limits_as_detected_and_headers_separately():
    results = ["tests/optics/test_one.py::test_2", "timed out", "survived", "survived"]
    record = {"package": "optics", "place": "warpdiff/optics/one.py:1", "changed": "SIZE = 3 | 1"}
    header = record | {"package": "native", "result": "x"}
    text = mutants.table([*(record | {"result": result} for result in results), header])
    assert "| all | 4 | 2 | 50.0% | 15.0% to 85.0% |" in text
    assert "| native | 1 | 1 | 100.0% |" in text
    assert "| warpdiff/optics/one.py:1 | `SIZE = 3 \\| 1` |" in text


def test_faults_of_a_header_run_tests_of_the_kernels_that_include_it(tmp_path):
    native = tmp_path / mutant_sites.NATIVE
    native.mkdir(parents=True)
    (native / "inner.h").write_text("")
    (native / "outer.h").write_text('#include "inner.h"\n')
    (tmp_path / "kernels/a.py").write_text('set_options("outer.h")\n\n\ndef traced():\n    return helper()\n')
    (tmp_path / "kernels/b.py").write_text("def other():\n    return 1\n")
    run = mutants.Run.__new__(mutants.Run)
    run.tree, run._most_s, run._executed = tmp_path, 10.0, {"traced", "other"}
    run._tests = {f"tests/{name}.py": {"seconds": 1.0, "names": [name]} for name in ("traced", "other")}
    run._uses = dict(run._used_names())
    fault = mutant_sites.Mutant("native", "kernels/native/inner.h", 0, "", "", 1, ("inner.h",), "")
    assert run.tests_of(fault) == ["tests/traced.py"]


def test_functions_of_kernels_run_the_tests_of_files_that_import_their_module(tmp_path):
    """Kernels in test files call functions of the library's kernels, which is not recorded.

    Tests of files that import the changed module must run before others, and those of other files only if they execute
    the changed code.
    """
    (tmp_path / "kernels").mkdir()
    (tmp_path / "kernels/a.py").write_text("def helper():\n    return 1\n")
    folder = tmp_path / "tests/kernels"
    folder.mkdir(parents=True)
    (folder / "test_b.py").write_text("from kernels import a\n")
    (folder / "test_c.py").write_text("from kernels import ab\n# a comment on a\n")
    run = mutants.Run.__new__(mutants.Run)
    run.tree, run._most_s, run._executed = tmp_path, 10.0, {"traced"}
    names = [f"tests/kernels/test_{letter}.py::test" for letter in "bc"]
    run._tests = {name: {"seconds": 1.0, "names": ["traced"]} for name in names}
    run._uses = dict(run._used_names())
    fault = mutant_sites.Mutant("kernels", "kernels/a.py", 0, "1", "0", 2, ("helper",), "")
    assert run.tests_of(fault) == names[:1]
