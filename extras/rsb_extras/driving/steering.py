"""The velocity that an operator's keys mean, and for how long; and which of them may be too old to mean anything."""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

APART_AT_MOST = 0.3
"""s between two bunches of keys on a line that can drive. mosh sends each half round trip, at most each 0.25 s."""
_KEY_LASTS = 0.6
"""s for which a key counts: a held key repeats after up to 0.5 s for the first time."""
_BURST, _BURST_SECONDS = 10, 0.1
"""Keys in so short a time were held up on their way: people and keyboards repeat them more slowly."""
_IGNORED_FOR = 0.3
"""s after a burst in which keys are ignored."""
_TOGETHER = 0.02
"""s between keys of one bunch. Keyboards repeat every 0.03 s."""
_PAUSE = 0.15, 0.7
"""s until a held key repeats for the first time, at least and at most: 0.66 is X11's default, the longest of the usual
ones."""
_REPEATS = _TOGETHER, 0.1
"""s from one repeat of a held key to the next, at least and at most; 0.03 to 0.04 are usual."""
_EVEN = 3
"""Bunches in a row that come evenly, with which a motion begins. Late keys come all at once, or in parts of which each
is larger than the one before (TCP's slow start)."""
_ROOM = 1.0
"""s of repeats that may come at once: what a gap holds up that a motion may outlive, and more than any bunch."""
_BROKEN_AFTER = 1.0
"""s without a key after which a held key has to be let go, and held again. A key that has waited for longer is late in
a terminal that answers, too (`FRESH_FOR`)."""
_STOOD_STILL = 1.0
"""s without a look at the keys after which this process stood still: keys that waited for it are ignored."""
_SPEED, _TURN = 0.2, 0.5
"""m/s and rad/s to begin with. Round figures: nothing was measured."""
_LEAST_SPEED, _MOST_SPEED = 0.02, 2.0
"""m/s. Round figures; limits of a robot are its own (`rsb_bridge.model.by_hand.VelocityLimits`)."""
WAYS = {
    "up": (1, 0), "down": (-1, 0), "left": (0, 1), "right": (0, -1),
    "i": (1, 0), "comma": (-1, 0), "j": (0, 1), "l": (0, -1),
    "u": (1, 1), "o": (1, -1), "m": (-1, -1), "full_stop": (-1, 1),
}  # fmt: skip
"""Forward and turn, counterclockwise, of each key, with the letters of teleop_twist_keyboard."""
STOPS = {"k", "space"}


class Rhythm:
    """The rhythm of keys whose age nothing proves: whether a hand holds one of them now.

    A held key comes once, after a pause again, and then evenly. A line may bring it in bunches, as mosh does: these are
    even, too, with as many keys as a hand repeats meanwhile. Keys that have waited come too many at once, or unevenly.

    Attributes:
        is_broken: whether the key has to be let go before it can begin a motion.
    """

    def __init__(self) -> None:
        self._full_at = float("-inf")
        self.forget()

    def forget(self) -> None:
        """Ask for a key that is held anew."""
        self._begin("", float("-inf"))

    def _begin(self, key: str, now: float) -> None:
        self._key = key
        self._keys, self._began, self._after = 1, now, 0.0
        """Of the newest bunch: its keys, its begin, and s since the begin of the bunch before."""
        self._paused_for = 0.0
        self._is_first_repeat = False
        self._bunches: deque[tuple[int, float]] = deque(maxlen=_EVEN)
        """Keys of the bunches after that with the first repeat, and s since the bunch before."""
        self.is_broken = False

    @property
    def apart(self) -> float:
        """Seconds from one bunch to the next, or 0 if keys come one by one."""
        is_bunched = any(keys > 1 for keys, _ in self._bunches)
        return sum(after for _, after in self._bunches) / len(self._bunches) if is_bunched else 0.0

    def is_burst(self, now: float) -> bool:
        """Take the time (s) of a key, and return whether there are more by now than a hand repeats."""
        full_at = max(self._full_at, now - _ROOM) + _REPEATS[0]
        self._full_at = min(full_at, now)
        return full_at > now

    def is_held(self, key: str, now: float) -> bool:
        """Take a key at a time (s), and return whether a hand holds it by now."""
        after = now - self._began
        if key != self._key or after >= _BROKEN_AFTER:
            self._begin(key, now)
            return False
        if after < _TOGETHER:
            self._keys += 1
            self.is_broken |= not self._paused_for
            return False
        bunch = self._keys, self._after
        self._keys, self._began, self._after = 1, now, after
        return self._follows(*bunch, after)

    def _follows(self, keys: int, after: float, next_after: float) -> bool:
        """Take a bunch that is over, s after the one before and before the next; return whether the key is held."""
        if keys == 1 and next_after > _PAUSE[0]:
            self._paused_for, self._is_first_repeat, self.is_broken = next_after, True, False
            self._bunches.clear()
            return False
        if not self._paused_for:
            self.is_broken = True
            return False
        if self._is_first_repeat:
            self._is_first_repeat = False
            is_one_by_one = keys == 1 and _REPEATS[0] <= next_after <= _REPEATS[1]
            return is_one_by_one and self._paused_for < _PAUSE[1]
        self._bunches.append((keys, after))
        return self._is_even()

    def _is_even(self) -> bool:
        counts, seconds = zip(*self._bunches, strict=True)
        rate = sum(counts) / sum(seconds)
        ahead = [keys - rate * after for keys, after in self._bunches]
        grows = all(a < b for a, b in pairwise(counts))
        return (
            len(counts) == _EVEN
            and max(seconds) <= APART_AT_MOST
            and 1 / _REPEATS[1] <= rate <= 1 / _REPEATS[0]
            and max(ahead) - min(ahead) <= 1 + sum(counts) / _EVEN / 4
            and not grows
        )


class Steering:
    """The velocity that the operator's keys mean.

    Args:
        relayed: gives whether late keys may look young, because a multiplexer stands between them and this process.

    Attributes:
        rhythm: of the keys, where they may look young.
        speed: m/s of a key.
        turn: rad/s of a key.
    """

    def __init__(self, relayed: Callable[[], bool] = lambda: False) -> None:
        self._relayed = relayed
        self.rhythm = Rhythm()
        self.speed, self.turn = _SPEED, _TURN
        self._forward = self._left = 0
        self._forward_until = self._left_until = 0.0
        self._times: deque[float] = deque(maxlen=_BURST)
        self._ignored_until = 0.0
        self._waits_until = 0.0
        self._looked_at = float("inf")

    def press(self, key: str, now: float) -> None:
        """Take a key at `now` (s)."""
        self._note_time(now)
        if self._is_burst(now):
            self._ignored_until = now + _IGNORED_FOR
        if key in STOPS or now < self._ignored_until:
            self._forward_until = self._left_until = self._waits_until = 0.0
            self.rhythm.forget()
            return
        if self._relayed() and not self._is_held(key, now):
            self._waits_until = now + _KEY_LASTS
            return
        forward, left = WAYS[key]
        if forward:
            self._forward, self._forward_until = forward, now + _KEY_LASTS
        if left:
            self._left, self._left_until = left, now + _KEY_LASTS

    def _is_burst(self, now: float) -> bool:
        if self._relayed():
            return self.rhythm.is_burst(now)
        self._times.append(now)
        return len(self._times) == _BURST and now - self._times[0] < _BURST_SECONDS

    def _is_held(self, key: str, now: float) -> bool:
        """Whether a key counts though it may have come late: a hand holds it, or the robot moves."""
        begins = self.rhythm.is_held(key, now)
        return begins or now < max(self._forward_until, self._left_until)

    def _note_time(self, now: float) -> None:
        if now - self._looked_at > _STOOD_STILL:
            self._ignored_until = now + _IGNORED_FOR
            self._forward_until = self._left_until = 0.0
        self._looked_at = now

    def came_late(self, now: float) -> bool:
        """Whether keys are ignored at `now` (s)."""
        return now < self._ignored_until

    def waits(self, now: float) -> bool:
        """Whether a key has come that does not count yet."""
        return now < self._waits_until

    def change_speed(self, factor: float) -> None:
        speed = max(_LEAST_SPEED, min(_MOST_SPEED, self.speed * factor))
        # Both by one factor, so that a curve stays the same curve.
        self.turn *= speed / self.speed
        self.speed = speed

    def at(self, now: float) -> tuple[float, float]:
        """Return the velocity at `now` (s): forward in m/s, turn in rad/s. To be asked several times a second."""
        self._note_time(now)
        forward = self._forward * self.speed if now < self._forward_until else 0.0
        return forward, self._left * self.turn if now < self._left_until else 0.0
