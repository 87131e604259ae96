"""The check of `rsb-console doctor` of the terminal: its size, colours and signs."""

from __future__ import annotations

import shutil
import sys
from functools import partial
from typing import TYPE_CHECKING

from rsb_bridge.doctor.finding import Check, Finding, Grade
from rsb_bridge.model.wording import Wording
from rsb_console.terminal.driver import prefers_ascii

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_SMALLEST = (80, 24)


class TerminalText(Wording):
    """Findings about a terminal, and remedies."""

    NO_TERMINAL = "standard output is not a terminal"
    TERMINAL = "{term}, {columns} × {lines}, {colours}, {signs}{inside}"
    TRUE_COLOUR = "24-bit colours"
    COLOURS = "256 colours"
    FEW_COLOURS = "16 colours"
    UNICODE = "Unicode signs"
    ASCII = "ASCII signs"
    INSIDE = ", inside {program}"
    SMALL = "the console needs {columns} × {lines} at least"
    CANNOT_DRAW = "TERM is {term!r}: the console cannot draw there"
    CANNOT_DRAW_REMEDY = "export TERM=xterm-256color"
    ASCII_REMEDY = "export LANG=C.UTF-8, if the terminal shows Unicode"


def terminal_check(environ: Mapping[str, str]) -> Check:
    """Return the check of the terminal of standard output."""
    return Check("terminal", "terminal", partial(_terminal, environ))


def _terminal(environ: Mapping[str, str]) -> Iterator[Finding]:
    if not sys.stdout.isatty():
        yield Finding("terminal", Grade.OK, "terminal", TerminalText.NO_TERMINAL())
        return
    term, size, plain = environ.get("TERM", ""), shutil.get_terminal_size(), prefers_ascii(environ)
    true_colour = environ.get("COLORTERM", "") in {"truecolor", "24bit"}
    colours = (
        TerminalText.TRUE_COLOUR if true_colour else TerminalText.COLOURS if "256" in term else TerminalText.FEW_COLOURS
    )()
    program = "tmux" if environ.get("TMUX") else "screen" if environ.get("STY") else ""
    facts = {"term": term, "columns": size.columns, "lines": size.lines, "colours": colours, "ascii": plain}
    if term in {"", "dumb"}:
        text, remedy = TerminalText.CANNOT_DRAW(term=term), TerminalText.CANNOT_DRAW_REMEDY()
        yield Finding("terminal", Grade.WARNING, "terminal", text, remedy, facts)
        return
    text = TerminalText.TERMINAL(
        term=term,
        columns=size.columns,
        lines=size.lines,
        colours=colours,
        signs=(TerminalText.ASCII if plain else TerminalText.UNICODE)(),
        inside=TerminalText.INSIDE(program=program) if program else "",
    )
    grade = Grade.NOTE if plain else Grade.OK
    yield Finding("terminal", grade, "terminal", text, TerminalText.ASCII_REMEDY() if plain else "", facts)
    if size.columns < _SMALLEST[0] or size.lines < _SMALLEST[1]:
        text = TerminalText.SMALL(columns=_SMALLEST[0], lines=_SMALLEST[1])
        yield Finding("terminal_size", Grade.WARNING, "terminal", text, facts=facts)
