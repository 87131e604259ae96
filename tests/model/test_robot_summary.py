"""A robot in a few figures: whose each of them is, and since when."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import pytest
from tests.console.scripted import NOW, route
from tests.model.robot_summary_helpers import SERVER, UP, a, on_server
from tests.support.wording import pattern, says

from rsb_bridge.model.robot_summary import (
    LOSS_SPAN,
    SUMMARY_BYTES,
    WHY_LENGTH,
    Battery,
    InvalidSummary,
    LossWindow,
    LostMessages,
    RobotState,
    RobotSummary,
    SummaryText,
    decode,
    drop_repeated_faults,
    encode,
    of_engine,
)
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import (
    Acknowledgement,
    Ledger,
    LinkSnapshot,
    PatternSnapshot,
    RouteSnapshot,
    Snapshot,
    State,
)
from rsb_bridge.model.verdict import Cause, LinkCause
from rsb_console.widgets.bars import state_counts

DOWN = replace(UP, state=State.DOWN, cause=LinkCause.LOST, reason="gone")


def test_all_is_well() -> None:
    summary = on_server(a("/scan"), a("/goal", outgoing=True, rate=2.0), a("/map", State.WAITING, rate=0.0))
    assert (summary.state, summary.why, summary.since, summary.seen) == (RobotState.OK, "", UP.since, NOW)
    assert (summary.links_up, summary.links, summary.flowing, summary.routes) == (1, 1, 2, 3)
    assert (summary.messages_from_robot, summary.messages_to_robot) == (10.0, 2.0)
    assert (summary.bytes_from_robot, summary.bytes_to_robot) == (UP.rx_bytes_per_second, UP.tx_bytes_per_second)
    assert (summary.host, summary.version) == (UP.peer, UP.peer_version)


def test_what_an_engine_says_of_itself() -> None:
    """It sends what its server gets."""
    session = msgspec.structs.replace(SERVER, name="robot1", role="client", clients=None, group="yard")
    now = Snapshot(NOW, "robot1", "client", "10.0.0.20", 1, running=True, links=(UP,), routes=(a("/scan"),))
    battery = Battery(0.5, NOW)
    losses = {"a": LostMessages(0.1, 9.0), "b": LostMessages(0.2, 5.0)}
    summary = of_engine(now, session, host="arm7", version="1.2", losses=losses, battery=battery)
    assert (summary.messages_from_robot, summary.messages_to_robot) == (0.0, 10.0)
    assert (summary.bytes_from_robot, summary.bytes_to_robot) == (UP.tx_bytes_per_second, UP.rx_bytes_per_second)
    assert (summary.group, summary.role, summary.host, summary.version) == ("yard", "client", "arm7", "1.2")
    assert (summary.battery, summary.loss) == (battery, LostMessages(0.2, 5.0))
    down = of_engine(replace(now, links=(DOWN,)), session, host="arm7", version="1.2", losses={}, battery=None)
    assert (down.state, down.since, down.seen) == (RobotState.FAULT, DOWN.since, NOW)  # it is there, and reports it
    off = of_engine(replace(now, running=False), session, host="arm7", version="1.2", losses={}, battery=None)
    assert off.state is RobotState.MISSING


@pytest.mark.parametrize(
    ("state", "cause", "expected"),
    [
        (State.DOWN, Cause.REFUSED, RobotState.FAULT),
        (State.STALE, Cause.SILENT, RobotState.FAULT),
        (State.STOPPED, Cause.PUBLISHER_GONE, RobotState.FAULT),
        (State.SLOW, Cause.SLOW, RobotState.WARN),
        (State.UNHEARD, Cause.QOS_INCOMPATIBLE, RobotState.WARN),
        (State.UNHEARD, Cause.NO_SUBSCRIBER, RobotState.OK),
        (State.PAUSED, Cause.PAUSED, RobotState.OK),
        (State.DISARMED, Cause.DISARMED, RobotState.OK),
        (State.WAITING, Cause.NO_PUBLISHER, RobotState.OK),
    ],
)
def test_the_worst_topic_decides(state: State, cause: Cause, expected: RobotState) -> None:
    summary = on_server(a("/map"), a("/scan", state, cause=cause, reason="it is broken"))
    assert summary.state is expected
    if expected.is_wrong:
        assert summary.why.startswith("/scan ")  # as the robot calls it
        assert "it is broken" in summary.why
        assert summary.since == NOW - 5.0
    else:
        assert (bool(summary.why), summary.since) == (state is State.UNHEARD, UP.since)


def test_the_figures_are_those_of_the_console() -> None:
    """A topic without a listener is no fault, and is counted all the same."""
    unheard = [a(f"/t{number}", State.UNHEARD, cause=Cause.NO_SUBSCRIBER) for number in range(27)]
    routes = (*unheard, a("/odom"))
    summary = on_server(*routes)
    assert summary.states == {State.UNHEARD: 27, State.OK: 1}
    assert decode(encode(summary)).states == summary.states
    (count, *_) = summary.why.split(":")
    header = "".join(text for text, _ in state_counts(routes, State, words=True))
    assert count in header


def announced(*routes: RouteSnapshot, links: tuple[LinkSnapshot, ...]) -> RobotSummary:
    now = Snapshot(NOW, "control", "server", "0.0.0.0", 1, running=True, links=links, routes=routes)
    return of_engine(now, SERVER, host="pc", version="1", losses={}, battery=None)


def test_fault_of_client_is_listed_once_there() -> None:
    links = (UP, replace(DOWN, name="robot2"))
    server = announced(a("/scan", State.STALE, cause=Cause.SILENT, reason="silent"), links=links)
    assert (server.state.is_wrong, server.wrong_clients, server.clients_wrong) == (True, ("robot1", "robot2"), 2)
    assert decode(encode(server)) == server
    rows = [RobotSummary(name=name, role="client", state=RobotState.FAULT, why="it") for name in ("robot1", "robot2")]
    states = [each.state for each in drop_repeated_faults([server, *rows])]
    assert states == [RobotState.OK, RobotState.FAULT, RobotState.FAULT]
    # robot2 has never been in the fleet: only the server knows that it is missing
    alone, _ = drop_repeated_faults([server, rows[0]])
    assert alone.state is server.state
    assert "robot2" in alone.why
    assert "robot1" not in alone.why


def test_a_fault_of_the_server_stays_its_own() -> None:
    links = tuple(replace(DOWN, name=name, cause=LinkCause.UNREACHABLE) for name in ("robot1", "robot2"))
    server = announced(links=links)
    assert (server.state, server.wrong_clients) == (RobotState.FAULT, ())


def test_more_clients_than_a_summary_names() -> None:
    links = tuple(replace(DOWN, name=f"robot-of-the-second-hall-{number}") for number in range(200))
    server = announced(links=links)
    assert server.clients_wrong == 200
    assert len(encode(server)) <= SUMMARY_BYTES
    rows = [RobotSummary(name=name, state=RobotState.FAULT) for name in server.wrong_clients]
    assert drop_repeated_faults([server, *rows])[0].state.is_wrong


def test_what_has_stopped_has_no_rate() -> None:
    assert on_server(a("/scan", State.STOPPED, rate=7.0)).messages_from_robot == 0.0


def test_several_faults() -> None:
    long = "x" * 400
    summary = on_server(*(a(f"/t{number}", State.DOWN, reason=long) for number in range(3)), a("/u", State.SLOW))
    assert summary.why.startswith("/t0 ")
    assert says(summary.why, SummaryText.MORE_FAULTS, count=3)
    assert len(summary.why) == WHY_LENGTH


def test_a_warning_of_a_link() -> None:
    summary = on_server(a("/scan", State.SLOW, reason="slow"), link=replace(UP, warning="two robot1"))
    assert summary.state is RobotState.WARN
    assert summary.why.startswith("two robot1")
    assert summary.since == UP.since


def test_a_link_that_is_down() -> None:
    summary = on_server(a("/scan", State.DOWN, reason="no link"), link=DOWN)
    assert (summary.state, summary.why, summary.since, summary.seen) == (
        RobotState.MISSING, "gone", DOWN.since, DOWN.since,
    )  # fmt: skip
    assert (summary.links_up, summary.flowing, summary.messages_from_robot) == (0, 0, 0.0)
    never = on_server(link=replace(DOWN, peer_domain=None))
    assert (never.state, never.seen) == (RobotState.MISSING, None)


def test_a_link_that_waits() -> None:
    link = replace(UP, state=State.WAITING, cause=LinkCause.NOT_YET, reason="not connected yet", peer_domain=None)
    summary = on_server(link=link)
    assert (summary.state, summary.why, summary.seen) == (RobotState.WAITING, "not connected yet", None)


def test_a_server_that_is_stopped() -> None:
    assert on_server(running=False).state is RobotState.MISSING


def ledgers(time: float, *counts: tuple[int, dict[str, int]], expired: int = 0) -> Snapshot:
    """Return topics ``/0``, ``/1`` and so on, with the delivered and dropped messages of each."""
    routes = tuple(
        route(f"/{number}", ledger=Ledger(delivered=delivered, dropped=dropped, expired=expired))
        for number, (delivered, dropped) in enumerate(counts)
    )
    return Snapshot(time, "control", "server", "0.0.0.0", 1, running=True, links=(UP,), routes=routes)


def test_loss_is_of_the_last_minute() -> None:
    window = LossWindow()
    assert window.add(ledgers(NOW, (100, {"queue full": 900}))) == {}  # before this console looked
    assert window.add(ledgers(NOW + 5, (200, {"queue full": 900}))) == {"robot1": LostMessages(0.0, 5.0)}
    assert window.add(ledgers(NOW + 10, (275, {"queue full": 900}), expired=25)) == {
        "robot1": LostMessages(25 / 200, 10.0)
    }
    for second in range(11, 200):
        loss = window.add(ledgers(NOW + second, (275 + second, {"queue full": 900}), expired=25))
    assert loss == {"robot1": LostMessages(0.0, LOSS_SPAN)}


def test_loss_counts_what_nobody_wants_only() -> None:
    window = LossWindow()
    window.add(ledgers(NOW, (0, {}), (0, {})))
    took = window.add(
        ledgers(NOW + 1, (50, {"would loop": 30, "paused": 9}), (30, {"lost on the way": 20, "disarmed": 1}))
    )
    assert took == {"robot1": LostMessages(0.2, 1.0)}


def test_loss_of_topic_that_counts_anew() -> None:
    window = LossWindow()
    window.add(ledgers(NOW, (500, {"queue full": 10})))
    assert window.add(ledgers(NOW + 1, (5, {}))) == {}
    assert window.add(ledgers(NOW + 2, (9, {"queue full": 1}))) == {"robot1": LostMessages(1 / 5, 1.0)}
    assert window.add(ledgers(NOW + 3)) == {}
    assert window.add(ledgers(NOW + 4, (900, {"queue full": 1}))) == {}


def test_what_another_says_is_bounded() -> None:
    made = RobotSummary(
        name="r\x1b[2J" + "x" * 300, group="\u202e", why="y" * 900, host="h\n", version="v" * 300, seen=math.nan,
        since=-1.0, links=-4, routes=1 << 60, messages_to_robot=math.inf, loss=LostMessages(7.0, 1.0),
        battery=Battery(-1.0, 2.0),
    )  # fmt: skip
    got = decode(encode(made))
    assert "\x1b" not in got.name
    assert (len(got.name), len(got.why), len(got.version), got.group, got.host) == (255, 200, 255, "\ufffd", "h\ufffd")
    assert (got.seen, got.since, got.links, got.messages_to_robot) == (0.0, 0.0, 0, 0.0)
    assert got.routes == 1 << 31
    assert (got.loss, got.battery) == (LostMessages(1.0, 1.0), Battery(0.0, 2.0))


def test_a_newer_version() -> None:
    """Its states and its further figures harm nobody."""
    data = msgspec.msgpack.encode({"name": "robot9", "role": "captain", "state": "melted", "temperature": 900})
    assert decode(data) == RobotSummary(name="robot9", state=RobotState.WARN)


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"", InvalidSummary.UNREADABLE),
        (b"\x93\x01\x02\x03", InvalidSummary.UNREADABLE),
        (msgspec.msgpack.encode({"name": " "}), InvalidSummary.NAMELESS),
        (msgspec.msgpack.encode({"group": "hall"}), InvalidSummary.UNREADABLE),
        (msgspec.msgpack.encode({"name": "robot1", "why": "x" * SUMMARY_BYTES}), InvalidSummary.TOO_LONG),
    ],
)
def test_what_is_no_summary(data: bytes, problem: InvalidSummary) -> None:
    with pytest.raises(ValueError, match=pattern(problem)):
        decode(data)


@pytest.mark.parametrize(
    ("state", "robot_state"), [(State.OK, RobotState.OK), (State.WAITING, RobotState.OK), (State.DOWN, RobotState.WARN)]
)
def test_partly_bridged_pattern_is_warning(state: State, robot_state: RobotState) -> None:
    pattern = PatternSnapshot("p", "robot1", Topic("/camera/**", "transmit"), state, "2 of 3", True, "/camera/**")
    summary = on_server(a("/scan"), link=replace(UP, patterns=(pattern, pattern)))
    assert summary.state is robot_state
    assert ("/camera/**" in summary.why) is (robot_state is RobotState.WARN)
    worse = on_server(a("/scan", State.STOPPED), link=replace(UP, patterns=(pattern,)))
    assert worse.state is RobotState.FAULT


def test_acknowledged_faults_are_counted_apart() -> None:
    known = Acknowledgement("anna", NOW - 1.0)
    stale = a("/scan", State.STALE, cause=Cause.SILENT, reason="it is broken")
    summary = on_server(replace(stale, acknowledged=known), a("/map"))
    assert (summary.state, summary.acknowledged, summary.since) == (RobotState.ACKNOWLEDGED, 1, NOW - 5.0)
    assert not summary.state.is_wrong
    assert "it is broken" in summary.why
    both = on_server(replace(stale, acknowledged=known), a("/map", State.SLOW, cause=Cause.SLOW))
    assert (both.state, both.acknowledged) == (RobotState.WARN, 1)
    away = a("/map", State.DOWN, cause=Cause.LINK_DOWN, acknowledged=known)
    gone = on_server(away, link=replace(DOWN, name="robot1", acknowledged=known))
    assert (gone.state, gone.acknowledged, gone.since) == (RobotState.ACKNOWLEDGED, 1, DOWN.since)
    assert decode(encode(gone)).acknowledged == 1
