"""Answers of a server whose callers were not found yet."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.ros.api import RosError

if TYPE_CHECKING:
    from collections.abc import Callable

_FOUND_WITHIN = 10.0
"""s that a caller that has called may take to be found; one that has gone never is.

DDS says again every 3 s what was lost of its discovery. On one core beside 8 busy loops that took 6 s at most, of 190.
"""
_TRIED_EVERY = 0.2
"""s; a caller that is there, but not matched, holds up everybody for half of that."""
_MOST = 1000
_MOST_BYTES = 16 << 20
"""Of one server."""


class _Answer(NamedTuple):
    """One that is kept.

    Attributes:
        number: of the caller's request.
        payload: the response.
        since: s, monotonic.
    """

    number: int
    payload: bytes
    since: float


class LateAnswers:
    """Sends answers in order, caller by caller; those that cannot be sent it keeps, and tries again for a while."""

    def __init__(self, send: Callable[[bytes, int, bytes], bool]) -> None:
        """Begin with none.

        Args:
            send: sends an answer, given its caller, the number of the request and the response. Whether it could.
        """
        self._send = send
        self._kept: dict[bytes, deque[_Answer]] = {}
        self._tried_at = 0.0

    def send(self, caller: bytes, number: int, payload: bytes) -> bool:
        """Send an answer, else keep it. Whether it was sent.

        Raises:
            RosError: it cannot be sent at all, or there is no room to keep it.
        """
        if caller not in self._kept and self._send(caller, number, payload):
            return True
        sizes = [len(each.payload) for answers in self._kept.values() for each in answers]
        if len(sizes) >= _MOST or sum(sizes) + len(payload) > _MOST_BYTES:
            raise RosError(f"{len(sizes):,} answers wait for callers that DDS does not know; there is no room for more")
        self._kept.setdefault(caller, deque()).append(_Answer(number, payload, time.monotonic()))
        return False

    def try_again(self) -> bool:
        """Send those that can be sent now, and give up those that are too old. Whether some are left."""
        now = time.monotonic()
        if now >= self._tried_at + _TRIED_EVERY:
            self._tried_at = now
            for caller, answers in tuple(self._kept.items()):
                while answers and self._is_settled(caller, answers[0], now):
                    answers.popleft()
                if not answers:
                    del self._kept[caller]
        return bool(self._kept)

    def _is_settled(self, caller: bytes, answer: _Answer, now: float) -> bool:
        try:
            return now > answer.since + _FOUND_WITHIN or self._send(caller, answer.number, answer.payload)
        except RosError:
            return True  # whoever answered has gone on
