"""A world from a seed: one server, up to eight robots, their topics, and all that happens to them."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING, Any

import msgspec
from tests.simulation import faults, operators
from tests.simulation.action_flow import ActionFlow
from tests.simulation.call_invariants import half_of
from tests.simulation.conditions import Conditions, draw_conditions
from tests.simulation.engine_host import EngineHost, Run
from tests.simulation.invariants import Invariants, route_of
from tests.simulation.loop import SimulatedLoop
from tests.simulation.network import Network
from tests.simulation.service_flow import ServiceFlow
from tests.simulation.sessions import (
    SERVER_ADDRESS,
    SERVER_NAME,
    client_session,
    kept,
    server_session,
    some_action,
    some_service,
    some_topic,
)
from tests.simulation.sockets import simulated
from tests.simulation.topic_flow import Account, TopicFlow, label_of
from tests.simulation.world_log import WorldLog
from tests.support.places import Place

from rsb_bridge.config.keys import Key
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.names import ANNOUNCEMENT_TOPIC
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.snapshot import Level
from rsb_bridge.route.sender import Sender

if TYPE_CHECKING:
    from collections.abc import Coroutine, Iterator, Sequence

    from tests.simulation.ros import Domain, Reader, Writer

    from rsb_bridge.link.link import Link
    from rsb_bridge.model.session import Session, Topic
    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.route.route import Route

_LONGEST = 10_000.0
"""s that a life may take."""

_BROKEN = "the peer broke the format"


@contextlib.contextmanager
def _no_figures() -> Iterator[None]:
    """Have simulated machines no figures: this one's differ each time, and would be sent."""
    machine = Place("rsb_extras.machine_state.machine_reading", "MachineWatch.look")
    nodes = Place("rsb_extras.nodes.node_watch", "NodeWatch.tick")
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(ModuleNotFoundError):  # the core alone
            stack.enter_context(machine.during(lambda _: None))
            stack.enter_context(nodes.during(lambda *_: None))
        yield


class Violation(AssertionError):  # noqa: N818 — it is a finding, not an error of this code
    """Something happened in a world that must never happen."""


@dataclass(eq=False)
class Robot:
    """A client, and what keeps it from being linked.

    Attributes:
        name: the client's, unless somebody has started it with a wrong one.
        troubles: reasons why it may be unlinked, with how often each applies.
        has_twin: whether another computer runs the same session.
    """

    name: str
    host: EngineHost
    topic_flows: list[TopicFlow] = field(default_factory=list)
    service_flows: list[ServiceFlow] = field(default_factory=list)
    action_flows: list[ActionFlow] = field(default_factory=list)
    troubles: Counter[str] = field(default_factory=Counter)
    clear_since: float = 0.0
    commanded: float = 0.0
    has_twin: bool = False


class World:
    """Everything, from a seed.

    Attributes:
        accounts: what each sender did.
        breaks_format: whether the test itself sends what the protocol forbids.
    """

    def __init__(self, seed: int, conditions: Conditions | None = None) -> None:
        self.seed = seed
        self.conditions = conditions or draw_conditions(self.random("climate"))
        self.loop = SimulatedLoop(self.random("executor"))  # type: ignore[abstract]  # what is not simulated raises
        self.loop.on_error = self._failed
        self.network = Network(self.loop, self.random("network"))
        self.topic_flows: dict[int, TopicFlow] = {}
        self.service_flows: dict[int, ServiceFlow] = {}
        self.action_flows: dict[int, ActionFlow] = {}
        self.accounts: dict[Sender, Account] = {}
        self.breaks_format = False
        self.log = WorldLog(self.loop)
        self.hosts: list[EngineHost] = []
        self.invariants = Invariants(self)
        self._violation: Violation | None = None
        random = self.random("world")
        encrypted = random.random() < 0.7
        names = [f"robot{number}" for number in range(1, random.choice(self.conditions.robots) + 1)]
        secret: dict[str, tuple[Key, ...]] = {name: (Key(random.randbytes(32)),) if encrypted else () for name in names}
        self.network.names[SERVER_NAME] = random.choice(([SERVER_ADDRESS], ["10.255.0.1", SERVER_ADDRESS]))
        session = server_session(names, random, encrypted=encrypted, outlive=self.conditions.outlive)
        self.server = self._host("pc", SERVER_ADDRESS, session, secret)
        self.robots = [self._robot(name, 2 + index, {name: secret[name]}, random) for index, name in enumerate(names)]

    def random(self, purpose: str) -> Random:
        """Return a generator for one purpose, so that draws for other purposes do not change its numbers.

        The purpose is part of the seed, so another word for it makes another world.
        """
        return Random(f"{self.seed} {purpose}")

    # --- how it is made

    def _robot(self, name: str, number: int, keys: dict[str, tuple[Key, ...]], random: Random) -> Robot:
        topics = tuple(some_topic(name, index, random) for index in range(random.choice(self.conditions.topics)))
        if self.conditions.keep:
            topics = tuple(kept(topic, self.conditions.keep) for topic in topics)
        encrypted, outlive = None not in keys.values(), self.conditions.outlive
        session = client_session(name, number, topics, random, encrypted=encrypted, outlive=outlive)
        calls = self.random(f"services of {name}")
        services = [some_service(name, index, calls) for index in range(calls.choice(self.conditions.services))]
        goals = self.random(f"actions of {name}")
        actions = [some_action(name, index, goals) for index in range(goals.choice(self.conditions.actions))]
        session = msgspec.structs.replace(session, topics=(*topics, *services, *actions))
        robot = Robot(name, self._host(name, f"10.0.0.{number}", session, keys))
        for topic in topics:
            self.add_topic_flow(robot, topic, random)
        for service in services:
            self._add_service_flow(robot, service, calls)
        for action in actions:
            self.add_action_flow(robot, action, self.conditions.periods[0])
        return robot

    def add_action_flow(self, robot: Robot, action: Topic, period: float) -> ActionFlow:
        number = len(self.action_flows) + 1
        flow = ActionFlow(
            number, action, robot.name, *self._ends(robot, action), **self._chance(f"errand {number}"), period=period
        )
        flow.explains = lambda goal: self.invariants.actions.explains(flow, goal)
        self.action_flows[number] = flow
        robot.action_flows.append(flow)
        return flow

    def _add_service_flow(self, robot: Robot, service: Topic, random: Random) -> None:
        number, period = len(self.service_flows) + 1, self._period(random)
        flow = ServiceFlow(
            number,
            service,
            robot.name,
            *self._ends(robot, service),
            **self._chance(f"exchange {number}"),
            period=period,
        )
        self.service_flows[number] = flow
        robot.service_flows.append(flow)

    def add_topic_flow(self, robot: Robot, topic: Topic, random: Random) -> TopicFlow:
        number = len(self.topic_flows) + 1
        latched = topic.qos == "auto" and random.random() < self.conditions.latched
        flow = TopicFlow(
            number,
            topic,
            robot.name,
            *self._ends(robot, topic),
            **self._chance(f"flow {number}"),
            qos=Qos(durability="transient_local", depth=random.choice((1, 1, 5))) if latched else Qos(),
            period=random.uniform(60.0, 600.0) if latched else self._period(random),
            size=random.randrange(1, self.conditions.size),
        )
        self.topic_flows[number] = flow
        robot.topic_flows.append(flow)
        return flow

    def _ends(self, robot: Robot, entry: Topic) -> tuple[tuple[Domain, Domain], tuple[str, str]]:
        """Return the near and the far domain of an entry of a robot's session, and its names there."""
        here, there = robot.host.domain, self.server.domain
        on_server = entry.remote_topic or f"/{robot.name}{entry.topic}"
        if entry.direction == "transmit":
            return (here, there), (entry.topic, on_server)
        return (there, here), (on_server, entry.topic)

    def _chance(self, purpose: str) -> dict[str, Any]:
        return {"random": self.random(purpose), "on_wrong": self.wrong}

    def _period(self, random: Random) -> float:
        shortest, longest = self.conditions.periods
        return float(shortest * (longest / shortest) ** random.random())

    @contextlib.contextmanager
    def twin(self, robot: Robot) -> Iterator[EngineHost]:
        original = robot.host
        address = f"10.254.0.{original.machine.address.rpartition('.')[2]}"
        host = self._host(f"{robot.name}'s twin", address, original.session, original.keys)
        robot.has_twin = True
        try:
            yield host
        finally:
            robot.has_twin = False
            self.hosts.remove(host)
            self.network.leave(address)

    def _host(self, name: str, address: str, session: Session, keys: dict[str, tuple[Key, ...]]) -> EngineHost:
        host = EngineHost(self.network, name, address, self.random(f"station {name}"))
        host.session, host.keys = session, keys
        host.on_run = self._begins
        host.on_end = self.forget
        host.on_event = self._event
        host.on_leak = lambda host, left: self.wrong(f"{host.name} has stopped, and left open {left}")
        self.hosts.append(host)
        return host

    # --- what happens

    def play(
        self,
        seconds: float = _LONGEST,
        *doings: Coroutine[None, None, None],
        life: Coroutine[None, None, None] | None = None,
    ) -> None:
        """Let it live, with all the faults and commands of its conditions.

        Args:
            doings: what else happens in it.
            life: what happens in it until it ends, within `seconds`, or None if only time ends it.

        Raises:
            Violation: something happened that must not.
            TimeoutError: the life has not come to its end.
        """
        with simulated(), _no_figures():
            try:
                self.loop.run_until_complete(self._play(seconds, doings, life))
            finally:
                self._clean_up()
                self.loop.close()

    def _clean_up(self) -> None:
        self.loop.on_error = lambda _: None
        for host in self.hosts:
            host.kill()
        tasks = asyncio.all_tasks(self.loop)
        for task in tasks:
            task.cancel()
        if tasks:
            self.loop.run_until_complete(asyncio.wait(tasks, timeout=60.0))

    async def _play(
        self, seconds: float, doings: Sequence[Coroutine[None, None, None]], life: Coroutine[None, None, None] | None
    ) -> None:
        doings = (*doings, self.invariants.watch(), *faults.of(self), *operators.of(self))
        tasks = [self.loop.create_task(doing) for doing in doings]
        self.server.start()
        for robot in self.robots:
            robot.host.start()
            for flow in robot.topic_flows:
                flow.listen()
                flow.appear()
            for service in robot.service_flows:
                service.appear()
                service.call()
            for action in robot.action_flows:
                action.appear()
                action.call()
        if life is None:
            await asyncio.sleep(seconds)
        else:
            async with asyncio.timeout(seconds):
                await life
            self.invariants.check()
        for task in tasks:
            task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.gather(*tasks)
        for host in self.hosts:
            await host.stop()

    def wrong(self, what: str) -> None:
        if self._violation is None:
            self._violation = Violation(f"{self.log.stamp()} {what}")
            self.loop.fail(self._violation)

    def command(self) -> str:
        return f"python -m tests.simulation {self.seed} --days {self.loop.time() / 86_400 + 0.001:.3f}"

    def summary(self) -> str:
        messages = sum(flow.heard for flow in self.topic_flows.values())
        answers = sum(service.answered for service in self.service_flows.values())
        answers += sum(action.answered for action in self.action_flows.values())
        return (
            f"world {self.seed} ({self.conditions.name}): {len(self.robots)} robots, {len(self.topic_flows)} topics, "
            f"{self.log.stamp()}, {self.invariants.checks} checks, {messages} messages came out, "
            f"{answers} calls were answered, "
            f"{self.log.events[EventCode.LINK_UP]} ends linked, "
            f"at most {self.invariants.worst_recovery:.1f} s after it was possible, "
            f"digest {self.log.digest:08x}\n{self.log.summary()}"
        )

    @contextlib.contextmanager
    def trouble(self, what: str, *robots: Robot, fault: bool = True) -> Iterator[None]:
        """Allow the robots to be unlinked meanwhile; with `fault` False, an operator has asked for it."""
        if fault:
            self.log.fault(what)
        self.log.tell(f"{what} begins: {', '.join(robot.name for robot in robots)}")
        for robot in robots:
            robot.troubles[what] += 1
        try:
            yield
        finally:
            for robot in robots:
                robot.troubles[what] -= 1
                if not robot.troubles[what]:
                    del robot.troubles[what]
                robot.clear_since = self.loop.time()
            self.log.tell(f"{what} is over: {', '.join(robot.name for robot in robots)}")

    @contextlib.contextmanager
    def flow_trouble(self, flow: TopicFlow | ServiceFlow | ActionFlow, what: str) -> Iterator[None]:
        self.log.fault(what)
        self.log.tell(f"{flow}: {what}")
        flow.troubles[what] += 1
        try:
            yield
        finally:
            flow.troubles[what] -= 1
            if not flow.troubles[what]:
                del flow.troubles[what]
            flow.changed = self.loop.time()
            self.log.tell(f"{flow}: {what} no more")

    def _failed(self, details: dict[str, object]) -> None:
        error = details.get("exception")
        self.wrong(f"nobody caught {error!r}: {details.get('message')}")

    def _event(self, host: EngineHost, level: Level, code: str, text: str, link: str) -> None:
        if level is not Level.DEBUG:  # they repeat earlier events
            self.log.tell(f"{host.name}: {level} {code} {text}" + (f" ({link})" if link else ""))
        self.log.events[code] += 1
        if _BROKEN in text and not self.breaks_format:  # nobody here speaks another protocol
            self.wrong(f"{host.name}: {text}")
        if code == EventCode.ENGINE_ERROR:
            self.wrong(f"{host.name}: {text}")

    # --- queries

    def runs(self) -> list[Run]:
        return [host.run for host in self.hosts if host.run is not None]

    def robot(self, name: str) -> Robot:
        return next((robot for robot in self.robots if robot.name == name), self.robots[0])

    def link_ends(self, robot: Robot) -> tuple[Link, Link] | None:
        """Return both ends of a robot's link, its own first, or None unless both engines run under their own names."""
        run, server = robot.host.run, self.server.run
        if run is None or server is None:
            return None
        there = next((link for link in server.links() if link.name == robot.name), None)
        (here,) = run.links()
        return None if there is None or here.name != robot.name else (here, there)

    def cut_off_at(self, robot: Robot) -> float | None:
        """Return when (s) the network between a robot and the server was cut in some direction, or None."""
        ends = (robot.host.machine, self.server.machine)
        since = [path.cut_at for path in self.network.both_ways(*ends)] + [machine.off_at for machine in ends]
        return min((time for time in since if time is not None), default=None)

    def clear_since(self, robot: Robot) -> float:
        """Since when (s) nothing keeps a robot from being linked."""
        began = [run.began for run in (robot.host.run, self.server.run) if run is not None]
        return max(robot.clear_since, *began)

    def state(self, flow: TopicFlow) -> str:
        told = []
        for link in self.link_ends(self.robot(flow.robot)) or ():
            route = route_of(link, flow)
            snapshot = route.snapshot() if route is not None else None
            told.append(f"{snapshot.state} {snapshot.reason!r} {snapshot.ledger}" if snapshot else "no route")
        return "; ".join(told)

    def said(self, service: ServiceFlow) -> str:
        halves = [half_of(link, service) for link in self.link_ends(self.robot(service.robot)) or ()]
        shown = [half.route.snapshot() for half in halves if half is not None]
        return "; ".join(f"{each.state} {each.reason!r} {each.calls} {each.stages}" for each in shown)

    # --- the outside truth

    def forget(self, run: Run) -> None:
        """An engine ends: what it published and has not reported yet, nobody will hear of."""
        for sender, account in self.accounts.items():
            if run is self.server.run or sender.route.peer.name == run.host.session.name:
                account.forget(sender)

    def forget_route(self, removed: Route) -> None:
        """Do the same for one route whose receiving half is removed while the link is down."""
        for sender, account in self.accounts.items():
            route = sender.route
            if route.peer.name == removed.peer.name and route.remote_topic == removed.remote_topic:
                account.forget(sender, removed=True)

    def _begins(self, run: Run) -> None:
        self.log.tell(f"{run.host.name}: an engine begins")
        run.node.on_reader = lambda reader, origin: self._subscribed(run, reader, origin)
        run.node.on_writer = lambda writer, _: self._advertised(writer)

    def _subscribed(self, run: Run, reader: Reader, origin: object) -> None:
        halves = [route.half for link in run.links() if link.name == origin for route in link.routes.values()]
        senders = [half for half in halves if isinstance(half, Sender) and half.route.topic == reader.topic]
        if not senders or reader.numbers is not senders[0].subscription.numbers:
            return  # no sender's, or it looks how many messages a publisher keeps
        sender = senders[0]
        account = self.accounts.setdefault(sender, Account())

        def took(batch: Sequence[RawMessage]) -> None:
            label = label_of(batch[0].payload)
            if label is not None:
                self.topic_flows[label.flow].took(account, sender.route.opened_at, batch)

        reader.on_take = took

    def _advertised(self, writer: Writer) -> None:
        if writer.topic == ANNOUNCEMENT_TOPIC or "/_action/" in writer.topic:
            return  # no flow's

        def published(payload: bytes) -> None:
            label = label_of(payload)
            if label is not None:
                self.topic_flows[label.flow].published(payload)

        writer.on_publish = published
