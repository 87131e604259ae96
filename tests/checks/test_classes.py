"""A limit on the methods of a class: one with more gives the reason in its docstring."""

from __future__ import annotations

import ast
from pathlib import Path

MOST = 40
REASON = f"more than {MOST} methods because"


def too_long(path: Path) -> list[str]:
    text = path.read_text(encoding="utf-8")
    if text.count("def ") <= MOST:
        return []  # to parse all takes seconds
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ClassDef) and REASON not in " ".join((ast.get_docstring(node) or "").split()):
            methods = sum(isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef) for each in node.body)
            found += [f"{path}: {node.name} has {methods} methods"] if methods > MOST else []
    return found


def test_a_class_has_few_methods_or_a_reason_for_more() -> None:
    root = Path(__file__).parents[2]
    paths = [path for program in ("bridge", "console") for path in sorted((root / program).rglob("*.py"))]
    found = [line for path in paths for line in too_long(path)]
    assert not found, "\n".join((f'split it, or say in its docstring: "It has {REASON} ..."', *found))
