"""A half's news for the other side, by what they are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rsb_bridge.wire.records import ReceivedCounts, ReceivedReport, SentCounts, SentReport

if TYPE_CHECKING:
    from rsb_bridge.route.receiver import Receiver
    from rsb_bridge.route.sender import Sender


def told_counts(half: Sender | Receiver) -> Any:
    """Return its news in numbers, or None without any."""
    return next((each for each in half.news() if isinstance(each, SentCounts | ReceivedCounts)), None)


def told_words(half: Sender | Receiver) -> Any:
    """Return its other news, or None without any."""
    return next((each for each in half.news() if isinstance(each, SentReport | ReceivedReport)), None)
