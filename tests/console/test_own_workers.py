"""Workers get functions, from `textual.work` or as a `functools.partial`, and no coroutines.

The coroutine of a worker that ends before it begins, as when the console quits, is never awaited: Python warns.
"""

from __future__ import annotations

import ast
import gc
import warnings
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import pytest
from tests.console.driving import on_main, until
from tests.support.screen_sources import FOLDERS, found_in

from rsb_console.actions.all_actions import BY_ID

if TYPE_CHECKING:
    from pathlib import Path

    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp

MADE_LATER = ("partial", "call_of")


def coroutines(source: str) -> list[str]:
    """The calls of `run_worker` with what a function has returned."""
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call) and node.args]
    given = [call.args[0] for call in calls if ast.unparse(call.func).endswith(".run_worker")]
    made = [each for each in given if isinstance(each, ast.Call)]
    return [ast.unparse(each) for each in made if ast.unparse(each.func) not in MADE_LATER]


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_workers_get_functions(folder: Path) -> None:
    assert found_in(folder, coroutines) == {}


def test_coroutine_is_found() -> None:
    source = (
        "self.run_worker(self._ask(1), group='a')\nself.app.run_worker(partial(other, self))\nself.run_worker(call)"
    )
    assert coroutines(source) == ["self._ask(1)"]


@on_main()
async def test_action_that_has_not_begun_leaves_no_coroutine(app: ConsoleApp, pilot: Pilot[None]) -> None:
    """Of an exclusive group, the second worker ends the first one before that has begun."""
    done: list[int] = []

    async def run(_screen: object, number: int) -> None:
        done.append(number)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for number in range(2):
            app.main.act(replace(BY_ID["sessions"], run=partial(run, number=number)))
        await until(pilot, lambda: bool(done), "the second one")
        gc.collect()
    assert done == [1]
