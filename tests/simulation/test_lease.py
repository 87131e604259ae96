"""An armed topic in a world where engines, threads and networks stall: no message is published that is older than a
second or was made before a disarm, and a stalled topic has to be armed again.

The topic has no `max_age`, so the lease alone has to see to it. Each of its rules is taken away once, and is missed.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import defaultdict
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import msgspec
import pytest
from tests.simulation.conditions import STILL
from tests.simulation.invariants import route_of
from tests.simulation.mutations import Mutation, nothing
from tests.simulation.world import Violation, World
from tests.support import replaced
from tests.support.long import long_cases

from rsb_bridge.api import EngineError
from rsb_bridge.channel import pacing, window
from rsb_bridge.link.client_end import ClientEnd
from rsb_bridge.link.link_arming import LinkLease
from rsb_bridge.model.commands import ArmTopic, DisarmTopic, KeepArmed
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.route.arming import ArmingPhase, Settling
from rsb_bridge.route.lease import GIVEN_UP_AFTER, LASTS, LeaseHalf, LeasePhase, Marker, Standstill

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator
    from random import Random

    from tests.simulation.engine_host import EngineHost, Run
    from tests.simulation.machine import Machine

    from rsb_bridge.model.transports import Protocol
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire import messages as wire

SECONDS = 90.0
_CONDITIONS = replace(STILL, checks=(1.0, 1.0), patience=4.0)
_DDS = 0.1
"""Seconds that a message takes in both domains."""
_LOOKS = 0.02
"""Seconds from one look at the screens to the next."""
_TAKEN = 0.01
"""Seconds that a message may wait for the ROS thread, in addition to the second that the lease allows."""
_ARMED_WITHIN = 30.0
_FASTEST = 800.0
"""Messages a second, at most: the bridge keeps as many until they are taken."""


class Heartbeats:
    """The numbers that each side has sent, and the newest that came back, by true time: the inputs of a lease."""

    def __init__(self) -> None:
        self._sent: defaultdict[LeaseHalf, dict[int, float]] = defaultdict(dict)
        self._answered: dict[LeaseHalf, float] = {}

    @contextlib.contextmanager
    def tapped(self, now: Callable[[], float]) -> Iterator[None]:
        send, handle = replaced.LEASE_SEND.value, LinkLease.handle

        def sends(lease: LinkLease) -> None:
            send(lease)
            self._sent[lease.state][lease.state.number] = now()

        def handles(lease: LinkLease, message: wire.Lease) -> None:
            sent = self._sent[lease.state].get(message.echo, 0.0)
            self._answered[lease.state] = max(self._answered.get(lease.state, 0.0), sent)
            handle(lease, message)

        with replaced.LEASE_SEND.during(sends), patch.object(LinkLease, "handle", handles):
            yield

    def answered_at(self, lease: LeaseHalf | None) -> float:
        """Return when (s) the newest number of a side was sent that it knows the other side to have heard."""
        return self._answered.get(lease, 0.0) if lease is not None else 0.0


class Armed:
    """A world with one robot, one topic that has to be armed, and operators on both sides."""

    def __init__(self, seed: int, protocol: Protocol, direction: str) -> None:
        self.world = World(seed, _CONDITIONS)
        (self.robot,) = self.world.robots
        self.robot.topic_flows.clear()
        self.world.topic_flows.clear()
        entry = Topic(
            "/cmd",
            "transmit" if direction == "transmit" else "receive",
            protocol=protocol,
            arm=True,
            deadman=0.0,
            max_age=0.0,
            expected_rate=_FASTEST,
        )
        self.robot.host.session = msgspec.structs.replace(self.robot.host.session, topics=(entry,))
        self.flow = self.world.add_topic_flow(self.robot, entry, self.world.random("flows"))
        self.flow.period, self.flow.fresh_within, self.flow.max_age = 0.05, LASTS + _DDS, LASTS + _TAKEN
        self._count_published = self.flow.published
        self.flow.published = self._published  # type: ignore[method-assign]
        self.random: Random = self.world.random("lease")
        self.heartbeats = Heartbeats()
        self.armed = 0
        self._asking: set[str] = set()
        self._asked_at = 0.0
        self._disarmed_at = 0.0
        self._stood_still_at = 0.0

    # --- who is there

    @property
    def source(self) -> EngineHost:
        return self.robot.host if self.flow.topic.direction == "transmit" else self.world.server

    @property
    def sink(self) -> EngineHost:
        return self.world.server if self.flow.topic.direction == "transmit" else self.robot.host

    @property
    def machines(self) -> tuple[Machine, Machine]:
        """Both computers, the one where messages are made first."""
        return self.source.machine, self.sink.machine

    def run(self, host: EngineHost) -> Run:
        assert host.run is not None
        return host.run

    def runs(self) -> list[Run]:
        runs = [run for run in (self.source.run, self.sink.run) if run is not None]
        return [run for run in runs if not self.world.loop.is_frozen(run.process)]

    def half(self, run: Run) -> Route | None:
        return next((half for link in run.links() if (half := route_of(link, self.flow)) is not None), None)

    def state(self, run: Run) -> State | None:
        half = self.half(run)
        return None if half is None else run.process.context.copy().run(half.verdict).state

    @property
    def stands(self) -> bool:
        halves = [self.half(run) for run in self.runs()]
        return len(halves) == 2 and all(half is not None and half.arming.phase is ArmingPhase.ARMED for half in halves)

    # --- what must never be

    def _published(self, payload: bytes) -> Any:
        account = self._count_published(payload)
        made, now, wrong = self.flow.made_at(payload), self.world.loop.time(), self.world.wrong
        assert made is not None
        for run in self.runs():
            if self.state(run) is State.DISARMED:
                wrong(f"{self.flow}: published while {run.host.name} shows it as disarmed")
        if made < self._disarmed_at:
            wrong(f"{self.flow}: published {now - self._disarmed_at:.3f} s after a disarm, made before it")
        if self._asked_at < self._stood_still_at:
            wrong(f"{self.flow}: published after a standstill, and nobody has armed it since")
        half = self.half(self.run(self.sink))
        answered = self.heartbeats.answered_at(half.arming.lease if half is not None else None)
        if now - answered > LASTS + _TAKEN:
            wrong(f"{self.flow}: published {now - answered:.3f} s after the last heartbeat")
        return account

    async def watch(self) -> None:
        """Note when either side begins to show it as disarmed."""
        shown: dict[Run, State | None] = {}
        looked_at = 0.0
        while True:
            for run in self.runs():
                state = self.state(run)
                if state is State.DISARMED and shown.get(run) not in (None, state):
                    self._disarmed_at = max(self._disarmed_at, looked_at)
                shown[run] = state
            looked_at = self.world.loop.time()
            await asyncio.sleep(_LOOKS)

    # --- what operators do

    async def keep(self) -> None:
        while True:
            await asyncio.sleep(1.0)
            for run in self.runs():
                await run.command(run.bridge.do(KeepArmed(pressed=True)))

    async def operate(self) -> None:
        while True:
            await asyncio.sleep(self.random.uniform(0.2, 2.0))
            if not (runs := self.runs()):
                continue
            run = self.random.choice(runs)
            half = self.half(run)
            if half is not None and self.state(run) is State.DISARMED:
                asyncio.ensure_future(self.arm(run))  # noqa: RUF006
            elif half is not None and half.arming.phase is ArmingPhase.ARMED and self.random.random() < 0.05:
                asyncio.ensure_future(self.disarm(run))  # noqa: RUF006

    async def arm(self, run: Run) -> None:
        half = self.half(run)
        if run.host.name in self._asking or half is None:
            return
        self._asking.add(run.host.name)
        self._asked_at = self.world.loop.time()
        try:
            await run.command(run.bridge.do(ArmTopic(half.key)))
            self.armed += 1
        except EngineError:
            pass
        finally:
            self._asking.discard(run.host.name)

    async def disarm(self, run: Run) -> None:
        """Disarm it on one side; when the command has ended, nothing that was made before it is published."""
        half = self.half(run)
        if half is None:
            return
        asked_at = self.world.loop.time()
        with contextlib.suppress(EngineError):
            await run.command(run.bridge.do(DisarmTopic(half.key)))
            self._disarmed_at = max(self._disarmed_at, asked_at)

    async def flows(self, host: EngineHost | None = None) -> None:
        """Have it armed, by an operator of one side or of either, until messages come out."""
        heard = self.flow.heard
        async with asyncio.timeout(_ARMED_WITHIN):
            while not (self.stands and self.flow.heard > heard + 5):
                if not self.stands:
                    heard = self.flow.heard
                    run = (host or self.random.choice((self.source, self.sink))).run
                    if run is not None and self.state(run) is State.DISARMED:
                        await self.arm(run)
                await asyncio.sleep(0.1)

    # --- faults

    @contextlib.asynccontextmanager
    async def stood_still(self, seconds: float, longest: float) -> Any:
        """Stall something for so long; after more than `longest`, it has to be armed again."""
        stood, began = self.stands, self.world.loop.time()
        yield
        if stood and seconds > longest:
            self._stood_still_at = max(self._stood_still_at, began)

    async def freeze(self, host: EngineHost, seconds: float, *, reads_first: bool) -> None:
        process = self.run(host).process
        async with self.stood_still(seconds, LASTS):
            self.world.loop.freeze(process)
            await asyncio.sleep(seconds)
        self.world.loop.thaw(process, reads_first=reads_first)

    async def stall(self, host: EngineHost, seconds: float) -> None:
        """Have the thread that takes from ROS stand still, while the loop goes on."""
        node = self.run(host).node
        async with self.stood_still(seconds, 2 * LASTS):
            node.stall()
            await asyncio.sleep(seconds)
        node.go_on()

    async def hold(self, seconds: float, *, back: bool | None = None) -> None:
        """Hold what the network carries, and release each stream at a moment of its own.

        Args:
            back: whether only the direction towards the publisher is held, or None for both directions.
        """
        network, ends = self.world.network, self.machines
        async with self.stood_still(seconds, GIVEN_UP_AFTER + LASTS):
            if back is None:
                network.cut(*ends)
            else:
                network.cut_one_way(*(reversed(ends) if back else ends))
            await asyncio.sleep(seconds)
        network.heal(*ends)

    async def slow(self, shortest: float, longest: float, seconds: float = 0.0) -> None:
        """Slow down the direction towards the publisher, for 0 s until `mend`."""
        path = self.world.network.path(*self.machines)
        path.latency = (shortest, longest)
        if seconds:
            await asyncio.sleep(seconds)
            path.mend()

    def mend(self) -> None:
        self.world.network.path(*self.machines).mend()

    async def restart(self, host: EngineHost) -> None:
        host.kill()
        await asyncio.sleep(self.random.uniform(0.0, 1.0))
        host.start()

    # --- lives

    def play(self, *lives: Coroutine[Any, Any, None]) -> None:
        """Play the world until the first of some lives is over, and watch it."""
        with self.heartbeats.tapped(self.world.loop.time):
            self.world.play(life=self._live(*lives))

    async def _live(self, life: Coroutine[Any, Any, None], *others: Coroutine[Any, Any, None]) -> None:
        tasks = [asyncio.ensure_future(each) for each in (self.watch(), self.keep(), *others)]
        await asyncio.sleep(8.0)
        with self.world.trouble("standstills", self.robot), self.world.flow_trouble(self.flow, "armed at times"):
            try:
                await life
                await asyncio.sleep(5.0)
            except (TimeoutError, AssertionError) as error:
                self.world.wrong(f"{self.flow}: {error!r}; {self.world.state(self.flow)}")
        for task in tasks:
            task.cancel()

    async def anything(self) -> None:
        random, loop = self.random, self.world.loop
        while loop.time() < SECONDS:
            await asyncio.sleep(random.uniform(0.5, 6.0))
            seconds = random.choice([0.4, 0.9, 1.2, 2.5, 4.5])
            host = random.choice((self.source, self.sink))
            match random.choice(["freeze", "stall", "hold", "hold", "hold one way", "slow", "restart"]):
                case "freeze":
                    await self.freeze(host, seconds, reads_first=random.random() < 0.5)
                case "stall":
                    await self.stall(host, seconds)
                case "hold":
                    await self.hold(seconds)
                case "hold one way":
                    await self.hold(seconds, back=random.random() < 0.5)
                case "slow":
                    await self.slow(*random.choice([(0.4, 0.5), (0.0, 0.6)]), 3.0)
                case _:
                    await self.restart(host)


CASES: list[Any] = [
    ("tcp", "transmit"), ("udp", "receive"), *long_cases(("tcp", "receive"), ("udp", "transmit"))
]  # fmt: skip


@pytest.mark.parametrize(("protocol", "direction"), CASES)
def test_armed_messages_come_young_or_never(protocol: Protocol, direction: str) -> None:
    armed = Armed(1, protocol, direction)
    armed.play(armed.anything(), armed.operate())
    assert armed.armed >= 3
    assert armed.flow.heard >= 300


# --- one thing after the other, as each rule needs it


async def disarmed_on_a_slow_way(armed: Armed) -> None:
    """Messages are in flight when an operator disarms."""
    for host in (armed.source, armed.sink):
        await armed.flows(host)
        await armed.slow(0.5, 0.5)
        await asyncio.sleep(1.0)
        await armed.disarm(armed.run(host))
        await asyncio.sleep(1.0)
        armed.mend()


async def disarmed_at_once(armed: Armed) -> None:
    """An operator of the other side disarms what has just been armed."""
    hosts = armed.source, armed.sink
    for number in range(6):
        await asyncio.sleep(2.0)
        arming, disarming = hosts if number % 2 else reversed(hosts)
        asyncio.ensure_future(armed.arm(armed.run(arming)))  # noqa: RUF006
        await asyncio.sleep(armed.random.uniform(0.0, 0.2))
        await armed.disarm(armed.run(disarming))


async def disarmed_while_held(armed: Armed) -> None:
    """The network holds messages, and what disarms, for longer than a second."""
    for _ in range(3):
        await armed.flows()
        holding = asyncio.ensure_future(armed.hold(1.5, back=False))
        await asyncio.sleep(0.3)
        await armed.disarm(armed.run(armed.source))
        await holding
        await asyncio.sleep(2.0)


async def stalled_on_a_slow_way(armed: Armed) -> None:
    """Messages wait for the ROS thread, too short to be noticed, and then in the network."""
    await armed.flows()
    await armed.slow(0.5, 0.5)
    for _ in range(3):
        await asyncio.sleep(1.5)
        await armed.stall(armed.source, 0.65)
    await asyncio.sleep(1.5)
    armed.mend()


async def stalled_with_a_backlog(armed: Armed) -> None:
    """More messages wait for the ROS thread than it takes at once, too short to be noticed, and then in the network."""
    await armed.flows()
    await armed.slow(0.7, 0.7)
    usual = armed.flow.period
    for _ in range(2):
        await asyncio.sleep(1.5)
        armed.flow.period = 1 / _FASTEST
        await asyncio.sleep(2 * usual)
        await armed.stall(armed.source, 0.42)
        armed.flow.period = usual
    await asyncio.sleep(1.5)
    armed.mend()


async def stalled_for_long(armed: Armed) -> None:
    """The ROS thread of either side stands still, while the two hear each other."""
    for host in (armed.source, armed.sink):
        await armed.flows()
        await armed.stall(host, 2.5)
        await asyncio.sleep(1.0)


async def frozen_for_long(armed: Armed) -> None:
    """The process of either side stands still, not for so long that the other one gives it up."""
    for host in (armed.source, armed.sink):
        for reads_first in (True, False):
            await armed.flows()
            await armed.freeze(host, 1.6, reads_first=reads_first)
            await asyncio.sleep(1.0)


async def held_for_long(armed: Armed) -> None:
    """The network holds everything for so long that the lease is given up."""
    await armed.flows()
    await armed.hold(4.5)
    await asyncio.sleep(5.0)


async def held_one_way(armed: Armed) -> None:
    """The network holds streams for less than the lease lasts, and releases them one by one."""
    for _ in range(6):
        await armed.flows()
        await armed.hold(1.5, back=False)
        await asyncio.sleep(2.0)


async def numbers_held(armed: Armed) -> None:
    """The heartbeats of the two sides are held back for longer than messages are."""
    for _ in range(8):
        await armed.flows()
        await armed.hold(0.9, back=False)
        await asyncio.sleep(2.0)


async def connected_anew(armed: Armed) -> None:
    """Either engine is killed, and started again."""
    for host in (armed.source, armed.sink):
        await armed.flows()
        await armed.restart(host)


EPISODES = (
    disarmed_on_a_slow_way, disarmed_at_once, disarmed_while_held, stalled_on_a_slow_way, stalled_with_a_backlog,
    stalled_for_long, frozen_for_long, held_for_long, held_one_way, numbers_held, connected_anew,
)  # fmt: skip


@pytest.mark.parametrize(("protocol", "direction"), CASES)
def test_one_standstill_after_the_other(protocol: Protocol, direction: str) -> None:
    armed = Armed(2, protocol, direction)

    async def live() -> None:
        for episode in EPISODES:
            await episode(armed)
        await armed.flows()

    armed.play(live())


# --- each rule is needed


def _any_number(self: LeaseHalf, number: int) -> bool:
    """Replace `LeaseHalf.passes` by a form that ignores the age of the number."""
    return number in self._sent and self.alive


def _any_time(self: LeaseHalf, number: int) -> bool:
    """Replace `LeaseHalf.passes` by a form that checks the number alone, as long as the lease is held."""
    sent = self._sent.get(number)
    return sent is not None and self.alive and self._steady() - sent <= GIVEN_UP_AFTER


def _blind_to(where: Standstill) -> Callable[[LeaseHalf], float]:
    """Replace `LeaseHalf._end_at_standstill` by a form that does not notice one kind of stall."""

    def look(self: LeaseHalf) -> float:
        phase, ended = self.phase, []
        with patch.object(self, "_ended", lambda: ended.append(True)):
            now = _look(self)
        if self.over is where and ended:
            self.phase, self.over = phase, None
        elif ended:
            self._ended()
        return now

    return look


def _newest_number(self: Marker, taken: Any) -> Any:
    """Replace `Marker.marked` by a form that takes the newest number."""
    return [each._replace(lease=self._lease.newest_before(float("inf"))) for each in taken]


def _each_turn(self: Marker, taken: Any) -> Any:
    """Replace `Marker.marked` by a form that gives the rest of a batch the turn in which it is taken."""
    self._is_empty = True
    return _marked(self, taken)


async def _at_once(self: Settling) -> None:
    """Replace `Settling.wait` by a form that does not wait."""


_look: Callable[[LeaseHalf], float] = replaced.LEASE_END.value
_marked = Marker.marked
_ALIVE = property(lambda self: self.phase is not LeasePhase.OFF)

_OLD = "s old, more than"
_AFTER = "after a disarm, made before it"
_STANDSTILL = "nobody has armed it since"
_ENDS = "_end_at_standstill"
_NO_LOOP, _NO_THREAD, _NO_PEER = map(_blind_to, (Standstill.LOOP, Standstill.ROS_THREAD, Standstill.PEER))
# fmt: off
_MISTAKES = (
    ("messages of any age pass", (LeaseHalf, "passes", _any_number), held_one_way, _OLD),
    ("messages pass for as long as the lease may last", (LeaseHalf, "passes", _any_time), held_one_way, _OLD),
    ("it is always alive", (LeaseHalf, "alive", _ALIVE), numbers_held, "s after the last heartbeat"),
    ("a loop that stands still is not noticed", (LeaseHalf, _ENDS, _NO_LOOP), frozen_for_long, _STANDSTILL),
    ("a ROS thread that stands still is not noticed", (LeaseHalf, _ENDS, _NO_THREAD), stalled_for_long, _STANDSTILL),
    ("a silent peer is not given up", (LeaseHalf, _ENDS, _NO_PEER), held_for_long, _STANDSTILL),
    ("messages carry the newest number", (Marker, "marked", _newest_number), stalled_on_a_slow_way, _OLD),
    ("a backlog counts as new", (Marker, "marked", _each_turn), stalled_with_a_backlog, _OLD),
    ("the command that disarms does not wait", (Settling, "wait", _at_once), disarmed_on_a_slow_way, _AFTER),
    ("messages in flight are not waited for", (Settling, "begin", nothing), disarmed_on_a_slow_way, "as disarmed"),
)
# fmt: on


@pytest.mark.parametrize(("what", "change", "episode", "finds"), _MISTAKES, ids=[what for what, *_ in _MISTAKES])
def test_each_rule_is_needed(what: str, change: Any, episode: Any, finds: str) -> None:
    # The link's window, and that of the path, would keep a burst from being sent at once.
    is_burst = episode is stalled_with_a_backlog
    # What is held has to have been sent just before, which it was in 3 of 10 worlds.
    armed = Armed(2 if episode is held_for_long else 3, "udp" if is_burst else "tcp", "transmit")
    wide = ((window, "FIRST", 1 << 20), (pacing, "LEAST_ON_PATH", 1 << 20)) if is_burst else ()
    # Another connection would take the place of the one that is held, and disarm.
    alone = ((ClientEnd, "doubts", nothing),) if episode is held_for_long else ()
    mutation = Mutation(what, (change, *wide, *alone), finds, _CONDITIONS, 3, 0.02)
    with mutation.made(), pytest.raises(Violation, match=mutation.finds):
        armed.play(episode(armed))
