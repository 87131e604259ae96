"""The drawing process gives each view its own pictures, even if others fail."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from geometry_msgs.msg import Vector3
from tests.support import constants
from tests.support.stopping import stop
from tests.support.waiting import eventually
from tests.view.samples import task

from rsb_bridge.model.pictures import Wish

if TYPE_CHECKING:
    import pytest

    from rsb_bridge.view.renderer import Renderer
    from rsb_bridge.view.worker import Task


def tree(view: int, x: float = 0.0) -> Task:
    """Return a view's task; the number of its messages is the view's."""
    return task(Wish(how="tree"), *[Vector3(x=x)] * view, view=view)


def test_a_view_never_gets_the_picture_of_one_that_ended_while_it_was_drawn(renderer: Renderer) -> None:
    async def run() -> tuple[int, int]:
        ended = asyncio.create_task(renderer.draw(tree(1)))
        await asyncio.to_thread(eventually, lambda: renderer.pid)
        ended.cancel()
        await asyncio.wait([ended])
        return (await renderer.draw(tree(2))).messages, (await renderer.draw(tree(3))).messages

    assert asyncio.run(run()) == (2, 3)


def test_a_hung_process_is_replaced(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.DRAWING_WITHIN.set(monkeypatch, 0.2)

    async def run() -> tuple[str, str]:
        await renderer.draw(tree(1))
        assert renderer.pid is not None
        stop(renderer.pid)
        return (await renderer.draw(tree(1))).problem, (await renderer.draw(tree(1))).problem

    first, second = asyncio.run(run())
    assert first
    assert not second


def test_a_slow_view_leaves_time_to_the_others(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.DRAWING_WITHIN.set(monkeypatch, 0.2)
    constants.DRAWING_SLOW.set(monkeypatch, 0.19)

    async def run() -> list[float]:
        await renderer.draw(tree(1))
        pauses = [renderer.pause_after(1)]  # it took so long because the process started
        assert renderer.pid is not None
        stop(renderer.pid)
        await renderer.draw(tree(1))
        pauses.append(renderer.pause_after(1))
        await renderer.draw(tree(2))
        pauses += renderer.pause_after(1), renderer.pause_after(2)
        renderer.forget(2)
        return [*pauses, renderer.pause_after(1)]

    at_start, alone, beside, of_other, alone_again = asyncio.run(run())
    assert beside >= 3 * 0.2
    assert (at_start, alone, of_other, alone_again) == (0.0, 0.0, 0.0, 0.0)


def test_a_closed_renderer_starts_no_process(renderer: Renderer) -> None:
    async def run() -> str:
        drawing = asyncio.create_task(renderer.draw(tree(1)))
        await asyncio.to_thread(eventually, lambda: renderer.pid)
        renderer.close()
        await drawing
        return (await renderer.draw(tree(1))).problem

    assert asyncio.run(run())
    eventually(lambda: renderer.pid is None)
