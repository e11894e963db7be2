"""The mutation run: its changes, its draw and its interval; and that the headers' faults fit the headers."""

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
    """A checkout whose packages are one file each."""
    for folder in mutant_sites.PACKAGES.values():
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "one.py").write_text(SOURCE)
    return tmp_path


def test_changes_are_of_code_alone(checkout):
    found = mutant_sites.mutants_of(checkout, "optics")
    assert [(change.old, change.new) for change in found] == [
        ("2", "3"), ("-", ""), ("1", "2"), ("is not", "is"), ("and", "or"), ("<", ">="), ("0.5", "0.55"), ("not", ""),
        ("1", "0"), ("+", "-"), ("+", "-"), ("-", "+"), ("*", "/"), ("max", "min"), ("0", "1"),
        ("a + b, c - d", "c - d, a + b"),
    ]  # fmt: skip
    assert [change.definition for change in found] == ["SIZE"] + 15 * ["nearest"]
    assert [change.at_import for change in found] == 3 * [True] + 13 * [False]
    source = (checkout / "warpdiff/optics/one.py").read_bytes()
    for change in found:
        ast.parse(change.apply(source))
        assert not change.is_equivalent(source)


def test_a_draw_keeps_its_changes_where_lines_move_and_others_appear(checkout):
    before = mutant_sites.draw(checkout, "seed", 10)
    for folder in mutant_sites.PACKAGES.values():
        path = checkout / folder / "one.py"
        path.rename(path.with_name("other.py"))
        path.with_name("other.py").write_text("# moved\n" + SOURCE + "\n\nMORE = 1\n")
    after = mutant_sites.draw(checkout, "seed", 10)
    assert len(before) == len(after) == 10
    assert len({change.key for change in before} & {change.key for change in after}) >= 8
    assert {change.key for change in before} != {change.key for change in mutant_sites.draw(checkout, "else", 10)}


def test_each_header_has_two_faults():
    changes = list(mutant_sites.header_mutants(ROOT))
    headers = {path.name for path in (ROOT / mutant_sites.NATIVE).glob("*.h")}
    assert Counter(change.definition for change in changes) == dict.fromkeys(headers, 2)


def test_intervals_are_wilsons():
    low, high = mutants.wilson(20, 20)
    assert (low, high) == pytest.approx((20 / (20 + 1.96**2), 1.0))
    assert mutants.wilson(5, 10) == pytest.approx((0.2366, 0.7634), abs=1e-4)


def test_scores_count_time_limits_as_detected_and_leave_out_equal_code():
    results = ["killed", "timed out", "survived", "survived", "equivalent"]
    records = [{"key": str(n), "package": "optics", "result": result} for n, result in enumerate(results)]
    row = mutants.summary(records, {"2": "equivalent: no effect", "3": "accepted: slower"})[0]
    assert (row["changes"], row["detected"], row["score"], row["score without equivalent"]) == (4, 2, 0.5, 2 / 3)
