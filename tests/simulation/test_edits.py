"""Topics of one side's session that operators of the other side edit, and sides that are started again."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.simulation.beds import Yard, until
from tests.simulation.conftest import bed_of

from rsb_bridge.api import EngineError
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import AddTopic, ArmTopic, EditTopic, PauseTopics, RemoveTopic
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.arming import ArmingPhase, Disarmed

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from tests.simulation.engine_host import EngineHost

    from rsb_bridge.model.session import Direction
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

    def depths(self, side: str) -> list[object]:
        """The depths of the QoS in a side's session."""
        return [qos and qos.depth for qos in (each.parsed_qos() for each in self.session(side))]

    def session(self, side: str) -> tuple[Topic, ...]:
        """The topics that a side would save, with their QoS."""
        return self.link(on_server=side == "server").entries.all()


@pytest.fixture
def edits(request: pytest.FixtureRequest) -> Edits:
    return Edits(**bed_of(request))


LISTERS = pytest.mark.parametrize("lister", ["robot", "server"])


@LISTERS
async def test_edit_from_peer_changes_listed_entry(lister: str, edits: Edits) -> None:
    for depth in (EDITED, 9):
        await edits.edit(edits.other, qos=depth)
        await edits.both(depth)
        assert edits.depths(lister) == [depth]
        assert edits.session(edits.other) == ()
    assert EventCode.OPERATOR_EDITED in edits.codes(on_server=lister == "server")


@LISTERS
@pytest.mark.parametrize("again", ["lister", "other"])
async def test_edit_lasts_as_long_as_listing_bridge(lister: str, again: str, edits: Edits) -> None:
    """Nobody has saved it there."""
    await edits.edit(edits.other, qos=EDITED)
    await edits.both(EDITED)
    await edits.restart(lister if again == "lister" else edits.other)
    await edits.both(5 if again == "lister" else EDITED)


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
async def test_both_sides_edit_one_entry(lister: str, edits: Edits) -> None:
    """A limit changes the open route; another QoS makes a new one."""
    await edits.edit(edits.other, qos=EDITED)
    await edits.both(EDITED)
    await edits.edit(lister, max_rate=2.0)
    await edits.edit(edits.other, qos=9)
    await edits.both(9)
    await edits.edit(lister, qos=EDITED)
    await edits.both(EDITED)
    assert [(each.qos, each.max_rate) for each in edits.session(lister)] == [(EDITED, 2.0)]


@LISTERS
async def test_an_edit_of_limits_and_qos_is_one(lister: str, edits: Edits) -> None:
    await edits.edit(edits.other, qos=EDITED, max_rate=2.0, max_age=3.0)
    await edits.both(EDITED)
    assert [(each.max_rate, each.max_age) for each in edits.session(lister)] == [(2.0, 3.0)]
    assert [half.spec.max_rate for half in edits.halves() if half is not None] == [2.0, 2.0]


@LISTERS
async def test_an_edit_pauses_and_resumes(lister: str, edits: Edits) -> None:
    for keys in ({"paused": True}, {"paused": False}, {"paused": True, "qos": EDITED}, {"paused": False, "qos": 9}):
        await edits.edit(edits.other, **keys)
        await edits.both(keys.get("qos", 5))
        assert [half is not None and half.pausing.paused for half in edits.halves()] == [keys["paused"]] * 2


@LISTERS
async def test_an_edit_without_the_link_changes_nothing(lister: str, edits: Edits) -> None:
    with edits.world.trouble("stopped", *edits.world.robots):
        await edits.host(lister).stop()
        await until(lambda: not edits.link(on_server=edits.other == "server").linked, 60.0)
        with pytest.raises(EngineError):
            await edits.edit(edits.other, qos=EDITED)
        edits.host(lister).start()
        await until(lambda: all(edits.link(on_server=each).linked for each in (True, False)), 60.0)
    await edits.both(5)


@LISTERS
@pytest.mark.parametrize("pauser", ["robot", "server"])
async def test_an_edited_topic_stays_paused(lister: str, pauser: str, edits: Edits) -> None:
    """Nobody has resumed it."""
    await edits.edit(edits.other, qos=EDITED)
    await edits.both(EDITED)
    await edits.pause(pauser)
    await edits.restart(edits.other)
    await edits.both(EDITED)
    assert [route is not None and route.pausing.paused for route in edits.halves()] == [True, True]


@pytest.mark.bed(lister="server")
@pytest.mark.parametrize("waits", [10.0, 15.0, 45.0])
async def test_pause_holds_though_its_side_stops(waits: float, edits: Edits) -> None:
    """The end of its data connections may be seen before its last control message."""
    await asyncio.sleep(waits)
    await edits.begin_pause("robot")
    await edits.restart("robot")
    await edits.both(5)
    assert [route is not None and route.pausing.paused for route in edits.halves()] == [True, True]


@LISTERS
async def test_a_topic_is_renamed_from_the_other_side(lister: str, edits: Edits) -> None:
    await edits.edit(edits.other, topic="/talk", remote_topic=None)
    await edits.both(5, "/talk")
    await edits.both(None)
    assert [(each.topic, each.remote_topic) for each in edits.session(lister)] == [("/talk", None)]
    await edits.restart(edits.other)
    await edits.both(5, "/talk")
    await edits.remove(edits.other, "/talk")
    await edits.both(None, "/talk")
    assert edits.session(lister) == ()


@LISTERS
@pytest.mark.bed(topic=msgspec.structs.replace(CHAT, arm=True))
async def test_peer_renames_nothing_to_be_armed(lister: str, edits: Edits) -> None:
    """The demand on each name would stay, so that a peer could make them grow."""
    with pytest.raises(EngineError):
        await edits.edit(edits.other, topic="/talk", remote_topic=None)
    await edits.both(5)
    assert [each.topic for each in edits.session(lister)] == ["/chat"]


@pytest.mark.bed(lister="server")
async def test_client_opens_no_port_of_server_by_edit(edits: Edits) -> None:
    with pytest.raises(EngineError):
        await edits.edit("robot", port=9_999)
    await edits.both(5)


@LISTERS
async def test_demand_of_edit_is_its_sides(lister: str, edits: Edits) -> None:
    await edits.edit(edits.other, arm=True, deadman=30.0, qos=EDITED)
    await edits.both(EDITED)
    assert [half is not None and half.arming.required for half in edits.halves()] == [True, True]
    assert [each.arm for each in edits.session(lister)] == [False]
    await edits.restart(lister)
    await edits.both(5)
    assert [half is not None and half.arming.required for half in edits.halves()] == [True, True]


@pytest.mark.bed(topic=msgspec.structs.replace(CHAT, direction="receive"))
@pytest.mark.parametrize("rights", [{"allow": ()}, {"deny": ("/talk",)}], ids=["not allowed", "denied"])
def test_edit_gives_server_no_forbidden_name(rights: dict[str, Any], edits: Edits) -> None:
    """A server publishes on a client only what the client's operators have listed or allowed."""
    edits.robot.session = msgspec.structs.replace(edits.robot.session, **rights)

    async def live() -> None:
        with pytest.raises(EngineError):
            await edits.edit("server", topic="/talk", remote_topic=None)
        await edits.both(5)
        assert [each.topic for each in edits.session("robot")] == ["/chat"]
        await edits.edit("server", qos=EDITED)
        await edits.both(EDITED)

    edits.world.play(life=edits.live(live()))


@pytest.mark.bed(topic=Topic("/ch*", "transmit", qos=5))
async def test_edit_of_patterns_topic_lists_it(edits: Edits) -> None:
    await edits.edit("server", qos=EDITED)
    await edits.both(EDITED)
    await edits.restart("server")
    await edits.both(EDITED)
    assert [each.topic for each in edits.session("robot")] == ["/chat", "/ch*"]


@LISTERS
@pytest.mark.bed(topic=msgspec.structs.replace(CHAT, arm=True, max_age=0.5))
@pytest.mark.parametrize("max_age", [0.0, None, 2.0])
async def test_peer_raises_no_age_of_what_is_armed(lister: str, max_age: float | None, edits: Edits) -> None:
    with pytest.raises(EngineError):
        await edits.edit(edits.other, max_age=max_age)
    assert [each.max_age for each in edits.session(lister)] == [0.5]
    assert [half.age.max_age for half in edits.halves() if half is not None] == [0.5, 0.5]
    await edits.edit(edits.other, max_age=0.25)
    assert [each.max_age for each in edits.session(lister)] == [0.25]


@LISTERS
@pytest.mark.parametrize("editor", ["robot", "server"])
@pytest.mark.bed(topic=msgspec.structs.replace(CHAT, arm=True))
async def test_edited_armed_topic_explains_disarming_on_both_sides(lister: str, editor: str, edits: Edits) -> None:
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
async def test_reload_undoes_edit_of_other_side(lister: str, edits: Edits) -> None:
    await edits.edit(edits.other, qos=EDITED)
    await edits.both(EDITED)
    assert await edits.reload(edits.other) == ([], []), "its session does not list it"
    (_,), failed = await edits.reload(lister)
    assert failed == []
    await edits.both(5)


class Both(Edits):
    """A robot and a server that both list a topic.

    Args:
        on_server: the server's entry, or None for the robot's, with what is `changed`.
        direction: of both.
    """

    def __init__(
        self,
        on_robot: Topic = CHAT,
        on_server: Topic | None = None,
        changed: dict[str, Any] | None = None,
        direction: Direction = "transmit",
    ) -> None:
        on_robot = msgspec.structs.replace(on_robot, direction=direction)
        super().__init__("robot", on_robot)
        self.list_on_server(on_server or msgspec.structs.replace(on_robot, **(changed or {})))

    async def begin(self) -> None:
        await Yard.begin(self)

    def verdicts(self) -> list[tuple[str, str]]:
        halves = [half.snapshot() for half in self.halves() if half is not None]
        return [(half.state, half.cause) for half in halves]

    async def apart(self) -> None:
        """Wait until nothing crosses since the two entries differ; then it stays so."""
        for wait in (0.0, 20.0):
            await asyncio.sleep(wait)
            await until(lambda: self.verdicts() == [(State.DOWN, Cause.LISTED_DIFFERENTLY)] * 2, _WITHIN)

    def reported(self) -> list[int]:
        return [self.codes(on_server=each).count(EventCode.ROUTE_LISTED_DIFFERENTLY) for each in (False, True)]


@pytest.fixture
def two(request: pytest.FixtureRequest) -> Both:
    return Both(**bed_of(request))


BOTH = ("robot", "server")
DIRECTIONS = pytest.mark.parametrize("direction", ["transmit", "receive"])
"""The server has another name for the topic, and so of what it sends, another key than the client."""


@DIRECTIONS
async def test_one_entry_on_both_sides_is_one_route(direction: Direction, two: Both) -> None:
    await two.both(5)
    assert [[each.topic for each in two.session(side)] for side in BOTH] == [["/chat"], ["/chat"]]
    assert two.reported() == [0, 0]
    for side in BOTH:
        assert await two.reload(side) == ([], [])


def test_what_the_server_lists_itself_needs_no_right(two: Both) -> None:
    """Its other entries need none, either."""
    clients = tuple(msgspec.structs.replace(each, deny=("/*",)) for each in two.server.session.accepted_clients)
    two.server.session = msgspec.structs.replace(two.server.session, clients=clients)
    two.world.play(life=two.live(two.both(5)))


@pytest.mark.parametrize("side", BOTH)
async def test_one_entry_on_both_sides_outlives_either(side: str, two: Both) -> None:
    await two.both(5)
    for _ in range(2):
        await two.restart(side)
        await two.both(5)
    assert [[each.topic for each in two.session(side)] for side in BOTH] == [["/chat"], ["/chat"]]


@pytest.mark.bed(changed={"arm": True, "max_age": 3.0})
async def test_demands_make_no_other_entry(two: Both) -> None:
    """Either side's demand holds."""
    await two.both(5)
    assert [half is not None and half.arming.required for half in two.halves()] == [True, True]
    assert [[each.arm for each in two.session(side)] for side in BOTH] == [[False], [True]]


@pytest.mark.parametrize("editor", BOTH)
async def test_an_edit_changes_both_entries(editor: str, two: Both) -> None:
    await two.both(5)
    for depth, rate in ((EDITED, None), (EDITED, 2.0), (9, None)):
        await two.edit(editor, qos=depth, max_rate=rate)
        await two.both(depth)
    assert [two.depths(side) for side in BOTH] == [[9], [9]]
    assert [half.spec.max_rate for half in two.halves() if half is not None] == [None, None]
    await two.restart("robot", "server")
    await two.both(5)


@pytest.mark.parametrize("remover", BOTH)
async def test_what_both_list_is_removed_on_both(remover: str, two: Both) -> None:
    await two.both(5)
    await two.remove(remover)
    await two.both(None)
    assert two.session("robot") == two.session("server") == ()


@DIRECTIONS
@pytest.mark.bed(changed={"qos": EDITED, "max_rate": 5.0})
@pytest.mark.parametrize("mender", BOTH)
async def test_two_different_entries_are_refused_on_both_sides(direction: Direction, mender: str, two: Both) -> None:
    await two.apart()
    assert two.reported() == [1, 1]
    for side in BOTH:
        reason = two.half(side).snapshot().reason
        assert "depth: 5" in reason
        assert "depth: 7" in reason
        assert "max_rate 5" in reason
    other = "server" if mender == "robot" else "robot"
    wanted = two.half(other).spec
    await two.edit(mender, qos=wanted.qos, max_rate=wanted.max_rate)
    await two.both(5 if other == "robot" else EDITED)


@pytest.mark.bed(changed={"max_rate": 5.0})
@pytest.mark.parametrize("remover", BOTH)
async def test_of_two_entries_one_is_removed(remover: str, two: Both) -> None:
    await two.apart()
    await two.remove(remover)
    await two.both(5)
    assert [half is not None and half.spec.max_rate for half in two.halves()] == [
        5.0 if remover == "robot" else None
    ] * 2


@pytest.mark.bed(on_server=Topic("/ch*", "transmit", qos=EDITED))
async def test_entry_goes_before_pattern_of_other_side(two: Both) -> None:
    await two.both(5)
    assert two.reported() == [0, 0]


@pytest.mark.bed(on_robot=Topic("/ch*", "transmit", qos=EDITED), on_server=CHAT)
async def test_servers_entry_goes_before_pattern_of_client(two: Both) -> None:
    await two.both(5)
    assert two.reported() == [0, 0]
    await two.restart("robot")
    await two.both(5)


@pytest.mark.bed(on_robot=Topic("/ch*", "transmit", qos=5), on_server=Topic("/c*", "transmit", qos=EDITED))
async def test_of_two_patterns_the_clients_counts(two: Both) -> None:
    await two.both(5)
    assert two.reported() == [0, 0]


@LISTERS
@pytest.mark.parametrize("same", [True, False])
async def test_entry_is_added_that_other_side_lists(lister: str, same: bool, edits: Edits) -> None:
    if same:
        await edits.add(edits.other, CHAT)
    else:
        with pytest.raises(EngineError):
            await edits.add(edits.other, msgspec.structs.replace(CHAT, max_rate=2.0))
    await edits.both(5)
    assert [each.topic for each in edits.session(edits.other)] == (["/chat"] if same else [])
    await edits.restart(lister)
    await edits.both(5)
