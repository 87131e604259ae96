"""The check of `rsb-console doctor` of the terminal: its size, colours and signs."""

from __future__ import annotations

import shutil
import sys
from functools import partial
from typing import TYPE_CHECKING

from rsb_bridge.doctor.finding import Check, Finding, Grade
from rsb_console.terminal.driver import prefers_ascii

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_SMALLEST = (80, 24)


def terminal_check(environ: Mapping[str, str]) -> Check:
    """Return the check of the terminal of standard output."""
    return Check("terminal", "terminal", partial(_terminal, environ))


def _terminal(environ: Mapping[str, str]) -> Iterator[Finding]:
    if not sys.stdout.isatty():
        yield Finding("terminal", Grade.OK, "terminal", "standard output is not a terminal")
        return
    term, size, plain = environ.get("TERM", ""), shutil.get_terminal_size(), prefers_ascii(environ)
    true_colour = environ.get("COLORTERM", "") in {"truecolor", "24bit"}
    colours = "24-bit colours" if true_colour else "256 colours" if "256" in term else "16 colours"
    program = "tmux" if environ.get("TMUX") else "screen" if environ.get("STY") else ""
    facts = {"term": term, "columns": size.columns, "lines": size.lines, "colours": colours, "ascii": plain}
    if term in {"", "dumb"}:
        text, remedy = f"TERM is {term!r}: the console cannot draw there", "export TERM=xterm-256color"
        yield Finding("terminal", Grade.WARNING, "terminal", text, remedy, facts)
        return
    signs = f"{'ASCII' if plain else 'Unicode'} signs{program and f', inside {program}'}"
    text, grade = f"{term}, {size.columns} × {size.lines}, {colours}, {signs}", Grade.NOTE if plain else Grade.OK
    remedy = "export LANG=C.UTF-8, if the terminal shows Unicode" if plain else ""
    yield Finding("terminal", grade, "terminal", text, remedy, facts)
    if size.columns < _SMALLEST[0] or size.lines < _SMALLEST[1]:
        text = f"the console needs {_SMALLEST[0]} × {_SMALLEST[1]} at least"
        yield Finding("terminal_size", Grade.WARNING, "terminal", text, facts=facts)
