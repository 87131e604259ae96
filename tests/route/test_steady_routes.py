"""A route whose messages go on as before is ticked seldom, and within a second once they do not, or somebody looks."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from msgspec.structs import replace
from tests.route.idle_routes_helpers import TALKER, Channel
from tests.support.offline import FakePeer, half_of

from rsb_bridge.channel.channel import Counts
from rsb_bridge.link.link import RouteReports
from rsb_bridge.model.capacity import Fullness
from rsb_bridge.model.faults import PathFault
from rsb_bridge.model.session import Topic
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.ros.publication_numbers import Untaken
from rsb_bridge.route.idling import tick_if_due
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.sender import Sender
from rsb_bridge.wire.records import ReceivedCounts, SentCounts

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.wire.messages import Report

_RATE = 10
_LEARNS = 60.0
"""s after which its usual rate is known, and all that followed from its opening is over."""


class Flowing:
    """A half with ten messages a second, which its link looks after once a second, and the other side's reports.

    Attributes:
        ticks: the times (s) of its ticks.
        delay: s that messages take.
    """

    def __init__(self, kind: type[Any], loop: VirtualLoop, context: Context) -> None:
        self.peer = FakePeer()
        self.half: Any = half_of(kind, context, Topic("/scan", "transmit"), self.peer)
        self.loop, self.ticks, self.rate, self.delay = loop, list[float](), _RATE, 0.01
        self.count = 0
        route = self.route = self.half.route
        route.open(1)
        route.on_accepted()
        self.half.carried.channel, self.half.carried.endpoints = Channel(), (TALKER,)
        self.seconds(_LEARNS)
        assert route.meter.usual_rate == pytest.approx(_RATE)
        self.ticks.clear()

    def seconds(self, seconds: float) -> None:
        for _ in range(int(seconds)):
            for _ in range(self.rate):
                self.loop.jump(0.5 / self.rate)
                self._message()
            self.loop.jump(0.5)
            self._report()
            now = self.loop.time()
            for route in self.peer.timetable.look(now):
                tick_if_due(route, now, looked_at=self.peer.is_looked_at)
                if not route.idling.goes_on_now:
                    self.ticks.append(now)

    def _message(self) -> None:
        self.count += 1
        self.half.flow.count(1, 100, self.loop.time())
        if isinstance(self.half, Sender):
            self.half.counts.offered += 1
            self.half.counts.sent(1)
        else:
            self.half.path.received += 1
            self.half.path.delivered += 1
            self.half.flow.latency.add(self.delay)

    def _report(self) -> None:
        report: Any = ReceivedCounts(1, self.count, self.count, self.count, self.delay)
        if isinstance(self.half, Receiver):
            report = SentCounts(1, offered=self.count, delivered=self.count)
        self.half.reported(report)


def _lose(flowing: Flowing) -> None:
    flowing.half.path.dropped["malformed"] += 1


def _drop(flowing: Flowing) -> None:
    flowing.half.counts.lose("queue full", 1)


def _lose_in_dds(flowing: Flowing) -> None:
    numbers = SimpleNamespace(counts={**flowing.half.subscription.numbers.counts, Untaken.LOST: 1}, newest={})
    flowing.half.subscription.numbers = numbers


def _stop_reports(flowing: Flowing) -> None:
    flowing.half.reported = lambda _: None


CHANGES: dict[str, tuple[type[Any], Callable[[Flowing], object]]] = {
    "slower": (Sender, lambda flowing: setattr(flowing, "rate", _RATE // 2)),
    "faster": (Sender, lambda flowing: setattr(flowing, "rate", _RATE * 2)),
    "silent": (Sender, lambda flowing: setattr(flowing, "rate", 0)),
    "silent there": (Receiver, lambda flowing: setattr(flowing, "rate", 0)),
    "late": (Sender, lambda flowing: setattr(flowing, "delay", 1.5)),
    "late there": (Receiver, lambda flowing: setattr(flowing, "delay", 1.5)),
    "dropped": (Sender, _drop),
    "lost in DDS": (Sender, _lose_in_dds),
    "malformed": (Receiver, _lose),
    "link full": (Sender, lambda flowing: setattr(flowing.peer.fullness, "out", Fullness(5e3, 15e3))),
    "lossy path": (
        Receiver,
        lambda flowing: setattr(flowing.peer.path, "fault", PathFault(LinkCause.LOSSY, "")),
    ),
    "something else": (Sender, lambda flowing: flowing.route.judge_again()),
}


@pytest.mark.parametrize("kind", [Sender, Receiver])
def test_route_is_ticked_each_fifth_second(
    kind: type[Any], loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    flowing = Flowing(kind, loop, make_context())
    flowing.seconds(100)
    assert len(flowing.ticks) == 20
    assert flowing.route.meter.rate == pytest.approx(_RATE)
    assert set(flowing.route.meter.history) == {_RATE}
    flowing.peer.is_looked_at = True
    flowing.ticks.clear()
    flowing.seconds(10)
    assert len(flowing.ticks) == 10, "somebody looks"


@pytest.mark.parametrize("change", CHANGES)
def test_change_has_it_ticked_at_once(change: str, loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    kind, happens = CHANGES[change]
    flowing = Flowing(kind, loop, make_context())
    while flowing.ticks != [loop.time()]:
        flowing.ticks.clear()
        flowing.seconds(1)
    flowing.ticks.clear()
    happens(flowing)
    flowing.seconds(3)  # a message that comes late is seen a second later
    assert flowing.ticks


def test_silence_of_reports_is_noticed(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    """What the other side does not report may not have arrived."""
    flowing = Flowing(Sender, loop, make_context())
    _stop_reports(flowing)
    flowing.seconds(4)
    assert flowing.half.flow.lateness.since is not None


def test_slow_topic_is_noticed_as_soon_as_while_somebody_looks(
    loop: VirtualLoop, make_context: Callable[..., Context]
) -> None:
    flowing = Flowing(Sender, loop, make_context())
    flowing.half.subscription = SimpleNamespace(
        receives=True, failure="", numbers=flowing.half.subscription.numbers, tick=lambda _: None
    )
    flowing.seconds(30)
    flowing.route.spec = replace(flowing.route.spec, expected_rate=2.0 * _RATE)
    flowing.route.judge_again()
    flowing.seconds(6)
    assert flowing.half.health.slow.since is not None


def test_last_counts_before_goodbye_are_of_present(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    flowing = Flowing(Sender, loop, make_context())
    while not flowing.route.idling.goes_on_now:
        flowing.seconds(1)
    flowing.seconds(2)
    assert flowing.route.idling.goes_on_now
    sent: list[Report] = []
    link: Any = SimpleNamespace(routes={"": flowing.route}, send=sent.append)
    RouteReports(link).leaving()
    assert [each.offered for report in sent for each in report.sent_counts] == [flowing.count]


def test_reported_delay_is_of_last_second(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    """Of all seconds since the last tick, it would hide a delay that has just begun."""
    flowing = Flowing(Receiver, loop, make_context())
    while flowing.ticks != [loop.time()]:
        flowing.ticks.clear()
        flowing.seconds(1)
    flowing.seconds(3)
    flowing.delay = 1.5
    flowing.seconds(1)
    assert flowing.half.flow.latency.recent == flowing.delay


def test_figures_are_of_present_when_they_are_shown(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    """Somebody who looks once, as a command does, gets no rate of some seconds before."""
    flowing = Flowing(Sender, loop, make_context())
    while flowing.ticks != [loop.time()]:
        flowing.ticks.clear()
        flowing.seconds(1)
    flowing.ticks.clear()
    flowing.rate = _RATE - 1
    flowing.seconds(3)
    assert not flowing.ticks
    assert flowing.route.snapshot().rate == pytest.approx(_RATE - 1)


def test_percentiles_are_reported_while_somebody_looks(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    flowing = Flowing(Receiver, loop, make_context())

    def reported() -> int:
        counts = []
        for _ in range(10):
            flowing.seconds(1)
            counts += [each for each in flowing.half.news() if isinstance(each, ReceivedCounts)]
        assert len(counts) == 10
        return sum(each.latency_p50 == flowing.delay for each in counts)

    assert reported() == 2
    flowing.peer.is_looked_at = True
    assert reported() == 10


def test_channels_losses_have_it_ticked(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    flowing = Flowing(Receiver, loop, make_context())
    flowing.half.carried.channel.counts = lambda: Counts(expired=1)
    flowing.half.news()
    flowing.seconds(2)
    assert flowing.ticks
