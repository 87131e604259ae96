"""An idle engine: its messages are no more than the other side needs, and its routes sleep through no change."""

from __future__ import annotations

from collections import Counter, defaultdict
from contextlib import contextmanager
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pytest
from tests.route.time_by_event_helpers import differences, shown_by
from tests.simulation.beds import Yard, until
from tests.simulation.conditions import LIVELY, QUIET, STILL, Conditions
from tests.simulation.episodes import type_differs_for
from tests.simulation.node import Node
from tests.simulation.world import Violation, World
from tests.support import replaced
from tests.support.long import long_cases

from rsb_bridge.context import Context
from rsb_bridge.link.link import Link
from rsb_bridge.model.session import Topic
from rsb_bridge.route.idling import Idling, Timetable
from rsb_bridge.wire.messages import Ping, Propose, Report

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.places import Place

    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_bridge.ros.ros_interface import Endpoint
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import ControlMessage

_WHILE = 600.0
_SETTLED_AFTER = 60.0


def count_messages(world: World, seconds: float, *doings: object) -> Counter[type]:
    """The control messages of both sides, by type, from a minute after the beginning."""
    sent: Counter[type] = Counter()
    send = Link.send

    def counting(self: Link, message: ControlMessage) -> None:
        if world.loop.time() > _SETTLED_AFTER:
            sent[type(message)] += 1
        send(self, message)

    with patch.object(Link, "send", counting):
        world.play(seconds, *doings)  # type: ignore[arg-type]
    return sent


def test_a_link_on_which_nothing_happens_only_pings() -> None:
    """Counts that the peer knows are not reported again, and routes do not ask the graph again and again."""
    asked: list[str] = []
    publishers = Node.publishers

    def asking(self: Node, topic: str) -> list[Endpoint]:
        asked.append(topic)
        return publishers(self, topic)

    with patch.object(Node, "publishers", asking):
        sent = count_messages(World(1, replace(STILL, topics=(4,), periods=(1e9, 1e9))), _WHILE)
    assert len(asked) < 2 * 4 * _WHILE / 5.0, "each route on either side once in ten seconds"
    assert sent[Ping] > 1.9 * (_WHILE - _SETTLED_AFTER)
    assert not sent[Report]


def test_each_message_is_reported_and_no_more() -> None:
    """The receiver's count, the sender's ledger with it, and the sender's before: three reports for a message."""
    world = World(1, replace(STILL, topics=(1,), periods=(10.0, 10.0)))
    sent = count_messages(world, _WHILE)
    (flow,) = world.topic_flows.values()
    assert flow.heard > 0.8 * _WHILE / 10.0
    assert sent[Report] <= 4 * flow.heard


def test_route_of_different_types_is_proposed_rarely() -> None:
    """Both sides accept it every time, and find out only then what it is refused for."""
    world = World(1, STILL)
    sent = count_messages(world, _WHILE, type_differs_for(world, 2 * _WHILE))
    assert 0.9 * _WHILE / 10.0 - 10 < sent[Propose] <= _WHILE / 10.0


def test_both_sides_know_that_somebody_looks_on_one() -> None:
    yard = Yard(Topic("/chat", "transmit"))

    async def live() -> None:
        there, here = yard.link(), yard.link(on_server=True)
        assert (here.is_looked_at, there.is_looked_at) == (False, False)
        here.context.is_looked_at = lambda: True
        await until(lambda: here.is_looked_at and there.is_looked_at, within=3.0)
        here.context.is_looked_at = lambda: False
        await until(lambda: not (here.is_looked_at or there.is_looked_at), within=3.0)

    yard.world.play(life=yard.live(live()))


@contextmanager
def polled_too() -> Iterator[Counter[str]]:
    """Tick idle routes every second all the same: that may change nothing, log nothing and report nothing.

    Yields the seconds of idle routes, and those of routes that are ticked anyway.
    """
    seconds: Counter[str] = Counter()
    shown: dict[Route, tuple[RouteSnapshot, float, float]] = {}
    look, log = Timetable.look, Context.log

    def poll(route: Route) -> None:
        before, peer_s = route.verdict(), route.judged.announced
        with patch.object(Idling, "ticked"), patch.object(Context, "log", side_effect=log) as logged:
            route.tick()
        after = route.verdict(), route.judged.announced
        if after != (before, peer_s) or logged.called or (route.id and route.half.news()):
            raise Violation(f"{route.key} slept through a change: {before} {peer_s}, {after}, {logged.call_args}")

    def show(route: Route) -> None:
        now = shown_by(route)
        if now is None:
            shown.pop(route, None)
        elif others := differences(shown.setdefault(route, now), now):
            raise Violation(f"{route.key} shows something else: {others}")

    known: defaultdict[Timetable[Any], set[Any]] = defaultdict(set)

    def polling(table: Timetable[Any], now: float) -> list[Any]:
        due: list[Any] = look(table, now)
        known[table] |= {*due, *table.awake}
        for route in known[table]:
            if route.idling.until == -inf:  # it has been removed
                continue
            show(route)
            seconds["idle" if route.idle else "due"] += 1
            if route.idle:
                poll(route)
        return due

    with patch.object(Timetable, "look", polling):
        yield seconds


WORLD = replace(QUIET, services=(0,), nights=0.0, periods=(150.0, 400.0), faults=500.0, commands=500.0)


CALLED = replace(WORLD, services=(1, 2), periods=(20.0, 400.0), faults=200.0, commands=300.0)


@pytest.mark.parametrize(
    ("seed", "conditions"), [(1, WORLD), (2, WORLD), (1, CALLED), (3, LIVELY), *long_cases((3, WORLD), (2, CALLED))]
)
def test_idle_routes_miss_nothing(seed: int, conditions: Conditions) -> None:
    """The oracle: to tick each route every second gives the same verdicts, events and reports."""
    with polled_too() as seconds:
        World(seed, conditions).play(1200.0)
    assert seconds["idle"] > 100


@pytest.mark.parametrize("place", [replaced.WAKE, replaced.SIGNS_MISSED], ids=lambda place: place.name)
def test_route_that_no_event_wakes_is_found(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    place.set(monkeypatch, lambda *_: None)
    with polled_too(), pytest.raises(Violation, match=r"slept through a change|shows something else"):
        World(2, WORLD).play(1200.0)
