"""The terminal's pulse: questions that it answers by itself, in order with its keys, so that late keys are known.

A key says nothing about when it was pressed: a hung SSH connection or a stopped process delivers it many seconds later,
as if it were new. But a terminal answers a question (DSR, the position of the cursor) at once, and the answer stands
between the keys that were pressed before it and after it. So a key is as young as the last question that was answered
before it, or younger.

The question moves the cursor to a place of its own first. The answer repeats the place, so an answer that is lost
makes no other one look younger.
"""

from __future__ import annotations

import re
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

ASKED_EVERY = 0.25
"""s between two questions while something can be driven or armed."""
FRESH_FOR = 1.0
"""s after a question, once it is answered, for which keys count. As `ASKED_EVERY` of it passes until the next question,
a line may have a round trip of 0.7 s."""
ANSWERS_WITHIN = 2.0
"""s after which a terminal that has never answered counts as one that answers no questions. One that
takes longer to answer has late keys anyway."""
_OPEN_AT_MOST = 8
"""Questions without an answer: a terminal that hangs gets no more of them. They are 2 s of questions, so that any line
whose keys can count has fewer on the way."""
_GIVEN_UP_AFTER = 30.0
"""s after which such questions count as lost, and others are asked. A round figure: a terminal that has lost questions,
but works again, has its keys refused for so long."""
_PLACES: Final = tuple((row, column) for row in range(2, 6) for column in range(2, 17))
"""Rows and columns of the questions. Each terminal has them: a smaller one would answer with its last column for all
beyond, and its keys would count as late. In the first row, the answer could be F3 with a modifier."""

WHO_ARE_YOU: Final = "\x1b[>c"
"""Asks for the kind of the terminal (DA2)."""
KIND = re.compile(r"\x1b\[>(?P<kind>[\d;]*)c")
_POSITION = re.compile(r"\x1b\[(\d+);(\d+)R")
_MULTIPLEXERS: Final = re.compile(r"(84|83)(;|$)|1;10;0$")
"""The kinds of tmux, GNU screen, and mosh."""
_ENVIRONMENT: Final = ("TMUX", "STY", "ZELLIJ")


class Pulse:
    """Questions to one terminal, and its answers. `answered` may be called from another thread than `question`.

    Args:
        environ: the environment, which names some multiplexers.

    Attributes:
        heard: when the question was asked that was answered last, or minus infinity.
        round_trip: s that its answer took, or None before the first one.
    """

    def __init__(self, environ: Mapping[str, str], clock: Callable[[], float] = time.monotonic) -> None:
        self.heard = float("-inf")
        self.round_trip: float | None = None
        self._clock = clock
        self._open: deque[tuple[tuple[int, int], float]] = deque()
        # The driver reads answers on a thread of its own, while the app asks.
        self._lock = threading.Lock()
        self._next = 0
        self._began = clock()
        self._is_multiplexer = any(environ.get(name) for name in _ENVIRONMENT)

    @property
    def relayed(self) -> bool:
        """Whether answers prove nothing about keys: a multiplexer gives them, or nobody does."""
        return self._is_multiplexer or self._is_mute

    @property
    def _is_mute(self) -> bool:
        return self.round_trip is None and self._clock() - self._began > ANSWERS_WITHIN

    @property
    def heard_now(self) -> float:
        """When the question was asked that was answered last, or infinity for a terminal that gives no answers."""
        return float("inf") if self._is_mute else self.heard

    @property
    def waits(self) -> bool:
        """Whether an answer is due from a terminal that gives answers."""
        return bool(self._open) and self.round_trip is not None

    def question(self) -> str:
        """Return the next question to write, or an empty string if too many wait for an answer."""
        now = self._clock()
        with self._lock:
            if self._open and now - self._open[0][1] > _GIVEN_UP_AFTER:
                self._open.clear()
            if len(self._open) >= _OPEN_AT_MOST:
                return ""
            row, column = place = _PLACES[self._next]
            self._next = (self._next + 1) % len(_PLACES)
            self._open.append((place, now))
        return f"\x1b7\x1b[{row};{column}H\x1b[6n\x1b8"

    def answered(self, row: int, column: int) -> None:
        """Take an answer. One that nobody has asked for changes nothing."""
        place = row, column
        with self._lock:
            asked = next((at for known, at in self._open if known == place), None)
            if asked is None:
                return
            # Answers come in order, so questions before this one will get none.
            while self._open.popleft()[0] != place:
                pass
            self.heard, self.round_trip = asked, self._clock() - asked

    def is_kind(self, kind: str) -> None:
        """Take the terminal's kind, as it answers `WHO_ARE_YOU`."""
        self._is_multiplexer |= _MULTIPLEXERS.match(kind) is not None

    def without_answers(self, pasted: str) -> str:
        """Return a pasted text without the answers that came in the midst of it, and take these."""

        def take(found: re.Match[str]) -> str:
            self.answered(int(found[1]), int(found[2]))
            return ""

        return _POSITION.sub(take, pasted)

    def stamp(self, event: object) -> None:
        """Note how young an event from the terminal is, for `heard_before`."""
        vars(event)["heard"] = self.heard_now


def is_from_terminal(event: object) -> bool:
    """Whether a terminal has sent an event, and not this program."""
    return "heard" in vars(event)


def heard_before(event: object) -> float:
    """Return when the last question was asked that was answered before an event.

    It is infinity for a terminal that gives no answers, and for events from no terminal.
    """
    heard: float = vars(event).get("heard", float("inf"))
    return heard
