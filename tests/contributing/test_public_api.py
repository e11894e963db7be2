"""The stored signatures of public names are current, and a change of them must be listed in the changelog."""

from bench.dev import public_signatures as api

CHANGELOG = """# Changelog

## 1.1.0

- `Lens.focus` is an argument of `draw`. `Prism` is new.

## 1.0.0

- `old_name` was new.
"""


def test_stored_signatures_are_current():
    stored = api.STORED.read_text(encoding="utf-8").splitlines()
    names = api.changed_names(stored, api.signatures())
    assert not names, "list the change in CHANGELOG.md, then run python -m bench.dev.public_signatures --write"


def test_signatures_contain_arguments_defaults_fields_and_flags():
    lines = "\n".join(api.signatures())
    for text in (
        "shade(mesh, heightfield, lights, view, *,", "tolerance=0.01", "Plan.terms: field", "HeightField.load(path, *,",
        "gratings.fingers(", "BakedLobes: class(SavedTable)", "HeightField.source: property",
        "warpdiff-render.--output: flag",
    ):  # fmt: skip
        assert text in lines, text
    assert " at 0x" not in lines


def test_added_removed_and_changed_names_are_found():
    old = ["A.f(self)", "A: class()", "g(x)", "h(x)"]
    assert api.changed_names(old, ["A.f(self, n=1)", "A: class()", "g(x)", "k()"]) == ["A.f", "h", "k"]


def test_a_change_must_be_listed_in_the_first_section():
    names = ["Lens.focus", "draw", "Prism", "Prism.__init__", "Prism.angle", "Lens.zoom", "old_name"]
    assert api.unlisted(names, CHANGELOG) == ["Lens.zoom", "old_name"]
