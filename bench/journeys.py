"""Calls of Python functions for what a bridge does most often: ``python -m bench.journeys``, in 10 s, without ROS.

A robot and a server of the simulation bridge one topic. Counted are calls of functions of `rsb_bridge`, not those of
Python's library or of C. They are the same on each machine.
"""

from __future__ import annotations

import asyncio
import sys
from collections import Counter
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import msgspec
from tests.simulation.beds import Yard, until
from tests.simulation.ros import STRING, Reader, hash_of

from rsb_bridge.model.commands import PauseTopics
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Iterator
    from contextlib import AbstractContextManager
    from types import FrameType

    from rsb_bridge.route.route import Route

_TOPIC = Topic("/chat", "transmit")


class Counted:
    """Calls of one journey, by function."""

    def __init__(self) -> None:
        self.by_function: Counter[str] = Counter()

    @contextmanager
    def counting(self) -> Iterator[None]:
        sys.setprofile(self._called)
        try:
            yield
        finally:
            sys.setprofile(None)

    def _called(self, frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event == "call" and "/rsb_bridge/" in code.co_filename:
            module = code.co_filename.rpartition("/rsb_bridge/")[2].removesuffix(".py")
            self.by_function[f"{module}: {code.co_qualname}"] += 1


class Journeys(Yard):
    def __init__(self) -> None:
        super().__init__(_TOPIC)
        self.world.invariants.check = lambda: None  # type: ignore[method-assign]  # they count the world's own flows
        self.counted: dict[str, Counted] = {}
        (self._writer,) = self.publish(_TOPIC.topic)

    def _count(self, name: str) -> AbstractContextManager[None]:
        self.counted[name] = Counted()
        return self.counted[name].counting()

    async def measure(self) -> None:
        # As a topic that nobody hears is a fault.
        Reader(self.server.domain, "/node", f"/{self._name}/chat", STRING, hash_of(STRING), Qos(), lambda _: None)
        for _ in range(40):
            self._writer.publish(b"\0\1\0\0\3\0\0\0go\0")
            await asyncio.sleep(0.25)
        for on_server, name in ((False, "tick, sending side"), (True, "tick, receiving side")):
            route = self._route(on_server=on_server)
            route.tick()
            with self._count(name):
                route.tick()
            with self._count(name.replace("tick", "snapshot")):
                route.snapshot()
        await self._pause()
        self._propose()

    def _route(self, *, on_server: bool) -> Route:
        return self.routes(on_server=on_server)[_TOPIC.topic]

    async def _pause(self) -> None:
        route, run = self._route(on_server=False), self.robot.run
        assert run is not None
        command = run.bridge.do(PauseTopics(route.key, True))
        with self._count("pause, whole command"):
            await run.command(command)
        await until(lambda: self._route(on_server=True).pausing.paused, 5.0)
        await run.command(run.bridge.do(PauseTopics(route.key, False)))
        await asyncio.sleep(2.0)

    def _propose(self) -> None:
        """Have the server take a proposal of one more topic."""
        link, there = self.link(on_server=True), self._route(on_server=True)
        proposal = there.proposal
        message = msgspec.structs.replace(
            proposal, topic="/other", remote_topic=f"{proposal.remote_topic}_other", route=there.id + 2
        )
        with self._count("proposal at the peer"):
            link.table.handle(message)


def main() -> None:
    journeys = Journeys()
    journeys.world.play(life=journeys.live(journeys.measure()))
    for name, counted in journeys.counted.items():
        print(f"{name:<24}{counted.by_function.total():>6,}")
    if "--by-function" in sys.argv:
        for name, counted in journeys.counted.items():
            print(f"\n{name}")
            for function, count in counted.by_function.most_common():
                print(f"{count:6,}  {function}")


if __name__ == "__main__":
    main()
