"""An armed topic in a world where engines and networks stand still: what comes out is never older than a second."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.simulation.climate import STILL
from tests.simulation.invariants import route_of
from tests.simulation.world import World

from rsb_bridge.api import EngineError
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.route.lease import LASTS

if TYPE_CHECKING:
    from random import Random

    from tests.simulation.conftest import Play
    from tests.simulation.station import Run

    from rsb_bridge.model.session import Protocol
    from rsb_bridge.route.route import Route

SECONDS = 150.0
_DDS = 0.1
"""Seconds that a message takes in both domains."""


class Armed:
    """A world with one robot, one topic that has to be armed, and operators on both sides.

    Attributes:
        armed: how often it was armed.
        world: it all.
    """

    def __init__(self, seed: int, protocol: Protocol, direction: str) -> None:
        self.world = World(seed, replace(STILL, checks=(1.0, 1.0), patience=4.0))
        (self.robot,) = self.world.robots
        self.robot.flows.clear()
        self.world.flows.clear()
        entry = Topic(
            "/cmd", "transmit" if direction == "transmit" else "receive", protocol=protocol, arm=True, deadman=0.0
        )
        self.robot.station.session = msgspec.structs.replace(self.robot.station.session, topics=(entry,))
        self.flow = self.world.add_flow(self.robot, entry, self.world.random("flows"))
        self.flow.period, self.flow.fresh_within = 0.05, LASTS + _DDS
        self.random: Random = self.world.random("lease")
        self.armed = 0
        self._asked: set[str] = set()

    def runs(self) -> list[Run]:
        return [run for run in (self.robot.station.run, self.world.server.run) if run is not None]

    def halves(self) -> list[Route]:
        links = self.world.link_ends(self.robot) or ()
        return [route for link in links if (route := route_of(link, self.flow)) is not None]

    async def watch(self) -> None:
        """What comes out after either side shows that it is disarmed is wrong."""
        shown_at, heard = float("inf"), 0
        while True:
            await asyncio.sleep(0.02)
            now, frozen = self.world.loop.time(), self.world.loop.is_frozen
            running = [run for run in self.runs() if not frozen(run.process)]
            shown = [state for run in running if (state := self._state(run)) is not None]
            if State.DISARMED not in shown or any(half.arming.held for half in self.halves()):
                shown_at = float("inf")
            elif shown_at == float("inf"):
                shown_at, heard = now, self.flow.heard
            if now > shown_at + _DDS and self.flow.heard > heard:
                self.world.wrong(f"{self.flow}: came out after it was shown as disarmed")
            elif now <= shown_at + _DDS:
                heard = self.flow.heard

    def _state(self, run: Run) -> State | None:
        """What a side shows of the topic."""
        half = self._half(run)
        return None if half is None else run.process.context.copy().run(half.verdict).state

    def _half(self, run: Run) -> Route | None:
        return next((half for link in run.links() if (half := route_of(link, self.flow)) is not None), None)

    async def operate(self) -> None:
        """Arm it again and again, on either side, keep it armed, and disarm it now and then."""
        while True:
            await asyncio.sleep(self.random.uniform(0.2, 2.0))
            for run in self.runs():
                if not self.world.loop.is_frozen(run.process):
                    await run.command(run.bridge.arming.keep(pressed=True))
            run = self.random.choice(self.runs())
            if self.world.loop.is_frozen(run.process):
                continue
            half = self._half(run)
            if half is not None and self._state(run) is State.DISARMED:
                asyncio.ensure_future(self._arm(run, half.key))  # noqa: RUF006
            elif half is not None and half.arming.armed and self.random.random() < 0.03:
                await run.command(run.bridge.arming.disarm(half.key))

    async def _arm(self, run: Run, key: str) -> None:
        if run.station.name in self._asked:
            return
        self._asked.add(run.station.name)
        try:
            await run.command(run.bridge.arming.arm(key))
            self.armed += 1
        except EngineError:
            pass
        finally:
            self._asked.discard(run.station.name)

    async def live(self) -> None:
        """Freeze engines, and hold what the network carries, one way or both."""
        watching = [asyncio.ensure_future(self.watch()), asyncio.ensure_future(self.operate())]
        ends = self.robot.station.machine, self.world.server.machine
        network, loop = self.world.network, self.world.loop
        await asyncio.sleep(10.0)
        with self.world.trouble("standstills", self.robot), self.world.flow_trouble(self.flow, "armed at times"):
            while loop.time() < SECONDS:
                await asyncio.sleep(self.random.uniform(1.0, 8.0))
                seconds = self.random.choice([0.4, 0.9, 1.2, 2.5, 4.0])
                match self.random.choice(["freeze", "hold", "hold one way"]):
                    case "freeze":
                        process = self.random.choice(self.runs()).process
                        loop.freeze(process)
                        await asyncio.sleep(seconds)
                        loop.thaw(process, reads_first=self.random.random() < 0.5)
                    case "hold":
                        network.cut(*ends)
                        await asyncio.sleep(seconds)
                        network.heal(*ends)
                    case _:
                        network.cut_one_way(*self.random.sample(ends, 2))
                        await asyncio.sleep(seconds)
                        network.heal(*ends)
            await asyncio.sleep(20.0)
        for task in watching:
            task.cancel()


CASES = [("tcp", "transmit"), ("tcp", "receive"), ("udp", "transmit"), ("udp", "receive")]


@pytest.mark.parametrize(("protocol", "direction"), CASES)
def test_what_is_armed_comes_out_young_or_not_at_all(protocol: Protocol, direction: str, play: Play) -> None:
    armed = Armed(1, protocol, direction)
    play(armed.world, SECONDS + 40.0, armed.live())
    assert armed.armed >= 3
    assert armed.flow.heard >= 500
