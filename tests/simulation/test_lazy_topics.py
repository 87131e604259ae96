"""Lazy topics in virtual time: how soon after a listener on the other side the sending side subscribes."""

from __future__ import annotations

import asyncio

import pytest
from tests.simulation.beds import Yard, until
from tests.simulation.ros import STRING, Reader, hash_of

from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.route.lazy import KEPT_FOR

SUBSCRIBED_WITHIN = 0.3  # s
UNSUBSCRIBED_WITHIN = 2.0  # s after `KEPT_FOR`: it looks at the graph, and reports


class Desk(Yard):
    """A robot with a lazy topic, and a desk where nodes listen to it now and then."""

    def __init__(self) -> None:
        super().__init__(Topic("/image", "transmit", lazy=True))
        (self.camera,) = self.publish("/image")

    @property
    def is_subscribed(self) -> bool:
        return any(each.node != "/program" for each in self.robot.domain.readers("/image"))

    def listen(self) -> Reader:
        topic = self.routes()["/image"].far_topic
        return Reader(self.server.domain, "/screen", topic, STRING, hash_of(STRING), Qos(), lambda _: None)


@pytest.mark.parametrize("phase", [0.0, 0.13, 0.37, 0.61, 0.89])
def test_subscribed_soon_after_listener_comes(phase: float) -> None:
    desk, now = Desk(), asyncio.get_running_loop

    async def live() -> None:
        await until(lambda: desk.routes()["/image"].verdict().state is State.RESTING, 20.0)
        for pause in (phase, 30.0 + phase, 120.0 + phase):  # just now, and when the route is idle
            assert not desk.is_subscribed
            await asyncio.sleep(pause)
            listener = desk.listen()
            await until(lambda: desk.is_subscribed, SUBSCRIBED_WITHIN)
            await asyncio.sleep(10.0)
            assert desk.is_subscribed
            listener.close()
            left = now().time()
            await until(lambda: not desk.is_subscribed, KEPT_FOR + UNSUBSCRIBED_WITHIN)
            assert now().time() - left >= KEPT_FOR

    desk.world.play(life=desk.live(live()))


def test_early_reports_come_only_when_listeners_change() -> None:
    """While nothing changes, a topic that rests costs no message."""
    desk = Desk()

    async def live() -> None:
        await until(lambda: desk.routes()["/image"].verdict().state is State.RESTING, 20.0)
        sides = desk.routes()["/image"], desk.routes(on_server=True)["/image"]
        await until(lambda: all(each.idle for each in sides), 30.0)

    desk.world.play(life=desk.live(live()))
