"""The log of a silent topic: a warning now and then, unless it has the cause already."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.topic_route import SilenceWatch

if TYPE_CHECKING:
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
            self._silence.tick(self._now, due=True, cause=cause)

    def hear(self) -> None:
        self._silence.seen(self._now)

    def _log(self, level: Level, code: EventCode, text: str) -> None:
        self.said.append(code)


@pytest.mark.parametrize("cause", [Cause.PUBLISHER_GONE, Cause.QOS_INCOMPATIBLE, Cause.NO_PATH, Cause.TOO_LARGE])
def test_silence_whose_cause_is_known_is_not_warned_of(cause: Cause) -> None:
    """The fault is in the log already, with its cause."""
    world = World()
    world.wait(10 * STALE_AFTER, cause)
    world.hear()
    assert world.said == []


@pytest.mark.parametrize("cause", [Cause.NONE, Cause.SILENT, Cause.PUBLISHER_SILENT, Cause.SLOW, Cause.NO_SUBSCRIBER])
def test_any_other_silence_is_warned_of_so_many_times(cause: Cause) -> None:
    world = World()
    world.wait(10 * STALE_AFTER, cause)
    world.hear()
    assert world.said == [EventCode.ROUTE_STALE] * 5 + [EventCode.ROUTE_DATA_AGAIN]


def test_a_cause_that_is_no_more_leaves_the_silence_to_be_told() -> None:
    world = World()
    world.wait(4 * STALE_AFTER, Cause.PUBLISHER_GONE)
    assert world.said == []
    world.wait(STALE_AFTER, Cause.SILENT)
    assert world.said == [EventCode.ROUTE_STALE]  # the fifth
