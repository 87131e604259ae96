"""Faults that operators have acknowledged: each is marked until its state or its cause changes."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import Mock

import pytest
from tests.console.scripted import LINK, ScriptedEngine, route
from tests.support.held import held_by

from rsb_bridge.model.clock import Clock
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.faults import needs_attention
from rsb_bridge.model.snapshot import LinkSnapshot, RouteSnapshot, Snapshot, State
from rsb_bridge.telemetry.acknowledgements import Acknowledgements, find_faulty
from rsb_bridge.telemetry.event_log import EventLog
from rsb_bridge.telemetry.snapshot_publisher import SnapshotPublisher

NOW = 1_700_000_000.0


class ManualClock(Clock):
    moved = 0.0

    def time_ns(self) -> int:
        return int((NOW + self.moved) * 1e9)

    def steady(self) -> float:
        return self.moved


SCAN = replace(route("/scan"), state=State.STALE, cause="publisher_silent", since=NOW - 60)
MAP = replace(route("/map"), since=NOW - 60)
DOWN = replace(LINK, state=State.DOWN, cause="unreachable", since=NOW - 60)


class Table:
    def __init__(self) -> None:
        self.clock = ManualClock()
        self.events = EventLog(self.clock)
        self.known = Acknowledgements(self.clock, self.events)

    @property
    def ended(self) -> list[str]:
        """The topics whose acknowledgements have ended."""
        return [event.topic for event in self.events.after(0)]

    def mark(self, *routes: RouteSnapshot, link: LinkSnapshot = LINK) -> list[bool]:
        """Whether the link is marked, and whether each route is."""
        links, marked = self.known.mark([link], routes, NOW + self.clock.moved)
        return [each.acknowledged is not None for each in links] + [each.acknowledged is not None for each in marked]


@pytest.fixture
def table() -> Table:
    made = Table()
    made.known.add(SCAN, "anna")
    return made


def test_marked_fault_needs_no_attention(table: Table) -> None:
    (link,), (scan, other) = table.known.mark([LINK], [SCAN, MAP], NOW)
    assert (link, other) == (LINK, MAP)
    assert scan.acknowledged is not None
    assert (scan.acknowledged.by, scan.acknowledged.at) == ("anna", NOW)
    assert replace(scan, acknowledged=None) == SCAN
    assert needs_attention(SCAN)
    assert not needs_attention(scan)


@pytest.mark.parametrize(
    "changed",
    [replace(SCAN, state=State.DOWN), replace(SCAN, cause="no_publisher"), replace(SCAN, state=State.OK, cause="")],
)
def test_fault_counts_again_after_change(table: Table, changed: RouteSnapshot) -> None:
    assert table.mark(SCAN) == [False, True]
    assert table.mark(replace(SCAN, reason="in other words")) == [False, True]
    assert table.mark(changed) == [False, False]
    assert table.mark(SCAN) == [False, False]


def test_fault_counts_again_after_return_between_snapshots(table: Table) -> None:
    table.clock.moved = 30.0
    assert table.mark(SCAN) == [False, True]
    assert table.mark(replace(SCAN, since=NOW + 20)) == [False, False]


def test_what_is_gone_is_forgotten(table: Table) -> None:
    assert table.mark() == [False]
    assert not held_by(table.known)
    assert table.mark(SCAN) == [False, False]


def test_a_links_covers_what_its_loss_has_stopped(table: Table) -> None:
    with_link = replace(MAP, state=State.DOWN, cause="link_down", link=LINK.name)
    snapshot = Snapshot(NOW, "robot1", "client", "", 0, running=True, links=(DOWN,), routes=(SCAN, with_link))
    assert find_faulty(snapshot, MAP.key, "") is DOWN
    assert find_faulty(snapshot, SCAN.key, "") is SCAN
    assert find_faulty(snapshot, "", LINK.name) is DOWN
    table.known.add(DOWN, "otto")
    assert table.mark(SCAN, with_link, link=DOWN) == [True, True, True]
    (link,), _ = table.known.mark([DOWN], [], NOW)
    assert not needs_attention(link)
    assert table.mark(with_link, link=replace(DOWN, cause="refused")) == [False, False]


def test_warning_of_link_that_is_up_is_fault() -> None:
    table = Table()
    warned = replace(LINK, warning="two machines have this name", cause="name_taken", since=NOW - 60)
    table.known.add(warned, "anna")
    assert table.mark(link=warned) == [True]
    assert table.mark(link=LINK) == [False]


def test_figures_of_full_link_keep_acknowledgement() -> None:
    table = Table()
    full = replace(LINK, warning="link full: carries 25 of 48 kB/s", cause="full", since=NOW - 60)
    table.known.add(full, "anna")
    assert table.mark(link=replace(full, warning="link full: carries 26 of 47 kB/s")) == [True]
    assert table.mark(link=replace(full, cause="name_taken")) == [False]


def test_acknowledging_needs_fault_undoing_needs_acknowledgement(table: Table) -> None:
    for fine in (MAP, LINK):
        with pytest.raises(ValueError, match="no fault"):
            table.known.add(fine, "anna")
    with pytest.raises(ValueError, match="acknowledged"):
        table.known.remove(MAP)
    table.known.remove(SCAN)
    assert table.mark(SCAN) == [False, False]


def test_killed_publisher_is_one_fault_when_noticed(table: Table) -> None:
    table.clock.moved = 20.0
    gone = replace(SCAN, cause="publisher_gone", since=NOW + 20)
    assert table.mark(gone) == [False, True]
    table.clock.moved = 40.0
    assert table.mark(gone) == [False, True]
    assert table.ended == []
    assert table.mark(replace(gone, cause="no_publisher")) == [False, False]
    assert len(table.ended) == 1


def test_ended_acknowledgement_is_told_once(table: Table) -> None:
    table.mark(replace(SCAN, state=State.OK, cause=""))
    assert table.ended == []
    table.known.add(SCAN, "anna")
    other = replace(SCAN, state=State.SLOW, cause="slow")
    for _ in range(5):
        table.mark(other)
    assert table.ended == [other.topic]


def test_the_end_of_an_acknowledgement_is_an_event() -> None:
    clock = ManualClock()
    events = EventLog(clock)
    shown = [SCAN]
    link = Mock(routes={"scan": Mock(snapshot=lambda: shown[0])}, snapshot=lambda: LINK)
    bridge = Mock(links=lambda: [link], refused=lambda: ())
    publisher = SnapshotPublisher(ScriptedEngine().snapshot(), events, clock)
    publisher.acknowledged.add(SCAN, "anna")
    publisher.refresh_now(bridge)
    shown[0] = replace(SCAN, state=State.SLOW, cause="slow")
    publisher.refresh_now(bridge)
    publisher.refresh_now(bridge)
    (event,) = events.after(0)
    assert (event.code, event.topic, event.link) == (EventCode.OPERATOR_ACKNOWLEDGEMENT_ENDED, SCAN.topic, SCAN.link)
    assert publisher.newest() is publisher.latest
    clock.moved += 11.0  # the I/O thread stands still
    (shown_link,) = publisher.newest().links
    assert (shown_link.state, "hangs" in shown_link.reason) == (State.DOWN, True)
