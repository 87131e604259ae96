"""A terminal's abilities by its own answers: colours, images, the pixels of a cell, its background and its name.

TERM and COLORTERM tell less: SSH carries only the first, and most terminals call themselves xterm. The answers come
among the keys, at any time or never, so nobody waits for them, and the console begins with what TERM says.

Sources: xterm's control sequences (ctlseqs), DEC STD 070 (DA1, DECRQSS), kitty's graphics protocol.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import select
import struct
import termios
import time
import tty
from dataclasses import dataclass, replace
from functools import reduce
from typing import TYPE_CHECKING, Annotated, Final, Literal

import msgspec

from rsb_console.notation.console_setting import placed
from rsb_console.terminal.pulse import KIND, WHO_ARE_YOU, multiplexer
from rsb_console.terminal.tmux import told_by_tmux

if TYPE_CHECKING:
    from collections.abc import Mapping

Pixels = Literal["kitty", "sixel", ""]

TRUE_COLOUR: Final = 1 << 24
BACKGROUND: Final = "\x1b]11;?\x07"
"""Asks for the background's colour. All terminals of `can_be_asked` swallow it."""
QUESTIONS: Final = (
    "\x1b[>q"  # XTVERSION
    "\x1b]4;200;?\x07"  # a colour of the palette that only 256 have
    # DECRQSS: the present colours, which are a true one. Those of the last frame come back, as the next one counts on
    # them (`screen_cells`).
    "\x1b7\x1b[48;2;1;2;3m\x1bP$qm\x1b\\\x1b8"
    "\x1b[16t"  # pixels of a cell
    "\x1b_Gi=31,s=1,v=1,a=q,t=d,f=24;AAAA\x1b\\"  # whether kitty's graphics could show a pixel
    "\x1b[c"  # DA1, last: everyone answers it
)
"""For terminals of a known kind (DA2). GNU screen would print a part of them (`can_be_asked_more`)."""
_TERMINALS: Final = (
    "xterm", "rxvt", "screen", "tmux", "konsole", "gnome", "vte", "putty", "foot", "alacritty", "wezterm", "mlterm",
    "contour",
)  # fmt: skip
"""The beginnings of TERM of terminals that swallow a question that they do not know."""
_PAINT_ERASED: Final = ("xterm", "konsole", "gnome", "vte", "putty", "rxvt", "alacritty")
"""The beginnings of TERM of terminals whose erased cells get the present paper: ``ech`` and ``bce`` of terminfo. kitty,
whose entry lacks the second, does so, too."""
_EMULATORS: Final = 90
"""The least version of an emulator (DA2); that of a VT is the version of its ROM, times ten: VT220 to VT525 have 10 to
30."""
_SCREEN, _PUTTY = "83", "0;136;0"
"""Kinds (DA2) of GNU screen, and of PuTTY, which shows true colours since 0.71 and answers no question about them."""
_ST: Final = r"(?:\x07|\x1b\\)"
_ANSWER: Final = re.compile(
    r"\[\?(?P<device>[\d;]*)c"
    r"|\[6;(?P<cell_height>\d{1,4});(?P<cell_width>\d{1,4})t"
    rf"|\](?P<place>11|4;200);rgba?:(?P<rgb>[\da-f]+/[\da-f]+/[\da-f]+)(?:/[\da-f]+)?{_ST}"
    r"|P[01]\$r(?P<sgr>[\d:;]*)m?\x1b\\"
    r"|P>\|(?P<name>[^\x1b]{0,60})\x1b\\"
    r"|_G(?P<kitty>[^\x1b]{0,60})\x1b\\",
    re.IGNORECASE,
)
"""An answer without its Escape."""
_BEGINNING: Final = re.compile(
    r"\[(?:\?[\d;]{0,80})?"
    r"|\[6(?:;\d{0,4}(?:;\d{0,4})?)?"
    r"|\](?:1|11|4|4;|4;2|4;20|4;200)?"
    r"|\](?:11|4;200);(?:r|rg|rgb|rgba|rgba?:[\da-f/]{0,24}\x1b?)?"
    r"|P(?:[01](?:\$(?:r[\d:;]{0,40}m?\x1b?)?)?)?"
    r"|P>(?:\|[^\x1b]{0,60}\x1b?)?"
    r"|_(?:G[^\x1b]{0,60}\x1b?)?",
    re.IGNORECASE,
)
_AFTER_ESCAPE: Final = re.compile(rf"\x1b({_ANSWER.pattern})", re.IGNORECASE)
_ARE_YOU_THERE: Final = "\x1b[c"
_DEVICE: Final = re.compile(r"\x1b\[\?[\d;]*c")
_ANSWERS_WITHIN: Final = 1.0
"""s that a command waits for a terminal, over a slow line, too."""
_TRUE_COLOUR_ANSWER: Final = re.compile(r"48[:;]2[:;]+1[:;]2[:;]3(?!\d)")
_SIXEL: Final = "4"
_WEIGHTS: Final = (0.299, 0.587, 0.114)
"""Of red, green and blue in the brightness (ITU-R BT.601)."""


@dataclass(frozen=True, slots=True)
class TerminalFacts:
    """A terminal's abilities, as far as they are known.

    Attributes:
        name: name and version by its own words (XTVERSION), or empty.
        kind: its device attributes (DA2), or empty.
        colours: 0, 16, 256 or `TRUE_COLOUR`.
        cell: width and height of a character in pixels, or None.
        pixels: the protocol by which it shows images, or empty.
        light: whether its background is light, or None.
        answered: whether it has answered the last of `QUESTIONS`.
        ascii_only: whether it may have no other characters, as its kind tells.
        erases: whether it can erase some cells, which get the present paper.
    """

    name: str = ""
    kind: str = ""
    colours: int = 256
    cell: tuple[float, float] | None = None
    pixels: Pixels = ""
    light: bool | None = None
    answered: bool = False
    ascii_only: bool = False
    erases: bool = False

    @property
    def colour_system(self) -> str:
        """Name of its colours in rich."""
        return {TRUE_COLOUR: "truecolor", 256: "256"}.get(self.colours, "standard")

    @property
    def shape(self) -> float:
        """Height of a character over its width; most fonts are twice as high as wide."""
        return 2.0 if self.cell is None else self.cell[1] / self.cell[0]

    @property
    def draws_sextants(self) -> bool:
        """Whether it draws Unicode 13's blocks itself; others leave them to a font, which may lack them."""
        drawers = ("kitty", "foot", "wezterm", "ghostty", "contour", "konsole", "vte", "iterm2", "rio")
        return self.name.lower().startswith(drawers)

    def told(self, answer: str) -> TerminalFacts:
        """Return the facts with an answer, given without its Escape; a text that is none changes nothing."""
        found = _ANSWER.fullmatch(answer)
        if found is None:
            return self
        match found.lastgroup:
            case "device":
                has_sixel = _SIXEL in found["device"].split(";") and not self.pixels
                return replace(self, answered=True, pixels="sixel" if has_sixel else self.pixels)
            case "cell_width":
                height, width = int(found["cell_height"]), int(found["cell_width"])
                return replace(self, cell=(width, height)) if width and height else self
            case "rgb" if found["place"] == "11":
                return replace(self, light=_brightness(found["rgb"]) > 0.5)
            case "rgb":
                return replace(self, colours=max(self.colours, 256))
            case "sgr":
                return replace(self, colours=TRUE_COLOUR) if _TRUE_COLOUR_ANSWER.search(found["sgr"]) else self
            case "name":
                return replace(self, name="".join(filter(str.isprintable, found["name"])))
            case _:
                return replace(self, pixels="kitty") if found["kitty"].endswith(";OK") else self

    def of_kind(self, kind: str) -> TerminalFacts:
        """Return the facts with the terminal's kind, the parameters of its answer to DA2."""
        erases = self.erases and kind.partition(";")[0] != _SCREEN
        return replace(self, kind=kind, colours=TRUE_COLOUR if kind == _PUTTY else self.colours, erases=erases)

    @property
    def can_be_asked_more(self) -> bool:
        """Whether `QUESTIONS` leave no trace: GNU screen passes some on as text, and shows another as its title."""
        return self.kind != "" and self.kind.partition(";")[0] != _SCREEN

    def line(self) -> str:
        """Return the facts in words."""
        colours = "true colours" if self.colours == TRUE_COLOUR else f"{self.colours or 'no'} colours"
        cell = "" if self.cell is None else f"{self.cell[0]:g} × {self.cell[1]:g} pixels a cell"
        pixels = f"{self.pixels} pixels" if self.pixels else ""
        return ", ".join(filter(None, (self.name, colours, cell, pixels)))


class TerminalSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The user's corrections of a terminal's answers, or None.

    Attributes:
        colours: the number, or true for true colours.
        pixels: protocol for images.
        cell: pixels of a character, ``8x19``.
    """

    colours: bool | Literal[0, 16, 256] | None = None
    pixels: Literal["kitty", "sixel", "none"] | None = None
    cell: Annotated[str, msgspec.Meta(pattern=r"\A[1-9]\d{0,2}x[1-9]\d{0,2}\Z")] | None = None

    @classmethod
    def read(cls, value: object) -> TerminalSettings:
        """Return the settings of a file.

        Raises:
            ValueError: the reason, which begins with the place of the mistake.
        """
        try:
            return msgspec.convert(value, cls)
        except msgspec.ValidationError as error:
            raise ValueError(placed("terminal", error)) from None

    def over(self, facts: TerminalFacts) -> TerminalFacts:
        """Return the facts with what the user has set in their place."""
        if self.colours is not None:
            facts = replace(facts, colours=TRUE_COLOUR if self.colours is True else int(self.colours))
        if self.pixels is not None:
            facts = replace(facts, pixels="" if self.pixels == "none" else self.pixels)
        if self.cell is not None:
            width, height = map(float, self.cell.split("x"))
            facts = replace(facts, cell=(width, height))
        return facts


def is_plain(kind: str) -> bool:
    """Whether a kind (DA2) is that of a VT by DEC, or of a terminal that tells none, such as the Linux console.

    Emulators answer with the number of a VT, too, but with their own version, which is greater.
    """
    _, _, rest = kind.partition(";")
    version = rest.partition(";")[0]
    return not kind or (not multiplexer(kind, {}) and version.isdigit() and int(version) < _EMULATORS)


def can_be_asked(environ: Mapping[str, str]) -> bool:
    return environ.get("TERM", "").startswith(_TERMINALS)


def is_answer(text: str) -> bool:
    """Whether a text is a whole answer, without its Escape."""
    return _ANSWER.fullmatch(text) is not None


def may_become_answer(text: str) -> bool:
    """Whether a text may be the beginning of an answer, without its Escape."""
    return _BEGINNING.fullmatch(text) is not None


def facts_before_answers(environ: Mapping[str, str], terminal: int) -> TerminalFacts:
    """Return what the environment and the kernel say of the terminal behind a file descriptor."""
    term = environ.get("TERM", "")
    if term in ("", "dumb", "unknown"):
        colours = 0
    elif environ.get("COLORTERM", "").strip().lower() in ("truecolor", "24bit"):
        colours = TRUE_COLOUR
    elif "RGB" in told_by_tmux(environ, "#{client_termfeatures}").strip().split(","):
        # tmux tells programs nothing of the terminal around it, to which it passes true colours on.
        colours = TRUE_COLOUR
    elif "256" in term or term in ("xterm-kitty", "foot", "alacritty", "wezterm", "xterm-ghostty"):
        colours = 256
    else:
        colours = 16
    return TerminalFacts(colours=colours, cell=cell_by_kernel(terminal), erases=term.startswith(_PAINT_ERASED))


def ask(facts: TerminalFacts, environ: Mapping[str, str], read_from: int, write_to: int) -> TerminalFacts:
    """Ask a terminal that nothing else reads from, and return what it answers, without the keys typed before.

    One that would show the questions is not asked.
    """
    if not can_be_asked(environ):
        return facts
    before = termios.tcgetattr(read_from)
    try:
        # This drops the keys typed before, which would be taken for answers.
        tty.setcbreak(read_from)
        answer = _answer(WHO_ARE_YOU + _ARE_YOU_THERE, read_from, write_to)
        if found := KIND.search(answer):
            facts = facts.of_kind(found["kind"])
        if facts.can_be_asked_more:
            answer += _answer(QUESTIONS, read_from, write_to)
    finally:
        # FLUSH drops the unread rest of an answer, which the shell would take for keys.
        termios.tcsetattr(read_from, termios.TCSAFLUSH, before)
    return reduce(TerminalFacts.told, (found[1] for found in _AFTER_ESCAPE.finditer(answer)), facts)


def _answer(questions: str, read_from: int, write_to: int) -> str:
    """Write questions, and return the answers up to that to the last one, which all terminals give."""
    answer, deadline = "", time.monotonic() + _ANSWERS_WITHIN
    os.write(write_to, questions.encode())
    while _DEVICE.search(answer) is None and (left := deadline - time.monotonic()) > 0:
        if select.select([read_from], [], [], left)[0]:
            answer += os.read(read_from, 1024).decode("latin-1")
    return answer


def cell_by_kernel(terminal: int) -> tuple[float, float] | None:
    """Return width and height of a character in pixels, as the kernel knows them, or None."""
    with contextlib.suppress(OSError):
        rows, columns, width, height = struct.unpack("4H", fcntl.ioctl(terminal, termios.TIOCGWINSZ, bytes(8)))
        if rows and columns and width and height:
            return width / columns, height / rows
    return None


def _brightness(rgb: str) -> float:
    shares = [int(digits, 16) / float(16 ** len(digits) - 1) for digits in rgb.split("/")]
    return sum(weight * share for weight, share in zip(_WEIGHTS, shares, strict=True))
