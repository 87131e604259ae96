"""The drawing process gives each view its own pictures, even if others fail."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from geometry_msgs.msg import Vector3
from tests.support.stopping import stop
from tests.support.waiting import eventually

from rsb_extras.pictures.picture import Wish
from rsb_extras.pictures.renderer import Renderer
from rsb_extras.pictures.tests import picture_places
from rsb_extras.pictures.tests.samples import task

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

    from rsb_extras.pictures.worker import Task


def tree(view: int, x: float = 0.0) -> Task:
    """Return a view's task; the number of its messages is the view's."""
    return task(Wish(how="tree"), *[Vector3(x=x)] * view, view=view)


async def test_view_never_gets_picture_of_ended_one(renderer: Renderer) -> None:
    ended = asyncio.create_task(renderer.draw(tree(1)))
    await asyncio.to_thread(eventually, lambda: renderer.pid)
    ended.cancel()
    await asyncio.wait([ended])
    assert ((await renderer.draw(tree(2))).messages, (await renderer.draw(tree(3))).messages) == (2, 3)


async def test_a_hung_process_is_replaced(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    picture_places.DRAWING_WITHIN.set(monkeypatch, 0.2)
    await renderer.draw(tree(1))
    assert renderer.pid is not None
    stop(renderer.pid)
    assert (await renderer.draw(tree(1))).problem
    assert not (await renderer.draw(tree(1))).problem


async def test_a_slow_view_leaves_time_to_the_others(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    picture_places.DRAWING_WITHIN.set(monkeypatch, 0.2)
    picture_places.DRAWING_SLOW.set(monkeypatch, 0.19)
    await renderer.draw(tree(1))
    assert renderer.pause_after(1) == 0.0  # it took so long because the process started
    assert renderer.pid is not None
    stop(renderer.pid)
    await renderer.draw(tree(1))
    assert renderer.pause_after(1) == 0.0, "it is alone"
    await renderer.draw(tree(2))
    assert (renderer.pause_after(1) >= 3 * 0.2, renderer.pause_after(2)) == (True, 0.0)
    renderer.forget(2)
    assert renderer.pause_after(1) == 0.0


async def test_a_closed_renderer_starts_no_process(renderer: Renderer) -> None:
    drawing = asyncio.create_task(renderer.draw(tree(1)))
    await asyncio.to_thread(eventually, lambda: renderer.pid)
    renderer.close()
    await drawing
    assert (await renderer.draw(tree(1))).problem
    await asyncio.to_thread(eventually, lambda: renderer.pid is None)


def test_the_drawing_process_runs_nothing_of_its_folder(planted: Path) -> None:
    renderer = Renderer()
    try:
        picture = asyncio.run(renderer.draw(task(Wish(how="tree"), Vector3(x=1.0))))
    finally:
        renderer.close()
        eventually(lambda: renderer.pid is None)
    assert not picture.problem
    assert not planted.exists()
