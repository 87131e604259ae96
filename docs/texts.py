"""Writes every text that operators may read to ``build/texts.txt``, to be read at once (`make texts`)."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

_ROOT = Path(__file__).parent.parent
_PROGRAM = ("bridge", "console", "extras")
_SEVERAL_WORDS = re.compile(r"[A-Za-z]{2,}\S* .*[A-Za-z]{2,}")


class _Texts(ast.NodeVisitor):
    """Collects a module's strings of several words, but not its docstrings. Expressions in them stand as source."""

    def __init__(self) -> None:
        self.found: list[str] = []

    def visit_Expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):
            self.generic_visit(node)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        self._take("".join(_source(part) for part in node.values))
        for part in node.values:
            if isinstance(part, ast.FormattedValue):
                self.visit(part.value)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str):
            self._take(node.value)

    def _take(self, text: str) -> None:
        if _SEVERAL_WORDS.search(text):
            self.found.append(text.encode("unicode_escape").decode() if not text.isprintable() else text)


def _source(part: ast.expr) -> str:
    """Return a part of an f-string: its text, or the source of its expression."""
    if isinstance(part, ast.Constant):
        return str(part.value)
    return f"{{{ast.unparse(part.value)}}}" if isinstance(part, ast.FormattedValue) else ""


def page() -> str:
    """The contents of the file: the path of each module, and its texts in their order."""
    parts = []
    found = (path for folder in _PROGRAM for path in (_ROOT / folder).rglob("*.py"))
    for path in sorted(path for path in found if "tests" not in path.relative_to(_ROOT).parts):
        texts = _Texts()
        texts.visit(ast.parse(path.read_text(encoding="utf-8")))
        if texts.found:
            parts.append("\n".join([f"# {path.relative_to(_ROOT)}", *texts.found]) + "\n")
    return "\n".join(parts)


if __name__ == "__main__":
    written = _ROOT / "build" / "texts.txt"
    written.parent.mkdir(exist_ok=True)
    written.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"{written}\n")
