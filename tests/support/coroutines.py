"""Tests that are coroutines, for the conftest of a folder that has some."""

from __future__ import annotations

import asyncio
import inspect
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a coroutine on its fixture `loop`, and without one on a loop of its own."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    given = pyfuncitem.funcargs
    test = pyfuncitem.obj(**{name: given[name] for name in inspect.signature(pyfuncitem.obj).parameters})
    loop: Any = given.get("loop")
    if loop is None:
        asyncio.run(test)
    else:
        loop.run_until_complete(test)
    return True


async def until(condition: Callable[[], object]) -> None:
    """Wait on the running loop for what other sockets and threads do."""
    async with asyncio.timeout(60):
        while not condition():  # noqa: ASYNC110 (it is no event of ours)
            await asyncio.sleep(0.005)
