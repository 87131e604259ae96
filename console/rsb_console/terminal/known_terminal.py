"""The facts of the present terminal, by its own answers.

Under dtach and the like a program outlives its terminal, and is attached to the next one. The environment describes the
first one only: a later one is known by its answers alone, and begins with an empty screen.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from rsb_console.terminal.pulse import multiplexer
from rsb_console.terminal.terminal_facts import TerminalFacts, can_be_asked, is_plain

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_ANSWERS_WITHIN: Final = 5.0
"""s after which a terminal that has not answered all questions counts as known. A round figure: over a slow line, the
first answers come behind a whole screen."""


class KnownTerminal:
    """Facts of one terminal after another.

    Args:
        facts: of the first terminal, by the environment.
        environ: the environment.

    Attributes:
        facts: of the present terminal.
        swallows: whether it ignores sequences that it does not know, instead of showing them.
    """

    def __init__(
        self, facts: TerminalFacts, environ: Mapping[str, str], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.facts = self._first = facts
        self.swallows = self._first_swallows = can_be_asked(environ)
        self._clock = clock
        self._kind: str | None = None
        self._first_kind: str | None = None
        self._next: TerminalFacts | None = None
        """Facts of the present terminal while its answers are not complete."""
        self._next_since = 0.0
        self._is_in_doubt = True

    def doubt(self) -> None:
        """Assume another terminal from now on. Signal handlers may call this."""
        self._is_in_doubt = True

    @property
    def is_in_doubt(self) -> bool:
        """Whether there may be another terminal, whose kind has not come yet."""
        return self._is_in_doubt

    @property
    def is_known(self) -> bool:
        """Whether the facts describe the present terminal."""
        asks = self._next is not None and self._clock() - self._next_since < _ANSWERS_WITHIN
        return not (self._is_in_doubt or asks)

    def is_news(self, kind: str) -> bool:
        """Whether the terminal that tells a kind may be another one than the last."""
        return self._is_in_doubt or kind != self._kind

    def meet(self, kind: str, cell: tuple[float, float] | None) -> bool:
        """Take the kind of the terminal that is there, and return whether it is to be asked for the rest.

        Args:
            kind: its answer to DA2, or empty if it has answered other questions only, or none.
            cell: pixels of a character, as the kernel knows them.
        """
        if not self.is_news(kind):
            return False
        self._is_in_doubt, self._kind = False, kind
        if self._first_kind is None:
            self._first_kind = kind
            self.facts = self.facts.of_kind(kind)
            return self.swallows and self.facts.can_be_asked_more
        if kind == self._first_kind:
            facts, self.swallows = replace(self._first, cell=cell), self._first_swallows
        else:
            # Multiplexers draw 256 colours with those that their terminal has.
            facts = TerminalFacts(colours=256 if multiplexer(kind, {}) else 16, cell=cell, ascii_only=is_plain(kind))
            self.swallows = not facts.ascii_only
        facts = facts.of_kind(kind)
        if self.swallows and facts.can_be_asked_more:
            self._next, self._next_since = facts, self._clock()
            return True
        self.facts, self._next = facts, None
        return False

    def take(self, answer: str) -> None:
        """Take an answer, given without its Escape."""
        if self._next is None:
            self.facts = self.facts.told(answer)
            return
        self._next = self._next.told(answer)
        if self._next.answered:  # the last of the questions
            self.facts, self._next = self._next, None
