"""Reports of faults: lasting ones are reported once each time that they begin, change and end."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from tests.console.scripted import LINK, NOW, route
from tests.support.held import held_by

from rsb_bridge.model.faults import LASTS, ChangeKind, FaultWatch
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import PatternSnapshot, Snapshot, State
from rsb_bridge.model.verdict import Cause, LinkCause

if TYPE_CHECKING:
    from rsb_bridge.model.faults import FaultChange
    from rsb_bridge.model.snapshot import LinkSnapshot, RouteSnapshot

FINE = route("/scan")
SLOW = route("/scan", State.SLOW, cause=Cause.SLOW)
STOPPED = route("/scan", State.STOPPED, cause=Cause.PUBLISHER_SILENT)
DOWN = replace(LINK, state=State.DOWN, cause=LinkCause.LOST)


class Watched:
    """A watch that looks once a second."""

    def __init__(self) -> None:
        self.watch = FaultWatch()
        self.now = 0.0

    def sees(self, *routes: RouteSnapshot, link: LinkSnapshot = LINK, seconds: int = 1) -> list[FaultChange]:
        """The changes that are reported while the bridge is so for a while."""
        found: list[FaultChange] = []
        for _ in range(seconds):
            self.now += 1
            snapshot = Snapshot(NOW + self.now, "robot1", "client", "", 0, running=True, links=(link,), routes=routes)
            found += self.watch.find_changes(snapshot, self.now)
        return found


def kinds(changes: list[FaultChange]) -> list[tuple[Any, ...]]:
    return [(change.kind, change.key, change.subject.state, change.before) for change in changes]


SCAN = ("route", "/scan")


def test_lasting_fault_is_reported_and_its_end() -> None:
    watched = Watched()
    assert watched.sees(FINE, seconds=5) == []
    assert watched.sees(SLOW, seconds=int(LASTS)) == []
    assert kinds(watched.sees(SLOW, seconds=5)) == [(ChangeKind.BEGUN, SCAN, State.SLOW, ("ok", ""))]
    assert watched.watch.ongoing == 1
    assert watched.sees(FINE, seconds=int(LASTS)) == []
    assert kinds(watched.sees(FINE, seconds=5)) == [(ChangeKind.OVER, SCAN, State.OK, ("slow", "slow"))]
    assert watched.watch.ongoing == 0


def test_flapping_fault_is_reported_once_rare_never() -> None:
    watched = Watched()
    assert kinds([change for _ in range(20) for change in watched.sees(SLOW) + watched.sees(FINE, seconds=3)]) == []
    flaps = [change for _ in range(20) for change in watched.sees(SLOW) + watched.sees(FINE)]
    assert kinds(flaps) == [(ChangeKind.BEGUN, SCAN, State.SLOW, ("ok", ""))]


def test_reported_fault_that_flaps_is_not_over() -> None:
    watched = Watched()
    assert len(watched.sees(SLOW, seconds=4)) == 1
    assert [watched.sees(FINE) + watched.sees(SLOW) for _ in range(20)] == [[]] * 20
    assert watched.watch.ongoing == 1


def test_fault_whose_cause_flaps_lasts_all_same() -> None:
    watched = Watched()
    changes = [change for _ in range(10) for change in watched.sees(SLOW) + watched.sees(STOPPED)]
    assert [change.kind for change in changes] == [ChangeKind.BEGUN]


def test_another_cause_is_reported_with_the_one_before() -> None:
    watched = Watched()
    watched.sees(SLOW, seconds=4)
    expected = (ChangeKind.CHANGED, SCAN, State.STOPPED, ("slow", "slow"))
    assert kinds(watched.sees(STOPPED, seconds=6)) == [expected]
    assert watched.watch.ongoing == 1


def test_what_operator_wants_or_waits_is_no_fault() -> None:
    watched = Watched()
    for state in (State.PAUSED, State.DISARMED, State.WAITING):
        assert watched.sees(route("/scan", state), seconds=5) == []
    assert watched.sees(route("/scan", State.UNHEARD, cause=Cause.NO_SUBSCRIBER), seconds=5) == []


def test_a_link_that_is_down_explains_its_routes() -> None:
    watched = Watched()
    dead = route("/scan", State.DOWN, cause=Cause.LINK_DOWN)
    watched.sees(SLOW, seconds=4)
    expected = (ChangeKind.BEGUN, ("link", "robot1"), State.DOWN, ("ok", ""))
    assert kinds(watched.sees(dead, route("/map", State.DOWN), link=DOWN, seconds=9)) == [expected]
    assert watched.watch.ongoing == 2, "how the slow topic is now is not known"
    assert {change.kind for change in watched.sees(FINE, seconds=5)} == {ChangeKind.OVER}
    assert watched.watch.ongoing == 0


def test_lossy_link_explains_routes_that_suffer_from_it() -> None:
    watched = Watched()
    lossy = replace(LINK, cause=LinkCause.LOSSY, warning="30 % of packets are lost")
    late, stopped = route("/late", State.LATE, cause=Cause.LOSSY), route("/odom", State.STOPPED)
    found = watched.sees(late, stopped, link=lossy, seconds=9)
    assert [(change.kind, change.key) for change in found] == [
        (ChangeKind.BEGUN, ("link", "robot1")),
        (ChangeKind.BEGUN, ("route", "/odom")),
    ]
    assert [change.key for change in watched.sees(late, stopped, seconds=9)] == [("link", "robot1"), ("route", "/late")]


WAITING = route("/scan", State.WAITING, cause=Cause.PUBLISHER_SILENT)
NOBODY = route("/scan", State.WAITING, cause=Cause.NO_PUBLISHER)


def _through_an_outage(before: RouteSnapshot, *after: RouteSnapshot) -> list[tuple[Any, ...]]:
    """The changes of a topic that are reported after its link was lost and came back."""
    watched = Watched()
    watched.sees(before, seconds=4)
    watched.sees(route("/scan", State.DOWN, cause=Cause.LINK_DOWN), link=DOWN, seconds=5)
    changes = [change for each in after for change in watched.sees(each, seconds=5)]
    return [each for each in kinds(changes) if each[1] == SCAN]


@pytest.mark.parametrize(
    "before",
    [
        STOPPED,
        SLOW,
        route("/scan", State.STALE, cause=Cause.SILENT),
        route("/scan", State.DOWN, cause=Cause.LOSSY),
    ],
)
def test_silent_topic_after_reconnection_is_not_over(before: RouteSnapshot) -> None:
    told = (str(before.state), before.cause)
    nothing_yet = route("/scan", State.WAITING, cause=Cause.NO_MESSAGE)
    assert _through_an_outage(before, nothing_yet, nothing_yet) == []
    assert _through_an_outage(before, nothing_yet, NOBODY, nothing_yet, NOBODY, FINE) == [
        (ChangeKind.CHANGED, SCAN, State.WAITING, told),
        (ChangeKind.OVER, SCAN, State.OK, ("waiting", "no_publisher")),
    ]


def test_publisher_silent_before_outage_is_no_news() -> None:
    assert _through_an_outage(STOPPED, WAITING, WAITING) == []


@pytest.mark.parametrize("state", [State.PAUSED, State.DISARMED, State.OK])
def test_silent_topic_is_over_when_paused_or_carrying(state: State) -> None:
    change = (ChangeKind.OVER, SCAN, state, ("stopped", "publisher_silent"))
    assert _through_an_outage(STOPPED, WAITING, route("/scan", state)) == [change]


def test_a_silent_topic_that_is_removed_is_over() -> None:
    watched = Watched()
    watched.sees(STOPPED, seconds=4)
    assert watched.sees(WAITING, seconds=4) == []
    (change,) = watched.sees(seconds=4)
    assert (change.kind, change.removed) == (ChangeKind.OVER, True)
    assert watched.watch.ongoing == 0


@pytest.mark.parametrize("cause", [Cause.NO_PATH, Cause.QOS_INCOMPATIBLE, Cause.TYPE_CONFLICT, Cause.REFUSED])
def test_obstacle_is_over_without_new_message(cause: Cause) -> None:
    """An idle topic whose firewall or QoS was mended owes no message."""
    change = (ChangeKind.OVER, SCAN, State.WAITING, ("down", cause))
    assert _through_an_outage(route("/scan", State.DOWN, cause=cause), WAITING) == [change]


def test_callable_service_is_over() -> None:
    gone = route("/scan", State.DOWN, cause=Cause.SERVER_GONE)
    nobody, ready = (route("/scan", State.WAITING, cause=each) for each in (Cause.NO_SERVER, Cause.NO_CALL))
    assert _through_an_outage(gone, nobody, ready) == [
        (ChangeKind.CHANGED, SCAN, State.WAITING, ("down", "server_gone")),
        (ChangeKind.OVER, SCAN, State.WAITING, ("waiting", "no_server")),
    ]


def test_running_link_with_warning_is_at_fault() -> None:
    watched = Watched()
    twice = replace(LINK, cause=LinkCause.NAME_TAKEN, warning="a second robot1")
    watched.sees(FINE)
    expected = (ChangeKind.BEGUN, ("link", "robot1"), State.OK, ("ok", ""))
    assert kinds(watched.sees(FINE, link=twice, seconds=4)) == [expected]


def test_what_is_removed_is_over() -> None:
    watched = Watched()
    watched.sees(SLOW, seconds=4)
    (change,) = watched.sees(seconds=5)
    assert (change.kind, change.removed, change.before) == (ChangeKind.OVER, True, ("slow", "slow"))
    assert watched.sees(SLOW, seconds=1) == []


def test_partly_bridged_pattern_is_at_fault() -> None:
    watched = Watched()
    fine = PatternSnapshot(
        "robot1 pattern", "robot1", Topic("/c/*", "transmit"), State.OK, "", here=True, source="/c/*"
    )
    partly = replace(fine, state=State.DOWN, reason="1 not bridged")
    key = ("pattern", fine.key)
    well, wrong, gone = (replace(LINK, patterns=each) for each in ((fine,), (partly,), ()))
    assert watched.sees(link=well, seconds=5) == []
    (begun,) = watched.sees(link=wrong, seconds=5)
    assert kinds([begun]) == [(ChangeKind.BEGUN, key, State.DOWN, ("ok", ""))]
    assert begun.seen == NOW + 6
    assert kinds(watched.sees(link=replace(DOWN, patterns=(fine,)), seconds=9)) == [
        (ChangeKind.BEGUN, ("link", "robot1"), State.DOWN, ("ok", ""))
    ]
    assert watched.watch.ongoing == 2, "how the pattern is now is not known"
    over = watched.sees(link=well, seconds=5)
    assert {change.key for change in over} == {key, ("link", "robot1")}
    assert {change.kind for change in over} == {ChangeKind.OVER}
    watched.sees(link=wrong, seconds=5)
    (removed,) = watched.sees(link=gone, seconds=5)
    assert (removed.kind, removed.removed, watched.watch.ongoing) == (ChangeKind.OVER, True, 0)


def test_nothing_is_kept_of_what_has_gone() -> None:
    watched = Watched()
    for number in range(50):
        watched.sees(route(f"/topic{number}", State.SLOW), seconds=4)
    watched.sees(FINE, seconds=4)
    assert watched.watch.ongoing == 0
    assert held_by(watched.watch) == 2, "the link and the topic that are there"
