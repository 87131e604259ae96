"""A limit on private members in tests: each breaks a test when the program renames it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

MOST = 96
PUBLIC = {"_replace", "_asdict", "_fields", "_make", "_exit", "_get_running_loop", "_set_running_loop"}
"""Of named tuples, `os` and asyncio."""
OWN = {"self", "cls", "super()"}


def private(path: Path) -> list[str]:
    text = path.read_text(encoding="utf-8")
    if {*re.findall(r"(?<!\bself)(?<!\bcls)\.(_[A-Za-z]\w*)", text)} <= PUBLIC:
        return []  # to parse all takes seconds
    nodes = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Attribute)]
    hidden = [each for each in nodes if each.attr.startswith("_") and each.attr[:2] != "__" and each.attr not in PUBLIC]
    return [f"{path}:{each.lineno} {each.attr}" for each in hidden if ast.unparse(each.value) not in OWN]


def test_tests_name_few_private_members_of_others() -> None:
    root = Path(__file__).parents[2]
    paths = [*(root / "tests").rglob("*.py"), *root.glob("extras/rsb_extras/*/tests/*.py")]
    found = [place for path in sorted(paths) for place in private(path)]
    assert len(found) <= MOST, "\n".join(found)
