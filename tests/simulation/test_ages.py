"""No message of a topic with `max_age` is published when it is older by true time, and each rule for that is needed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.simulation.conditions import STILL
from tests.simulation.episodes import aged, linked_by_a_slow_way
from tests.simulation.mutations import Mutation
from tests.simulation.world import Violation, World
from tests.support import replaced
from tests.support.long import long

from rsb_bridge.model.clock import StampClock
from rsb_bridge.route.age import MessageAge, PublisherClocks

if TYPE_CHECKING:
    from tests.simulation.topic_flow import TopicFlow

    from rsb_bridge.model.transports import Protocol

MAX_AGE = 0.5
_AGES = replace(STILL, checks=(5.0, 5.0), patience=20.0)


def aging_world(seed: int, protocol: Protocol = "tcp", max_rate: float | None = None) -> tuple[World, TopicFlow]:
    """A world with one topic of `MAX_AGE`, 20 messages a second."""
    world = World(seed, _AGES)
    (robot,), (flow,) = world.robots, world.topic_flows.values()
    topic = msgspec.structs.replace(
        flow.topic, protocol=protocol, port=None, qos="auto", paused=False, max_age=MAX_AGE, max_rate=max_rate
    )
    robot.host.session = msgspec.structs.replace(robot.host.session, topics=(topic,))
    flow.topic, flow.period, flow.max_age = topic, 0.05, MAX_AGE
    return world, flow


@pytest.mark.parametrize("protocol", ["tcp", "udp"])
@pytest.mark.parametrize("seed", [2, *long(1, 3, 4, 5, 6)])
def test_nothing_old_is_published(seed: int, protocol: Protocol) -> None:
    world, flow = aging_world(seed, protocol, None if seed % 2 else 10.0)
    world.play(life=aged(world))
    assert flow.heard > 500
    assert flow.oldest < MAX_AGE + 0.2  # with what DDS takes at both ends


def _any_age(self: Any, stamp: int) -> None:
    """Replace `MessageAge.why_old` by a form in which the receiver checks nothing."""


def _exact(self: Any, stamp: int) -> Any:
    """Replace `MessageAge.why_old` by a form that takes the other side's clock for exact."""
    offset = self._peer.stamps.offset
    if offset is None:
        return None
    return None if (self._context.stamps.now() - stamp) / 1e9 + offset <= self.max_age else "link_slow"


def _wall(self: Any) -> int:
    """Replace `StampClock.now` by a clock that can be set."""
    return int(self._clock.time_ns())


def _unseen(self: Any) -> None:
    """Replace `StampClock.compare` by a form that ignores steps."""
    self.shift = self._measure()[0]


def _taken(self: Any, source: int, taken: int, publisher: bytes) -> int:
    """Replace `PublisherClocks.born` by a form that ignores the publisher's stamp."""
    return taken


_MISTAKES = (
    ("the receiver publishes messages of any age", ((MessageAge, "why_old", _any_age),), aged),
    (
        "the uncertainty of the other side's clock counts for nothing",
        ((MessageAge, "why_old", _exact),),
        linked_by_a_slow_way,
    ),
    ("stamps are of a clock that may be set", ((StampClock, "now", _wall),), aged),
    ("a clock that is set is not noticed", ((StampClock, "compare", _unseen),), aged),
    ("a message's age counts from when it was taken", ((PublisherClocks, "born", _taken),), aged),
)


def test_slow_way_publishes_nothing_old_after_link() -> None:
    world, flow = aging_world(1)
    world.play(life=linked_by_a_slow_way(world))
    assert flow.heard > 500


@pytest.mark.parametrize(("what", "changes", "doing"), _MISTAKES, ids=[what for what, *_ in _MISTAKES])
def test_each_rule_is_needed(what: str, changes: Any, doing: Any) -> None:
    found = []
    for seed in (4, 7, 1, 2, 3, 5, 6, 8):  # in most of them not every mistake shows; in the first two, soon
        world, _ = aging_world(seed)
        mutation = Mutation(what, changes, "s old, more than", _AGES, seed, 1.0)
        try:
            with mutation.made():
                world.play(life=doing(world))
        except Violation as violation:
            if mutation.finds not in str(violation):
                raise
            found.append(seed)
            break
    assert found, what


def test_nothing_is_sent_when_already_old(monkeypatch: pytest.MonkeyPatch) -> None:
    """Messages that wait in the sender's queue or are taken late expire there, for any receiver."""
    replaced.WHY_OLD.set(monkeypatch, _any_age)
    world, flow = aging_world(3)
    flow.max_age = float("inf")
    sent: list[float] = []
    send = replaced.STREAM_SEND.value

    def noted(self: Any, batch: Any) -> None:
        now = self.route.context.stamps.now()
        sent.extend((now - stamp) / 1e9 for _, stamp, _ in batch)
        send(self, batch)

    replaced.STREAM_SEND.set(monkeypatch, noted)
    world.play(life=aged(world))
    assert sent
    assert max(sent) <= MAX_AGE + 0.002
