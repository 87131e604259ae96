"""Checks the format of every line of a bridge's log."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from rsb_bridge.model.codes import EventCode

_ADDRESS = re.compile(r"( at |: )(\d+\.\d+\.\d+\.\d+|\[[0-9a-f:]+\])(:\d+)?\b")
"""``: 10.0.0.1:7060 accepts, but does not answer``: of a server that is busy for some seconds."""
_WARNINGS = frozenset(
    {
        EventCode.LINK_LOST,
        EventCode.LINK_CLOSED_BY_PEER,
        EventCode.LINK_REPLACED,
        EventCode.LINK_NAME_TAKEN,
        EventCode.LINK_WRONG_KEY,
        EventCode.LINK_REJECTED,
        EventCode.ROUTE_FAULT,
        EventCode.ROUTE_STALE,
    }
)


def check_lines(events: Iterable[dict[str, Any]], link: str = "robot1") -> None:
    """Check a log's events, as JSON: each names its link, or its topic; a link's address follows "at".

    Raises:
        AssertionError: one does not.
    """
    events = list(events)
    assert events, "no lines to check"
    for event in events:
        if event["source"] in ("link", "route"):
            # Of a stream that comes after its connection's end, nobody knows whose it is.
            assert event["link"] == link or (event["code"], event["link"]) == (EventCode.LINK_REJECTED, ""), event
        if event["source"] == "link":
            assert _ADDRESS.search(event["text"]), event
        if event["source"] == "route":
            assert event["text"].startswith(f"{event['topic']}: "), event
        if event["code"] in _WARNINGS:
            assert event["level"] in ("WARNING", "ERROR"), event
