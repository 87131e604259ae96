"""The log of a silent topic: a warning now and then, unless it has the cause already."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.route.unpacking_helpers import OnePublisher, opened
from tests.support.offline import FakePeer

from rsb_bridge.channel.channel import Counts
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.faults import PathFault
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.verdict import Cause, LinkCause
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.topic_flow import SilenceWatch

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.model.snapshot import Level

STALE_AFTER = 15.0
SESSION = Session(name="robot1", role="client", server_ip="127.0.0.1", server_port=1)


class World:
    """A route's silence.

    Attributes:
        said: the codes of its events.
    """

    def __init__(self) -> None:
        self.said: list[EventCode] = []
        self._silence = SilenceWatch(self._log, 0.0)
        self._silence.configure(Topic("/scan", "transmit"), SESSION)
        self._now = 0.0

    def wait(self, seconds: float, cause: str) -> None:
        for _ in range(int(seconds)):
            self._now += 1.0
            self._silence.tick(self._now, cause)

    def hear(self) -> None:
        self._silence.seen(self._now)

    def _log(self, level: Level, code: EventCode, text: str) -> None:
        self.said.append(code)


@pytest.mark.parametrize("cause", [Cause.PUBLISHER_GONE, Cause.QOS_INCOMPATIBLE, Cause.NO_PATH, Cause.TOO_LARGE])
def test_silence_of_known_cause_gives_no_warning(cause: Cause) -> None:
    """The fault is in the log already, with its cause."""
    world = World()
    world.wait(10 * STALE_AFTER, cause)
    world.hear()
    assert world.said == []


@pytest.mark.parametrize("cause", [Cause.NONE, Cause.SILENT, Cause.PUBLISHER_SILENT, Cause.SLOW, Cause.NO_SUBSCRIBER])
def test_other_silence_is_warned_of_few_times(cause: Cause) -> None:
    world = World()
    world.wait(10 * STALE_AFTER, cause)
    world.hear()
    assert world.said == [EventCode.ROUTE_STALE] * 5 + [EventCode.ROUTE_DATA_AGAIN]


def test_ended_cause_leaves_silence_to_tell() -> None:
    world = World()
    world.wait(4 * STALE_AFTER, Cause.PUBLISHER_GONE)
    assert world.said == []
    world.wait(STALE_AFTER, Cause.SILENT)
    assert world.said == [EventCode.ROUTE_STALE]  # the fifth


def test_expected_message_waits_for_a_silent_link(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    """The receiving side finds out by itself that nobody publishes any more."""
    peer = FakePeer()
    ros = OnePublisher()
    ros.published.subscriber_count = 1
    context = make_context(ros=ros)
    regular, seldom = (opened(context, peer, topic) for topic in ("/odom", "/chat"))
    channel: Any = SimpleNamespace(ready=True, trouble=lambda: None, counts=lambda: Counts(newest=None))
    regular.carried.channel = seldom.carried.channel = channel

    def causes(seconds: int, messages: int) -> list[str]:
        for _ in range(seconds):
            for _ in range(messages):
                loop.jump(0.1)
                regular.deliver([(b"x", 0, 0)])
            loop.jump(1.0 - 0.1 * messages)
            for receiver in (regular, seldom):
                receiver.route.advance()
                receiver.route.tick()
        return [receiver.route.verdict().cause for receiver in (regular, seldom)]

    fine, waits = Cause.NONE, Cause.AWAITS_LINK
    seldom.deliver([(b"x", 0, 0)])
    assert causes(60, 10) == [fine, fine]
    assert causes(4, 0) == [fine, fine]
    peer.path.fault = PathFault(LinkCause.SILENT, "nothing comes")
    assert causes(1, 0) == [waits, fine]
    peer.path.fault = None
    assert causes(1, 10) == [fine, fine]


def test_outage_is_no_silence_of_a_topic(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    """Else all topics would be stale for a second after each outage of 15 s."""
    ros = OnePublisher()
    ros.published.subscriber_count = 1
    receiver = opened(make_context(ros=ros), FakePeer(), "/odom")
    receiver.carried.channel = SimpleNamespace(ready=True, trouble=lambda: None, counts=lambda: Counts(newest=None))  # type: ignore[assignment]
    receiver.flow.silence.own, receiver.flow.silence.watch.after = True, STALE_AFTER
    receiver.deliver([(b"x", 0, 0)])
    receiver.route.suspend()
    loop.jump(30.0)
    receiver.route.resume()
    assert receiver.facts.stale_since(Crossing.YES) is None
    loop.jump(30.0)
    assert receiver.facts.stale_since(Crossing.YES) is not None
