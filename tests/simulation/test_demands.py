"""Names that either session demands to be armed, while operators of both sides edit entries at random.

Nobody arms anything, and no edit drops a demand by name. So no message of such a name may ever cross: the nodes at the
other end count.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from random import Random
from typing import TYPE_CHECKING
from unittest.mock import patch

import msgspec
import pytest
from tests.simulation.beds import Yard
from tests.simulation.ros import STRING, Reader, Writer, hash_of
from tests.support import replaced
from tests.support.long import long

from rsb_bridge.api import EngineError
from rsb_bridge.link.link_arming import LinkArming
from rsb_bridge.model.commands import AddTopic, EditTopic, RemoveTopic
from rsb_bridge.model.demands import NO_DEMAND, Demand, Demands, DemandSource, RunningDemands, merged
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.simulation.engine_host import Run

    from rsb_bridge.link.link import Link
    from rsb_bridge.model.session import Direction
    from rsb_bridge.route.route import Route

_HOURS = 0.05
_EVERY = 1.0
"""s between messages of each name."""
_DIRECTIONS: tuple[Direction, Direction] = ("transmit", "receive")


class Edits(Yard):
    """A robot and a server whose sessions demand some names, by name and by patterns, and bridge others freely.

    Attributes:
        crossed: messages by name on the robot, as nodes of the other domain have counted them.
    """

    def __init__(self, seed: int) -> None:
        super().__init__()
        self.world.invariants.check = lambda: None  # type: ignore[method-assign]  # they count the world's own flows
        self.random = Random(f"demands {seed}")
        self.names = [f"/{word}_{number}" for word in ("cmd", "arm", "free") for number in range(4)]
        self.demanded = {name for name in self.names if not name.startswith("/free")}
        self.crossed: Counter[str] = Counter()
        robot, server = self._demanding("cmd"), self._demanding("arm")
        if self.random.random() < 0.5:
            robot, server = server, robot
        self.robot.session = msgspec.structs.replace(self.robot.session, topics=robot)
        self.list_on_server(*server)
        self._writers = [self._ends(name) for name in self.names]

    def _demanding(self, word: str) -> tuple[Topic, ...]:
        """The entries of a side that demands the names of a word: some by their names, the others by patterns."""
        one, other = self.random.sample(_DIRECTIONS, 2)
        named = tuple(Topic(f"/{word}_{number}", self.random.choice(_DIRECTIONS), arm=True) for number in range(2))
        shadow = (Topic("/**", one),) if self.random.random() < 0.5 else ()
        return (*named, *shadow, Topic(f"/{word}*", self.random.choice((one, other)), arm=True))

    def _ends(self, name: str) -> Writer:
        """A publisher of a name on one side, and a subscription on the other."""
        there = f"/{self._name}{name}"
        robot, server = (self.robot.domain, name), (self.server.domain, there)
        (near, here), (far, at) = (robot, server) if self.random.random() < 0.5 else (server, robot)

        def count(batch: list[object]) -> None:
            self.crossed[name] += len(batch)

        Reader(far, "/counter", at, STRING, hash_of(STRING), Qos(), count)  # type: ignore[arg-type]
        return Writer(near, "/publisher", here, STRING, hash_of(STRING), Qos())

    async def edit(self) -> None:
        """Publish, and have operators of both sides edit."""
        until = self.world.loop.time() + _HOURS * 3600
        commands = 0
        while self.world.loop.time() < until:
            for writer in self._writers:
                writer.publish(b"\0\1\0\0\3\0\0\0go\0")
            await asyncio.sleep(_EVERY)
            if self.random.random() < 0.3:
                commands += await self._edit()
            wrong = {name: count for name, count in self.crossed.items() if name in self.demanded}
            assert not wrong, f"crossed unarmed: {wrong}"
        assert commands > 20
        assert any(name not in self.demanded for name in self.crossed), "what is free crosses"

    async def _edit(self) -> bool:
        on_server = self.random.random() < 0.5
        run = (self.server if on_server else self.robot).run
        assert run is not None
        link = self.link(on_server=on_server)
        edits = (
            *(self._add, self._add, self._edit_route, self._remove_route),
            *(self._edit_pattern, self._remove_pattern, self._reload),
        )
        try:
            return await self.random.choice(edits)(run, link)
        except EngineError:
            return False

    async def _add(self, run: Run, link: Link) -> bool:
        name = self.random.choice([*self.names, "/*", "/cmd*", "/arm_1*", "/free*"])
        remote = f"/{link.name}{name}" if self.random.random() < 0.3 else None
        topic = Topic(name, self.random.choice(_DIRECTIONS), remote_topic=remote)
        await run.command(run.bridge.do(AddTopic(topic, link.name)))
        return True

    async def _edit_route(self, run: Run, link: Link) -> bool:
        route = self._some(link)
        if route is None:
            return False
        spec = msgspec.structs.replace(route.spec, compression=self.random.choice((None, "zstd", "none")))
        if self.random.random() < 0.3:
            spec = msgspec.structs.replace(spec, topic=self.random.choice(self.names), remote_topic=None)
        if self.random.random() < 0.3:
            spec = msgspec.structs.replace(spec, direction=self.random.choice(_DIRECTIONS))
        if self.random.random() < 0.2:
            spec = _unarmed(spec)
        await run.command(run.bridge.do(EditTopic(route.key, spec)))
        return True

    async def _remove_route(self, run: Run, link: Link) -> bool:
        if (route := self._some(link)) is None:
            return False
        await run.command(run.bridge.do(RemoveTopic(route.key)))
        return True

    async def _edit_pattern(self, run: Run, link: Link) -> bool:
        if not (patterns := link.patterns.all()):
            return False
        pattern = self.random.choice(patterns)
        changes = self.random.choice((
            {"excepts": (self.random.choice(self.names),)}, {"direction": self.random.choice(_DIRECTIONS)},
            {"topic": f"{pattern.topic.rstrip('*')}*", "remote_topic": None},
            {"topic": "/cmd_1*", "remote_topic": None},
        ))  # fmt: skip
        edited = msgspec.structs.replace(pattern, **changes)
        await run.command(run.bridge.do(EditTopic(link.patterns.key_of(pattern), edited)))
        return True

    async def _remove_pattern(self, run: Run, link: Link) -> bool:
        if not (patterns := link.patterns.all()) or self.random.random() < 0.5:
            return False
        await run.command(run.bridge.do(RemoveTopic(link.patterns.key_of(self.random.choice(patterns)))))
        return True

    async def _reload(self, run: Run, link: Link) -> bool:
        """Read a file that lists fewer entries, and some of them without arm."""
        session = run.bridge.session

        def fewer(topics: tuple[Topic, ...]) -> tuple[Topic, ...]:
            listed = (each for each in topics if self.random.random() < 0.7)
            return tuple(self.random.choice((each, _unarmed(each))) for each in listed)

        session = msgspec.structs.replace(session, topics=fewer(session.topics), armed=())
        if session.clients is not None:
            clients = (msgspec.structs.replace(each, topics=fewer(each.topics)) for each in session.clients)
            session = session.with_clients(tuple(clients))
        await run.command(run.bridge.reload(session, run.bridge.role.keys, dry_run=False))
        return True

    def _some(self, link: Link) -> Route | None:
        routes = list(link.routes.values())
        return self.random.choice(routes) if routes else None


def _unarmed(topic: Topic) -> Topic:
    return msgspec.structs.replace(topic, arm=False, deadman=None)


@pytest.mark.parametrize("seed", [0, *long(1, 2)])
def test_what_either_session_demands_never_crosses_unarmed(seed: int) -> None:
    yard = Edits(seed)
    yard.world.play(life=yard.live(yard.edit()))


def _forgotten(self: RunningDemands) -> Demands:
    """Have a removed entry take its demand along."""
    self._lines = merged(self._host.armed_in_file)
    found: Demands = _read(self)
    return found


def _of_the_entry(self: LinkArming, route: Route) -> Demand:
    """Replace the check by its old form, which asks only the entry that made the route."""
    if not route.proposed_here or not route.spec.arm:
        return NO_DEMAND
    deadman = route.spec.deadman_seconds
    return Demand(deadman, None, (DemandSource(("", route.local_topic), route.local_topic, deadman),))


def _first(self: Demands, kind: object, name: str) -> Iterator[object]:
    """Replace the check by its old form, which asks only the first pattern that matches."""
    yield from (each for each in list(_matching(self, kind, name))[:1] if not each.is_pattern)


_matching = replaced.DEMANDS_MATCHING.value
_read = replaced.RUNNING_DEMANDS_READ.value


@pytest.mark.parametrize(
    ("owner", "name", "mistake"),
    [(RunningDemands, "read", _forgotten), (LinkArming, "_own", _of_the_entry), (Demands, "_matching", _first)],
    ids=["edits drop demands", "only the route's own entry", "patterns do not count"],
)
def test_a_mistake_is_found(owner: type, name: str, mistake: Callable[..., object]) -> None:
    yard = Edits(0)
    with patch.object(owner, name, mistake), pytest.raises(AssertionError, match="crossed unarmed"):
        yard.world.play(life=yard.live(yard.edit()))
