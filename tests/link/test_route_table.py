"""The route tables of both sides agree in the end, for all orders of crossing messages."""

from __future__ import annotations

import asyncio
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING, Any, cast

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.support import constants
from tests.support.offline import FakePeer, proposal_for

from rsb_bridge.config.rights import Rights
from rsb_bridge.link.base_link import LinkStatus
from rsb_bridge.link.extension import LinkError
from rsb_bridge.link.proposed_routes import ProposedTopics
from rsb_bridge.link.route_ids import RouteIds
from rsb_bridge.link.route_table import RouteTable
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.demands import sources_of_entries
from rsb_bridge.model.purposes import purposes
from rsb_bridge.model.reason import EndCode, Reason
from rsb_bridge.model.session import Topic
from rsb_bridge.route.route import Entry
from rsb_bridge.wire.messages import Close

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.link import Link
    from rsb_bridge.model.demands import DemandSource
    from rsb_bridge.model.snapshot import Level
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import Propose, UrgentMessage

TOPIC = Topic("/chat", "transmit")


class Side(FakePeer):
    """One side of a link: its table, and the messages in flight to it."""

    linked_at = 0.0
    connections = 1
    rights = Rights("the peer", "this side", "", allow=(), deny=())
    prefixed = use_name = False

    def __init__(self, context: Context, *, is_client: bool) -> None:
        super().__init__()
        self.is_client = is_client
        self.end = self
        self.context = context
        self.inbox: deque[Any] = deque()
        self.demands_counted = 0
        self.other: Side
        self.routes: dict[str, Route] = {}
        self.ids = RouteIds(is_client=is_client)
        self.status = LinkStatus(0.0, reason="cut")
        self.table = RouteTable(cast("BaseLink", self))
        self.proposed = ProposedTopics(cast("Link", self), self.table)
        self.handlers = {**self.table.messages, **self.proposed.messages}
        context.demands.register(self)

    # --- arming, as a link does it

    def demand_sources(self) -> Iterator[DemandSource]:
        self.demands_counted += 1
        topics = self.proposed.all()
        return sources_of_entries(topics, "robot1", on_server=not self.is_client, use_name=False)

    def apply_demands(self) -> None:
        self.table.apply_demands()

    def demand_dropped(self, source: DemandSource) -> None:
        self.table.arming.demand_dropped(source)

    # --- what an operator does, and what happens to a route

    def add(self, topic: Topic = TOPIC) -> None:
        with suppress(LinkError):  # it is there
            self.proposed.add(topic)

    def edit(self) -> None:
        for route in tuple(self.routes.values()):
            self.change(route, qos=7 if self.is_client else 9)

    def rename(self) -> None:
        for route in tuple(self.routes.values()):
            self.change(route, topic="/talk" if route.spec.topic == TOPIC.topic else TOPIC.topic, remote_topic=None)

    def change(self, route: Route, **keys: Any) -> None:
        topic = msgspec.structs.replace(route.spec, **keys)
        with suppress(LinkError):  # the new name is bridged
            self.proposed.check_replace(route, topic)
            if route.proposed_here:
                self.proposed.replace(route, topic)
                return
            question = self.proposed.question(route, self.proposed.demand(route, topic))
            if question is not None and question.route:
                self.send(question)

    def remove(self) -> None:
        for route in tuple(self.routes.values()):
            self.table.remove(route, "by an operator")

    def pause(self, paused: bool) -> None:
        for route in self.routes.values():
            self.table.pause(route, paused=paused)

    def limit(self, rate: float | None) -> None:
        for route in self.routes.values():
            self.change(route, max_rate=rate)

    def lose(self) -> None:
        for route in self.routes.values():
            route.channel_lost(Reason("cut", EndCode.BROKE))

    def hear(self) -> None:
        if self.inbox:
            message = self.inbox.popleft()
            self.handlers[type(message)](message)

    @property
    def state(self) -> dict[str, tuple[object, ...]]:
        return {
            key: (
                route.pausing.paused,
                route.spec.max_rate,
                route.proposal.max_rate,
                route.proposal.qos,
                route.life.accepted,
            )
            for key, route in self.routes.items()
        }

    @property
    def apart(self) -> set[str]:
        """The topics that both sides list, with values that differ."""
        return {key for key, route in self.routes.items() if self.refusal_of(route).code is EndCode.LISTED_DIFFERENTLY}

    def refusal_of(self, route: Route) -> Reason:
        open_for = self.context.now() - route.opened_at if route.id else 0.0
        return route.reopening.shown_refusal(route.life, open_for)

    @property
    def listed(self) -> list[str]:
        """The names of the topics in its session."""
        return sorted(topic.topic for topic in self.proposed.all())

    # --- as the table's link

    def send(self, message: Any) -> None:
        self.other.inbox.append(message)

    def send_urgent(self, message: UrgentMessage) -> None:
        """Both ways bring it."""
        self.send(message)
        self.send(message)

    def closed(self, route_id: int) -> None:
        self.ids.closed(route_id)

    def derive_keys(self, route_id: int, *, proposed_here: bool) -> None:
        pass

    def refusal(self, topic: str) -> str:
        return ""

    def with_local_name(self, proposal: Propose) -> Propose:
        return proposal

    async def prepare_port(self, route: Route) -> None:
        return

    def spawn(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        before = asyncio._get_running_loop()
        asyncio._set_running_loop(self.context.loop)
        try:
            with pytest.raises(StopIteration):  # nothing in it waits
                work.send(None)
        finally:
            asyncio._set_running_loop(before)
        return None  # type: ignore[return-value]

    def guarded(self, work: Callable[[], None]) -> None:
        work()

    def protocol_error(self, reason: str) -> None:
        raise AssertionError(reason)

    def log(self, level: Level, code: EventCode, text: str, *, topic: str = "") -> None:
        pass


Pair = tuple["Side", "Side"]


def pair_of(client_context: Context, server_context: Context) -> Pair:
    client, server = Side(client_context, is_client=True), Side(server_context, is_client=False)
    client.other, server.other = server, client
    return client, server


@pytest.fixture
def make_pair(make_context: Callable[..., Context]) -> Callable[[], Pair]:
    return lambda: pair_of(make_context(), make_context(role="server"))


def settle(pair: Pair, loop: VirtualLoop) -> None:
    """Let all messages in flight arrive, and half a minute pass."""
    for _ in range(30):
        let_time_pass(pair, loop, 1.0)
    hear_all(pair)


def let_time_pass(pair: Pair, loop: VirtualLoop, seconds: float) -> None:
    """Let all messages in flight arrive, then time pass and the tables tick."""
    hear_all(pair)
    loop.jump(seconds)
    for side in pair:
        side.table.tick()


def hear_all(pair: Pair) -> None:
    while any(side.inbox for side in pair):
        for side in pair:
            side.hear()


OPERATIONS = (
    "add", "remove", "edit", "rename", "pause", "resume", "limit", "unlimit", "lose", "hear",
)  # fmt: skip
_ANY_MACHINE = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
steps = st.lists(st.tuples(st.booleans(), st.sampled_from(OPERATIONS)), max_size=25)


@given(steps, st.sampled_from(["client", "server", "nobody"]), st.booleans())
@settings(max_examples=settings().max_examples * 3, deadline=None, suppress_health_check=_ANY_MACHINE)
def test_both_sides_reach_same_routes_and_states(
    make_pair: Callable[[], Pair], loop: VirtualLoop, taken: list[tuple[bool, str]], adds: str, linked_first: bool
) -> None:
    client, server = pair = make_pair()
    if adds != "nobody":
        (client if adds == "client" else server).add()
    if linked_first:
        settle(pair, loop)
    for at_client, operation in taken:
        side = client if at_client else server
        match operation:
            case "pause" | "resume":
                side.pause(operation == "pause")
            case "limit":
                side.limit(2.0 if at_client else 3.0)
            case "unlimit":
                side.limit(None)
            case _:
                getattr(side, operation)()
    settle(pair, loop)
    apart = client.apart
    assert apart == server.apart
    assert client.state.keys() == server.state.keys()
    assert all(client.state[key] == server.state[key] for key in client.state.keys() - apart)
    for side in pair:
        assert len(set(side.listed)) == len(side.listed), "a file with an entry twice cannot be read"


@pytest.mark.parametrize("proposer", ["client", "server"])
@pytest.mark.parametrize("remover", ["client", "server"])
@pytest.mark.parametrize("loser", ["client", "server"])
@pytest.mark.parametrize("heard", range(6))
def test_route_removed_during_outage_stays_removed(
    proposer: str, remover: str, loser: str, heard: int, make_pair: Callable[[], Pair], loop: VirtualLoop
) -> None:
    """However much of it each side hears before the other's next step."""
    pair = make_pair()
    sides = {"client": pair[0], "server": pair[1]}
    sides[proposer].add()
    settle(pair, loop)
    sides[loser].lose()
    for number in range(heard):
        pair[number % 2].hear()
    if heard % 2:
        loop.jump(1.5)
        sides[proposer].table.tick()
    sides[remover].remove()
    settle(pair, loop)
    assert pair[0].state == pair[1].state == {}


def remembered(ids: RouteIds) -> list[int]:
    """Return the ids of closed openings whose route is still known."""
    return [each for each in range(1, 1000) if ids.find(each) and not ids.open_route(each)]


def test_ids_of_closed_incarnations_are_remembered_within_bounds(
    make_pair: Callable[[], Pair], loop: VirtualLoop
) -> None:
    client, server = pair = make_pair()
    client.add()
    for _ in range(100):
        server.lose()
        settle_shortly(pair, loop)
    assert len(remembered(client.ids)) == len(remembered(server.ids)) == 4
    client.remove()
    settle_shortly(pair, loop)
    assert remembered(client.ids) == remembered(server.ids) == []


def test_other_sides_actions_are_recorded_within_bounds(make_pair: Callable[[], Pair], loop: VirtualLoop) -> None:
    client, server = pair = make_pair()
    client.add()
    settle(pair, loop)

    def recorded() -> int:
        return sum(event.source == "operator" for event in server.context.events.after(0))

    for number in range(100):
        client.pause(number % 2 == 0)
        hear_all(pair)
    assert recorded() == 20
    loop.jump(3600.0)
    for number in range(100):
        client.pause(number % 2 == 0)
        hear_all(pair)
    assert recorded() == 32


@pytest.mark.parametrize("operator", [0, 1], ids=["client", "server"])
def test_change_of_limit_goes_on_with_same_opening(
    operator: int, make_pair: Callable[[], Pair], loop: VirtualLoop
) -> None:
    pair = make_pair()
    pair[0].add()
    settle(pair, loop)
    routes = [next(iter(side.routes.values())) for side in pair]
    ids = [route.id for route in routes]
    pair[operator].limit(2.0)
    settle(pair, loop)
    assert [next(iter(side.routes.values())) for side in pair] == routes
    assert [route.id for route in routes] == ids
    assert [route.spec.max_rate for route in routes] == [2.0, 2.0]
    for side in pair:
        said = [event.text for event in side.context.events.after(0) if event.code == EventCode.ROUTE_AMENDED]
        assert said == ["/chat: max_rate none → 2 Hz"]


either_apart = pytest.mark.parametrize("apart", [0, 1], ids=["client", "server"])


@either_apart
def test_limit_that_changed_while_apart_keeps_route(
    apart: int, make_pair: Callable[[], Pair], loop: VirtualLoop
) -> None:
    """The proposer's route has another limit when the two sides meet again; what the other side counted stays."""
    pair = make_pair()
    pair[apart].add()
    settle(pair, loop)
    kept = next(iter(pair[1 - apart].routes.values()))
    for side in pair:
        side.table.disconnected()
        side.inbox.clear()
    pair[apart].limit(2.0)
    for side in pair:
        side.table.connected()
    settle(pair, loop)
    assert next(iter(pair[1 - apart].routes.values())) is kept
    assert kept.spec.max_rate == kept.proposal.max_rate == 2.0


@either_apart
def test_pause_while_apart_holds_on_both_sides(apart: int, make_pair: Callable[[], Pair], loop: VirtualLoop) -> None:
    pair = make_pair()
    pair[0].add()
    settle(pair, loop)
    for side in pair:
        side.table.disconnected()
        side.inbox.clear()
    pair[apart].pause(True)
    for side in pair:
        side.table.connected()
    settle(pair, loop)
    assert [route.pausing.paused for side in pair for route in side.routes.values()] == [True, True]
    events = pair[1 - apart].context.events.after(0)
    (paused,) = [event for event in events if event.code == EventCode.OPERATOR_PAUSED]
    assert paused.from_peer
    assert " says: " in paused.who


def test_topic_at_limit_may_replace_another(
    make_pair: Callable[[], Pair], loop: VirtualLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.ROUTES_PROPOSED_BY_SERVER.set(monkeypatch, 1)
    client, server = pair = make_pair()
    server.add()
    settle(pair, loop)
    server.rename()
    hear_all(pair)  # at once, and not when it is proposed again
    (renamed,) = server.routes.values()
    assert renamed.life.accepted
    assert [route.spec.topic for route in client.routes.values()] == ["/talk"]
    server.add()  # but no more than the limit
    hear_all(pair)
    assert [route.life.accepted for route in server.routes.values()] == [True, False]
    assert [route.spec.topic for route in client.routes.values()] == ["/talk"]


@pytest.mark.skipif("view" not in purposes(), reason="the core alone")
def test_peer_cannot_list_links_own_names(make_pair: Callable[[], Pair]) -> None:
    client, _ = make_pair()
    topic, views = Topic("view/1", "transmit"), purposes()["view"]
    route = client.table.add(Entry(topic, proposal_for(topic, client.context, views)), proposed_here=True)
    client.table.handle(Close(route.id, "edited", EndCode.EDITED))
    assert client.listed == []


def settle_shortly(pair: Pair, loop: VirtualLoop) -> None:
    let_time_pass(pair, loop, 10.0)
    hear_all(pair)


def test_no_two_routes_offer_one_service(make_pair: Callable[[], Pair]) -> None:
    """Each call would be made twice; what an operator adds while the bridge runs is no exception."""
    pair = make_pair()

    def add(**entry: Any) -> None:
        topic = Topic(**entry)
        proposal = proposal_for(topic, pair[0].context)
        pair[0].table.add(Entry(topic, proposal), proposed_here=True)

    add(topic="/camera", direction="receive", kind="parameters")
    with pytest.raises(LinkError):
        add(topic="/camera/set_parameters", direction="receive", kind="service")
    with pytest.raises(LinkError):
        add(topic="/camera/set_parameters", direction="transmit", kind="service")
    add(topic="/camera", direction="receive", kind="action")
    add(topic="/camera", direction="receive", kind="service")
    add(topic="/camera", direction="receive")
