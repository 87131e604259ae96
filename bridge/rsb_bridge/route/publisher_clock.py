"""The age of messages by their publishers' stamps, as far as these can be right.

A publisher stamps its messages by the clock of its own host, which may be wrong. Two observations prove that: a stamp
in the future, and a stamp from before the subscription on a volatile topic, whose messages of that time never come. A
message of such a publisher counts from when the bridge took it. Its later messages are compared with the one that
took the shortest time by that clock: what a freeze or a queue holds up takes longer, and counts as older.

A stamp in the past proves nothing else: it may be a latched message, or one that was held up. So it is believed, and a
publisher whose clock is behind has its messages dropped, until its clock is set or the topic is opened again.
"""

from __future__ import annotations

_SANE = 50_000_000
"""ns by which a right clock may seem to be wrong."""
_DRIFT = 5e-4
"""ns a ns by which a publisher's clock may run slower or faster, while it is being corrected, too."""
_MOST_PUBLISHERS = 1024


class PublisherClocks:
    """The clocks of one topic's publishers, or of one service's callers. All times are in ns.

    Attributes:
        since: when the subscription began, or None if messages from before it may come.
    """

    def __init__(self) -> None:
        self.since: int | None = None
        self._wrong: dict[bytes, tuple[int, int]] = {}  # the shortest time that a message took, and when that was

    def __len__(self) -> int:
        return len(self._wrong)

    def born(self, source: int, taken: int, publisher: bytes) -> int:
        """Return the time from which a message's age counts; it is not later than `taken`.

        Args:
            source: when it was published, by its publisher's clock, or 0 if that is unknown.
            taken: when it came here.
            publisher: an id.
        """
        if not source:
            return taken
        took = taken - source
        known = self._wrong.get(publisher)
        if known is None:
            if took >= -_SANE and (self.since is None or source >= self.since - _SANE):
                return min(source, taken)
            if len(self._wrong) >= _MOST_PUBLISHERS:
                del self._wrong[next(iter(self._wrong))]
            self._wrong[publisher] = took, taken
            return taken
        shortest, at = known
        shortest = min(took, shortest + int(_DRIFT * max(0, taken - at)))
        if abs(shortest) <= _SANE:
            del self._wrong[publisher]  # its clock has been set
            return min(source, taken)
        self._wrong[publisher] = shortest, taken
        return source + shortest

    def forget(self) -> None:
        """Forget all measurements, because this side's clock was set.

        From then on, a stamp from before the subscription may come from the old clock, and proves nothing.
        """
        self._wrong.clear()
        self.since = None
