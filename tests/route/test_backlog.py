"""Messages that waited for a link, until they are settled."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support.offline import half_of

from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import Ledger
from rsb_bridge.route.catching_up import Backlog
from rsb_bridge.route.sender import Sender

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context


def judged(*seconds: tuple[int, int, int], late_for: int = 0) -> list[int]:
    """Return what is left each second, or -1 once nothing is; given are offered, waiting and in flight.

    Messages are late in the first `late_for` seconds.
    """
    backlog = Backlog()
    backlog.begin(0)
    left = []
    for now, (offered, waiting, in_flight) in enumerate(seconds):
        if backlog.exists:
            backlog.judge(Ledger(offered, waiting=waiting, in_flight=in_flight), float(now), held_up=now < late_for)
        left.append(backlog.left if backlog.exists else -1)
    return left


def test_backlog_ends_once_all_behind_it_is_reported() -> None:
    assert judged((600, 590, 10), (610, 100, 500), (620, 0, 300), (630, 0, 20)) == [600, 600, 290, -1]


def test_nothing_that_waited_is_no_backlog() -> None:
    assert judged((600, 0, 0)) == [-1]


def test_link_that_carries_less_than_is_published_never_catches_up() -> None:
    left = judged(*[(600 + 10 * now, 500 + now % 3, 100) for now in range(14)])
    assert left[9] > 0
    assert left[10:] == [-1] * 4


def test_backlog_goes_on_while_what_came_behind_it_is_late() -> None:
    """A topic of 200 Hz: when its 1,000 kept messages are published, those of the meantime wait in their place."""
    seconds = (1000, 0, 1000), (1200, 0, 800), (1400, 0, 400), (1600, 0, 100)
    assert judged(*seconds, late_for=3) == [1000, 800, 400, -1]
    assert judged(*seconds) == [1000, 600, -1, -1]


def test_what_a_silent_link_dropped_is_no_overload_once_it_is_back(make_context: Callable[..., Context]) -> None:
    """A best-effort topic drops messages from the beginning of the silence, before the link is given up."""
    sender = half_of(Sender, make_context(), Topic("/scan", "transmit", qos="sensor_data"))
    for second in range(5):
        sender.health.losses.judge(100, {"queue full": 10 * second}, float(second))
    assert sender.health.losses.loss is not None
    sender.route.suspend()
    sender.route.resume()
    for second in range(5, 10):
        sender.health.losses.judge(10 * second + 60, {"queue full": 40}, float(second))
        assert sender.health.losses.loss is None
