"""Parts of an HTML page: escaped texts, tables, lists and paragraphs."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence

# Mark at the end of a column's name. It aligns the numbers of this column to the right, and the page does not show it.
RIGHT = "→"


class Html(NamedTuple):
    """Cell of a table that contains HTML text. Texts in other cells are escaped."""

    html: str


def text_of(value: object) -> str:
    """Return a value as escaped HTML text; numbers stay on one line with their unit or sign."""
    return (
        html.escape(str(value))
        .replace(" %", "\u00a0%")
        .replace(" µm", "\u00a0µm")
        .replace(" nm", "\u00a0nm")
        .replace(" = ", "\u00a0=\u00a0")
    )


def table_of(names: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return an HTML table.

    On narrow screens, each row is a block, and each cell has the name of its column.

    Args:
        names: Names of the columns. A name that ends in `RIGHT` marks numbers. The last name may be empty, for a column
            of notes, which is omitted if all notes are empty.
        rows: Cells of each row.
    """
    if not names[-1] and not any(row[-1] for row in rows):
        names, rows = names[:-1], [row[:-1] for row in rows]
    kinds = ["number" if name.endswith(RIGHT) else "" if name else "note" for name in names]
    classes = [f' class="{kind}"' if kind else "" for kind in kinds]
    labels = [text_of(name.rstrip(RIGHT)) for name in names]
    head = "".join(f"<th{kind}>{label}</th>" for kind, label in zip(classes, labels, strict=True))
    starts = [f'<td{kind} data-name="{label}">' for kind, label in zip(classes, labels, strict=True)]
    lines = [
        "<tr>" + "".join(f"{start}{_cell(cell)}</td>" for start, cell in zip(starts, row, strict=True)) + "</tr>\n"
        for row in rows
    ]
    return (
        '<table class="wide">\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{''.join(lines)}</tbody></table>\n"
    )  # fmt: skip


def _cell(value: object) -> str:
    return value.html if isinstance(value, Html) else text_of(value)


def facts_table(facts: Sequence[tuple[str, str]]) -> str:
    """Return an HTML table of two columns: a name, and its value as HTML text."""
    rows = "".join(f"<tr><th>{text_of(name)}</th><td>{text}</td></tr>\n" for name, text in facts)
    return f'<table class="facts"><tbody>\n{rows}</tbody></table>\n'


def listed(texts: Sequence[str], tag: str = "ul") -> str:
    """Return an HTML list of texts: with bullets for the tag ``"ul"``, with numbers for ``"ol"``."""
    return f"<{tag}>\n" + "".join(f"<li>{text_of(text)}</li>\n" for text in texts) + f"</{tag}>\n"


def paragraph(text: str) -> str:
    """Return a text as an HTML paragraph."""
    return f"<p>{text_of(text)}</p>\n"
