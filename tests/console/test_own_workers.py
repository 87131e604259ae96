"""A screen's own method is a worker by `textual.work`, which hands over a function.

The coroutine of a worker that ends before it begins, as when the console quits, is never awaited: Python warns.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import rsb_console
import rsb_extras

FOLDERS = [Path(str(package.__file__)).parent for package in (rsb_console, rsb_extras)]


def own_coroutines(source: str) -> list[str]:
    """The calls of `self.run_worker` with what a method of `self` has returned."""
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call) and node.args]
    given = [call.args[0] for call in calls if ast.unparse(call.func) == "self.run_worker"]
    return [ast.unparse(each) for each in given if isinstance(each, ast.Call) and "self." in ast.unparse(each.func)]


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_own_methods_are_workers_by_decorator(folder: Path) -> None:
    sources = {path: path.read_text(encoding="utf-8") for path in folder.rglob("*.py")}
    assert sources
    assert {path: found for path, source in sources.items() if (found := own_coroutines(source))} == {}


def test_own_coroutine_is_found() -> None:
    source = "self.run_worker(self._ask(1), group='a')\nself.run_worker(other(self))\nself.app.run_worker(self.set())"
    assert own_coroutines(source) == ["self._ask(1)"]
