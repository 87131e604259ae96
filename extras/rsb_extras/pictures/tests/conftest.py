"""Fixtures of the tests of pictures: of the process that draws, engines, commands and consoles."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.command.children_helpers import planted
from tests.command.conftest import here, ran
from tests.console.conftest import _parsed_once, _same_everywhere, _toasts_stay, folder
from tests.engine.conftest import _answers_take_their_time, shared
from tests.support.coroutines import pytest_pyfunc_call
from tests.support.offline import loop, make_context
from tests.support.waiting import eventually

from rsb_extras.pictures.renderer import Renderer

__all__ = [
    "_answers_take_their_time",
    "_parsed_once",
    "_same_everywhere",
    "_toasts_stay",
    "folder",
    "here",
    "loop",
    "make_context",
    "planted",
    "pytest_pyfunc_call",
    "ran",
    "renderer",
    "shared",
]


@pytest.fixture
def renderer() -> Iterator[Renderer]:
    """The process that draws."""
    renderer = Renderer()
    yield renderer
    renderer.close()
    eventually(lambda: renderer.pid is None)
