"""A bridge of which only the snapshots and the log are there, on a clock that the test moves."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from tests.console.scripted import LINK, route

from rsb_bridge.model.snapshot import Ledger, LinkSnapshot, RouteSnapshot, Snapshot, State
from rsb_bridge.telemetry.event_log import EventLog
from rsb_extras.history.recorder import Recorder
from rsb_extras.history.tests.hand_clock import HandClock

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_extras.history.history_data import HistoryReport, Outage, Track
    from rsb_extras.history.timeline import SavedTrack, Timeline


class World:
    """A client with one link and some topics.

    Attributes:
        clock: moved by `go`.
        recorder: looks once a second.
    """

    def __init__(self, *topics: str, clock: HandClock | None = None) -> None:
        self.clock = clock or HandClock()
        self.events = EventLog(self.clock)
        self.link: LinkSnapshot = replace(
            LINK, state=State.OK, reason="", rx_bytes_per_second=700.0, tx_bytes_per_second=300.0
        )
        self.routes: dict[str, RouteSnapshot] = {topic: route(topic, ledger=Ledger()) for topic in topics}
        self.running = True
        self.recorder = Recorder("robot1", "client", self.events, lambda: self.snapshot, self.clock)
        self.renew()
        self.recorder.record()

    @property
    def timeline(self) -> Timeline:
        return self.recorder._timeline

    @property
    def records(self) -> tuple[SavedTrack, ...]:
        return self.recorder.save().subjects

    def renew(self) -> None:
        self.snapshot = Snapshot(
            self.clock.wall, "robot1", "client", "", 3, self.running, (self.link,), tuple(self.routes.values())
        )

    def go(self, seconds: float, step: float = 1.0, rate: float = 10.0) -> None:
        """Let time pass; topics that are OK carry so many messages a second."""
        passed = 0.0
        while passed < seconds:
            self.clock.go(step)
            passed += step
            for topic, each in self.routes.items():
                if each.state is State.OK:
                    ledger = Ledger(delivered=each.ledger.delivered + round(rate * step))
                    self.routes[topic] = replace(each, ledger=ledger)
            self.renew()
            self.recorder.record()

    def put(self, topic: str, state: State, reason: str = "") -> None:
        """A topic's state from now on."""
        self.routes[topic] = replace(self.routes[topic], state=state, reason=reason)
        self.renew()
        self.recorder.record()

    def begin(self, topic: str, state: State, reason: str = "") -> None:
        self.routes[topic] = route(topic, ledger=Ledger())
        self.put(topic, state, reason)

    def put_link(self, state: State, reason: str = "") -> None:
        """The link's state from now on; its topics follow two seconds later."""
        self.link = replace(self.link, state=state, reason=reason)
        self.renew()
        self.recorder.record()
        self.go(2)
        for topic in self.routes:
            self.put(topic, state, "" if state is State.OK else "no link")

    def report(self, seconds: float = 3600.0) -> HistoryReport:
        return self.recorder.report(seconds)

    def outages(self, seconds: float = 3600.0) -> Sequence[Outage]:
        return self.report(seconds).outages

    def track(self, topic: str, seconds: float = 3600.0) -> Track:
        return next(each for each in self.report(seconds).tracks if each.topic == topic)


def brief(outages: Sequence[Outage]) -> list[tuple[Any, ...]]:
    return [(each.topic, round(each.seconds), each.state, each.cause) for each in outages]
