"""Tests that are coroutines, for the conftest of a folder that has some."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Callable
from typing import Any

import pytest


def arguments_of(test: pytest.Function) -> dict[str, Any] | None:
    """Return what a test that is a coroutine takes, or None of another test."""
    if not inspect.iscoroutinefunction(test.obj):
        return None
    return {name: test.funcargs[name] for name in inspect.signature(test.obj).parameters}


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a coroutine on its fixture `loop`, and without one on a loop of its own."""
    if (given := arguments_of(pyfuncitem)) is None:
        return None
    test = pyfuncitem.obj(**given)
    loop: Any = pyfuncitem.funcargs.get("loop")
    if loop is None:
        asyncio.run(test)
    else:
        loop.run_until_complete(test)
    return True


async def until(condition: Callable[[], object]) -> None:
    """Wait on the running loop for what other sockets and threads do."""
    async with asyncio.timeout(180):
        while not condition():  # noqa: ASYNC110 (it is no event of ours)
            await asyncio.sleep(0.005)
