"""Prints what recording costs a message, on the halves of a route between stand-ins of DDS and link, off and on."""

from __future__ import annotations

import time
from random import Random
from typing import TYPE_CHECKING

from tests.route.loop_filter_helpers import FIRST, Graph, world_of
from tests.route.unpacking_helpers import OnePublisher, opened
from tests.support.offline import FakePeer
from tests.support.virtual_time import VirtualClock, virtual_loop

from rsb_bridge.context import Context
from rsb_bridge.model.session import Session
from rsb_bridge.ros.ros_interface import RawMessage
from rsb_bridge.ros.ros_thread import RosToLoopQueue
from rsb_bridge.telemetry.event_log import EventLog
from rsb_extras.recording.keeping import Keeping

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

_SIZE = 2_500  # bytes, as `bench.profile`
_MESSAGES, _ROUNDS = 3_200, 25


class _Bridge:
    """A bridge that has no links."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.role = self

    def links(self) -> tuple[()]:
        return ()


def _context(loop: VirtualLoop, ros: object, record: object) -> Context:
    session = Session(name="robot1", role="client", server_ip="127.0.0.1", server_port=1, features={"record": record})
    clock = VirtualClock(loop)
    context = Context(session, 0, ros, EventLog(clock), RosToLoopQueue(loop), loop, clock, Random(1))  # type: ignore[arg-type]
    Keeping(_Bridge(context)).open()  # type: ignore[arg-type]
    return context


def _sending(loop: VirtualLoop, record: object) -> Callable[[int], None]:
    graph = Graph()
    world = world_of(graph, _context(loop, graph, record), loop)
    numbers = iter(range(1, 1 << 40))

    def pass_on(together: int) -> None:
        world.peer.channel.sent.clear()
        world.path.offer([RawMessage(bytes(_SIZE), 1, FIRST, next(numbers), 0, 1) for _ in range(together)])

    return pass_on


def _receiving(loop: VirtualLoop, record: object) -> Callable[[int], None]:
    ros = OnePublisher()
    receiver = opened(_context(loop, ros, record), FakePeer(), "/chat")

    def pass_on(together: int) -> None:
        ros.published.sizes.clear()
        receiver.deliver([(bytes(_SIZE), 0, 0) for _ in range(together)])

    return pass_on


def _seconds(pass_on: Callable[[int], None], together: int) -> float:
    began = time.process_time()
    for _ in range(_MESSAGES // together):
        pass_on(together)
    return (time.process_time() - began) / _MESSAGES


def main() -> None:
    for name, half in (("sending", _sending), ("receiving", _receiving)):
        for together in (1, 16):
            with virtual_loop() as loop:
                off, on = half(loop, False), half(loop, True)
                pairs = [(_seconds(off, together), _seconds(on, together)) for _ in range(_ROUNDS)]
            less, more = (sorted(each)[_ROUNDS // 2] * 1e6 for each in zip(*pairs, strict=True))
            print(f"{name}, {together} together: off {less:.2f} µs, on {more:.2f} µs a message")


if __name__ == "__main__":
    main()
