"""The terminal's pulse: questions that it answers in order with its keys, so that an app or a command knows late keys.

A key says nothing about when it was pressed: a hung SSH connection or a stopped process delivers it many seconds later,
as if it were new. But a terminal answers a question (DSR, the position of the cursor) at once, and the answer stands
between the keys that were pressed before it and after it. So a key is as young as the last question that was answered
before it, or younger.

The question moves the cursor to a place of its own first. The answer repeats the place, so an answer that is lost
makes no other one look younger.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import termios
import threading
import time
import tty
from collections import deque
from typing import TYPE_CHECKING, Any, Final, Self

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

ASKED_EVERY = 0.25
"""s between two questions while a key could drive, or say yes to what may move a robot."""
ASKED_AT_REST = 0.5
"""The same while no screen is open whose keys have an effect, and a round trip takes no longer than `ASKED_EVERY`: then
keys are young as well, and on a slow line the questions are a third of what a console at rest sends."""
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
_ALL_OPEN_AT_MOST = 2 * _OPEN_AT_MOST
"""Questions without an answer, also of a terminal that may have been replaced meanwhile. Many fewer than the places, so
that a late answer is not taken for one to a newer question at the same place."""
_SEVERAL_FOR = 5.0
"""s after a second answer to the same question for which several terminals count as attached. A round figure."""
_SOONER = 0.02
"""s by which an answer comes sooner than half of the shortest time so far, so that another program may give it."""

WHO_ARE_YOU: Final = "\x1b[>c"
"""Asks for the kind of the terminal (DA2)."""
KIND = re.compile(r"\x1b\[>(?P<kind>[\d;]*)c")
_ANSWERS = re.compile(rf"\x1b\[\d+;\d+R|{KIND.pattern.replace('?P<kind>', '')}")
_KINDS: Final = {"84": "tmux", "83": "GNU screen", "1;10;0": "mosh"}
"""The kinds of programs that answer for the terminal: all of the answer, or its first number."""
_VARIABLES: Final = {"TMUX": "tmux", "STY": "GNU screen", "ZELLIJ": "zellij"}
"""The same by environment variables."""
_READ_SIZE = 4096
_LOOKS, _LOOK_EVERY = 6, 0.05
"""Looks at the end for the terminal's last answer, which would go to the shell; and s between them: 0.3 s in all, as in
the console."""
_LONGEST_ANSWER = 16
"""Bytes, more than any answer has: a longer rest after an Escape is no answer that has come in part."""
_TYPED_PIECES: Final = re.compile(
    rb"\x1b\[(?P<row>\d+);(?P<column>\d+)R|" + KIND.pattern.encode() + rb"|(?P<line>[\r\n])|(?P<end>\x04)"
)
_LOCAL_MODES = 3
"""The place of the local modes in `termios.tcgetattr`."""


class Pulse:
    """Questions to one terminal, and its answers. `answered` may be called from another thread than `question`.

    dtach and the like pass on what one terminal says, and another time another one, or several at once. So a terminal
    that tells its kind is asked for it with each question: the newest kind counts.

    Args:
        environ: the environment, which names some multiplexers.

    Attributes:
        asked: when the newest question was asked.
        round_trip: s that the last answer took, or None before the first one.
    """

    def __init__(self, environ: Mapping[str, str], clock: Callable[[], float] = time.monotonic) -> None:
        self.asked = float("-inf")
        self.round_trip: float | None = None
        self._clock = clock
        self._heard = self._doubted_at = self._several_until = float("-inf")
        self._open: deque[tuple[tuple[int, int], float]] = deque()
        self._answered: deque[tuple[int, int]] = deque(maxlen=_OPEN_AT_MOST)
        # The driver reads answers on a thread of its own, while the app asks.
        self._lock = threading.Lock()
        self._next = 0
        self._began = clock()
        self._is_in_multiplexer = bool(multiplexer("", environ))
        self._is_multiplexer = self._tells_kind = False
        self._shortest = 0.0

    @property
    def relayed(self) -> bool:
        """Whether answers prove nothing about keys: a multiplexer, one of several terminals, or nobody gives them."""
        is_multiplexer = self._is_in_multiplexer or self._is_multiplexer
        return is_multiplexer or self._is_mute or self.is_shared

    @property
    def _is_mute(self) -> bool:
        return self.round_trip is None and self._clock() - self._began > ANSWERS_WITHIN

    @property
    def heard(self) -> float:
        """When the question was asked that was answered last, or minus infinity if another terminal may be there."""
        return self._heard if self._heard >= self._doubted_at else float("-inf")

    @property
    def heard_now(self) -> float:
        """When the question was asked that was answered last, or infinity for a terminal that gives no answers."""
        return float("inf") if self._is_mute else self.heard

    @property
    def is_doubted(self) -> bool:
        """Whether another terminal may be there, which has not answered yet."""
        return self._heard < self._doubted_at and not self._is_mute

    @property
    def doubted_for(self) -> float:
        """Seconds for which another terminal may be there that has not answered, or 0."""
        return self._clock() - self._doubted_at if self.is_doubted else 0.0

    @property
    def is_shared(self) -> bool:
        """Whether several terminals are attached, which answer the same questions."""
        return self._clock() < self._several_until

    def doubt(self) -> None:
        """Note that another terminal may be there from now on: no key counts before it has answered.

        Signal handlers may call this, so it takes no lock.
        """
        self._doubted_at = self._clock()

    def is_over(self, moment: float) -> bool:
        """Whether the terminal has sent nothing more of the keys that began to arrive at a moment (s).

        It has answered a later question by then. Where answers prove nothing, or nobody asks, `FRESH_FOR` has to pass.
        """
        if self.relayed or self.asked < moment:
            return self._clock() - moment > FRESH_FOR
        return self.heard >= moment

    @property
    def waits(self) -> bool:
        """Whether an answer is due from a terminal that gives answers."""
        return bool(self._open) and self.round_trip is not None

    @property
    def asks_kind(self) -> bool:
        """Whether the next question is to ask for the kind, too: some terminals print what they do not know."""
        oldest = next((at for _, at in self._open), float("inf"))
        return self._tells_kind or self.is_doubted or self._clock() - oldest > FRESH_FOR

    def is_due(self, *, at_rest: bool) -> bool:
        """Whether it is time for the next question, unless something else has just asked.

        Args:
            at_rest: whether no screen is open whose keys have an effect.
        """
        is_quick = self.round_trip is not None and self.round_trip < ASKED_EVERY
        every = ASKED_AT_REST if at_rest and is_quick else ASKED_EVERY
        return self._clock() - self.asked > every - ASKED_EVERY / 2

    def question(self) -> str:
        """Return the next question to write, or an empty string if too many wait for an answer."""
        now = self._clock()
        with self._lock:
            if self._open and now - self._open[0][1] > _GIVEN_UP_AFTER:
                self._open.clear()
            to_this_terminal = sum(at >= self._doubted_at for _, at in self._open)
            if to_this_terminal >= _OPEN_AT_MOST or len(self._open) >= _ALL_OPEN_AT_MOST:
                return ""
            row, column = place = _PLACES[self._next]
            self._next = (self._next + 1) % len(_PLACES)
            self._open.append((place, now))
            self.asked = now
        return f"\x1b7\x1b[{row};{column}H\x1b[6n\x1b8"

    def answered(self, row: int, column: int) -> float | None:
        """Take an answer, and return when its question was asked, or None if nobody has asked.

        A second answer to a question makes `relayed`, another one changes nothing.
        """
        place, now = (row, column), self._clock()
        with self._lock:
            asked = next((at for known, at in self._open if known == place), None)
            if asked is None:
                # What one terminal answers proves nothing about the keys of another one.
                self._several_until = now + _SEVERAL_FOR if place in self._answered else self._several_until
                return None
            # Answers come in order, so questions before this one will get none.
            while self._open.popleft()[0] != place:
                pass
            self._answered.append(place)
            self._heard, took = asked, now - asked
            was_shortest = took if self.round_trip is None else self._shortest
            if not self._tells_kind and took < was_shortest / 2 - _SOONER:
                self.doubt()  # a multiplexer may be there now, which is nearer than the terminal
            self.round_trip, self._shortest = took, min(took, was_shortest)
        return asked

    def take_kind(self, kind: str) -> None:
        """Take the terminal's kind, as it answers `WHO_ARE_YOU`."""
        self._tells_kind = True
        self._is_multiplexer = bool(multiplexer(kind, {}))

    def stamp(self, event: object) -> None:
        """Note how young an event from the terminal is, for `heard_before`."""
        vars(event)["heard"] = self.heard_now


def multiplexer(kind: str, environ: Mapping[str, str]) -> str:
    """Return the name of what answers for a terminal, by its kind or the environment, or an empty string."""
    by_kind = _KINDS.get(kind) or _KINDS.get(kind.partition(";")[0], "")
    return by_kind or next((name for variable, name in _VARIABLES.items() if environ.get(variable)), "")


def without_answers(pasted: str) -> str:
    """Return a pasted text without answers to questions.

    The terminal may have given them in the midst of it, or the text contains them: so they prove nothing, and count as
    lost.
    """
    return _ANSWERS.sub("", pasted)


def is_from_terminal(event: object) -> bool:
    """Whether a terminal has sent an event, and not this program."""
    return "heard" in vars(event)


def heard_before(event: object) -> float:
    """Return when the last question was asked that was answered before an event.

    It is infinity for a terminal that gives no answers, and for events from no terminal.
    """
    heard: float = vars(event).get("heard", float("inf"))
    return heard


class TypedKeys:
    """Lines on standard input that an operator types for a command in a shell, until its end. To be used as a context.

    On a terminal, the terminal itself is asked, as in the console. It answers without a newline, so standard input is
    read key by key meanwhile, and not echoed.

    Args:
        environ: the environment, which names some multiplexers.
    """

    def __init__(self, fd: int, environ: Mapping[str, str], clock: Callable[[], float] = time.monotonic) -> None:
        self._fd = fd
        self._clock = clock
        self._pulse = Pulse(environ, clock)
        self._modes: list[Any] | None = None
        self._terminal = -1
        self._begun = b""
        self._ended = False

    def __enter__(self) -> Self:
        if os.isatty(self._fd):
            with contextlib.suppress(OSError, termios.error):  # then its keys count, as if it gave no answers
                self._modes = termios.tcgetattr(self._fd)
                # A descriptor of its own: a terminal that hangs must not block the write, but O_NONBLOCK on standard
                # input would hold for the shell, too.
                self._terminal = os.open(os.ttyname(self._fd), os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
        return self

    def __exit__(self, *_exception: object) -> None:
        """Take the last answer, which the shell would take for keys, and give the terminal back as it was."""
        for _look in range(_LOOKS):
            if not self._pulse.waits or self._ended:
                break
            self._is_typed(_LOOK_EVERY)
        if self._modes is not None and self._is_in_foreground:
            with contextlib.suppress(termios.error):  # at once: a terminal that hangs takes no output
                termios.tcsetattr(self._fd, termios.TCSANOW, self._modes)
                termios.tcflush(self._fd, termios.TCIFLUSH)
        if self._terminal >= 0:
            os.close(self._terminal)

    def wait(self, seconds: float) -> bool:
        """Ask the terminal, and wait for a young line for at most some seconds; return whether one came."""
        self._ask()
        return self._is_typed(seconds)

    @property
    def _is_in_foreground(self) -> bool:
        """Whether this process may change the terminal: in the background it would be stopped."""
        try:
            return os.tcgetpgrp(self._fd) == os.getpgrp()
        except OSError:
            return False

    def _ask(self) -> None:
        if self._terminal < 0 or not self._is_in_foreground:
            return
        with contextlib.suppress(OSError, termios.error):  # a terminal that takes nothing gives no answers
            if termios.tcgetattr(self._fd)[_LOCAL_MODES] & termios.ICANON:  # at first, and after Ctrl-Z
                tty.setcbreak(self._fd, termios.TCSANOW)
            kind = WHO_ARE_YOU if self._pulse.asks_kind else ""
            if question := self._pulse.question():
                os.write(self._terminal, (kind + question).encode())

    def _is_typed(self, seconds: float) -> bool:
        """Whether a young line comes within some seconds."""
        if not select.select([] if self._ended else [self._fd], [], [], seconds)[0]:
            return False
        try:
            data = os.read(self._fd, _READ_SIZE)
        except OSError:  # the terminal is gone
            data = b""
        self._ended = not data
        return self._receive(data)

    def _receive(self, data: bytes) -> bool:
        """Take keys and answers, in their order; return whether there was a young line."""
        data, is_young, done = self._begun + data, False, 0
        for piece in _TYPED_PIECES.finditer(data):
            if piece["row"] is not None:
                self._pulse.answered(int(piece["row"]), int(piece["column"]))
            elif piece["kind"] is not None:
                self._pulse.take_kind(piece["kind"].decode())
            elif piece["line"] is not None:
                # A pipe answers no questions, so its lines count.
                is_young |= self._terminal < 0 or self._clock() - self._pulse.heard_now < FRESH_FOR
            # Ctrl-D: without line editing, the kernel passes it on as a byte. In a pipe it is one of the data.
            elif self._terminal >= 0:
                self._ended = True
            done = piece.end()
        # Behind the last piece, so that a line after an arrow key does not count again with each further key.
        start = data.rfind(b"\x1b", done)
        is_cut = start >= 0 and len(data) - start < _LONGEST_ANSWER
        self._begun = data[start:] if is_cut else b""
        return is_young
