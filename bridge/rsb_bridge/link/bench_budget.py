"""What a peer that measures the link may still cause here."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.benchmark import Leave

HOUR = 3600.0
_LITTLE_LEFT = ", and too little of that is left"


class BenchBudget:
    """One link's, for an hour from the first use on; then it begins anew.

    Args:
        now: the clock that all timers use, in s.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._began = float("-inf")
        self._seconds = self._bytes = 0.0
        self._wire = self._payload = 0
        self._full = False

    def refusal(self, leave: Leave | None, seconds: float = 0.0, size: float = 0.0, rate: float = 0.0) -> str:
        """Why nothing, or nothing of this kind, may be caused now; empty: it may.

        Args:
            leave: the limits that the session sets now, or None if nothing is allowed.
            seconds: s for which is to be sent.
            size: bytes that are to be sent.
            rate: Hz at which.
        """
        if leave is None:
            return "there is no leave to measure the link"
        self._renew()
        if rate > leave.max_rate:
            return f"a benchmark may send at most {leave.max_rate:g} messages a second (bench.max_rate)"
        if self._seconds >= leave.seconds or self._seconds + seconds > leave.seconds:
            return f"a benchmark may take at most {leave.seconds:g} s in an hour (bench.seconds){_LITTLE_LEFT}"
        most = leave.megabytes * 1e6
        if self._full or self._used() >= most or self._used() + size > most:
            return f"a benchmark may send at most {most / 1e6:g} MB in an hour (bench.megabytes){_LITTLE_LEFT}"
        return ""

    def spend(self, seconds: float, size: float) -> None:
        """So many s were used, and bytes."""
        self._renew()
        self._begin()
        self._seconds += seconds
        self._bytes += size

    def take(self, leave: Leave | None, *, wire: int = 0, payload: int = 0) -> bool:
        """Count bytes from the peer before they are used; return False if they exceed the peer's limits.

        Args:
            leave: the limits that the session sets now, or None if nothing is allowed.
            wire: bytes as they came, with headers and seals.
            payload: bytes of a message after decompression.
        """
        self._renew()
        most = 0.0 if leave is None else leave.megabytes * 1e6
        if self._full or self._bytes + max(self._wire + wire, self._payload + payload) > most:
            self._full = True
            return False
        self._begin()
        self._wire += wire
        self._payload += payload
        return True

    def _used(self) -> float:
        """Bytes that were sent for the peer, and of what it sent what is more: as it came, or unpacked."""
        return self._bytes + max(self._wire, self._payload)

    def _begin(self) -> None:
        if self._began == float("-inf"):
            self._began = self._now()

    def _renew(self) -> None:
        if self._now() - self._began >= HOUR:
            self._began = float("-inf")
            self._seconds = self._bytes = 0.0
            self._wire = self._payload = 0
            self._full = False
