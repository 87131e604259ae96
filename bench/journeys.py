"""Calls of Python functions for what a bridge does most often: ``python -m bench.journeys``, in 10 s, without ROS.

A robot and a server of the simulation bridge one topic, two others ten, two others one service. Counted are calls of
functions of `rsb_bridge`, not those of Python's library or of C. They are the same on each machine.
"""

from __future__ import annotations

import asyncio
import sys
import threading
from collections import Counter
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import msgspec
from tests.simulation.beds import Yard
from tests.simulation.call_harness import CallHarness
from tests.simulation.ros import STRING, Reader, hash_of

from rsb_bridge.model.commands import EditTopic, PauseTopics
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.ros.ros_interface import RawMessage
from rsb_bridge.ros.ros_thread import RosToLoopQueue, RosTurns

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

    from tests.simulation.beds import Bed
    from tests.simulation.engine_host import EngineHost

    from rsb_bridge.model.commands import Command
    from rsb_bridge.route.route import Route

_TOPIC = Topic("/chat", "transmit")
_SETTLED_AFTER = 2.0  # s
_MESSAGE = b"\0\1\0\0\3\0\0\0go\0"
_counted: dict[str, Counter[str]] = {}
"""Calls of each journey, by function."""


@contextmanager
def _counting(name: str) -> Iterator[None]:
    by_function = _counted[name] = Counter()

    def called(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event == "call" and "/rsb_bridge/" in code.co_filename:
            module = code.co_filename.rpartition("/rsb_bridge/")[2].removesuffix(".py")
            by_function[f"{module}: {code.co_qualname}"] += 1

    sys.setprofile(called)
    try:
        yield
    finally:
        sys.setprofile(None)


async def _command(name: str, host: EngineHost, command: Command[Any]) -> None:
    assert host.run is not None
    done = host.run.bridge.do(command)
    with _counting(f"{name}, whole command"):
        await host.run.command(done)
    await asyncio.sleep(_SETTLED_AFTER)  # the other side takes part in it


class TopicJourneys(Yard):
    def __init__(self) -> None:
        super().__init__(_TOPIC)
        (self._writer,) = self.publish(_TOPIC.topic)

    async def measure(self) -> None:
        # As a topic that nobody hears is a fault.
        Reader(self.server.domain, "/node", f"/{self._name}/chat", STRING, hash_of(STRING), Qos(), lambda _: None)
        for _ in range(120):  # until it has settled (`rsb_bridge.route.idling.SETTLES`)
            self._writer.publish(_MESSAGE)
            await asyncio.sleep(0.25)
        for on_server, name in ((False, "tick, sending side"), (True, "tick, receiving side")):
            route = self._route(on_server=on_server)
            route.tick()
            with _counting(name):
                route.tick()
            with _counting(name.replace("tick", "snapshot")):
                route.snapshot()
        key, spec = self._route().key, self._route().spec
        await _command("pause", self.robot, PauseTopics(key, True))
        await _command("resume", self.robot, PauseTopics(key, False))
        await _command("edit of max_rate", self.robot, EditTopic(key, msgspec.structs.replace(spec, max_rate=2.0)))
        self._propose()

    def _route(self, *, on_server: bool = False) -> Route:
        return self.routes(on_server=on_server)[_TOPIC.topic]

    def _propose(self) -> None:
        """Have the server take a proposal of one more topic."""
        link, there = self.link(on_server=True), self._route(on_server=True)
        proposal = there.proposal
        message = msgspec.structs.replace(
            proposal, topic="/other", remote_topic=f"{proposal.remote_topic}_other", route=there.id + 2
        )
        with _counting("proposal at the peer"):
            link.table.handle(message)


class TurnJourneys(Yard):
    def __init__(self) -> None:
        topics = [Topic(f"/topic_{number}", "transmit") for number in range(10)]
        super().__init__(*topics)
        self._writers = self.publish(*[each.topic for each in topics])

    def _listen(self) -> None:
        for each in self._writers:
            topic = f"/{self._name}{each.topic}"
            Reader(self.server.domain, "/node", topic, STRING, hash_of(STRING), Qos(), lambda _: None)

    async def measure(self) -> None:
        self._listen()
        for _ in range(40):
            for each in self._writers:
                each.publish(_MESSAGE)
            await asyncio.sleep(0.25)
        channel: Any = next(iter(self.routes(on_server=True).values())).half.carried.channel
        came = channel._from.stream
        data_received = came.data_received

        def counted(data: bytes) -> None:
            with _counting("turn of ten topics, receiving side"):
                data_received(data)

        came.data_received = counted
        self._turn()
        await asyncio.sleep(_SETTLED_AFTER)
        del came.data_received

    def _turn(self) -> None:
        """Have the ROS thread hand on a message of each topic, while the I/O loop waits."""
        routes = self.routes()
        assert self.robot.run is not None
        turns, loop = RosTurns(), asyncio.get_running_loop()
        queue = RosToLoopQueue(loop, lambda work: (work(), True)[1], turns)
        queue.joined = self.link().context.ros_queue.joined
        turns.gathering = threading.get_ident()
        now = self.robot.clock.time_ns()
        with _counting("turn of ten topics, sending side"):
            for each in self._writers:
                half: Any = routes[each.topic].half
                message = RawMessage(_MESSAGE, now, each.gid, each.published + 1, source=now)
                queue.put(half.subscription._receiver, [message])
            turns.gathered()


class SecondJourneys(TurnJourneys):
    async def measure(self) -> None:
        flow = asyncio.get_running_loop().create_task(self._flow())
        await asyncio.sleep(60.0)  # until their usual rates are known
        with _counting("ten seconds of ten topics at 10 Hz"):
            await asyncio.sleep(10.0)
        flow.cancel()

    async def _flow(self) -> None:
        self._listen()
        while True:
            for each in self._writers:
                each.publish(_MESSAGE)
            await asyncio.sleep(0.1)


class ServiceJourneys(CallHarness):
    async def measure(self) -> None:
        self.server()
        client = self.client()
        await self.ready(client)
        client.ask()
        await asyncio.sleep(_SETTLED_AFTER)
        asking, _ = self.halves()
        with _counting("snapshot of a service, callers' side"):
            asking.route.snapshot()
        await _command("pause of a service", self.near, PauseTopics(asking.route.key, True))


def main() -> None:
    journeys: Bed
    for journeys in (TopicJourneys(), TurnJourneys(), SecondJourneys(), ServiceJourneys()):
        journeys.world.invariants.check = lambda: None  # type: ignore[method-assign]  # they count the world's own flows
        journeys.world.play(life=journeys.live(journeys.measure()))
    for name, by_function in _counted.items():
        print(f"{name:<38}{by_function.total():>6,}")
    if "--by-function" in sys.argv:
        for name, by_function in _counted.items():
            print(f"\n{name}")
            for function, count in by_function.most_common():
                print(f"{count:6,}  {function}")


if __name__ == "__main__":
    main()
