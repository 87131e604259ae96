"""Parts of an engine stop what they move before a topic is disarmed, and nothing moves again until it is."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.support import replaced

from rsb_bridge.engine.bridge import Bridge
from rsb_bridge.engine.part import EnginePart, MovingPart
from rsb_bridge.feature import Feature
from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

TOPIC = "/cmd_vel"
SNAPSHOTS: Any = SimpleNamespace(newest=None)


class Mover(MovingPart):
    """Has a robot move whenever it may, as its operator presses keys all the time; to stop it takes some seconds."""

    def __init__(self, bridge: Bridge, seconds: float) -> None:
        super().__init__()
        self._bridge, self._seconds = bridge, seconds
        self.moves = False

    def press(self) -> None:
        self.moves |= self._bridge.may_move(TOPIC)

    async def end_motions(self, topics: Collection[str] | None) -> bool:
        self.moves = False
        if self._seconds:
            await asyncio.sleep(self._seconds)
        return bool(self._seconds)


class Failing(MovingPart):
    async def end_motions(self, topics: Collection[str] | None) -> bool:
        raise RuntimeError("it fails")


class Moving(Feature):
    name = "moving"

    def parts(self, bridge: Bridge) -> Iterable[EnginePart]:
        self.movers = [Mover(bridge, seconds) for seconds in (0.0, 0.1, 0.2)]
        return Failing(), *self.movers


@pytest.mark.parametrize("topics", [{TOPIC}, None])
def test_no_motion_begins_while_another_part_stops(
    topics: set[str] | None, loop: VirtualLoop, make_context: Callable[..., Context], monkeypatch: pytest.MonkeyPatch
) -> None:
    feature = Moving()
    replaced.FEATURES_ASKED.set(monkeypatch, lambda _: (feature,))
    context = make_context()
    bridge = Bridge(context, {"robot1": ()}, SNAPSHOTS)

    def press() -> None:
        for each in feature.movers:
            each.press()

    async def disarm() -> None:
        keys = loop.create_task(hold())
        await asyncio.sleep(1.0)
        assert all(each.moves for each in feature.movers)
        assert await bridge.end_motions(topics)
        press()
        assert not any(each.moves for each in feature.movers), "when the topic is disarmed"
        await asyncio.sleep(1.0)
        assert all(each.moves for each in feature.movers), "once it is armed again"
        keys.cancel()

    async def hold() -> None:
        while True:
            press()
            await asyncio.sleep(0.03)

    loop.run_until_complete(disarm())
    assert EventCode.ENGINE_ERROR in [event.code for event in context.events.after(0)]


def test_only_disarmed_topics_are_kept_still(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    bridge = Bridge(make_context(), {"robot1": ()}, SNAPSHOTS)

    async def disarm() -> None:
        await bridge.end_motions({TOPIC})
        assert not bridge.may_move(TOPIC)
        assert bridge.may_move("/other")

    loop.run_until_complete(disarm())
