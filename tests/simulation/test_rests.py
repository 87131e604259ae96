"""A node drives a robot over an armed topic while links, bridges and consoles fail and operators change things.

The robot's motors are the judge. The node publishes ten velocities a second, so while it drives the motors hear
something all the time, and once it no longer does, the last thing that they hear is a rest: at most 1.2 s after the
link was cut, and 0.1 s after the robot's bridge knows of any other end (docs/stopping.md).
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import msgspec
import pytest
from tests.simulation.drivers import LAYOUT, Drivers, written
from tests.simulation.mutations import nothing
from tests.simulation.ros import Writer, hash_of
from tests.simulation.world import Violation
from tests.support.long import long_cases

from rsb_bridge.model.commands import ArmTopic, DisarmTopic, KeepArmed, PauseTopics
from rsb_bridge.model.qos import Qos
from rsb_bridge.route.arming import ArmingPhase
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.rest_message import RestMessage

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterable, Sequence

    from tests.simulation.drivers import Driver
    from tests.simulation.engine_host import Run

    from rsb_bridge.model.transports import Protocol
    from rsb_bridge.ros.ros_interface import RawMessage

_SECONDS = 240.0
_TWIST = "geometry_msgs/msg/Twist"
_SPEED = 0.4
_NAME = "/robot1/cmd"
"""On the control PC."""
_RATE = 10.0
_RESTS_WITHIN = 1.2 + 0.1
"""s from a cut until the rest, and one interval of the node's messages, the last of which may have been lost."""
_CROSSES_WITHIN = 0.1
"""s that DDS takes at most in the simulation, from the robot's bridge to its motors."""
_ENDS = 8
"""How often the driving has to end, at least, for a world to prove something."""


class Motors(Drivers):
    """A robot that a node on the control PC drives.

    Attributes:
        ends: how often the motors have heard a rest after a message that moved.
    """

    def __init__(self, seed: int, protocol: Protocol) -> None:
        self._moved_at: float | None = None  # s, when the last message came, if that moved
        self._armed_at = float("-inf")  # s, when the robot's bridge was last seen armed
        self.ends = 0
        super().__init__(seed, protocol)

    # --- what must never be

    def _hear(self, batch: Sequence[RawMessage]) -> None:
        now = self.world.loop.time()
        for message in batch:
            moves = any(message.payload[4:])
            if not moves:
                self.ends += self._moved_at is not None
                self._moved_at = None
            elif self._is_armed(now):
                self._moved_at = now
            else:
                self.world.wrong("the robot moves though its bridge has ended the arming")

    def _is_armed(self, now: float) -> bool:
        """Whether the robot's bridge is armed, or was so when it published the present message."""
        route = self._route(self.robot)
        if route is not None and route.arming.phase is ArmingPhase.ARMED:
            self._armed_at = now
        return now - self._armed_at <= _CROSSES_WITHIN

    async def watch(self) -> None:
        """Look all the time whether the motors were left with a velocity."""
        loop = self.world.loop
        while True:
            await asyncio.sleep(0.02)
            now = loop.time()
            self._is_armed(now)
            if self._moved_at is not None and now - self._moved_at > _RESTS_WITHIN:
                self.world.wrong(f"the robot has moved on for {now - self._moved_at:.2f} s without a command")

    # --- who drives, and what befalls them

    async def publish_all_the_time(self) -> None:
        """Have a node on the control PC drive, whether it is armed or not; now and then it stops in the midst of it."""
        await asyncio.sleep(8.0)
        written = self.server.domain.written[_TWIST]({"linear": {"x": str(_SPEED)}})
        node = Writer(self.server.domain, "/nav", _NAME, _TWIST, hash_of(_TWIST), Qos(depth=10))
        while True:
            node.publish(written)
            stops = self.random.random() < 0.01  # without a zero, or its zero is lost on the way
            await asyncio.sleep(3.0 if stops else 1 / _RATE)

    async def keep_armed(self, driver: Driver) -> None:
        while True:
            await asyncio.sleep(0.5)
            if driver.stands_still:
                continue
            await self.do(driver, lambda _: KeepArmed(pressed=True))
            route = self._route(driver.host)
            if route is not None and not route.arming.held:
                await asyncio.sleep(self.random.uniform(0.0, 3.0))
                await self.do(driver, lambda route: ArmTopic(route.key))

    async def change(self, driver: Driver) -> None:
        while True:
            await asyncio.sleep(self.random.uniform(4.0, 15.0))
            if self.random.random() < 0.5:
                await self.do(driver, lambda route: DisarmTopic(route.key))
                continue
            await self.do(driver, lambda route: PauseTopics(route.key, True))
            await asyncio.sleep(self.random.uniform(0.5, 2.0))
            await self.do(driver, lambda route: PauseTopics(route.key, False))

    async def end_a_bridge(self, seconds: float) -> None:
        """Kill the server's bridge, or stop either side's in good order."""
        if self.random.random() < 0.4:
            await super().end_a_bridge(seconds)
            return
        host = self.random.choice((self.robot, self.server))
        await host.stop()
        await asyncio.sleep(seconds)
        host.start()

    def _run(self) -> Run | None:
        return self.server.run  # a robot's own bridge that stands still leaves it moving, as documented

    async def live(self) -> None:
        anna, _, carol = self.drivers
        await asyncio.gather(
            self.befall(),
            self.watch(),
            self.publish_all_the_time(),
            self.keep_armed(anna),
            self.change(self.random.choice((anna, carol))),
        )


@pytest.mark.parametrize(("seed", "protocol"), [(1, "tcp"), (2, "udp"), *long_cases((3, "tcp"), (4, "udp"))])
def test_last_thing_that_motors_hear_is_rest(seed: int, protocol: Protocol) -> None:
    motors = Motors(seed, protocol)
    motors.play()
    assert motors.ends >= _ENDS


# --- one node, whose messages the motors hear


class Heard(Drivers):
    """A node on the control PC drives; nothing befalls anybody.

    Attributes:
        speeds: that the motors have heard.
    """

    def __init__(self, protocol: Protocol, **entry: Any) -> None:
        self.speeds: list[float] = []
        super().__init__(1, protocol)
        (topic,) = self.robot.session.topics
        topics = (msgspec.structs.replace(topic, **entry),)
        self.robot.session = msgspec.structs.replace(self.robot.session, topics=topics)

    def _hear(self, batch: Sequence[RawMessage]) -> None:
        self.speeds += [LAYOUT.unpack_from(each.payload, 4)[0] for each in batch]

    def hear(self, life: Callable[[Writer], Coroutine[Any, Any, None]]) -> None:
        """Live with the node's publisher, whose messages cross."""

        async def live() -> None:
            staying = asyncio.ensure_future(self.stay(self.drivers[0]))
            await asyncio.sleep(8.0)
            node = Writer(self.server.domain, "/nav", _NAME, _TWIST, hash_of(_TWIST), Qos(depth=10))
            await asyncio.sleep(2.0)
            await self.do(self.drivers[0], lambda route: ArmTopic(route.key))
            await asyncio.sleep(1.0)  # until the bridge's subscription has found it
            await life(node)
            staying.cancel()

        self.play(lambda _: live())

    async def publish_speeds(self, node: Writer, speeds: Iterable[float], every: float) -> None:
        for speed in speeds:
            node.publish(written({"linear": {"x": str(speed)}}))
            await asyncio.sleep(every)


@pytest.mark.parametrize("arm", [False, True])
def test_stop_is_heard_between_beats_of_limit(arm: bool) -> None:
    heard = Heard("tcp", max_rate=10.0, arm=arm, deadman=20.0 if arm else None)

    async def live(node: Writer) -> None:
        for motions in range(2, 12):
            await heard.publish_speeds(node, [_SPEED] * motions + [0.0], 0.02)
            await asyncio.sleep(0.2)  # before the hold of an armed topic ends
            assert _SPEED in heard.speeds
            assert heard.speeds[-1] == 0.0
            heard.speeds.clear()

    heard.hear(live)


def test_overtaken_motion_is_not_heard() -> None:
    heard = Heard("udp")

    async def live(node: Writer) -> None:
        path = heard.world.network.path(heard.server.machine, heard.robot.machine)
        path.latency = (0.0, 0.2)
        await heard.publish_speeds(node, [number / 1000 for number in range(1, 100)], 0.02)
        moves = [each for each in heard.speeds if each]
        assert len(moves) > 20
        assert moves == sorted(moves)

    heard.hear(live)


# --- each rule is needed


_MISTAKES: tuple[tuple[str, type, str], ...] = (
    ("no rest follows an arming", RestMessage, "begin"),
    ("a link that is not heard is waited for", Receiver, "lapse"),
    ("a velocity holds for ever", RestMessage, "_hold"),
)


@pytest.mark.parametrize(("owner", "name"), [each[1:] for each in _MISTAKES], ids=[each[0] for each in _MISTAKES])
def test_a_mistake_is_found(owner: type, name: str) -> None:
    motors = Motors(1, "tcp")
    with patch.object(owner, name, nothing), pytest.raises(Violation, match="the robot"):
        motors.play()
