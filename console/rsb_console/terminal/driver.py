"""The terminal under the app, and its clipboard. If it stops reading, the app goes on."""

from __future__ import annotations

import contextlib
import os
import re
import select
import signal
import sys
import threading
import time
from queue import Full
from typing import TYPE_CHECKING, Any

from textual import constants, events
from textual.drivers.linux_driver import (
    KITTY_DISAMBIGUATE_ESCAPE_CODES,
    KITTY_REPORT_ALL_KEYS,
    KITTY_REPORT_ASSOCIATED_TEXT,
)

from rsb_bridge.config.files import make_folder, owner_only
from rsb_console.library_internals.textual_internals import (
    SYNC_END,
    SYNC_START,
    KeyReader,
    TerminalDriver,
    read_keys_with,
)
from rsb_console.terminal import terminal_facts
from rsb_console.terminal.known_terminal import KnownTerminal
from rsb_console.terminal.pulse import KIND, WHO_ARE_YOU, Pulse, without_answers
from rsb_console.terminal.terminal_line import TerminalLine, rate_of
from rsb_console.terminal.tmux import tmux

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path
    from types import FrameType

    from textual.app import App
    from textual.message import Message

    from rsb_console.terminal.terminal_facts import TerminalFacts

_ESCAPE = "\x1b"
_CONTINUES_ESCAPE = "[Obf\x7f"  # begins a sequence, or is a word's key of line editing
_BEGINS_SEQUENCE = re.compile(r"\x1b(\[[0-9:;<=>?]*|O)")
_SEQUENCE = re.compile(r"\x1b(\[[0-9:;<=>?]*[A-Za-z~]|O[A-Za-z])")
_KEEP_TITLE, _GIVE_TITLE_BACK = "\x1b[22;0t", "\x1b[23;0t"
_OWN_COLOURS = "\x1b[m"
_ALTERNATE_SCREEN = "\x1b7\x1b[?1047h"
"""Keeps the shell's cursor for the end, and clears nothing where the alternate screen is shown already."""
_MOUSE_IN_CELLS = "\x1b[?1016l"
_CURSOR_AND_FOCUS = "\x1b[?25l\x1b[?1004h"
_KITTY_KEYS = f"\x1b[<u\x1b[>{KITTY_DISAMBIGUATE_ESCAPE_CODES | KITTY_REPORT_ALL_KEYS | KITTY_REPORT_ASSOCIATED_TEXT}u"
"""kitty's keyboard protocol, as in Textual: in place of what was set, and not on top of it."""
_MUTE_AFTER = 5.0
"""s without an answer after which another terminal counts as one that answers nothing. A round figure: a line that
hangs for longer is drawn in few colours until it answers."""
_KIND, _FACT = "<terminal-kind>", "<terminal-fact>"
_REDRAW = "ctrl+l"
"""What dtach types where a terminal is attached to it."""
_BEGINS_ANSWER = "][P_"  # after an Escape
_ANSWER_WITHIN = 0.5
"""s in which an answer has to come whole. A round figure: Escape and ] wait for so long if no key follows."""


class KeyParser(KeyReader):
    """Reads Escape and another key that arrive together as those two keys, and what the terminal says of itself.

    Textual reads the two as Alt with the key, which means nothing to the console; of two Escapes it makes ``^``, and of
    an answer that it does not know keys.

    A line may also tear an arrow key's sequence apart. Its Escape counts as a key after 0.1 s, and its letter would arm
    or disarm. So the rest of a sequence is no key while it may still be on its way with that Escape.

    Args:
        pulse: the terminal's, or None if it has none: then the rest is always a key.
    """

    _after_escape = False
    _answer = ""  # characters that may become the answer, after its Escape, which waits
    _answer_due = 0.0
    _sequence = ""  # what has come of a sequence, with its Escape
    _sequence_at = 0.0

    def __init__(self, pulse: Pulse | None = None, debug: bool = False) -> None:
        self._pulse = pulse
        super().__init__(debug)

    def feed(self, data: str) -> Iterator[Message]:
        """Read what has come at once: its keys have the same time, however long this takes."""
        came_at = time.monotonic()
        for message in self._read(data):
            message.time = came_at
            yield message

    def _read(self, data: str) -> Iterator[Message]:
        # An empty text is the end of the input to Textual, and the loop below would leave it out.
        if not data:
            yield from super().feed(data)
        for char in data:
            if self._is_torn(char):
                continue
            if self._answer or (self._after_escape and self.waits and char in _BEGINS_ANSWER):
                yield from self._feed_answer(char)
            else:
                yield from self._feed_key(char)

    def _is_torn(self, char: str) -> bool:
        """Whether a character is the rest of a sequence whose Escape counts as a key already."""
        if char == _ESCAPE:
            self._sequence, self._sequence_at = char, time.monotonic()
            return False
        if not self._sequence:
            return False
        sequence = self._sequence + char
        self._sequence = sequence if _BEGINS_SEQUENCE.fullmatch(sequence) else ""
        if not (self._sequence or _SEQUENCE.fullmatch(sequence)) or self.waits or self._answer:
            return False
        return self._pulse is not None and not self._pulse.is_over(self._sequence_at)

    def tick(self) -> Iterable[Message]:
        if self._answer and time.monotonic() > self._answer_due:
            yield from self._end_answer()
        yield from super().tick()

    def _feed_key(self, char: str) -> Iterator[Message]:
        if self._after_escape and self.waits and char not in _CONTINUES_ESCAPE:
            self.end_escape()
        yield from super().feed(char)
        self._after_escape = char == _ESCAPE

    def _feed_answer(self, char: str) -> Iterator[Message]:
        if not self._answer:
            self.wait_no_longer()
            self._answer_due = time.monotonic() + _ANSWER_WITHIN
        self._answer += char
        if terminal_facts.is_answer(self._answer):
            self.end_escape()
            self.drop_keys()  # its Escape is none
            self._after_escape = False
            answer, self._answer = self._answer, ""
            yield events.Key(_FACT, answer)
        elif not terminal_facts.may_become_answer(self._answer):
            yield from self._end_answer()

    def _end_answer(self) -> Iterator[Message]:
        """Read the characters as keys, as they are no answer."""
        keys, self._answer = self._answer, ""
        for char in keys:
            yield from self._feed_key(char)

    def keys_of(self, sequence: str, alt: bool) -> Iterable[events.Key]:
        if KIND.fullmatch(sequence):  # Textual would take it for keys
            return [events.Key(_KIND, sequence)]
        return super().keys_of(sequence, alt)


_WAITED = 0.02
"""s from which on the kernel let a write wait."""
_LOOK_EVERY_MS = 500
"""ms until the watch for a hangup notices that the app has ended. The kernel reports a hangup itself at once."""
_LAST_ANSWER_WITHIN, _LOOK_EVERY = 0.3, 0.01
"""s to wait for the terminal's answer at the end, which would go to the shell; and between two looks for it. A round
figure: over a line with a longer round trip, the shell may get some characters; longer, and quitting would drag."""
CLOSE_TIMEOUT = 1.0  # s; then a terminal that does not read is given up. Round: to quit there takes up to twice as long


@contextlib.contextmanager
def terminal_to_itself(log: Path) -> Iterator[int]:
    """Reserve the terminal for the app: other output to descriptors 1 and 2, such as that of Fast DDS, goes to a log.

    The log is emptied first. If it cannot be written, that output is discarded.

    Yields:
        A descriptor of the terminal. It is never closed, because a thread may be stuck in a write to it.
    """
    sys.stdout.flush()  # earlier output is for the terminal, not for the log
    terminal, errors = os.dup(1), os.dup(2)
    try:
        make_folder(log.parent)
        target = owner_only(str(log), os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
    except OSError:
        target = os.open(os.devnull, os.O_WRONLY)
    os.dup2(target, 1)
    os.dup2(target, 2)
    os.close(target)
    try:
        yield terminal
    finally:
        sys.stdout.flush()
        os.dup2(terminal, 1)
        os.dup2(errors, 2)
        os.close(errors)


class TerminalFile:
    """The terminal as an unbuffered file, which calls `gone` once, when the terminal is gone.

    A write to a terminal that does not read may never return. A buffered stream would stay locked then, and delay the
    interpreter's exit.

    Attributes:
        texts: number of texts that were written.
    """

    def __init__(self, fd: int, gone: Callable[[], None], line: TerminalLine) -> None:
        self.texts = 0
        self._fd = fd
        self._gone: Callable[[], None] | None = gone
        self._line = line

    def write(self, text: str) -> None:
        """Write all of `text`. It blocks while the terminal does not read, and does nothing once it is gone."""
        data, began = text.encode("utf-8", "replace"), time.monotonic()
        size = len(data)
        while data and self._gone is not None:
            try:
                # A terminal may take a part only.
                data = data[os.write(self._fd, data) :]
            except OSError:
                self.hung_up()
        if (seconds := time.monotonic() - began) > _WAITED:
            self._line.waited(size, seconds)
        self.texts += 1

    def hung_up(self) -> None:
        gone, self._gone = self._gone, None
        if gone is not None:
            gone()

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def fileno(self) -> int:
        return self._fd


class ConsoleDriver(TerminalDriver):
    """Textual's driver, whose `write` never blocks the app.

    Textual passes what it writes to a thread through a queue of 30, and blocks the app, with its keys and signals,
    while that is full. Frames come only while it is empty (`ScreenWriter`); of the rest, what does not fit is dropped.

    Attributes:
        line: the bytes in flight to the terminal.
        losses: number of times that the terminal was cleared.
    """

    def __init__(self, app: Any, **options: Any) -> None:
        self.line = TerminalLine(rate=rate_of(app.terminal))
        self._terminal = TerminalFile(app.terminal, app.terminal_gone, self.line)
        super().__init__(app, self._terminal, **options)
        self.losses = 0
        self._texts = 0
        self._waits_since = 0.0
        self._ended: object = None
        """The thread that writes no more: until the next one, another program has the terminal."""
        self._unwatched = threading.Event()
        self._continuing = False
        self._asks = False
        self._suit_terminal: Callable[[TerminalFacts], None] = app.suit_terminal
        self._known = KnownTerminal(app.facts, os.environ)
        self._parser: KeyParser | None = None
        self._lacks_modes = False
        """Whether the terminal may be another one, whose modes were not set."""
        self._kind_told = ""
        self._title = ""
        self.pulse = Pulse(os.environ)

    def terminal_size(self) -> tuple[int, int]:
        # Textual asks standard output, which may not be the terminal.
        with contextlib.suppress(OSError):
            columns, lines = os.get_terminal_size(self._terminal.fileno())
            if columns and lines:  # a pseudo-terminal that nobody has sized is 0 × 0
                return columns, lines
        return super().terminal_size()

    def write(self, data: str) -> None:
        """Pass `data` on to the terminal, or drop it while the queue is full, or another program has the terminal."""
        if not self._has_terminal:
            return
        if not self._waits:
            self._waits_since = time.monotonic()
        with contextlib.suppress(Full):
            self.queue.put_nowait(data)
            self._texts += 1
            self.line.wrote(len(data) if data.isascii() else len(data.encode("utf-8", "replace")))

    def write_frame(self, text: str, *, whole: bool) -> None:
        """Write a frame, which the terminal shows at once if it is to be whole and the terminal can do so."""
        if self._lacks_modes:
            self._set_modes()
        synchronized = whole and self.can_synchronize
        self.write(f"{SYNC_START}{text}{SYNC_END}" if synchronized else text)
        if self.line.is_to_be_asked:
            self.ask()

    @property
    def _has_terminal(self) -> bool:
        return self.writer is not self._ended

    @property
    def _waits(self) -> bool:
        """Whether the thread has not yet written all."""
        return self._terminal.texts != self._texts

    @property
    def is_free(self) -> bool:
        """Whether the next frame may be written."""
        return self._has_terminal and not self._waits and self.line.is_free

    @property
    def late(self) -> float:
        """Seconds until the terminal has all that was written, as far as is known."""
        return max(self.line.late, time.monotonic() - self._waits_since if self._waits else 0.0)

    # --- another terminal

    @property
    def knows_terminal(self) -> bool:
        """Whether the abilities of the present terminal are known."""
        return self.pulse.round_trip is None or self._known.is_known

    @property
    def erases(self) -> bool:
        """Whether cells that the terminal erases get the present paper, as if blanks were written."""
        facts = self._known.facts
        if not self._known.is_known:
            return False  # another terminal may be there, with the facts of the one before
        # TERM alone proves nothing, and sixels go with text only.
        return facts.erases and facts.kind != "" and facts.pixels != "sixel"

    def _doubt(self) -> None:
        """Assume another terminal, with an empty screen, from now on. Signal handlers may call this.

        The next frame sets its modes, and is of the whole screen.
        """
        self.pulse.doubt()
        self._known.doubt()
        self.losses += 1
        self._lacks_modes = True
        self._kind_told = ""
        # Until the terminal says that it tells its size among the keys, SIGWINCH tells it.
        self.tells_size_among_keys = False

    def _set_modes(self) -> None:
        """Set what `start_application_mode` sets; in the terminal that has it already, this changes nothing."""
        self._lacks_modes = False
        self.write(_ALTERNATE_SCREEN)
        if self.mouse_in_pixels and self._parser is not None:
            self.mouse_in_pixels = self._parser.mouse_pixels = False
            self.write(_MOUSE_IN_CELLS)
        self.set_mouse()
        self.write(_CURSOR_AND_FOCUS if constants.DISABLE_KITTY_KEY else _CURSOR_AND_FOCUS + _KITTY_KEYS)
        self.set_text_modes()

    def _meet(self, kind: str) -> None:
        """Find out what the terminal can show, if it may be another one."""
        if not self._known.is_news(kind):
            return
        if self.pulse.is_shared and self._known.is_known:
            return  # each of several tells its own kind, and would be the next
        before = self._known.facts
        if self._known.meet(kind, terminal_facts.cell_by_kernel(self._terminal.fileno())):
            self.write(terminal_facts.BACKGROUND + terminal_facts.QUESTIONS)
            self.ask()  # after the answer to this one, none comes
        title, self._title = self._title, ""
        self.entitle(title)
        self._suit(before)

    def _meet_told(self) -> None:
        """Take over the reported kind, unless the previous terminal may have sent it."""
        if not self.pulse.is_doubted:
            self._meet(self._kind_told)

    def look_for_answers(self) -> None:
        """Take a terminal that has not answered for long for one that answers nothing."""
        if self._known.is_in_doubt and self.pulse.doubted_for > _MUTE_AFTER:
            self._meet("")
            self.line.expect_no_answers()

    def _take_answer(self, answer: str) -> None:
        before = self._known.facts
        self._known.take(answer)
        self._suit(before)

    def _suit(self, before: TerminalFacts) -> None:
        if self._known.facts != before:
            self._suit_terminal(self._known.facts)

    # --- the terminal's pulse

    def start_application_mode(self) -> None:
        super().start_application_mode()  # type: ignore[no-untyped-call]
        self._doubt_at_new_size()
        self._doubt()
        self._lacks_modes = False  # Textual has set them
        if self._known.swallows:
            self.write(_KEEP_TITLE)
            title, self._title = self._title, ""
            self.entitle(title)
        self._asks = True
        if self._known.swallows:
            self.write(terminal_facts.BACKGROUND)
        self.ask()  # last: the end waits for this answer, after which no other one comes

    def _doubt_at_new_size(self) -> None:
        """Doubt that the terminal is still the same when its size changes, as where dtach is attached again."""
        textual = signal.getsignal(signal.SIGWINCH)
        if not callable(textual):  # in the background, application mode does not begin
            return

        def resized(number: int, frame: FrameType | None) -> None:
            self._doubt()
            textual(number, frame)

        signal.signal(signal.SIGWINCH, resized)

    def stop_application_mode(self) -> None:
        if self._known.swallows:
            self.write(_GIVE_TITLE_BACK)
        super().stop_application_mode()
        self.write(_OWN_COLOURS)  # last, as a frame leaves the terminal in the look of its end

    def entitle(self, title: str) -> None:
        """Set the terminal's title, if it can have one."""
        if self._known.swallows and title != self._title:
            self._title = title
            self.write(f"\x1b]0;{title}\x07")

    def ask(self) -> None:
        """Ask the terminal for a sign that it gets what is written, and that its keys come here."""
        # While the queue is full, the question would be dropped, and count as one that the terminal does not answer.
        if self._asks and not self.queue.full():
            kind = WHO_ARE_YOU if self.pulse.asks_kind else ""
            if question := self.pulse.question():
                self.write(kind + question)  # the kind first: it is known once the question is answered
                self.line.asked(self.pulse.asked)

    def process_message(self, message: Message) -> None:
        """Take the terminal's answers, and note how young its keys are."""
        match message:
            case events.CursorPosition():
                if (asked := self.pulse.answered(message.y + 1, message.x + 1)) is not None:
                    self.line.answered(asked)
                    if self._known.is_in_doubt:
                        self.app.call_later(self._meet_told)
                return
            case events.Key(key=key, character=answer) if key == _FACT:
                self.app.call_later(self._take_answer, answer or "")  # on the app's thread, as this one reads the keys
                return
            case events.Key(key=key) if key == _KIND:
                kind = KIND.fullmatch(message.character or "")["kind"]  # type: ignore[index]
                self.pulse.take_kind(kind)
                self._kind_told = kind
                self.app.call_later(self._meet_told)
                return
            case events.Key(key=key) if key == _REDRAW:
                self._doubt()
                self.app.call_later(self.app.refresh)
            case events.Paste():
                message.text = without_answers(message.text)
        self.pulse.stamp(message)
        super().process_message(message)

    def disable_input(self) -> None:
        """Read no more keys, but wait for the last answer, which the shell would take for keys."""
        self._asks = False
        deadline = time.monotonic() + _LAST_ANSWER_WITHIN
        while self.pulse.waits and time.monotonic() < deadline:
            time.sleep(_LOOK_EVERY)
        super().disable_input()

    def continued(self) -> None:
        """Take the terminal back, soon. Signals may arrive faster than that takes; one call serves all of them."""
        if self.writer is not None and not self._continuing:
            self._doubt()
            self._continuing = True
            self.app.call_later(self._continue)

    def _continue(self) -> None:
        """Take the terminal back and redraw everything.

        Without SIGTSTP before SIGCONT (after SIGSTOP, and at a hangup), Textual would enter application mode a second
        time: it would leave threads behind, and restore raw mode at the end. So application mode is left first.
        """
        self._continuing = False
        if not self.resumes:
            self.suspend_application_mode()
        super().continued()
        self.app.refresh()

    def run_input_thread(self) -> None:
        """Read keys until the terminal is gone. Without the watch for a hangup, this would spin on empty reads."""
        self._unwatched = ended = threading.Event()
        threading.Thread(target=self._watch_hangup, args=(ended,), name="terminal-hangup", daemon=True).start()
        read_keys_with(self._new_parser)
        with contextlib.suppress(OSError):
            super().run_input_thread()

    def _new_parser(self, debug: bool) -> KeyParser:
        self._parser = KeyParser(self.pulse, debug)
        return self._parser

    def _watch_hangup(self, ended: threading.Event) -> None:
        poll = select.poll()
        poll.register(self.fileno, 0)  # POLLHUP and POLLERR are always reported
        while not ended.is_set():
            if poll.poll(_LOOK_EVERY_MS):
                ended.set()
                self.exit_event.set()
                self._terminal.hung_up()

    def close(self) -> None:
        """Write the last frames, unless the terminal does not read."""
        self._unwatched.set()  # a hangup is no news any more
        thread = self.writer
        if thread is None:
            return
        self._ended = thread
        try:
            self.queue.put(None, timeout=CLOSE_TIMEOUT)
        except Full:
            return  # a daemon thread: it ends with the process
        thread.join(CLOSE_TIMEOUT)


_SHOWN = 200  # characters of the copied text: a toast of a few lines


def copy(app: App[object], text: str) -> str:
    """Copy a text, and return a note for the operator."""
    line = text[: _SHOWN + 1].partition("\n")[0]
    beginning = line if len(line) <= _SHOWN else f"{line[:_SHOWN]}…"
    # tmux passes OSC 52 on only if set-clipboard is on; this always fills its own buffer.
    if tmux(os.environ, "load-buffer", "-w", "-", text=text, within=2.0) is not None:
        return f"copied to tmux: {beginning}"
    app.copy_to_clipboard(text)
    return f"copied: {beginning}"
