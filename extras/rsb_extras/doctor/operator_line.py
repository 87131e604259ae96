"""Findings about the operator's line: how long a terminal takes to answer, and what comes to it in a second.

The terminal answers a question (DSR, the position of the cursor) once it has read all that was written before. So the
time of the answer tells the round trip, and with many bytes before the question, how fast the line carries them. The
bytes choose colours, in which nothing is written. Many questions, one soon after the other, tell whether their answers
come one by one or in bunches. Where a program such as mosh gives the answers, a key that is held tells it.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import sys
import termios
import time
import tty
from functools import partial
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from rsb_bridge.feature_api import Check, Finding, Grade, Wording
from rsb_console.notation.formats import byte_rate
from rsb_console.terminal.pulse import ANSWERS_WITHIN, ASKED_EVERY, FRESH_FOR, multiplexer
from rsb_console.terminal.terminal_facts import ask, facts_before_answers

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from rsb_console.terminal.terminal_facts import TerminalFacts

_QUESTION: Final = b"\x1b[6n"
_ANSWER: Final = re.compile(rb"\x1b\[\d+;\d+R")
_PLAIN: Final = b"\x1b[m"
_COLOUR_SIZE: Final = len(b"\x1b[30;40m")
_ROUND_TRIPS: Final = 3
"""Questions for the round trip, of which the fastest counts: the machine may be busy."""
_SIZES: Final = tuple(64 * 4**step for step in range(6))
_LONG_ENOUGH: Final = 0.09
"""s that bytes take beyond the round trip, after which no more are written. They take 0.5 s in all at most, as each
size is four times the one before."""
_LOOK_EVERY: Final = 0.05
_TOGETHER: Final = 0.01
"""s between two arrivals of one bunch. Keyboards repeat every 0.03 s."""
_ASKED_APART: Final = 0.03
"""s between two questions: as between two repeats of a key."""
_WATCHED_FOR, _WHILE_KEYS_COME = 1.0, 3.0
"""s for which arrivals are watched, and for which they are at most while a key is held: keyboards begin to repeat after
0.2 to 0.7 s, and mosh brings a bunch each 0.02 to 0.25 s."""
_LEAST_BUNCHES: Final = 3
_BUNCHED: Final = 1.5
"""Arrivals in a bunch from which on a line bunches: a busy machine brings two at once now and then."""
_SLOW: Final = 2_000.0
"""Bytes/s below which a refresh at the usual rates leaves keys little room. A round figure."""


class LineText(Wording):
    """Findings about the operator's line, and remedies."""

    NONE = "no terminal: standard input or output is a file or a pipe"
    NOT_ASKED = "TERM is {term!r}: such a terminal is asked nothing"
    MUTE = "the terminal answers nothing within {seconds:.0f} s, so that round trip and rate cannot be measured"
    MUTE_REMEDY = "docs/lines.md says what the console does there"
    RELAYED = "{name} answers for the terminal: round trip and rate of the line to it cannot be measured: {facts}"
    LINE = "round trip {round_trip:.0f} ms, {rate}: {facts}"
    BUNCHES = ", {what} come in bunches of {size:.0f}, each {apart:.2f} s"
    HOLD = "run rsb-console doctor without {name}, or hold a key while it runs: that tells how keys come"
    BUNCHED = "to drive, hold a key until the robot moves: one press moves nothing"
    FAST = "more than {rate}"
    FAR = "use a shorter way: with a round trip of more than {most:.2f} s no key drives, arms or agrees"
    SLOW = "press - in the console, or set refresh_rate: 0.5 in console.yaml; docs/lines.md has more"


class Line(NamedTuple):
    """A measured line.

    Attributes:
        round_trip: s.
        rate: bytes/s, or None if it is more than `_SIZES` can tell.
    """

    round_trip: float
    rate: float | None


class Bunches(NamedTuple):
    """How a line brings what was sent one by one.

    Attributes:
        what: ``keys`` or ``answers``.
        size: mean number in a bunch.
        apart: s from one bunch to the next, the median.
    """

    what: str
    size: float
    apart: float

    @classmethod
    def found(cls, what: str, times: Sequence[float]) -> Bunches | None:
        """Return the bunches in which things arrived at some times (s), or None if they came one by one."""
        begins = [now for before, now in pairwise((float("-inf"), *times)) if now - before > _TOGETHER]
        # The first may be the press itself, and the last one cut short.
        if len(begins) < _LEAST_BUNCHES + 2:
            return None
        size = sum(begins[1] <= each < begins[-1] for each in times) / (len(begins) - 2)
        apart = median(after - before for before, after in pairwise(begins[1:]))
        return cls(what, size, apart) if size >= _BUNCHED else None


class BunchTimes(NamedTuple):
    """Times (s) at which answers and keys came."""

    answers: list[float]
    keys: list[float]

    @property
    def bunches(self) -> Bunches | None:
        """The bunches in which they came: keys count before answers, which may be another program's."""
        return Bunches.found("keys", self.keys) or Bunches.found("answers", self.answers)


def line_check(environ: Mapping[str, str]) -> Check:
    """Return the check of the line to the terminal of this command."""
    return Check("line", "operator's line", partial(_line, environ))


def _line(environ: Mapping[str, str]) -> Iterator[Finding]:
    found = partial(Finding, "line", subject="operator's line")
    term = environ.get("TERM", "")
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        yield found(grade=Grade.UNKNOWN, text=LineText.NONE())
    elif term in {"", "dumb", "unknown"}:
        yield found(grade=Grade.UNKNOWN, text=LineText.NOT_ASKED(term=term))
    else:
        with AskedTerminal(sys.stdin.fileno()) as terminal:
            line = terminal.measure()
            arrivals = BunchTimes([], []) if line is None else terminal.watch()
        facts = facts_before_answers(environ, 1)
        if line is not None:
            facts = ask(facts, environ, 0, 1)
        yield finding(line, facts, environ, arrivals.bunches)


def finding(
    line: Line | None, facts: TerminalFacts, environ: Mapping[str, str], bunches: Bunches | None = None
) -> Finding:
    """Return what was found out about a line, or the reason why nothing was, if there is none."""
    name = multiplexer(facts.kind, environ)
    data: dict[str, Any] = {
        "answers": line is not None, "name": facts.name, "kind": facts.kind, "multiplexer": name,
        "colours": facts.colours, "pixels": facts.pixels, "round_trip": None, "bytes_per_second": None,
        "bunches": None if bunches is None else bunches._asdict(),
    }  # fmt: skip
    found = partial(Finding, "line", subject="operator's line", facts=data)
    if line is None:
        text = LineText.MUTE(seconds=ANSWERS_WITHIN)
        return found(grade=Grade.UNKNOWN, text=text, remedy=LineText.MUTE_REMEDY())
    shown = facts.line()
    if bunches is not None:
        shown += LineText.BUNCHES(what=bunches.what, size=bunches.size, apart=bunches.apart)
    if name:
        remedy = LineText.HOLD(name=name) if bunches is None else LineText.BUNCHED()
        return found(grade=Grade.UNKNOWN, text=LineText.RELAYED(name=name, facts=shown), remedy=remedy)
    data |= {"round_trip": line.round_trip, "bytes_per_second": line.rate}
    most = FRESH_FOR - ASKED_EVERY
    fast = LineText.FAST(rate=byte_rate(_SIZES[-1] / _LONG_ENOUGH))
    rate = fast if line.rate is None else byte_rate(line.rate)
    text = LineText.LINE(round_trip=line.round_trip * 1e3, rate=rate, facts=shown)
    if line.round_trip > most:
        return found(grade=Grade.WARNING, text=text, remedy=LineText.FAR(most=most))
    if line.rate is not None and line.rate < _SLOW:
        return found(grade=Grade.NOTE, text=text, remedy=LineText.SLOW())
    if bunches is not None:
        return found(grade=Grade.NOTE, text=text, remedy=LineText.BUNCHED())
    return found(grade=Grade.OK, text=text)


class AskedTerminal:
    """A terminal whose answers are timed. A context manager: meanwhile the terminal echoes nothing.

    Args:
        read_from: its file descriptor.
    """

    def __init__(self, read_from: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._fd = read_from
        self._clock = clock

    def __enter__(self) -> AskedTerminal:
        # A descriptor of its own: a terminal that hangs must not block the write, but O_NONBLOCK on the standard
        # output would hold for the shell, too.
        self._terminal = os.open(os.ttyname(self._fd), os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
        self._modes = termios.tcgetattr(self._fd)
        tty.setcbreak(self._fd, termios.TCSANOW)
        termios.tcflush(self._fd, termios.TCIFLUSH)  # keys typed before could be taken for an answer
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(termios.error):  # at once: a terminal that hangs takes no output
            termios.tcsetattr(self._fd, termios.TCSANOW, self._modes)
            termios.tcflush(self._fd, termios.TCIFLUSH)
        os.close(self._terminal)

    def measure(self) -> Line | None:
        """Return the round trip and the rate, or None if the terminal does not answer."""
        took = [self._time_of(b"") for _ in range(_ROUND_TRIPS)]
        if None in took:
            return None
        round_trip = min(each for each in took if each is not None)
        for size in _SIZES:
            seconds = self._time_of(self._invisible(size))
            if seconds is None:
                return None
            if (beyond := seconds - round_trip) >= _LONG_ENOUGH:
                return Line(round_trip, size / beyond)
        return Line(round_trip, None)

    def watch(self) -> BunchTimes:
        """Ask again and again, and return when answers and keys came."""
        found, rest = BunchTimes([], []), b""
        began = asked_at = self._clock()
        while (now := self._clock()) < began + (_WHILE_KEYS_COME if found.keys else _WATCHED_FOR):
            if now >= asked_at:
                asked_at = now + _ASKED_APART
                self._write(_QUESTION)
            data = rest + self._read(max(0.0, asked_at - self._clock()))
            came_at = self._clock()
            found.answers.extend(came_at for _ in _ANSWER.finditer(data))
            typed, begun, rest = _ANSWER.sub(b"", data).partition(b"\x1b")
            rest = begun + rest  # an answer that has come in part
            found.keys.extend(came_at for _ in typed)
        return found

    def _read(self, within: float) -> bytes:
        """Return what comes within some seconds, or nothing."""
        return os.read(self._fd, 1024) if select.select([self._fd], [], [], within)[0] else b""

    def _invisible(self, size: int) -> bytes:
        # Not the same again and again, which a line may compress.
        colours = (divmod(each % 64, 8) for each in os.urandom(size // _COLOUR_SIZE))
        return b"".join(b"\x1b[3%d;4%dm" % each for each in colours) + _PLAIN

    def _time_of(self, before: bytes) -> float | None:
        """Return the s until a question is answered that stands behind other bytes, or None without an answer."""
        rest, answer, began = before + _QUESTION, b"", self._clock()
        while self._clock() - began < ANSWERS_WITHIN:
            readable, writable, _ = select.select([self._fd], [self._terminal] if rest else [], [], _LOOK_EVERY)
            if writable:
                rest = rest[self._write(rest) :]
            if readable:
                answer += os.read(self._fd, 1024)
                if _ANSWER.search(answer):
                    return self._clock() - began
        termios.tcflush(self._terminal, termios.TCOFLUSH)
        return None

    def _write(self, data: bytes) -> int:
        try:
            return os.write(self._terminal, data)
        except BlockingIOError:
            return 0
