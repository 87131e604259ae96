"""A busy receiver reports more often than once a second, because unreported messages are unknown when it dies."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

from tests.route.unpacking_helpers import OnePublisher, opened
from tests.support.offline import FakePeer

from rsb_bridge.link.link import RouteReports
from rsb_bridge.wire.records import ReceivedCounts, ReceivedReport

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.link.link import Link
    from rsb_bridge.wire.messages import Report

MESSAGE = (b"x", 0, 0)


class Peer(FakePeer):
    """Counts the requests for an early report."""

    def __init__(self) -> None:
        super().__init__()
        self.soon = 0

    def report_soon(self, route: Any) -> None:
        self.soon += 1


def test_a_report_is_due_after_a_hundred_messages(make_context: Callable[..., Context]) -> None:
    peer = Peer()
    receiver = opened(make_context(ros=OnePublisher()), peer, "/scan")
    for messages, soon in ((99, 0), (1, 1), (99, 1), (500, 2)):
        receiver.deliver([MESSAGE] * messages)
        assert peer.soon == soon


def test_reports_go_together_at_most_ten_a_second(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    context = make_context(ros=OnePublisher())
    sent: list[Report] = []
    early = RouteReports(cast("Link", SimpleNamespace(context=context, send=sent.append)))
    receivers = [opened(context, FakePeer(), name) for name in ("/scan", "/odom")]
    for _ in range(100):
        for receiver in receivers:
            receiver.deliver([MESSAGE] * 100)
            early.add(receiver.route)
        loop.run_until_complete(asyncio.sleep(0.01))
    assert 9 <= len(sent) <= 10
    assert all(len(report.received_counts) == 2 for report in sent)
    assert sent[-1].received_counts[0].delivered >= 9_000
    early.add(receivers[0].route)
    early.disconnected()
    count = len(sent)
    loop.run_until_complete(asyncio.sleep(1.0))
    assert len(sent) == count


def test_what_has_not_changed_is_not_reported_again(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    receiver = opened(make_context(ros=OnePublisher()), FakePeer(), "/scan")

    def news() -> list[type]:
        return [type(each) for each in receiver.news()]

    assert news() == [ReceivedCounts, ReceivedReport]
    assert news() == []
    receiver.deliver([MESSAGE])
    assert news() == [ReceivedCounts], "a list of numbers"
    receiver.path.malformed = "data: too long"
    assert news() == [ReceivedReport]
    receiver.resume()  # the last reports may have been lost with the connection
    assert news() == [ReceivedCounts, ReceivedReport]
