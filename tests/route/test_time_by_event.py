"""The oracle of `route.idling`: a half that is ticked when it is due does what one that is ticked each second does.

The other one is judged at each tick, too, even if it stays fine.

Random lives of one half are lived twice, for forty minutes each: the same happens to both at the same times, and their
verdicts, events and rates are compared each second.
"""

from __future__ import annotations

from collections import Counter, deque
from functools import partial
from math import inf
from random import Random
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pytest
from tests.route.idle_routes_helpers import TALKER, Channel
from tests.route.time_by_event_helpers import differences, shown_by
from tests.support import replaced
from tests.support.offline import FakePeer, half_of, loop, make_context
from tests.support.virtual_time import VirtualLoop, virtual_loop

from rsb_bridge.model.audience import Audience
from rsb_bridge.model.capacity import Fullness
from rsb_bridge.model.faults import PathFault
from rsb_bridge.model.reason import Reason
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, LinkCause, Verdict
from rsb_bridge.ros.publication_numbers import PublicationNumbers
from rsb_bridge.route.blocking_rules import judge
from rsb_bridge.route.idling import tick_if_due
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.sender import Sender
from rsb_bridge.route.topic_facts import SenderFacts
from rsb_bridge.wire.records import ReceivedReport, SentReport, VerdictRecord

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.places import Place

    from rsb_bridge.context import Context

__all__ = ["loop", "make_context"]

_LIFE = 2400
_SEEDS = range(1, 13)


_SUBSCRIPTION: Any = SimpleNamespace(
    spec=None, receives=True, failure="", numbers=PublicationNumbers(float), is_unmatched=False, awaits_match=False,
    is_settled=True, refuses=False, tick=lambda _: None, close=lambda: 0, unsubscribe=lambda: None,
)  # fmt: skip
"""One that works."""


class Sending(Sender):
    """A half without a graph, whose subscription works."""

    def __init__(self, *args: Any, **fields: Any) -> None:
        super().__init__(*args, **fields)
        self.subscription = _SUBSCRIPTION
        self.facts = SenderFacts(self.flow, self.path, _SUBSCRIPTION, self.resolver, self.health)

    def proceed(self) -> None:
        pass


class Receiving(Receiver):
    def proceed(self) -> None:
        pass


class Life:
    """A half and what happens to it; two of the same seed live the same life."""

    def __init__(self, loop: VirtualLoop, context: Context, seed: int, *, regular: bool = False) -> None:
        self._messages = [1] if regular else [1, 1, 3]  # that may come together
        random = self._random = Random(seed)
        topic = Topic(
            "/scan",
            "transmit",
            stale_after=random.choice([None, None, 20.0, 70.0]),
            expected_rate=random.choice([None, None, 0.05, 0.05, 1.0]),
        )
        self.loop, self.peer = loop, FakePeer()
        kind: Any = random.choice([Sending, Sending, Receiving])
        self.half: Any = half_of(kind, context, topic, self.peer)
        self._every = 0  # s from one message to the next, or 0 for none
        self._later: dict[float, Callable[[], None]] = {}
        self._open()

    def _open(self) -> None:
        self.half.route.open(1)
        self.half.route.on_accepted()
        self.half.carried.channel = Channel()

    def second(self) -> None:
        """Move time on to the next tick; half a second before, something may happen."""
        self.loop.jump(0.5)
        if self._random.random() < 0.008:
            self._random.choice(_EVENTS)(self)
            self.half.route.advance()
        if (later := self._later.pop(self.loop.time(), None)) is not None:
            later()
        if self._every and int(self.loop.time()) % self._every == 0 and self.half.route.id:
            self.half.flow.count(self._random.choice(self._messages), 100, self.loop.time())
        self.loop.jump(0.5)

    def says(self) -> tuple[Any, ...]:
        """Return its verdicts, events and rates."""
        route = self.half.route
        events = [(event.time, event.code, event.text) for event in route.context.events.after(0)]
        shown = route.judged.shown(route.verdict())
        return shown, route.judged.announced, events, route.meter.rate, route.meter.bytes_per_second, self._history()

    def judges(self) -> tuple[object, ...]:
        """Return its verdicts and events without texts, as rates that are learned differ a little."""
        shown, announced, events, *_ = self.says()
        verdicts = [(each.verdict.state, each.verdict.cause) for each in (shown, announced)]
        return verdicts, [(time, code) for time, code, _ in events]

    def _history(self) -> tuple[int, ...]:
        meter = self.half.route.meter
        return (meter.history_at(self.loop.time()) if self.half.route.idle else tuple(meter.history))[-60:]

    # --- what may happen

    def flow(self) -> None:
        self._every = self._random.choice([0, 1, 1, 2, 40])

    def look(self) -> None:
        self.half.carried.endpoints = self._random.choice(
            [(), (TALKER,), (TALKER._replace(node="/other", gid=b"other"),)]
        )

    def pause(self) -> None:
        self.half.route.pausing.change(paused=not self.half.route.pausing.paused)

    def reopen(self) -> None:
        self.half.route.close("a test")
        self._open()

    def fill(self) -> None:
        self._have(Fullness(5e3, 15e3), None)

    def break_path(self) -> None:
        cause = self._random.choice([LinkCause.LOSSY, LinkCause.SILENT, LinkCause.LARGE_PACKETS])
        self._have(None, PathFault(cause, "a fault of the path"))

    def _have(self, full: Fullness | None, fault: PathFault | None) -> None:
        self.peer.fullness.out = self.peer.fullness.into = full
        self.peer.path.fault = fault
        self.half.route.judge_again()
        if full or fault:
            self._later[self.loop.time() + 30.0] = partial(self._have, None, None)

    def hear(self) -> None:
        """Hear of a fault that comes again soon, which the log tells after a minute at the earliest."""
        states = (State.DOWN, Cause.NOT_PUBLISHED), (State.UNHEARD, Cause.NO_SUBSCRIBER), (State.STALE, Cause.SILENT)
        verdict = VerdictRecord(*self._random.choice(states), "says the other side")
        now = self.loop.time()
        for after, said in ((0.0, verdict), (10.0, None), (20.0, verdict), (100.0, None)):
            self._later[now + after] = partial(self._report, said)

    def _report(self, verdict: VerdictRecord | None) -> None:
        report = ReceivedReport if self.half.route.outgoing else SentReport
        self.half.reported(report(route=1, verdict=verdict))

    def limit(self) -> None:
        self.half.route.limit.set_max_rate(self._random.choice([0.0, 0.5, 7.0]))


_EVENTS: list[Callable[[Life], None]] = [
    *[Life.flow] * 6, Life.look, Life.look, Life.pause, Life.reopen, Life.fill, Life.break_path, Life.hear, Life.limit,
]  # fmt: skip


def live(seed: int, *, looked_at: bool = True) -> int:
    """Live a life twice; return for how many seconds the half was idle, or needed no tick as its messages went on.

    Args:
        looked_at: whether somebody looks, so that figures have to be new each second.

    Raises:
        AssertionError: one that is ticked when it is due does something else.
    """
    with virtual_loop() as loop, virtual_loop() as other:
        make: Any = make_context.__wrapped__  # type: ignore[attr-defined]
        by_event, polled = (Life(each, make(each)(), seed, regular=not looked_at) for each in (loop, other))
        by_event.peer.is_looked_at = looked_at
        idle, shown = 0, shown_by(by_event.half.route)
        for _ in range(_LIFE):
            by_event.second()
            polled.second()
            with patch("rsb_bridge.route.route.stays_fine", lambda *_: False):
                polled.half.route.tick()
            for route in by_event.peer.timetable.look(loop.time()):
                tick_if_due(route, loop.time(), looked_at=looked_at)
            idle += by_event.half.route.idle if looked_at else by_event.half.route.idling.goes_on_now
            says, said = (each.says() if looked_at else each.judges() for each in (by_event, polled))
            assert says == said, f"seed {seed}, {loop.time():.0f} s"
            before, shown = shown, shown_by(by_event.half.route)
            others: list[object] = differences(before, shown) if before and shown else []
            assert not others, f"seed {seed}, {loop.time():.0f} s: shown otherwise: {others}"
        return idle


def live_all() -> int:
    return sum(live(seed) for seed in _SEEDS)


def test_half_that_is_ticked_when_due_says_what_one_says_that_is_polled() -> None:
    assert live_all() > 0.2 * _LIFE * len(_SEEDS)


def test_half_whose_messages_go_on_says_what_one_says_that_is_polled() -> None:
    assert sum(live(seed, looked_at=False) for seed in _SEEDS) > 0.01 * _LIFE * len(_SEEDS)


def _never(*_: object, **__: object) -> float:
    return inf


MUTATIONS: list[tuple[Place, object]] = [
    (replaced.WAKE, lambda *_: None),
    (replaced.SIGNS_MISSED, lambda *_: False),
    (replaced.HEALTH_CHANGES, _never),
    (replaced.LOG_CHANGES, property(_never)),
    (replaced.NEXT_WARNING, property(_never)),
    (replaced.SILENCE_DUE, property(_never)),
    (replaced.METER_STILL, property(lambda _: True)),
    (replaced.METER_RESTED, lambda *_: None),
    (replaced.METER_BLANK, lambda *_: True),
    (replaced.LASTING, property(lambda _: False)),
    (replaced.HALF_CHANGES, _never),
    (replaced.TOPIC_CHANGES, _never),
    (replaced.IS_WELL, lambda *_: True),
    (replaced.SIGNS_LAST, lambda *_: True),
]


@pytest.mark.parametrize(("place", "mutation"), MUTATIONS, ids=[place.name for place, _ in MUTATIONS])
def test_rule_without_its_time_and_event_without_its_wake_are_found(
    place: Place, mutation: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    place.set(monkeypatch, mutation)
    with pytest.raises(AssertionError, match="seed"):
        live_all()


def judged(half: Any, loop: VirtualLoop, seconds: int) -> int:
    """Return how often a half is judged that gets a message each second."""
    with patch("rsb_bridge.route.route.judge", side_effect=judge) as judging:
        for _ in range(seconds):
            loop.jump(1.0)
            half.flow.count(1, 100, loop.time())
            half.route.tick()
    return judging.call_count


def test_topic_that_flows_is_judged_only_when_something_changes(
    loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    life = Life(loop, make_context(), seed=1)
    life.half.carried.endpoints = (TALKER,)
    assert judged(life.half, loop, 30) < 20
    assert judged(life.half, loop, 30) == 0
    life.peer.path.fault = PathFault(LinkCause.SILENT, "a fault of the path")
    assert judged(life.half, loop, 5) == 5


def test_topic_that_nobody_hears_is_judged_only_when_something_changes(
    loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    half: Any = half_of(Receiving, make_context(), Topic("/scan", "transmit"), FakePeer())
    half.route.open(1)
    half.route.on_accepted()
    half.carried.channel = Channel()
    unheard = Verdict(State.UNHEARD, Cause.NO_SUBSCRIBER, "nobody subscribes")
    with patch.object(Receiving, "rules", (lambda *_: unheard,)):
        assert judged(half, loop, 30) < 20
        assert judged(half, loop, 30) == 0
        half.flow.audience = Audience(1, ("/rviz",))
        assert judged(half, loop, 5) == 5


NOT_WELL: list[tuple[type[Any], str, object]] = [
    *[
        (kind, name, value)
        for kind in (Sending, Receiving)
        for name, value in (("flow.lateness.since", 0.0), ("route.notices.undelivered", "it was refused"))
    ],
    (Sending, "backlog.exists", True),
    (Sending, "health.slow.since", 0.0),
    (Sending, "health.stop.since", 0.0),
    (Sending, "carried.endpoints", (TALKER, TALKER)),
    (Receiving, "listeners._unmatched_since", 0.0),
]


@pytest.mark.parametrize(
    ("kind", "name", "value"), NOT_WELL, ids=[f"{kind.__name__}.{name}" for kind, name, _ in NOT_WELL]
)
def test_half_says_each_reason_for_which_it_is_not_well(
    kind: type[Any], name: str, value: object, loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    half = half_of(kind, make_context(), Topic("/scan", "transmit"), FakePeer())
    half.route.open(1)
    half.route.on_accepted()
    half.carried.channel = Channel()
    half.carried.endpoints = (TALKER,)
    judged(half, loop, 60)
    assert half.is_well(loop.time())
    *path, last = name.split(".")
    part = half
    for each in path:
        part = getattr(part, each)
    with patch.object(part, last, value):
        assert not half.is_well(loop.time())


NOT_CALM: list[tuple[type[Any], str, object]] = [
    *[
        (kind, name, value)
        for kind in (Sending, Receiving)
        for name, value in (
            ("route.meter.rate", 1.0),
            ("route.reopening.refused", Reason("it was refused")),
            ("route.age._since", 0.0),
            ("route.age._lately", deque([(0, Counter()), (1, Counter())])),
            ("route.age._lately", deque([(1, Counter()), (1, Counter({Cause.LINK_SLOW: 1}))])),
            ("flow.latency._samples", deque([0.1])),
            ("flow.latency._reported", (0.1, 0.1)),
            ("flow.lateness._other", 1),
            ("flow.drivers._counts", {b"gid": 1}),
            ("flow.drivers._ticks", deque([({b"gid": 1}, 1.0)])),
            ("flow.left_out._count", 1),
            ("flow.peek_slot._looked_at", inf),
        )
    ],
    (Sending, "carried.endpoints", ()),
    (Sending, "subscription.is_settled", False),
    (Sending, "delays._reported_at", inf),
    (Sending, "health._lost_in_dds", deque([0, 1])),
    (Sending, "health.losses._row.lost", Counter({"lost": 1})),
    (Sending, "health.losses._marks", deque([(0.0, 0, {}), (1.0, 0, {"lost": 1})])),
    (Receiving, "carried.type_name", "std_msgs/msg/String"),
]


@pytest.mark.parametrize(
    ("kind", "name", "value"), NOT_CALM, ids=[f"{kind.__name__}.{name}" for kind, name, _ in NOT_CALM]
)
def test_half_says_each_reason_for_which_it_is_not_calm(
    kind: type[Any], name: str, value: object, loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    half = half_of(kind, make_context(), Topic("/scan", "transmit"), FakePeer())
    half.route.open(1)
    half.route.on_accepted()
    half.carried.channel = Channel()
    half.carried.endpoints = (TALKER,)
    loop.jump(10.0)
    half.route.tick()
    assert half.route.is_calm(loop.time())
    *path, last = name.split(".")
    part = half
    for each in path:
        part = getattr(part, each)
    with patch.object(part, last, value):
        assert not half.route.is_calm(loop.time())


def test_route_that_comes_to_rest_has_to_be_shown_once_more(
    loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    """Its figures have changed last, and nobody renews those of an idle route."""
    half: Any = half_of(Sending, make_context(), Topic("/scan", "transmit"), FakePeer())
    route = half.route
    route.open(1)
    route.on_accepted()
    half.carried.channel, half.carried.endpoints = Channel(), (TALKER,)
    judged(half, loop, 2)
    while route.idling.until <= loop.time():
        if was_shown := not route.only_counts:
            route.snapshot()
        loop.jump(1.0)
        route.tick()
    assert route.meter.rate == 0.0
    assert not was_shown, "figures alone change at first"
    assert not route.only_counts
