"""Leaving messages out, so that a topic keeps to its highest rate."""

from __future__ import annotations

_MOST_PUBLISHERS = 4096


class Throttle:
    """Decides message by message. Publishers may be told apart: then each has that rate to itself.

    Args:
        rate: messages a second; 0: all pass.
    """

    def __init__(self, rate: float) -> None:
        self._interval = int(1e9 / rate) if rate else 0
        self._due: dict[bytes, int] = {}

    def passes(self, stamp: int, publisher: bytes = b"") -> bool:
        """Whether a message passes that was received at `stamp` (ns)."""
        interval = self._interval
        if not interval:
            return True
        due = self._due.get(publisher, 0)
        late = stamp - due
        if -interval <= late < 0:  # farther ahead it is only if the clock was set back
            return False
        if len(self._due) >= _MOST_PUBLISHERS:
            self._due.clear()
        # Due times keep their own beat, so that a 50 Hz topic throttled to 20 Hz gives 20, not 16.7.
        self._due[publisher] = (due if late < interval else stamp) + interval
        return True
