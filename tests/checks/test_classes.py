"""A limit on the methods of a class: one with more gives the reason in its docstring."""

from __future__ import annotations

import ast
from pathlib import Path

MOST = 40
REASON = f"It has more than {MOST} methods because"


def test_class_has_few_methods_or_reason_for_more() -> None:
    root = Path(__file__).parents[2]
    for path in (path for part in ("bridge", "console", "extras") for path in (root / part).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if text.count("def ") <= MOST:
            continue  # to parse all takes seconds
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ClassDef):
                methods = sum(isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef) for each in node.body)
                says_why = REASON in (ast.get_docstring(node) or "")
                assert methods <= MOST or says_why, f'{path}: split {node.name}, or tell its readers: "{REASON} ..."'
