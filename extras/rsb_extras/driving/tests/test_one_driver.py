"""Three operators at consoles of both sides want to drive one robot, while consoles, bridges and the network stall.

The robot's motors are the judge: between the messages of one driver and another's they hear a rest. So two never drive
at once, and an arming goes over through a rest.
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pytest
from tests.simulation.beds import until
from tests.simulation.drivers import RATE, SIGN_OF_LIFE_EVERY, TWIST, Driver, Drivers, written
from tests.simulation.mutations import nothing
from tests.simulation.ros import Writer, hash_of
from tests.simulation.world import Violation
from tests.support.long import long_cases

from rsb_bridge.engine.topic_commands import ArmingCommands
from rsb_bridge.model.commands import (
    AnswerAsker,
    ArmTopic,
    AskHolder,
    DisarmTopic,
    KeepArmed,
    TakeArming,
    console,
    operator,
)
from rsb_bridge.model.qos import Qos
from rsb_bridge.route.arming import Arming
from rsb_bridge.route.rest_message import RestMessage
from rsb_extras.driving.publish_requests import Publish

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from rsb_bridge.model.transports import Protocol

_CHANGES = 6
"""How often the robot has to change its driver, at least, for a world to prove something."""


class Hands(Drivers):
    """Operators who arm the robot, ask for it, take it and drive by hand."""

    async def sit(self, driver: Driver) -> None:
        """Give signs of life, and answer others' questions now and then."""
        while True:
            await asyncio.sleep(SIGN_OF_LIFE_EVERY)
            if driver.stands_still:
                continue
            await self.do(driver, lambda _: KeepArmed(pressed=True))
            if not self._holds(driver) or not self.is_asked(driver):
                continue
            if self.random.random() < 0.3:
                gives = self.random.random() < 0.7
                await self.do(driver, lambda route, gives=gives: AnswerAsker(route.key, gives=gives))  # type: ignore[misc]

    async def drive(self, driver: Driver) -> None:
        """Drive while it is this driver's, and even if it is not, as hands do that have not read the screen."""
        ticket, random = 0, self.random
        while True:
            await asyncio.sleep(random.choice((1 / RATE, 1 / RATE, random.uniform(0.0, 2.0))))
            if driver.stands_still or not (self._holds(driver) or random.random() < 0.2):
                continue
            ticket = await self.publish(driver, ticket, random.choice(("", "linear: {x: 0.0}")))

    async def publish(self, driver: Driver, ticket: int = 0, rest: str = "") -> int:
        """Have a driver give a command, and return the ticket for the next one; the first gets only that."""
        published = await self.do(
            driver,
            lambda route: Publish(
                route.local_topic,
                f"linear: {{x: {driver.speed}}}",
                TWIST,
                ticket=ticket,
                rest=rest,
                rest_after=0.5 if rest else 5.0,
            ),
        )
        return published.ticket if published is not None else ticket

    async def drive_shortly(self, driver: Driver) -> None:
        ticket = 0
        for _ in range(5):  # of which the first brings a ticket
            ticket = await self.publish(driver, ticket)
            await asyncio.sleep(1 / RATE)

    async def want(self, driver: Driver) -> None:
        random = self.random
        while True:
            await asyncio.sleep(random.uniform(2.0, 20.0))
            if driver.stands_still:
                continue
            wants = (DisarmTopic,) if self._holds(driver) else (ArmTopic, AskHolder, AskHolder, TakeArming)
            await self.command(driver, random.choice(wants))

    async def live(self) -> None:
        works: list[Coroutine[Any, Any, None]] = [self.befall()]
        for driver in self.drivers:
            works += (self.sit(driver), self.drive(driver), self.want(driver))
        await asyncio.gather(*works)


@pytest.mark.parametrize(("seed", "protocol"), [(7, "tcp"), (2, "udp"), *long_cases((3, "tcp"), (4, "udp"))])
def test_one_person_drives_with_rest_between(seed: int, protocol: Protocol) -> None:
    drivers = Hands(seed, protocol)
    drivers.play()
    assert drivers.changes >= _CHANGES
    assert all(drivers.heard[each.name] > 10 for each in drivers.drivers), drivers.heard


async def goes_over(drivers: Hands, first: int, second: int, pause: float = 2.0) -> None:
    """One drives, a node comes on the control PC with another QoS, and another operator takes over and drives.

    Args:
        pause: s from the last command of the one to the other's arming; a velocity holds for 1 s.
    """
    both = [drivers.drivers[each] for each in (first, second)]
    sitting = [asyncio.ensure_future(drivers.sit(each)) for each in both]
    await asyncio.sleep(8.0)
    for driver, command in zip(both, (ArmTopic, TakeArming), strict=True):
        await drivers.command(driver, command)
        await drivers.drive_shortly(driver)
        name = drivers.local_name(drivers.server)
        Writer(drivers.server.domain, "/node", name, TWIST, hash_of(TWIST), Qos(depth=3, deadline=5.0))
        await asyncio.sleep(pause)
    assert all(drivers.heard[each.name] for each in both), drivers.heard
    for each in sitting:
        each.cancel()


_BESIDE_EACH_OTHER = partial(goes_over, first=0, second=1)
_AT_ONCE = partial(goes_over, first=0, second=1, pause=0.1)
_FROM_THE_ROBOT_S_SIDE = partial(goes_over, first=2, second=0)


@pytest.mark.parametrize("life", [_BESIDE_EACH_OTHER, _FROM_THE_ROBOT_S_SIDE], ids=["beside", "from the robot's side"])
def test_it_goes_over_through_a_rest(life: Any) -> None:
    """With any QoS, and any publisher that the robot's own topic has meanwhile."""
    drivers = Hands(1, "tcp")
    drivers.play(life)
    assert drivers.changes == 1


@pytest.mark.parametrize("gives", [True, False], ids=["gives", "keeps"])
@pytest.mark.parametrize("asker", [1, 2], ids=["beside", "from the robot's side"])
def test_the_holder_decides(asker: int, gives: bool) -> None:
    """An operator without the topic disarms nothing by leaving a drive screen, and drives nothing."""
    drivers = Hands(1, "tcp")
    anna, other = drivers.drivers[0], drivers.drivers[asker]

    async def held(driver: Driver) -> int:
        return len((await drivers.do(driver, lambda _: KeepArmed(pressed=True))).keys)

    async def live() -> None:
        staying = [asyncio.ensure_future(drivers.stay(each)) for each in (anna, other)]
        await asyncio.sleep(8.0)
        await drivers.command(anna, ArmTopic)
        await drivers.command(other, partial(DisarmTopic, own=True))
        assert (await held(anna), await held(other)) == (1, 0)
        asking = asyncio.ensure_future(drivers.command(other, AskHolder))
        await until(lambda: drivers.is_asked(anna), 1.0)
        await drivers.do(anna, lambda route: AnswerAsker(route.key, gives=gives, who="another"))
        assert drivers.is_asked(anna)
        assert not asking.done()
        await drivers.command(anna, partial(AnswerAsker, gives=gives))
        await asking
        assert (await held(anna), await held(other)) == (not gives, gives)
        holder, before = (other, anna) if gives else (anna, other)
        for driver in (before, holder):
            await drivers.drive_shortly(driver)
        assert drivers.heard[holder.name]
        assert not drivers.heard[before.name]
        await drivers.command(holder, partial(DisarmTopic, own=True))
        assert not await held(holder)
        for each in staying:
            each.cancel()

    drivers.play(lambda _: live())


@pytest.mark.parametrize("asker", [1, 2], ids=["beside", "from the robot's side"])
def test_disarm_lasts_though_somebody_asks_for_topic(asker: int) -> None:
    """A node drives all the time: after the disarm its robot hears a rest, and no motion."""
    drivers = Hands(1, "tcp")
    anna, other = drivers.drivers[0], drivers.drivers[asker]

    async def plan(node: Writer) -> None:
        while True:
            node.publish(written({"linear": {"x": str(anna.speed)}}))
            await asyncio.sleep(1 / RATE)

    async def live() -> None:
        works = [asyncio.ensure_future(drivers.stay(each)) for each in (anna, other)]
        await asyncio.sleep(8.0)
        name = drivers.local_name(drivers.server)
        node = Writer(drivers.server.domain, "/nav", name, TWIST, hash_of(TWIST), Qos(depth=10))
        works.append(asyncio.ensure_future(plan(node)))
        await drivers.command(anna, ArmTopic)
        asking = asyncio.ensure_future(drivers.command(other, AskHolder))
        await until(lambda: drivers.is_asked(anna) and drivers.heard[anna.name] > 5, 2.0)
        await drivers.command(anna, DisarmTopic)
        await asking
        await asyncio.sleep(0.5)
        moved = drivers.heard[anna.name]
        await asyncio.sleep(5.0)
        assert drivers.heard[anna.name] == moved
        assert drivers.heard[""]
        for each in works:
            each.cancel()

    drivers.play(lambda _: live())


# --- each rule is needed


def _anybody(*_: object) -> bool:
    """Replace `Arming.is_held_by` by its old form, in which any console's messages pass while it is armed."""
    return True


async def _handed_over(self: ArmingCommands, command: Any, opening: int) -> None:
    """Replace `ArmingCommands._take` by a form that hands the arming over as it is."""

    _, route = self._bridge.find(command.key)
    if not route.arming.held or route.arming.console is None:
        await self.arm(ArmTopic(command.key, command.shared))
    else:
        route.arming.by, route.arming.console = operator(), console()


_MISTAKES: tuple[tuple[str, type, str, object, Any], ...] = (
    ("any console's messages pass", Arming, "is_held_by", _anybody, None),
    ("it is handed over without a disarm", ArmingCommands, "_take", _handed_over, _AT_ONCE),
    ("no rest follows an arming", RestMessage, "begin", nothing, _FROM_THE_ROBOT_S_SIDE),
    ("a motion is forgotten with a publisher", RestMessage, "replaces", nothing, _FROM_THE_ROBOT_S_SIDE),
)


@pytest.mark.parametrize(
    ("owner", "name", "mistake", "life"), [each[1:] for each in _MISTAKES], ids=[each[0] for each in _MISTAKES]
)
def test_a_mistake_is_found(owner: type, name: str, mistake: object, life: Any) -> None:
    drivers = Hands(1, "tcp")
    with patch.object(owner, name, mistake), pytest.raises(Violation, match="no rest in between"):
        drivers.play(life)
