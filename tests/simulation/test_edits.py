"""Topics of one side's session that operators of the other side edit, and sides that are started again."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.simulation.test_calls import until
from tests.simulation.test_patterns import Yard, lived

from rsb_bridge.link.client_link import ClientLink
from rsb_bridge.link.reloading import client_steps
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import AddTopic, ArmTopic, EditTopic, PauseTopics, RemoveTopic
from rsb_bridge.model.session import Topic
from rsb_bridge.route.arming import Disarmed

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from tests.simulation.conftest import Play
    from tests.simulation.engine_host import EngineHost

    from rsb_bridge.link.reloading import ReloadStep
    from rsb_bridge.route.route import Route

CHAT = Topic("/chat", "transmit", qos=5)
EDITED = 7
_SETTLED = 30.0
"""s after which nothing changes any more: a side waits up to 13 s for the other side's proposal."""


@dataclass
class Edits:
    """A robot and a server, one of which lists a topic, while operators of both change it.

    Attributes:
        lister: the side whose session lists it: `"robot"` or `"server"`.
    """

    yard: Yard
    lister: str = "robot"

    @property
    def other(self) -> str:
        return "server" if self.lister == "robot" else "robot"

    def host(self, side: str) -> EngineHost:
        return self.yard.server if side == "server" else self.yard.robot

    def route(self, side: str, name: str = "/chat") -> Route | None:
        return self.yard.routes(on_server=side == "server").get(name)

    def qos(self, name: str = "/chat") -> list[Any]:
        """The QoS of a topic that both sides have accepted, on either side."""
        routes = [self.route(side, name) for side in ("robot", "server")]
        qos = [route.spec.parsed_qos() if route is not None and route.accepted else None for route in routes]
        return [None if each is None else each.depth for each in qos]

    async def both(self, depth: int | None, name: str = "/chat") -> None:
        """Wait until both sides bridge a topic with a QoS, or with None, until neither has it; then it stays so."""
        await until(lambda: self.qos(name) == [depth, depth], _SETTLED)
        await asyncio.sleep(_SETTLED)
        assert self.qos(name) == [depth, depth]
        assert depth is not None or self.route("robot", name) is self.route("server", name) is None

    def _command(self, side: str, command: Any) -> Coroutine[None, None, Any]:
        run = self.host(side).run
        assert run is not None
        return run.command(run.bridge.do(command))

    async def edit(self, side: str, name: str = "/chat", **keys: Any) -> None:
        route = self.route(side, name)
        assert route is not None
        await self._command(side, EditTopic(route.key, msgspec.structs.replace(route.spec, **keys)))

    async def remove(self, side: str, name: str = "/chat") -> None:
        route = self.route(side, name)
        assert route is not None
        await self._command(side, RemoveTopic(route.key))

    async def pause(self, side: str) -> None:
        route = self.route(side)
        assert route is not None
        await self._command(side, PauseTopics(route.key, paused=True))

    async def arm(self, side: str) -> None:
        run, route = self.host(side).run, self.route(side)
        assert run is not None
        assert route is not None
        await run.command(run.bridge.do(ArmTopic(route.key)), "anna")

    async def add(self, side: str, topic: Topic) -> None:
        await self._command(side, AddTopic(topic, self.yard.link().name))

    async def reload(self, side: str) -> tuple[list[str], list[str]]:
        """Have a side read its file again, which is as it was at first."""
        host = self.host(side)
        assert host.run is not None
        done = await host.run.command(host.run.bridge.reload(host.session, host.keys, dry_run=False), "anna")
        assert done is not None
        return done

    async def restart(self, *sides: str) -> None:
        """Start sides again, with the sessions that they had at first."""
        with self.yard.world.trouble("restarted", *self.yard.world.robots):
            for side in sides:
                await self.host(side).stop()
            for side in sides:
                self.host(side).start()
            await until(lambda: all(self._linked(side) for side in ("robot", "server")), 60.0)

    def _linked(self, side: str) -> bool:
        return self.yard.link(on_server=side == "server").linked

    def session(self, side: str) -> tuple[Topic, ...]:
        """The topics that a side would save, with their QoS."""
        return self.yard.link(on_server=side == "server").listed_topics()

    def codes(self, side: str) -> list[str]:
        run = self.host(side).run
        assert run is not None
        return [event.code for event in run.events.after(0)]


def made(lister: str = "robot", topic: Topic = CHAT) -> Edits:
    """A robot and a server whose session, or the robot's, lists a topic."""
    yard = Yard(topic) if lister == "robot" else Yard()
    if lister == "server":
        clients = tuple(
            msgspec.structs.replace(each, topics=(topic,) if each.name == yard.robot.session.name else ())
            for each in yard.server.session.accepted_clients
        )
        yard.server.session = msgspec.structs.replace(yard.server.session, clients=clients)
    yard.publish("/chat", "/talk")
    return Edits(yard, lister)


def played(play: Play, edits: Edits, life: Callable[[], Coroutine[None, None, None]]) -> None:
    async def live() -> None:
        await edits.both(5)
        await life()

    lived(play, edits.yard, live(), 1200.0)


LISTERS = pytest.mark.parametrize("lister", ["robot", "server"])


@LISTERS
def test_an_entry_comes_back_once_the_side_that_edited_it_has_forgotten_that(lister: str, play: Play) -> None:
    """It has been started again, and has not saved the edit."""
    edits = made(lister)

    async def live() -> None:
        await edits.edit(edits.other, qos=EDITED)
        await edits.both(EDITED)
        await edits.restart(edits.other)
        await edits.both(5)
        assert EventCode.ROUTE_ABANDONED in edits.codes(lister)
        await edits.restart(edits.other)
        await edits.both(5)

    played(play, edits, live)


@LISTERS
def test_an_edited_entry_stays_in_the_session_that_lists_it(lister: str, play: Play) -> None:
    """Saved, its file would have lost it."""
    edits = made(lister)

    async def live() -> None:
        await edits.edit(edits.other, qos=EDITED)
        await edits.both(EDITED)
        assert [each.qos for each in edits.session(lister)] == [5]

    played(play, edits, live)


@LISTERS
@pytest.mark.parametrize("remover", ["robot", "server"])
def test_an_edited_topic_that_is_removed_stays_removed(lister: str, remover: str, play: Play) -> None:
    edits = made(lister)

    async def live() -> None:
        await edits.edit(edits.other, qos=EDITED)
        await edits.both(EDITED)
        await edits.remove(remover)
        await edits.both(None)
        await edits.restart(edits.other)
        await edits.both(None)
        assert edits.session(lister) == edits.session(edits.other) == ()

    played(play, edits, live)


@LISTERS
def test_an_edit_that_is_taken_back_and_forgotten(lister: str, play: Play) -> None:
    edits = made(lister)

    async def live() -> None:
        for depth in (EDITED, 9, 5):
            await edits.edit(edits.other, qos=depth)
            await edits.both(depth)
        await edits.restart(edits.other)
        await edits.both(5)
        assert [each.qos for each in edits.session(lister)] == [5]

    played(play, edits, live)


@LISTERS
def test_what_the_listing_side_edits_since_stays(lister: str, play: Play) -> None:
    """A limit changes the open route; another QoS makes a new one, which is the listing side's again."""
    edits = made(lister)

    async def live() -> None:
        await edits.edit(edits.other, qos=EDITED)
        await edits.both(EDITED)
        await edits.edit(lister, max_rate=2.0)
        await edits.restart(edits.other)
        await edits.both(5)
        assert [each.max_rate for each in edits.session(lister)] == [2.0]
        await edits.edit(edits.other, qos=EDITED)
        await edits.both(EDITED)
        await edits.edit(lister, qos=9)
        await edits.both(9)
        await edits.restart(edits.other)
        await edits.both(9)
        assert [each.qos for each in edits.session(lister)] == [9]

    played(play, edits, live)


@LISTERS
@pytest.mark.parametrize("again", [("robot", "server"), ("lister",)], ids=["both", "that lists it"])
def test_the_side_that_lists_it_is_started_again(lister: str, again: tuple[str, ...], play: Play) -> None:
    """The client's entry takes precedence, whoever lists it; nothing else has been saved."""
    edits = made(lister)

    async def live() -> None:
        await edits.edit(edits.other, qos=EDITED)
        await edits.both(EDITED)
        await edits.restart(*(lister if each == "lister" else each for each in again))
        await edits.both(EDITED if again == ("lister",) and lister == "server" else 5)

    played(play, edits, live)


@LISTERS
@pytest.mark.parametrize("pauser", ["robot", "server"])
def test_a_paused_topic_comes_back_paused(lister: str, pauser: str, play: Play) -> None:
    """Nobody has resumed it."""
    edits = made(lister)

    async def live() -> None:
        await edits.edit(edits.other, qos=EDITED)
        await edits.both(EDITED)
        await edits.pause(pauser)
        await edits.restart(edits.other)
        await edits.both(5)
        routes = [edits.route(side) for side in ("robot", "server")]
        assert [route is not None and route.paused for route in routes] == [True, True]

    played(play, edits, live)


def test_a_topic_that_was_renamed_comes_back_under_its_name(play: Play) -> None:
    edits = made()

    async def live() -> None:
        await edits.edit("server", topic="/talk", remote_topic=None)
        await edits.both(5, "/talk")
        await edits.both(None)
        assert [each.topic for each in edits.session("robot")] == ["/chat"]
        await edits.restart("server")
        await edits.both(5)
        await edits.both(None, "/talk")

    played(play, edits, live)


def test_a_topic_that_was_renamed_is_removed_by_its_new_name(play: Play) -> None:
    edits = made()

    async def live() -> None:
        await edits.edit("server", topic="/talk", remote_topic=None)
        await edits.both(5, "/talk")
        await edits.remove("server", "/talk")
        await edits.both(None, "/talk")
        await edits.restart("server")
        await edits.both(None)
        assert edits.session("robot") == ()

    played(play, edits, live)


def test_an_edit_that_the_client_refuses_leaves_the_clients_entry(play: Play) -> None:
    edits = made()
    edits.yard.robot.session = msgspec.structs.replace(edits.yard.robot.session, deny=("/talk",))

    async def live() -> None:
        await edits.edit("server", topic="/talk", remote_topic=None)
        await edits.both(5)
        there = edits.route("server", "/talk")
        assert there is not None
        assert there.shown_refusal

    played(play, edits, live)


def test_an_entry_that_is_added_anew_meanwhile_is_listed_once(play: Play) -> None:
    edits = made()

    async def live() -> None:
        await edits.edit("server", topic="/talk", remote_topic=None)
        await edits.both(5, "/talk")
        await edits.add("robot", msgspec.structs.replace(CHAT, qos=9))
        await edits.both(9)
        assert [(each.topic, each.qos) for each in edits.session("robot")] == [("/chat", 9)]
        await edits.restart("server")
        await edits.both(None, "/talk")
        await edits.both(9)

    played(play, edits, live)


def test_what_a_pattern_has_made_comes_back_through_it(play: Play) -> None:
    edits = made(topic=Topic("/ch*", "transmit", qos=5))

    async def live() -> None:
        await edits.edit("server", qos=EDITED)
        await edits.both(EDITED)
        await edits.restart("server")
        await edits.both(5)
        assert [each.topic for each in edits.session("robot")] == ["/ch*"]

    played(play, edits, live)


@LISTERS
@pytest.mark.parametrize("editor", ["robot", "server"])
def test_an_armed_topic_that_is_edited_says_on_both_sides_why_it_is_not_armed(
    lister: str, editor: str, play: Play
) -> None:
    edits = made(lister, msgspec.structs.replace(CHAT, arm=True))

    def why() -> list[object]:
        routes = [edits.route(side) for side in ("robot", "server")]
        return [route is not None and not route.arming.held and route.arming.why for route in routes]

    async def live() -> None:
        await edits.arm(edits.other)
        assert all(route is not None and route.arming.armed for route in map(edits.route, ("robot", "server")))
        await edits.edit(editor, qos=EDITED)
        route = edits.route(editor)
        assert route is not None
        assert route.arming.why is Disarmed.EDITED, "at once, as `rsb-console arm` shows it"
        await edits.both(EDITED)
        assert why() == [Disarmed.EDITED, Disarmed.EDITED]
        for side in ("robot", "server"):
            assert EventCode.ROUTE_DISARMED in edits.codes(side)

    played(play, edits, live)


@LISTERS
def test_a_file_that_is_read_again_undoes_an_edit_of_the_other_sides_entry(lister: str, play: Play) -> None:
    edits = made(lister)

    async def live() -> None:
        for depth in (EDITED, 9):
            await edits.edit(edits.other, qos=depth)
            await edits.both(depth)
        (step,), failed = await edits.reload(edits.other)
        assert step.endswith("the edit is undone; the other side's own entry applies again")
        assert failed == []
        await edits.both(5)
        assert edits.session(edits.other) == ()
        assert [each.qos for each in edits.session(lister)] == [5]
        assert await edits.reload(edits.other) == ([], [])

    played(play, edits, live)


def test_a_file_that_is_read_again_while_while_the_servers_edit_takes_precedence(play: Play) -> None:
    edits = made()

    def steps(*topics: Topic) -> list[ReloadStep]:
        link = edits.yard.link()
        assert isinstance(link, ClientLink)
        session = msgspec.structs.replace(edits.yard.robot.session, topics=topics)
        return list(client_steps(link, session, link.key))

    async def live() -> None:
        await edits.edit("server", qos=EDITED)
        await edits.both(EDITED)
        assert steps(CHAT) == []
        (step,) = steps(msgspec.structs.replace(CHAT, qos=9))
        assert step.text.endswith("an edit on the server takes precedence")
        step.apply()
        assert [each.qos for each in edits.session("robot")] == [9]
        await edits.both(EDITED)
        (step,) = steps()
        step.apply()
        assert edits.session("robot") == ()
        assert steps() == []
        await edits.restart("server")
        await edits.both(None)

    played(play, edits, live)
