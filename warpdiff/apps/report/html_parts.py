"""Parts of an HTML page: escaped texts, tables, lists and paragraphs."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

# Numbers of a table are aligned to the right if their column's name ends so.
RIGHT = "→"


def text_of(value: object) -> str:
    """Return a text for HTML; a number and its percent sign stay on one line."""
    return html.escape(str(value)).replace(" %", "\u00a0%").replace(" µm", "\u00a0µm").replace(" nm", "\u00a0nm")


def table_of(names: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a table; columns whose name ends in the mark are numbers, and those without a name are notes."""
    kinds = ["number" if name.endswith(RIGHT) else "" if name else "note" for name in names]
    classes = [f' class="{kind}"' if kind else "" for kind in kinds]
    head = "".join(f"<th{kind}>{text_of(name.rstrip(RIGHT))}</th>" for kind, name in zip(classes, names, strict=True))
    lines = [
        "<tr>" + "".join(f"<td{kind}>{text_of(cell)}</td>" for kind, cell in zip(classes, row, strict=True)) + "</tr>\n"
        for row in rows
    ]
    return wide(f"<thead><tr>{head}</tr></thead>\n<tbody>\n{''.join(lines)}</tbody>")


def wide(table: str) -> str:
    """Return the inner HTML of a table as one that scrolls on narrow screens."""
    return f'<div class="wide" tabindex="0"><table>\n{table}</table></div>\n'


def facts_table(facts: Sequence[tuple[str, str]]) -> str:
    """Return a table of names and HTML texts."""
    rows = "".join(f"<tr><th>{text_of(name)}</th><td>{text}</td></tr>\n" for name, text in facts)
    return f'<table class="facts"><tbody>\n{rows}</tbody></table>\n'


def listed(texts: Sequence[str], tag: str = "ul") -> str:
    """Return a list of texts, ``"ul"`` without and ``"ol"`` with numbers."""
    return f"<{tag}>\n" + "".join(f"<li>{text_of(text)}</li>\n" for text in texts) + f"</{tag}>\n"


def paragraph(text: str) -> str:
    """Return a text as a paragraph."""
    return f"<p>{text_of(text)}</p>\n"
