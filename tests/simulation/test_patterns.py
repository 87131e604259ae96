"""Patterns over hours: topics that come and go, more of them than there is room for, and links that are cut."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING
from unittest.mock import patch

import msgspec
import pytest
from tests.simulation.beds import until
from tests.simulation.ros import STRING, Writer, hash_of
from tests.support import constants, replaced

from rsb_bridge.api import EngineError
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import RemoveTopic
from rsb_bridge.model.patterns import (
    EXCEPTIONS_PER_PATTERN,
    GONE_AFTER,
    ROUTES_BY_PATTERNS,
    ROUTES_PER_PATTERN,
    Pattern,
)
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State

if TYPE_CHECKING:
    from tests.simulation.beds import Yard

    from rsb_bridge.link.graph_watch import NameWatch

_OTHER = "std_msgs/msg/Int32"
_SEEN = 5.0
"""s within which a change of a graph has made routes on both sides."""


_NO_EXCEPTION_LEFT = tuple(f"/gone/t{n}" for n in range(EXCEPTIONS_PER_PATTERN))


@pytest.mark.bed(Topic("/camera/**", "transmit"))
async def test_departed_topic_keeps_route_for_a_while(yard: Yard) -> None:
    """A node that is started again finds its route as it was; one that never comes back leaves none."""
    (writer,) = yard.publish("/camera/image")
    await until(lambda: "/camera/image" in yard.routes(on_server=True), _SEEN)
    first = yard.routes()["/camera/image"]
    for _ in range(5):
        writer.close()
        await until(lambda: yard.patterns()[0].gone == 1, _SEEN)
        await asyncio.sleep(GONE_AFTER - 2 * _SEEN)
        assert yard.routes() == {"/camera/image": first}
        (writer,) = yard.publish("/camera/image")
        await until(lambda: yard.patterns()[0].gone == 0, _SEEN)
    writer.close()
    await until(lambda: yard.patterns()[0].gone == 1, _SEEN)
    await asyncio.sleep(GONE_AFTER - _SEEN)
    assert "/camera/image" in yard.routes(on_server=True)
    await until(lambda: not yard.routes() and not yard.routes(on_server=True), 2 * _SEEN)
    assert yard.patterns()[0].state is State.WAITING
    yard.publish("/camera/image")
    await until(lambda: "/camera/image" in yard.routes(on_server=True), _SEEN)


@pytest.mark.bed(Topic("/cmd/*", "receive"))
async def test_lost_link_does_not_remove_topics(yard: Yard) -> None:
    """While the link is down, the server's topics are unknown; a topic that is missing afterwards counts as gone from
    then on.
    """
    stays, goes = yard.publish(*(f"/{yard.link().name}/cmd/{name}" for name in ("stays", "goes")), on_server=True)
    await until(lambda: yard.routes().keys() == {"/cmd/stays", "/cmd/goes"}, _SEEN)
    with yard.world.trouble("server away", *yard.world.robots):
        await yard.server.stop()
        goes.close()
        await asyncio.sleep(3 * GONE_AFTER)
        assert yard.routes().keys() == {"/cmd/stays", "/cmd/goes"}
        assert yard.patterns()[0].gone == 0
        assert yard.patterns()[0].state is State.WAITING
        yard.server.start()
    await until(lambda: yard.patterns()[0].gone == 1, 60.0)
    await asyncio.sleep(GONE_AFTER - _SEEN)
    assert "/cmd/goes" in yard.routes()
    await until(lambda: yard.routes().keys() == {"/cmd/stays"}, 2 * _SEEN)
    assert not stays.closed


@pytest.mark.long
@pytest.mark.bed(Topic("/a/*", "transmit"), Topic("/b/**", "transmit"), Topic("/c/*", "transmit"))
async def test_pattern_ends_at_its_limit_and_says_so(yard: Yard) -> None:
    writers = yard.publish(*(f"/a/t{n}" for n in range(ROUTES_PER_PATTERN + 20)))
    await until(lambda: yard.patterns()[0].beyond == 20, _SEEN)
    assert (yard.patterns()[0].routes, yard.patterns()[0].state) == (ROUTES_PER_PATTERN, State.DOWN)
    assert yard.codes().count(EventCode.LINK_PATTERN_FULL) == 1
    await until(lambda: len(yard.routes(on_server=True)) == ROUTES_PER_PATTERN, 30.0)
    bridged = [writer for writer in writers if writer.topic in yard.routes()]
    for writer in bridged[:20]:
        writer.close()  # a topic that is gone makes room at once
    await until(lambda: yard.patterns()[0].beyond == 0, _SEEN)
    assert {writer.topic for writer in bridged[:20]}.isdisjoint(yard.routes())
    assert yard.codes().count(EventCode.LINK_PATTERN_ROOM) == 1
    rest = ROUTES_BY_PATTERNS - 2 * ROUTES_PER_PATTERN
    yard.publish(*(f"/b/x/t{n}" for n in range(ROUTES_PER_PATTERN)), *(f"/c/t{n}" for n in range(rest + 1)))
    await until(lambda: yard.patterns()[2].beyond == 1, _SEEN)
    assert [each.routes for each in yard.patterns()] == [ROUTES_PER_PATTERN, ROUTES_PER_PATTERN, rest]
    assert len(yard.routes()) == ROUTES_BY_PATTERNS


@pytest.mark.bed(Topic("/cmd/*", "receive"))
def test_untold_names_are_forgotten_with_connection(yard: Yard) -> None:
    async def live() -> None:
        yard.publish(*(f"/{yard.link().name}/cmd/{name}" for name in "abc"), on_server=True)
        await until(lambda: yard.patterns()[0].beyond == 1, _SEEN)
        assert yard.patterns()[0].state is State.DOWN
        with yard.world.trouble("server away", *yard.world.robots):
            await yard.server.stop()
            await until(lambda: not yard.link().linked, 60.0)
            assert (yard.patterns()[0].beyond, yard.patterns()[0].state) == (0, State.WAITING)
            yard.server.start()
        await until(lambda: yard.patterns()[0].beyond == 1, 60.0)

    with constants.NAMES_FOLLOWED.during(2):
        yard.world.play(life=yard.live(live()))


@pytest.mark.bed(Topic("/cmd/*", "receive"))
def test_new_type_is_told_without_room_for_names(yard: Yard) -> None:
    async def live() -> None:
        name = f"/{yard.link().name}/cmd/vel"
        yard.publish(name, on_server=True)
        await until(lambda: yard.link().patterns.names.there == {("topic", name): STRING}, _SEEN)
        Writer(yard.server.domain, "/another", name, _OTHER, hash_of(_OTHER), Qos())
        await until(lambda: yard.link().patterns.names.there == {("topic", name): ""}, 2 * _SEEN)

    with constants.NAMES_FOLLOWED.during(1):
        yard.world.play(life=yard.live(live()))


@pytest.mark.bed(Topic("/a/*", "transmit", remote_topic="/x/*"))
async def test_unbridgeable_names_of_edited_pattern_are_named(yard: Yard) -> None:
    """Its name on the server would be too long: it stays as it was."""
    name = f"/a/{'t' * 150}"
    yard.publish(name)
    await until(lambda: yard.routes(on_server=True).keys() == {name}, _SEEN)
    of_pattern = yard.link().patterns
    (before,) = of_pattern.all()
    of_pattern.replace(before.identity, msgspec.structs.replace(before, remote_topic=f"/{'y' * 150}/*"))
    assert yard.patterns()[0].state is State.DOWN
    assert name in yard.patterns()[0].reason
    of_pattern.replace(before.identity, before)
    assert (yard.patterns()[0].state, yard.patterns()[0].routes) == (State.OK, 1)


@pytest.mark.bed(Topic("/a/*", "transmit", excepts=_NO_EXCEPTION_LEFT))
async def test_operators_cannot_make_session_unreadable(yard: Yard) -> None:
    """A pattern has a limited number of exceptions, for removals by both sides."""
    yard.publish("/a/one", "/a/two")
    await until(lambda: yard.routes(on_server=True).keys() == {"/a/one", "/a/two"}, _SEEN)
    own, other = yard.robot.run, yard.server.run
    assert own is not None
    assert other is not None
    with pytest.raises(EngineError):
        await own.command(own.bridge.do(RemoveTopic(yard.routes()["/a/one"].key)))
    assert "/a/one" in yard.routes()
    await other.command(other.bridge.do(RemoveTopic(yard.routes(on_server=True)["/a/two"].key)))
    await until(lambda: EventCode.LINK_PATTERN_FULL in yard.codes(), _SEEN)
    assert yard.link().patterns.all()[0].excepts == _NO_EXCEPTION_LEFT


@pytest.mark.bed(Topic("/cmd/*", "receive"))
async def test_topics_of_patterns_are_listed_while_present(yard: Yard) -> None:
    """A server may do with its client what that lists: not what a server's operator has removed."""
    yard.publish(f"/{yard.link().name}/cmd/vel", on_server=True)
    await until(lambda: "/cmd/vel" in yard.routes(on_server=True), _SEEN)
    assert yard.link().table.listed == {("topic", "/cmd/vel", "receive")}
    server = yard.server.run
    assert server is not None
    await server.command(server.bridge.do(RemoveTopic(yard.routes(on_server=True)["/cmd/vel"].key)))
    await until(lambda: not yard.routes(), _SEEN)
    assert yard.link().patterns.all()[0].excepts == ("/cmd/vel",)
    assert yard.link().table.listed == set()


@pytest.mark.long
@pytest.mark.bed(*(Topic(f"/group{n}/**/none", "transmit") for n in range(19)), Topic("/group0/*", "transmit"))
def test_many_patterns_cost_nothing_while_nothing_changes(yard: Yard) -> None:
    """500 topics and 20 patterns: a name is held against patterns once, and a graph that rests is not looked at."""
    yard.publish(*(f"/group{n % 20}/t{n}" for n in range(500)))
    matched: list[str] = []
    looks: list[float] = []
    match, look = Pattern.match, replaced.NAMES_SEARCH.value

    def note_match(self: Pattern, name: str) -> tuple[str, ...] | None:
        matched.append(name)
        return match(self, name)

    async def note_look(self: NameWatch) -> None:
        looks.append(yard.world.loop.time())
        await look(self)

    async def live() -> None:
        await until(lambda: yard.patterns()[-1].routes == 25, 30.0)
        await asyncio.sleep(60.0)
        matched.clear()
        looks.clear()
        await asyncio.sleep(600.0)
        assert len(looks) <= 2 * 600.0 / 60.0, "two engines, and each once a minute in case a change was missed"
        assert matched == []
        yard.publish("/group0/new", "/another")
        await until(lambda: yard.patterns()[-1].routes == 26, _SEEN)
        assert set(matched) == {"/group0/new", "/another"}

    with patch.object(Pattern, "match", note_match), replaced.NAMES_SEARCH.during(note_look):
        yard.world.play(life=yard.live(live()))
