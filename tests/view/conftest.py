"""Fixtures of the views' tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.support.coroutines import pytest_pyfunc_call
from tests.support.waiting import eventually

from rsb_bridge.view.renderer import Renderer

__all__ = ["pytest_pyfunc_call", "renderer"]


@pytest.fixture
def renderer() -> Iterator[Renderer]:
    """The process that draws."""
    renderer = Renderer()
    yield renderer
    renderer.close()
    eventually(lambda: renderer.pid is None)
