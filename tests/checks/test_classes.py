"""A limit on the methods of a class: one with more gives the reason in its docstring, where that is allowed."""

from __future__ import annotations

import ast

from tests.checks.class_bases import PARTS, ROOT, classes_in, is_special, lineage, methods_of

MOST = 40
REASON = f"It has more than {MOST} methods because"
ROOMS_IN_ORDER = (ROOT / "bridge" / "rsb_bridge" / "route",)
"""Where no reason is taken, and the methods of all bases count: bases only hide how much a class can do."""


def test_class_has_few_methods_or_reason_for_more() -> None:
    for path in (path for part in PARTS for path in (ROOT / part).rglob("*.py")):
        if any(path.is_relative_to(room) for room in ROOMS_IN_ORDER):
            continue
        if path.read_text(encoding="utf-8").count("def ") <= MOST:
            continue  # to parse all takes seconds
        for node in classes_in(path):
            methods = sum(isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef) for each in node.body)
            says_why = REASON in (ast.get_docstring(node) or "")
            assert methods <= MOST or says_why, f'{path}: split {node.name}, or tell its readers: "{REASON} ..."'


def test_class_has_few_methods_with_all_bases() -> None:
    """Properties count; special methods, and bases from outside the project, do not."""
    counts = {
        f"{path.relative_to(ROOT)}: {node.name}": len(
            {name for each in lineage(path, node) for name in methods_of(each) if not is_special(name)}
        )
        for room in ROOMS_IN_ORDER
        for path in room.rglob("*.py")
        for node in classes_in(path)
    }
    assert len(counts) > 100
    assert {name: count for name, count in counts.items() if count > MOST} == {}
