"""Helpers of `test_late_requests` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tests.support import replaced

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest

    from rsb_bridge.control.remote_engine import RemoteEngine


def each_again(monkeypatch: pytest.MonkeyPatch, do: Callable[[Any], object]) -> None:
    """Do something with each command right before it is sent again."""
    send = replaced.ATTACHED_SEND.value
    sent: list[object] = []

    def send_request(remote: RemoteEngine, waiting: Any) -> None:
        if any(each is waiting for each in sent):
            do(waiting)
        sent.append(waiting)
        send(remote, waiting)

    replaced.ATTACHED_SEND.set(monkeypatch, send_request)


def slow_line(remote: RemoteEngine, monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    """Let the tickets that the console has grow old."""
    remote._ticket -= int(seconds * 1e3)
    replaced.ATTACHED_POLL.set(monkeypatch, lambda _: None)  # no further ticket comes by itself
