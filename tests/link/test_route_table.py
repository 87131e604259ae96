"""The route tables of both sides agree in the end, for all orders of crossing messages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.link.route_table_helpers import Pair, hear_all, pair_of
from tests.support import constants
from tests.support.offline import proposal_for

from rsb_bridge.link.extension import LinkError
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.purposes import purposes
from rsb_bridge.model.reason import EndCode
from rsb_bridge.model.session import Topic
from rsb_bridge.route.route import Entry
from rsb_bridge.wire.messages import Close

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.link.route_ids import RouteIds


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
