"""Generator of ``warpdiff/request/keywords.py``: the keyword arguments of public functions, for type checkers.

``python -m bench.dev.write_keywords`` makes a ``TypedDict`` from each class of ``warpdiff/request/settings.py``. A test
checks that the file corresponds to the classes.
"""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SETTINGS = ROOT / "warpdiff" / "request" / "settings.py"
KEYWORDS = ROOT / "warpdiff" / "request" / "keywords.py"
HEAD = '''"""Types of the keyword arguments of public functions, written by ``python -m bench.dev.write_keywords``."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TypedDict

from numpy.typing import ArrayLike

from warpdiff.optics.coherence import Coherence
from warpdiff.optics.materials import Material
from warpdiff.request.plan import Plan
from warpdiff.request.settings import Bits, Display, Energy, GamutName, Integration, Method, TangentRule
'''


class _WithoutRanges(ast.NodeTransformer):
    """Syntax tree transformer that replaces ``Annotated[T, …]`` by ``T``."""

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        """Replace one expression ``Annotated[T, …]`` by ``T``."""
        self.generic_visit(node)
        if ast.unparse(node.value) == "Annotated" and isinstance(node.slice, ast.Tuple):
            return node.slice.elts[0]
        return node


def keywords(settings: str) -> str:
    """Return the text of ``keywords.py`` that corresponds to the source of ``settings.py``."""
    blocks = [HEAD]
    for node in ast.parse(settings).body:
        if not isinstance(node, ast.ClassDef):
            continue
        bases = [ast.unparse(base) for base in node.bases]
        names = [base.replace("Settings", "Keywords") for base in bases if base != "Checked"] or ["TypedDict"]
        lines = [f"class {node.name.replace('Settings', 'Keywords')}({', '.join(names)}, total=False):"]
        lines.append(f'    """Keyword arguments of :class:`warpdiff.request.settings.{node.name}`."""')
        fields = [each for each in node.body if isinstance(each, ast.AnnAssign)]
        lines += [""] * bool(fields)
        lines += [
            f"    {ast.unparse(each.target)}: {ast.unparse(_WithoutRanges().visit(each.annotation))}" for each in fields
        ]
        blocks.append("\n".join(lines) + "\n")
    return "\n\n".join(blocks)


if __name__ == "__main__":
    KEYWORDS.write_text(keywords(SETTINGS.read_text(encoding="utf-8")), encoding="utf-8")
