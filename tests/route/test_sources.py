"""The messages that a route may carry, in random worlds of domains and bridges, with news in any order."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from itertools import count
from random import Random
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rsb_bridge.model.hops import hop
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.announcements import Origin
from rsb_bridge.ros.ros_interface import Endpoint, RawMessage
from rsb_bridge.route.loop_filter import LoopFilter

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.route.loop_filter import SourceTable
    from rsb_bridge.wire.records import Source


class Place(NamedTuple):
    domain: int
    topic: str


@dataclass(eq=False)
class Bridge:
    """An engine in a domain, as the decision sees it: a stand-in for the announcements and for ROS."""

    node_name: str
    domain: int
    world: World
    own: dict[bytes, tuple[str, str, Origin]] = field(default_factory=dict)  # topic, link, origin by gid
    heard: dict[str, dict[bytes, Origin]] = field(default_factory=dict)
    bridges: tuple[str, ...] = ()

    def publishers(self, topic: str) -> list[Endpoint]:
        place = Place(self.domain, topic)
        found = [endpoint(gid, "stock") for gid in self.world.users.get(place, ())]
        for other in self.world.bridges:
            if other is not self and other.domain == self.domain:
                found += [endpoint(gid, other.node_name) for gid, (where, _, _) in other.own.items() if where == topic]
        return found

    def own_publishers(self, topic: str, besides: str) -> list[Endpoint]:
        own = self.own.items()
        return [endpoint(gid, self.node_name) for gid, (where, link, _) in own if where == topic and link != besides]

    def origin_of(self, publisher: Endpoint) -> Origin | None:
        if publisher.gid in self.own:
            return self.own[publisher.gid][2]
        node = publisher.node.lstrip("/")
        return self.heard.get(node, {}).get(publisher.gid) if node.startswith("rsb") else Origin(())


def endpoint(gid: bytes, node: str) -> Endpoint:
    return Endpoint(f"/{node}", "", "", Qos(), gid)


@dataclass(eq=False)
class Link:
    """One side's view of a link."""

    name: str
    near: Bridge
    far: Bridge
    bridges: tuple[str, ...] = ()

    def learn_bridges(self) -> None:
        self.bridges = self.far.bridges


class NoTimers:
    """A loop on which nothing is ever due: the world calls again by itself."""

    def time(self) -> float:
        return 0.0

    def call_later(self, delay: float, work: object) -> Any:
        return SimpleNamespace(when=lambda: delay, cancel=lambda: None)


class Route:
    """One direction of one topic over a link."""

    def __init__(self, link: Link, topic: str, remote_topic: str) -> None:
        context: Any = SimpleNamespace(announcements=link.near, ros=link.near, now=lambda: 0.0, loop=NoTimers())
        self.link, self.topic, self.remote_topic = link, topic, remote_topic
        route: Any = SimpleNamespace(context=context, ends=link.near, peer=link, advance=lambda: None)
        self.loop_filter = LoopFilter(route)
        self.described: tuple[Source, ...] = ()
        self.waiting: deque[RawMessage] = deque()
        self.control: deque[tuple[Source, ...]] = deque()
        self.answers: deque[int] = deque()
        self.wire: deque[tuple[bytes, int]] = deque()
        self.outputs: list[bytes] = []

    @property
    def start(self) -> Place:
        return Place(self.link.near.domain, self.topic)

    @property
    def end(self) -> Place:
        return Place(self.link.far.domain, self.remote_topic)

    @property
    def departure(self) -> tuple[str, str]:
        """Its link's name, and the bridge at its start."""
        return self.link.name, self.link.near.node_name

    @property
    def table(self) -> SourceTable:
        return self.loop_filter.table

    def advance(self) -> None:
        """Update the sources as `Sender.advance` does."""
        self.loop_filter.update(self.topic, self.remote_topic)
        sources = self.table.sources if self.table.closes_loop else self.table.to_describe()
        if sources and sources != self.described:
            self.described = sources
            self.table.described()
            self.control.append(self.described)


class World:
    """Domains, bridges between them, and news and messages on their way."""

    def __init__(self, random: Random) -> None:
        self.random = random
        self.gids = count(1)
        self.bridges: list[Bridge] = []
        self.links: dict[tuple[str, str], Link] = {}
        self.routes: list[Route] = []
        self.users: dict[Place, list[bytes]] = {}
        self.copies: Counter[tuple[bytes, Place]] = Counter()
        self.trails: dict[int, tuple[str, ...]] = {}  # what each copy really crossed
        self.numbers = count()

    def bridge(self, domain: int, number: int) -> Bridge:
        name = f"rsb_{domain}_{number}"
        found = next((each for each in self.bridges if each.node_name == name), None)
        if found is None:
            found = Bridge(name, domain, self)
            found.bridges = (name,)
            self.bridges.append(found)
        return found

    def route(self, near: Bridge, far: Bridge, topic: str, remote_topic: str) -> None:
        """Bridge a topic; twice the same is once."""
        name = "-".join(sorted((near.node_name, far.node_name)))
        link = self.links.setdefault((near.node_name, far.node_name), Link(name, near, far))
        if all((each.link, each.topic, each.remote_topic) != (link, topic, remote_topic) for each in self.routes):
            self.routes.append(Route(link, topic, remote_topic))

    def remove(self, route: Route) -> None:
        self.routes.remove(route)
        for gid in route.outputs:
            del route.link.far.own[gid]

    # --- messages

    def publish(self, place: Place, gid: bytes, origin: bytes, trail: tuple[str, ...]) -> None:
        self.copies[origin, place] += 1
        for route in self.routes:
            own = route.link.near.own.get(gid)
            if route.start == place and (own is None or own[1] != route.link.name):
                number = next(self.numbers)
                self.trails[number] = trail
                route.waiting.append(RawMessage(origin, number, gid))

    def take(self, route: Route) -> None:
        batch = tuple(route.waiting)
        route.waiting.clear()
        messages = route.loop_filter.release()
        admitted, unseen = route.loop_filter.admit(batch)
        messages += admitted
        if unseen:
            route.advance()
            messages = [each for each in messages if each.gid in route.table.flags]  # the facts about these may change
        messages += route.loop_filter.release()
        crossed = hop(route.link.near.node_name, route.topic)
        for origin, number, gid, *_ in messages:
            trail = self.trails[number]
            assert crossed not in trail, "a message crosses a bridge twice"
            source = route.table.number_of(gid)
            assert route.described[source].via == (*trail, crossed), "a message is sent as what it is not"
            self.trails[number] = (*trail, crossed)
            route.wire.append((origin, number | source << 40))

    def arrive(self, route: Route) -> None:
        origin, mixed = route.wire.popleft()
        gid = route.outputs[mixed >> 40]
        self.publish(route.end, gid, origin, self.trails[mixed & (1 << 40) - 1])

    # --- news

    def steps(self) -> Iterator[Any]:
        """Everything that may happen next."""
        for route in self.routes:
            yield route.advance
            if route.control:
                yield lambda route=route: self.describe(route)
            if route.answers:
                yield lambda route=route: route.table.answered(route.answers.popleft())
            if route.waiting or route.loop_filter.holds:
                yield lambda route=route: self.take(route)
            if route.wire:
                yield lambda route=route: self.arrive(route)
        for bridge in self.bridges:
            for other in self.bridges:
                if bridge is not other and bridge.domain == other.domain:
                    yield lambda bridge=bridge, other=other: self.hear(bridge, other)
        for link in self.links.values():
            yield link.learn_bridges

    def describe(self, route: Route) -> None:
        far, sources = route.link.far, route.control.popleft()
        for number, source in enumerate(sources):
            if number == len(route.outputs):
                route.outputs.append(b"%d" % next(self.gids))
            far.own[route.outputs[number]] = (route.remote_topic, route.link.name, Origin(source.via, source.live))
        route.answers.append(len(sources))

    @staticmethod
    def hear(bridge: Bridge, other: Bridge) -> None:
        """A bridge reads the newest announcement of another one."""
        bridge.heard[other.node_name] = {gid: origin for gid, (_, _, origin) in other.own.items()}
        bridge.bridges = (bridge.node_name, *sorted(bridge.heard))

    def state(self) -> object:
        """Changes as long as there is news."""
        return (
            [
                (r.described, r.table.echoes, tuple(r.control), tuple(r.answers), r.table.closes_loop)
                for r in self.routes
            ],
            [(len(route.waiting), len(route.wire), route.loop_filter.holds) for route in self.routes],
            [(each.own.copy(), each.heard.copy(), each.bridges) for each in self.bridges],
            [link.bridges for link in self.links.values()],
            self.copies.total(),  # one message may have taken another one's place
        )

    def settle(self) -> None:
        """Let everything happen, in any order, until nothing changes any more."""
        for _ in range(1000):
            before = self.state()
            steps = list(self.steps())
            self.random.shuffle(steps)
            for step in steps:
                step()
            if self.state() == before:
                assert not any(route.waiting or route.wire or route.loop_filter.holds for route in self.routes)
                return
        pytest.fail("the world does not settle")

    def stir(self, rounds: int) -> None:
        """Let some things happen, and users publish amid them."""
        for _ in range(rounds):
            if steps := list(self.steps()):
                self.random.choice(steps)()
            if self.random.random() < 0.1 and self.users:
                self.say(self.random.choice(sorted(self.users)))

    def say(self, place: Place) -> bytes:
        origin = b"message %d" % next(self.numbers)
        self.publish(place, self.users[place][0], origin, ())
        return origin


class Way(NamedTuple):
    """A way that comes to no place twice, and not back over the link that it came by.

    Attributes:
        seen: the places on it.
        arrival: the last link's name, and the bridge at its end.
    """

    end: Place
    seen: frozenset[Place]
    arrival: tuple[str, str]


def ways_from(world: World, start: Place) -> Iterator[Way]:
    """The oracle: all ways on which a message of a user's should travel."""

    def walk(way: Way) -> Iterator[Way]:
        yield way
        for route in world.routes:
            if route.start == way.end and route.end not in way.seen and route.departure != way.arrival:
                yield from walk(Way(route.end, way.seen | {route.end}, (route.link.name, route.link.far.node_name)))

    yield from walk(Way(start, frozenset({start}), ("", "")))


def check(world: World) -> None:
    ways = [way for user in world.users for way in ways_from(world, user)]
    for user in world.users:
        origin = world.say(user)
        world.settle()
        got = Counter({place: copies for (said, place), copies in world.copies.items() if said == origin})
        assert got == Counter(way.end for way in ways_from(world, user))
    for route in world.routes:
        came = [way for way in ways if way.end == route.start and way.arrival != route.departure]
        loops = route.start == route.end or (bool(came) and all(route.end in way.seen for way in came))
        assert route.table.closes_loop == loops


ENDS = st.tuples(st.integers(0, 3), st.integers(0, 1))
ROUTES = st.lists(
    st.tuples(ENDS, ENDS, st.sampled_from(["/a", "/a", "/b"]), st.sampled_from(["/a", "/a", "/b"])), max_size=7
)
USERS = st.sets(st.builds(Place, st.integers(0, 3), st.sampled_from(["/a", "/b"])), max_size=3)


def make(routes: list[Any], users: set[Place], seed: int) -> World:
    world = World(Random(seed))
    for (near, near_number), (far, far_number), topic, remote_topic in routes:
        if (near, near_number) != (far, far_number):
            world.route(world.bridge(near, near_number), world.bridge(far, far_number), topic, remote_topic)
    world.users = {place: [b"%d" % next(world.gids)] for place in sorted(users)}
    return world


# A publisher turns out to be another bridge's while a message of it is sorted.
_TURNS_OUT = [
    ((0, 0), (0, 0), "/a", "/a"),
    ((0, 0), (0, 0), "/a", "/a"),
    ((0, 0), (1, 0), "/b", "/a"),
    ((1, 0), (0, 0), "/a", "/a"),
    ((1, 1), (0, 0), "/a", "/a"),
    ((2, 0), (2, 1), "/a", "/a"),
    ((0, 0), (0, 1), "/b", "/a"),
]


_TAKES_A_PLACE = [
    ((0, 0), (0, 0), "/a", "/a"), ((2, 0), (1, 1), "/a", "/a"), ((1, 1), (3, 1), "/a", "/a"),
    ((2, 1), (3, 0), "/a", "/a"), ((3, 0), (1, 0), "/a", "/a"), ((0, 0), (2, 0), "/b", "/a"),
    ((3, 0), (2, 0), "/a", "/a"),
]  # fmt: skip


@settings(max_examples=settings().max_examples * 3, deadline=None)
@given(ROUTES, USERS, st.integers(0, 2**32))
@example(_TAKES_A_PLACE, {Place(0, "/b"), Place(1, "/b"), Place(2, "/a")}, 17930)
@example(_TURNS_OUT, {Place(0, "/a"), Place(1, "/b"), Place(2, "/a")}, 793)
def test_no_message_circles_and_all_arrive(routes: list[Any], users: set[Place], seed: int) -> None:
    """Not while bridges learn of each other, nor after a route is removed, which ends refusals."""
    world = make(routes, users, seed)
    world.stir(40)
    world.settle()
    check(world)
    if world.routes:
        world.remove(world.random.choice(world.routes))
        world.stir(20)
        world.settle()
        check(world)
