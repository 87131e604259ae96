"""Topics of one side's session that operators of the other side edit, and sides that are started again."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.simulation.beds import Yard, until
from tests.simulation.conftest import bed_of

from rsb_bridge.link.client_link import ClientLink
from rsb_bridge.link.reloading import client_steps
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import AddTopic, ArmTopic, EditTopic, PauseTopics, RemoveTopic
from rsb_bridge.model.session import Topic
from rsb_bridge.route.arming import ArmingPhase, Disarmed

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from tests.simulation.engine_host import EngineHost

    from rsb_bridge.link.reloading import ReloadStep
    from rsb_bridge.route.route import Route

CHAT = Topic("/chat", "transmit", qos=5)
EDITED = 7
_WITHIN = 30.0
_SETTLED = 15.0
"""s after which nothing changes any more: a side waits up to 13 s for the other side's proposal."""


class Edits(Yard):
    """A robot and a server, one of which lists a topic, while operators of both change it.

    Args:
        lister: the side whose session lists it: `"robot"` or `"server"`.
    """

    def __init__(self, lister: str = "robot", topic: Topic = CHAT) -> None:
        super().__init__(*([topic] if lister == "robot" else []))
        self.lister = lister
        if lister == "server":
            self.list_on_server(topic)
        self.publish("/chat", "/talk")

    async def begin(self) -> None:
        await super().begin()
        await self.both(5)

    @property
    def other(self) -> str:
        return "server" if self.lister == "robot" else "robot"

    def host(self, side: str) -> EngineHost:
        return self.server if side == "server" else self.robot

    def route(self, side: str, name: str = "/chat") -> Route | None:
        return self.routes(on_server=side == "server").get(name)

    def half(self, side: str, name: str = "/chat") -> Route:
        return self.routes(on_server=side == "server")[name]

    def halves(self, name: str = "/chat") -> list[Route | None]:
        return [self.route(side, name) for side in ("robot", "server")]

    def qos(self, name: str = "/chat") -> list[Any]:
        """The QoS of a topic that both sides have accepted, on either side."""
        halves = self.halves(name)
        qos = [route.spec.parsed_qos() if route is not None and route.life.accepted else None for route in halves]
        return [None if each is None else each.depth for each in qos]

    async def both(self, depth: int | None, name: str = "/chat") -> None:
        """Wait until both sides bridge a topic with a QoS, or with None, until neither has it; then it stays so."""
        await until(lambda: self.qos(name) == [depth, depth], _WITHIN)
        await asyncio.sleep(_SETTLED)
        assert self.qos(name) == [depth, depth]
        assert depth is not None or self.route("robot", name) is self.route("server", name) is None

    def _command(self, side: str, command: Any) -> Coroutine[None, None, Any]:
        run = self.host(side).run
        assert run is not None
        return run.command(run.bridge.do(command), "anna")

    async def edit(self, side: str, name: str = "/chat", **keys: Any) -> None:
        route = self.half(side, name)
        await self._command(side, EditTopic(route.key, msgspec.structs.replace(route.spec, **keys)))

    async def remove(self, side: str, name: str = "/chat") -> None:
        await self._command(side, RemoveTopic(self.half(side, name).key))

    async def pause(self, side: str) -> None:
        await self.begin_pause(side)
        await until(lambda: all(half is not None and half.pausing.paused for half in self.halves()), 1.0)

    async def begin_pause(self, side: str) -> None:
        await self._command(side, PauseTopics(self.half(side).key, paused=True))

    async def arm(self, side: str) -> None:
        await self._command(side, ArmTopic(self.half(side).key))

    async def add(self, side: str, topic: Topic) -> None:
        await self._command(side, AddTopic(topic, self.link().name))

    async def reload(self, side: str) -> tuple[list[str], list[str]]:
        """Have a side read its file again, which is as it was at first."""
        host = self.host(side)
        assert host.run is not None
        done = await host.run.command(host.run.bridge.reload(host.session, host.keys, dry_run=False), "anna")
        assert done is not None
        return done

    async def restart(self, *sides: str) -> None:
        """Start sides again, with the sessions that they had at first."""
        with self.world.trouble("restarted", *self.world.robots):
            for side in sides:
                await self.host(side).stop()
            for side in sides:
                self.host(side).start()
            await until(lambda: all(self._linked(side) for side in ("robot", "server")), 60.0)

    def _linked(self, side: str) -> bool:
        return self.link(on_server=side == "server").linked

    def session(self, side: str) -> tuple[Topic, ...]:
        """The topics that a side would save, with their QoS."""
        return self.link(on_server=side == "server").listed_topics()


@pytest.fixture
def edits(request: pytest.FixtureRequest) -> Edits:
    return Edits(**bed_of(request))


LISTERS = pytest.mark.parametrize("lister", ["robot", "server"])


@LISTERS
async def test_an_entry_comes_back_once_the_side_that_edited_it_has_forgotten_that(lister: str, edits: Edits) -> None:
    """It has been started again, and has not saved the edit."""
    await edits.edit(edits.other, qos=EDITED)
    await edits.both(EDITED)
    assert [each.qos for each in edits.session(lister)] == [5], "saved, its file would have lost it"
    await edits.restart(edits.other)
    await edits.both(5)
    assert EventCode.ROUTE_ABANDONED in edits.codes(on_server=lister == "server")
    await edits.restart(edits.other)
    await edits.both(5)


@LISTERS
@pytest.mark.parametrize("remover", ["robot", "server"])
async def test_an_edited_topic_that_is_removed_stays_removed(lister: str, remover: str, edits: Edits) -> None:
    await edits.edit(edits.other, qos=EDITED)
    await edits.both(EDITED)
    await edits.remove(remover)
    await edits.both(None)
    await edits.restart(edits.other)
    await edits.both(None)
    assert edits.session(lister) == edits.session(edits.other) == ()


@LISTERS
async def test_an_edit_that_is_taken_back_and_forgotten(lister: str, edits: Edits) -> None:
    for depth in (EDITED, 9, 5):
        await edits.edit(edits.other, qos=depth)
        await edits.both(depth)
    await edits.restart(edits.other)
    await edits.both(5)
    assert [each.qos for each in edits.session(lister)] == [5]


@LISTERS
async def test_what_the_listing_side_edits_since_stays(lister: str, edits: Edits) -> None:
    """A limit changes the open route; another QoS makes a new one, which is the listing side's again."""
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


@LISTERS
@pytest.mark.parametrize("again", [("robot", "server"), ("lister",)], ids=["both", "that lists it"])
async def test_the_side_that_lists_it_is_started_again(lister: str, again: tuple[str, ...], edits: Edits) -> None:
    """The client's entry takes precedence; nothing else has been saved."""
    await edits.edit(edits.other, qos=EDITED)
    await edits.both(EDITED)
    await edits.restart(*(lister if each == "lister" else each for each in again))
    await edits.both(EDITED if again == ("lister",) and lister == "server" else 5)


@LISTERS
@pytest.mark.parametrize("pauser", ["robot", "server"])
async def test_a_paused_topic_comes_back_paused(lister: str, pauser: str, edits: Edits) -> None:
    """Nobody has resumed it."""
    await edits.edit(edits.other, qos=EDITED)
    await edits.both(EDITED)
    await edits.pause(pauser)
    await edits.restart(edits.other)
    await edits.both(5)
    assert [route is not None and route.pausing.paused for route in edits.halves()] == [True, True]


@pytest.mark.bed(lister="server")
@pytest.mark.parametrize("waits", [10.0, 15.0, 45.0])
async def test_a_side_that_pauses_and_stops_at_once_has_paused_it(waits: float, edits: Edits) -> None:
    """The end of its data connections may be seen before its last control message."""
    await asyncio.sleep(waits)
    await edits.begin_pause("robot")
    await edits.restart("robot")
    await edits.both(5)
    assert [route is not None and route.pausing.paused for route in edits.halves()] == [True, True]


async def test_a_topic_that_was_renamed_comes_back_under_its_name(edits: Edits) -> None:
    await edits.edit("server", topic="/talk", remote_topic=None)
    await edits.both(5, "/talk")
    await edits.both(None)
    assert [each.topic for each in edits.session("robot")] == ["/chat"]
    await edits.restart("server")
    await edits.both(5)
    await edits.both(None, "/talk")


async def test_a_topic_that_was_renamed_is_removed_by_its_new_name(edits: Edits) -> None:
    await edits.edit("server", topic="/talk", remote_topic=None)
    await edits.both(5, "/talk")
    await edits.remove("server", "/talk")
    await edits.both(None, "/talk")
    await edits.restart("server")
    await edits.both(None)
    assert edits.session("robot") == ()


def test_an_edit_that_the_client_refuses_leaves_the_clients_entry(edits: Edits) -> None:
    edits.robot.session = msgspec.structs.replace(edits.robot.session, deny=("/talk",))

    async def live() -> None:
        await edits.edit("server", topic="/talk", remote_topic=None)
        await edits.both(5)
        assert edits.half("server", "/talk").status().refusal

    edits.world.play(life=edits.live(live()))


async def test_an_entry_that_is_added_anew_meanwhile_is_listed_once(edits: Edits) -> None:
    await edits.edit("server", topic="/talk", remote_topic=None)
    await edits.both(5, "/talk")
    await edits.add("robot", msgspec.structs.replace(CHAT, qos=9))
    await edits.both(9)
    assert [(each.topic, each.qos) for each in edits.session("robot")] == [("/chat", 9)]
    await edits.restart("server")
    await edits.both(None, "/talk")
    await edits.both(9)


@pytest.mark.bed(topic=Topic("/ch*", "transmit", qos=5))
async def test_what_a_pattern_has_made_comes_back_through_it(edits: Edits) -> None:
    await edits.edit("server", qos=EDITED)
    await edits.both(EDITED)
    await edits.restart("server")
    await edits.both(5)
    assert [each.topic for each in edits.session("robot")] == ["/ch*"]


@LISTERS
@pytest.mark.parametrize("editor", ["robot", "server"])
@pytest.mark.bed(topic=msgspec.structs.replace(CHAT, arm=True))
async def test_an_armed_topic_that_is_edited_says_on_both_sides_why_it_is_not_armed(
    lister: str, editor: str, edits: Edits
) -> None:
    def why() -> list[object]:
        return [route is not None and not route.arming.held and route.arming.why for route in edits.halves()]

    await edits.arm(edits.other)
    assert all(route is not None and route.arming.phase is ArmingPhase.ARMED for route in edits.halves())
    await edits.edit(editor, qos=EDITED)
    assert edits.half(editor).arming.why is Disarmed.EDITED, "at once, as `rsb-console arm` shows it"
    await edits.both(EDITED)
    assert why() == [Disarmed.EDITED, Disarmed.EDITED]
    for side in ("robot", "server"):
        assert EventCode.ROUTE_DISARMED in edits.codes(on_server=side == "server")


@LISTERS
async def test_a_file_that_is_read_again_undoes_an_edit_of_the_other_sides_entry(lister: str, edits: Edits) -> None:
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


async def test_a_file_that_is_read_again_while_while_the_servers_edit_takes_precedence(edits: Edits) -> None:
    def steps(*topics: Topic) -> list[ReloadStep]:
        link = edits.link()
        assert isinstance(link, ClientLink)
        session = msgspec.structs.replace(edits.robot.session, topics=topics)
        return list(client_steps(link, session, link.key))

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
