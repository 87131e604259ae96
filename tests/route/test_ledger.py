"""The sender's ledger against arbitrary reports of a peer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.route.unpacking_helpers import OnePublisher
from tests.support.offline import FakePeer, half_of

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.route.ledger import RouteLedger
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.sender import Sender
from rsb_bridge.wire.messages import Describe, Ready
from rsb_bridge.wire.records import ReceivedCounts, SentCounts, SentReport, Source, VerdictRecord

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.model.snapshot import Ledger

# What a peer can put into a msgpack integer, most often near what could be right.
counts = st.one_of(st.integers(-3, 12), st.integers(-(2**63), 2**64 - 1))
causes = st.dictionaries(st.text("abc", max_size=4), counts, max_size=32)
reports = st.builds(
    ReceivedCounts,
    route=st.integers(1, 4),
    received=counts,
    delivered=counts,
    expired=counts,
    incomplete=counts,
    newest=counts,
    dropped=causes,
)
instances = st.sampled_from(["first", "second"])
steps = st.one_of(
    st.tuples(st.just("send"), st.integers(0, 5)),
    st.tuples(st.just("drop"), st.integers(0, 5)),
    st.tuples(st.just("throttle"), st.integers(0, 5)),
    st.tuples(st.just("expire"), st.integers(0, 5)),
    st.tuples(st.just("open"), st.integers(1, 4), instances),
    st.tuples(st.just("close")),
    st.tuples(st.just("goodbye")),
    st.tuples(st.just("report"), reports),
    st.tuples(st.just("settle"), st.none() | reports, instances),
)


def check(ledger: Ledger) -> None:
    known = (ledger.delivered, ledger.throttled, ledger.expired, *ledger.dropped.values())
    parts = (*known, ledger.unknown, ledger.waiting, ledger.in_flight)
    assert sum(parts) == ledger.offered
    assert min(parts) >= 0
    assert len(ledger.dropped) <= 32


@given(st.lists(steps, max_size=40), st.booleans())
@settings(max_examples=settings().max_examples * 2, deadline=None)
def test_no_report_makes_part_negative_or_sum_wrong(taken: list[tuple[Any, ...]], lossy: bool) -> None:
    ledger = RouteLedger()
    ledger.lossy = lossy
    for now, (what, *details) in enumerate(taken):
        match what:
            case "send":
                ledger.offered += details[0]
                ledger.sent(details[0])
            case "drop":
                ledger.offered += details[0]
                ledger.drop("queue full", details[0])
            case "throttle":
                ledger.offered += details[0]
                ledger.throttled += details[0]
            case "expire":
                ledger.offered += details[0]
                ledger.expired += details[0]
            case "open":
                ledger.opened(*details)
            case "close":
                ledger.closed()
            case "goodbye":
                ledger.receiver_left()
            case "report":
                ledger.reported(details[0], now)
            case "settle":
                ledger.settle(*details)
        check(ledger.ledger({}))


@given(st.lists(st.integers(0, 5), min_size=1, max_size=10), st.lists(st.integers(0, 4), max_size=10))
def test_true_reports_are_taken_as_they_are(sent: list[int], lost: list[int]) -> None:
    """Openings of one process, each with some messages lost: the ledger says what the receiver counted."""
    ledger, delivered = RouteLedger(), 0
    before: ReceivedCounts | None = None
    for number, count in enumerate(sent):
        route_id = 2 * number + 1
        ledger.opened(route_id, "first")
        assert ledger.settle(before, "first")
        ledger.offered += count
        ledger.sent(count)
        arrived = max(0, count - (lost[number] if number < len(lost) else 0))
        delivered += arrived
        if arrived:
            before = ReceivedCounts(route=route_id, received=arrived, delivered=arrived, newest=count)
        ledger.closed()
    ledger.settle(before, "first")
    final = ledger.ledger({})
    assert final.delivered == delivered
    assert final.dropped.get("link lost", 0) == sum(sent) - delivered


def test_other_process_cannot_settle_opening() -> None:
    """Ids begin at 1 in each process, so the id alone does not say whose count it is."""
    ledger = RouteLedger()
    ledger.opened(1, "first")
    ledger.offered += 5
    ledger.sent(5)
    ledger.closed()
    ledger.opened(1, "second")
    assert ledger.settle(ReceivedCounts(route=1, received=131, delivered=131, newest=131), "second")
    assert (ledger.ledger({}).dropped, ledger.ledger({}).unknown) == ({}, 5)


def opened(instance: str, sent: int, *, lossy: bool = False) -> RouteLedger:
    """A ledger with an opening in which some messages were sent."""
    ledger = RouteLedger()
    ledger.lossy = lossy
    ledger.opened(1, instance)
    ledger.offered += sent
    ledger.sent(sent)
    return ledger


@pytest.mark.parametrize("over", [False, True])
def test_messages_too_old_anywhere_are_expired(over: bool) -> None:
    """Messages whose parts did not come are another matter, which the receiver reports under that name."""
    ledger = opened("first", 20)
    ledger.offered += 4
    ledger.expired += 4
    report = ReceivedCounts(route=1, received=18, delivered=15, expired=2, newest=20, dropped={"expired": 3})
    if over:
        ledger.closed()
        assert ledger.settle(report, "first")
    else:
        assert ledger.reported(report, 0)
    balance = ledger.ledger({})
    assert (balance.delivered, balance.expired, balance.dropped) == (15, 7, {"incomplete": 2})
    assert balance.in_flight == 0


def test_what_a_receiver_has_forgotten_is_unknown() -> None:
    """Its half was removed and added: it reported some, and knows of none."""
    ledger = opened("first", 10)
    ledger.reported(ReceivedCounts(route=1, received=4, delivered=4, newest=4), 0)
    ledger.closed()
    ledger.settle(None, "first")
    balance = ledger.ledger({})
    assert (balance.delivered, balance.dropped, balance.unknown) == (4, {}, 6)


@pytest.mark.parametrize(("instance", "rest"), [("first", {"link lost": 6}), ("second", {})])
def test_datagrams_lost_stay_lost_after_link(instance: str, rest: dict[str, int]) -> None:
    """The count of drops falls neither when the opening ends nor when it is settled."""
    ledger = opened("first", 20, lossy=True)
    ledger.reported(ReceivedCounts(route=1, received=11, delivered=11, newest=14), 0)
    assert ledger.ledger({}).dropped == {"lost on the way": 3}
    ledger.closed()
    assert ledger.ledger({}).dropped == {"lost on the way": 3}
    ledger.settle(None if rest == {} else ReceivedCounts(route=1, received=11, delivered=11, newest=14), instance)
    balance = ledger.ledger({})
    assert balance.dropped == {"lost on the way": 3, **rest}
    assert (balance.unknown, balance.in_flight) == (0 if rest else 6, 0)


def test_what_is_not_sent_waits() -> None:
    ledger = opened("first", 4)
    ledger.offered += 6
    ledger.drop("outage", 2)
    balance = ledger.ledger({})
    assert (balance.waiting, balance.in_flight, balance.open) == (4, 4, 8)


@pytest.mark.parametrize("reported", [0, 3])
def test_goodbye_leaves_nothing_unknown(reported: int) -> None:
    ledger = opened("first", 10)
    if reported:
        ledger.reported(ReceivedCounts(route=1, received=reported, delivered=reported, newest=reported), 0)
    ledger.receiver_left()
    ledger.closed()
    ledger.opened(1, "second")
    assert ledger.settle(None, "second")
    balance = ledger.ledger({})
    assert (balance.delivered, balance.dropped, balance.open) == (reported, {"link lost": 10 - reported}, 0)


@pytest.fixture
def topic() -> Topic:
    return Topic("/scan", "transmit")


def test_receiver_tells_counts_to_sending_process_only(make_context: Callable[..., Context], topic: Topic) -> None:
    peer = FakePeer()
    receiver = half_of(Receiver, make_context(role="server", ros=OnePublisher()), topic, peer, here=False)

    def counted_before(number: int) -> ReceivedCounts | None:
        """Open the route again; return its report of the opening before."""
        if receiver.route.id:
            receiver.route.close("the link was lost")
        receiver.route.open(number)
        receiver.route.on_accepted()
        receiver.described(Describe(number, "std_msgs/msg/String", "RIHS01_" + "0" * 64, Qos(), (Source(("there",)),)))
        return next(each for each in reversed(peer.sent) if isinstance(each, Ready)).before

    assert counted_before(1) is None
    receiver.deliver([(b"\0\1\0\0\2\0\0\0x\0", 0, 0)] * 131)
    before = counted_before(3)
    assert before is not None
    assert (before.route, before.delivered) == (1, 131)
    peer.instance = "second"
    assert counted_before(5) is None


def test_impossible_report_is_said_once_and_ends_nothing(make_context: Callable[..., Context], topic: Topic) -> None:
    context = make_context()
    sender = half_of(Sender, context, topic)
    sender.route.open(1)
    for delivered in (131, -1, 2**63):
        sender.reported(ReceivedCounts(route=1, delivered=delivered, latency_p50=float("nan"), jitter=1e300))
    assert [event.code for event in context.events.after(0)] == [EventCode.ROUTE_IMPLAUSIBLE_REPORT]
    assert (sender.flow.latency.percentiles()[0], sender.flow.latency.jitter) == (None, None)
    check(sender.facts.ledger)


@pytest.mark.parametrize(
    "wrong",
    [
        {"offered": 10, "delivered": 11, "in_flight": -1},
        {"offered": 10, "delivered": 3},
        {"offered": 2**63, "delivered": 2**63},
        {"offered": 10, "delivered": 10, "lost_in_dds": -1},
        {"offered": 10, "delivered": 15, "dropped": {"link lost": -5}},
        {"offered": 10, "delivered": 15, "unknown": -5},
        {"offered": 10, "delivered": 10, "missed_while_down": -1},
        {"offered": 10, "delivered": 10, "unsubscribed": -1},
        {"offered": 10, "delivered": 11, "waiting": -1},
    ],
)
def test_a_sender_s_impossible_ledger_is_not_shown(
    make_context: Callable[..., Context], topic: Topic, wrong: dict[str, Any]
) -> None:
    context = make_context(role="server")
    receiver = half_of(Receiver, context, topic, here=False)
    receiver.route.open(1)
    receiver.reported(SentCounts(route=1, offered=7, delivered=4, unknown=2, in_flight=1))
    receiver.reported(SentReport(route=1, verdict=VerdictRecord("down", "slow", "still told")))
    receiver.reported(SentCounts(route=1, **wrong))
    assert (receiver.facts.ledger.offered, receiver.facts.ledger.delivered, receiver.facts.ledger.unknown) == (7, 4, 2)
    assert receiver.route.judged.peer.text == "still told"
    assert [event.code for event in context.events.after(0)] == [EventCode.ROUTE_IMPLAUSIBLE_REPORT]
