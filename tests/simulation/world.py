"""A world from a seed: one server, up to eight robots, their topics, and all that happens to them."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING

import msgspec
from tests.simulation import faults, operators
from tests.simulation.call_invariants import half_of
from tests.simulation.chronicle import Chronicle
from tests.simulation.climate import Climate, climate_of
from tests.simulation.errands import Errand
from tests.simulation.exchanges import Exchange
from tests.simulation.flows import Account, Flow, label_of
from tests.simulation.invariants import Invariants, route_of
from tests.simulation.loop import SimulatedLoop
from tests.simulation.network import Network
from tests.simulation.sessions import (
    SERVER_ADDRESS,
    SERVER_NAME,
    client_session,
    server_session,
    some_action,
    some_service,
    some_topic,
)
from tests.simulation.sockets import simulated
from tests.simulation.station import Run, Station

from rsb_bridge.config.keys import Key
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.sources import ANNOUNCEMENT_TOPIC
from rsb_bridge.route.outgoing import OutgoingRoute

if TYPE_CHECKING:
    from collections.abc import Coroutine, Iterator, Sequence

    from tests.simulation.ros import Reader, Writer

    from rsb_bridge.link.link import Link
    from rsb_bridge.model.session import Session, Topic
    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.route.route import Route


class Violation(AssertionError):  # noqa: N818 — it is what was found, not what went wrong here
    """Something happened in a world that must never happen."""


@dataclass(eq=False)
class Robot:
    """A client, and what keeps it from being linked.

    Attributes:
        name: the client's, unless somebody has started it with a wrong one.
        station: its computer.
        flows: its topics.
        exchanges: its services.
        errands: its actions.
        troubles: what goes on that may keep it from being linked, each with how often.
        clear_since: s, since when there is nothing.
        commanded: s, when an operator last changed something.
        has_twin: whether another computer runs the same session.
    """

    name: str
    station: Station
    flows: list[Flow] = field(default_factory=list)
    exchanges: list[Exchange] = field(default_factory=list)
    errands: list[Errand] = field(default_factory=list)
    troubles: Counter[str] = field(default_factory=Counter)
    clear_since: float = 0.0
    commanded: float = 0.0
    has_twin: bool = False


class World:
    """Everything, from a seed.

    Attributes:
        seed: of all that is left to chance.
        loop: whose time it is.
        network: between the machines.
        server: the PC that the robots call.
        robots: the clients.
        flows: by number.
        exchanges: services, by number.
        errands: actions, by number.
        accounts: what each route's sending half did, by the route.
        chronicle: what has happened.
    """

    def __init__(self, seed: int, climate: Climate | None = None) -> None:
        """Make it.

        Args:
            seed: of all that is left to chance.
            climate: how much there is of everything; None: the seed decides that, too.
        """
        self.seed = seed
        self.climate = climate or climate_of(self.random("climate"))
        self.loop = SimulatedLoop(self.random("executor"))  # type: ignore[abstract]  # what is not simulated raises
        self.loop.on_error = self._failed
        self.network = Network(self.loop, self.random("network"))
        self.flows: dict[int, Flow] = {}
        self.exchanges: dict[int, Exchange] = {}
        self.errands: dict[int, Errand] = {}
        self.accounts: dict[OutgoingRoute, Account] = {}
        self.chronicle = Chronicle(self.loop)
        self.stations: list[Station] = []
        self.invariants = Invariants(self)
        self._violation: Violation | None = None
        random = self.random("world")
        encrypted = random.random() < 0.7
        names = [f"robot{number}" for number in range(1, random.choice(self.climate.robots) + 1)]
        secret: dict[str, tuple[Key, ...]] = {name: (Key(random.randbytes(32)),) if encrypted else () for name in names}
        self.network.names[SERVER_NAME] = random.choice(([SERVER_ADDRESS], ["10.255.0.1", SERVER_ADDRESS]))
        self.server = self._station("pc", SERVER_ADDRESS, server_session(names, random, encrypted=encrypted), secret)
        self.robots = [self._robot(name, 2 + index, {name: secret[name]}, random) for index, name in enumerate(names)]

    def random(self, purpose: str) -> Random:
        """Numbers for one purpose, so that what is asked for another one changes nothing here."""
        return Random(f"{self.seed} {purpose}")

    # --- how it is made

    def _robot(self, name: str, number: int, keys: dict[str, tuple[Key, ...]], random: Random) -> Robot:
        topics = tuple(some_topic(name, index, random) for index in range(random.choice(self.climate.topics)))
        session = client_session(name, number, topics, random, encrypted=None not in keys.values())
        calls = self.random(f"services of {name}")
        services = [some_service(name, index, calls) for index in range(calls.choice(self.climate.services))]
        goals = self.random(f"actions of {name}")
        actions = [some_action(name, index, goals) for index in range(goals.choice(self.climate.actions))]
        session = msgspec.structs.replace(session, topics=(*topics, *services, *actions))
        robot = Robot(name, self._station(name, f"10.0.0.{number}", session, keys))
        for topic in topics:
            self.add_flow(robot, topic, random)
        for service in services:
            self._add_exchange(robot, service, calls)
        for action in actions:
            self.add_errand(robot, action, self.climate.periods[0])
        return robot

    def add_errand(self, robot: Robot, action: Topic, period: float) -> Errand:
        """Have clients at one end of an action, with a goal every `period` s (0: none), and a server at the other."""
        here, there = robot.station.domain, self.server.domain
        on_server = action.remote_topic or f"/{robot.name}{action.topic}"
        transmit, number = action.direction == "transmit", len(self.errands) + 1
        errand = Errand(
            number,
            action,
            robot.name,
            (here, there) if transmit else (there, here),
            (action.topic, on_server) if transmit else (on_server, action.topic),
            random=self.random(f"errand {number}"),
            period=period,
            on_wrong=self.wrong,
        )
        errand.explains = lambda goal: self.invariants.actions.explains(errand, goal)
        self.errands[number] = errand
        robot.errands.append(errand)
        return errand

    def _add_exchange(self, robot: Robot, service: Topic, random: Random) -> None:
        """Have callers at one end of a service and a server at the other."""
        here, there = robot.station.domain, self.server.domain
        on_server = service.remote_topic or f"/{robot.name}{service.topic}"
        transmit = service.direction == "transmit"
        number, (shortest, longest) = len(self.exchanges) + 1, self.climate.periods
        exchange = Exchange(
            number,
            service,
            robot.name,
            (here, there) if transmit else (there, here),
            (service.topic, on_server) if transmit else (on_server, service.topic),
            random=self.random(f"exchange {number}"),
            period=shortest * (longest / shortest) ** random.random(),
            on_wrong=self.wrong,
        )
        self.exchanges[number] = exchange
        robot.exchanges.append(exchange)

    def add_flow(self, robot: Robot, topic: Topic, random: Random) -> Flow:
        """Have a publisher at one end of a topic and a subscription at the other."""
        here, there = robot.station.domain, self.server.domain
        on_server = topic.remote_topic or f"/{robot.name}{topic.topic}"
        transmit = topic.direction == "transmit"
        climate = self.climate
        latched = topic.qos == "auto" and random.random() < climate.latched
        shortest, longest = climate.periods
        flow = Flow(
            len(self.flows) + 1,
            topic,
            robot.name,
            (here, there) if transmit else (there, here),
            (topic.topic, on_server) if transmit else (on_server, topic.topic),
            random=self.random(f"flow {len(self.flows) + 1}"),
            qos=Qos(durability="transient_local", depth=random.choice((1, 1, 5))) if latched else Qos(),
            period=random.uniform(60.0, 600.0) if latched else shortest * (longest / shortest) ** random.random(),
            size=random.randrange(1, climate.size),
            on_wrong=self.wrong,
        )
        self.flows[flow.number] = flow
        robot.flows.append(flow)
        return flow

    @contextlib.contextmanager
    def twin(self, robot: Robot) -> Iterator[Station]:
        """Another computer that runs the same session, in a ROS domain of its own where nobody publishes."""
        original = robot.station
        address = f"10.254.0.{original.machine.address.rpartition('.')[2]}"
        station = self._station(f"{robot.name}'s twin", address, original.session, original.keys)
        robot.has_twin = True
        try:
            yield station
        finally:
            robot.has_twin = False
            self.stations.remove(station)
            self.network.leave(address)

    def _station(self, name: str, address: str, session: Session, keys: dict[str, tuple[Key, ...]]) -> Station:
        station = Station(self.network, name, address, self.random(f"station {name}"))
        station.session, station.keys = session, keys
        station.on_run = self._begins
        station.on_end = self.forget
        station.on_event = self._event
        station.on_leak = lambda station, left: self.wrong(f"{station.name} has stopped, and left open {left}")
        self.stations.append(station)
        return station

    # --- what happens

    def play(self, seconds: float, *doings: Coroutine[None, None, None]) -> None:
        """Let it live, with all the faults and commands of its climate.

        Args:
            seconds: simulated.
            doings: what else happens in it.

        Raises:
            Violation: something happened that must not.
        """
        with simulated(), self.invariants.actions.tapped():
            try:
                self.loop.run_until_complete(self._play(seconds, doings))
            finally:
                self._clean_up()
                self.loop.close()

    def _clean_up(self) -> None:
        """Have whatever still runs end, as after a failure."""
        self.loop.on_error = lambda _: None
        for station in self.stations:
            station.kill()
        tasks = asyncio.all_tasks(self.loop)
        for task in tasks:
            task.cancel()
        if tasks:
            self.loop.run_until_complete(asyncio.wait(tasks, timeout=60.0))

    async def _play(self, seconds: float, doings: Sequence[Coroutine[None, None, None]]) -> None:
        doings = (*doings, self.invariants.watch(), *faults.of(self), *operators.of(self))
        tasks = [self.loop.create_task(doing) for doing in doings]
        self.server.start()
        for robot in self.robots:
            robot.station.start()
            for flow in robot.flows:
                flow.listen()
                flow.appear()
            for exchange in robot.exchanges:
                exchange.appear()
                exchange.call()
            for errand in robot.errands:
                errand.appear()
                errand.call()
        await asyncio.sleep(seconds)
        for task in tasks:
            task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.gather(*tasks)
        for station in self.stations:
            await station.stop()

    def wrong(self, what: str) -> None:
        """Something is as it must not be: the world ends."""
        if self._violation is None:
            self._violation = Violation(f"{self.chronicle.stamp()} {what}")
            self.loop.fail(self._violation)

    def command(self) -> str:
        """What plays it again, up to now."""
        return f"python -m tests.simulation {self.seed} --days {self.loop.time() / 86_400 + 0.001:.3f}"

    def summary(self) -> str:
        """What it was, in a few lines."""
        messages = sum(flow.heard for flow in self.flows.values())
        answers = sum(exchange.answered for exchange in self.exchanges.values())
        answers += sum(errand.answered for errand in self.errands.values())
        return (
            f"world {self.seed} ({self.climate.name}): {len(self.robots)} robots, {len(self.flows)} topics, "
            f"{self.chronicle.stamp()}, {self.invariants.checks} checks, {messages} messages came out, "
            f"{answers} calls were answered, "
            f"{self.chronicle.events[EventCode.LINK_UP]} ends linked, "
            f"at most {self.invariants.worst_recovery:.1f} s after it was possible, "
            f"digest {self.chronicle.digest:08x}\n{self.chronicle.summary()}"
        )

    @contextlib.contextmanager
    def trouble(self, what: str, *robots: Robot, fault: bool = True) -> Iterator[None]:
        """While this lasts, the robots need not be linked; where `fault` is False, because an operator wants it so."""
        if fault:
            self.chronicle.fault(what)
        self.chronicle.tell(f"{what} begins: {', '.join(robot.name for robot in robots)}")
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
            self.chronicle.tell(f"{what} is over: {', '.join(robot.name for robot in robots)}")

    @contextlib.contextmanager
    def flow_trouble(self, flow: Flow | Exchange | Errand, what: str) -> Iterator[None]:
        """While this lasts, a topic need not flow."""
        self.chronicle.fault(what)
        self.chronicle.tell(f"{flow}: {what}")
        flow.troubles[what] += 1
        try:
            yield
        finally:
            flow.troubles[what] -= 1
            if not flow.troubles[what]:
                del flow.troubles[what]
            flow.changed = self.loop.time()
            self.chronicle.tell(f"{flow}: {what} no more")

    def _failed(self, details: dict[str, object]) -> None:
        error = details.get("exception")
        self.wrong(f"nobody caught {error!r}: {details.get('message')}")

    def _event(self, station: Station, level: Level, code: EventCode, text: str, link: str) -> None:
        if level is not Level.DEBUG:  # they repeat what was told before
            self.chronicle.tell(f"{station.name}: {level} {code} {text}" + (f" ({link})" if link else ""))
        self.chronicle.events[code] += 1
        if code == EventCode.ENGINE_ERROR:
            self.wrong(f"{station.name}: {text}")

    # --- what there is

    def runs(self) -> list[Run]:
        """The engines that run."""
        return [station.run for station in self.stations if station.run is not None]

    def robot(self, name: str) -> Robot:
        """A robot by its name."""
        return next((robot for robot in self.robots if robot.name == name), self.robots[0])

    def link_ends(self, robot: Robot) -> tuple[Link, Link] | None:
        """Both ends of a robot's link, its own first; None: one of the engines does not run, or under another name."""
        run, server = robot.station.run, self.server.run
        if run is None or server is None:
            return None
        there = next((link for link in server.links() if link.name == robot.name), None)
        (here,) = run.links()
        return None if there is None or here.name != robot.name else (here, there)

    def cut_off_at(self, robot: Robot) -> float | None:
        """Since when (s) nothing gets through between a robot and the server in a direction; None: everything does."""
        ends = (robot.station.machine, self.server.machine)
        since = [path.cut_at for path in self.network.both_ways(*ends)] + [machine.off_at for machine in ends]
        return min((time for time in since if time is not None), default=None)

    def clear_since(self, robot: Robot) -> float:
        """Since when (s) nothing keeps a robot from being linked."""
        began = [run.began for run in (robot.station.run, self.server.run) if run is not None]
        return max(robot.clear_since, *began)

    def state(self, flow: Flow) -> str:
        """What both sides say of a flow, its robot's first."""
        told = []
        for link in self.link_ends(self.robot(flow.robot)) or ():
            route = route_of(link, flow)
            snapshot = route.snapshot() if route is not None else None
            told.append(f"{snapshot.state} {snapshot.reason!r} {snapshot.ledger}" if snapshot else "no route")
        return "; ".join(told)

    def said(self, exchange: Exchange) -> str:
        """What both sides say of a service, its robot's first."""
        halves = [half_of(link, exchange) for link in self.link_ends(self.robot(exchange.robot)) or ()]
        shown = [half.snapshot() for half in halves if half is not None]
        return "; ".join(f"{each.state} {each.reason!r} {each.calls} {each.stages}" for each in shown)

    # --- the outside truth

    def forget(self, run: Run) -> None:
        """An engine ends: what it published and has not reported yet, nobody will hear of."""
        for route, account in self.accounts.items():
            if run is self.server.run or route.peer.name == run.station.session.name:
                account.forget(route)

    def forget_route(self, removed: Route) -> None:
        """The receiving half of a route is removed: likewise, where the link is down and the sending half is not."""
        for route, account in self.accounts.items():
            if route.peer.name == removed.peer.name and route.remote_topic == removed.remote_topic:
                account.forget(route, removed=True)

    def _begins(self, run: Run) -> None:
        self.chronicle.tell(f"{run.station.name}: an engine begins")
        run.node.on_reader = lambda reader, origin: self._subscribed(run, reader, origin)
        run.node.on_writer = lambda writer, _: self._advertised(writer)

    def _subscribed(self, run: Run, reader: Reader, origin: object) -> None:
        routes = [route for link in run.links() if link.name == origin for route in link.routes.values()]
        route = next((each for each in routes if isinstance(each, OutgoingRoute) and each.topic == reader.topic), None)
        if route is None:
            return
        account = self.accounts.setdefault(route, Account())

        def took(batch: Sequence[RawMessage]) -> None:
            label = label_of(batch[0].payload)
            if label is not None:
                self.flows[label.flow].took(account, batch)

        reader.on_take = took

    def _advertised(self, writer: Writer) -> None:
        if writer.topic == ANNOUNCEMENT_TOPIC or "/_action/" in writer.topic:
            return  # no flow's

        def published(payload: bytes) -> None:
            label = label_of(payload)
            if label is not None:
                self.flows[label.flow].published(payload)

        writer.on_publish = published
