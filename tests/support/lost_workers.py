"""A pytest plugin: a run that loses a worker of pytest-xdist is interrupted, not one with a failure.

What the worker's lane had left is not run at all, so such a run says nothing of it.
"""

from __future__ import annotations

from typing import Any

import pytest

_IS_LOST = pytest.StashKey[bool]()


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: object) -> None:
    if error is not None:
        node.config.stash[_IS_LOST] = True


def pytest_sessionfinish(session: pytest.Session) -> None:
    if session.config.stash.get(_IS_LOST, False):
        session.exitstatus = pytest.ExitCode.INTERRUPTED
