"""What ``doctor`` finds out about the terminal: what images will look like, and what would make them better."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Finding, Grade, Wording
from rsb_console.notation.ascii_signs import prefers_ascii
from rsb_console.terminal.terminal_facts import TRUE_COLOUR, ask, facts_before_answers
from rsb_extras.pictures.graphics import protocol_of, why_no_graphics

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_console.terminal.terminal_facts import TerminalFacts


class TerminalText(Wording):
    NONE = "no terminal: standard input or output is a file or a pipe"
    PIXELS = "images are shown in pixels: {facts}"
    BLOCKS = "images are shown in characters: {facts}"
    ASCII = "images are shown by their brightness, in ASCII"
    MORE_CHARACTERS = "export LC_ALL=C.UTF-8, if the terminal shows Unicode"
    MORE_COLOURS = "if it has more colours: export COLORTERM=truecolor, or terminal: {{colours: true}} in console.yaml"
    MORE_PIXELS = "kitty, WezTerm, Ghostty, foot or xterm -ti vt340 show pixels"


def terminal() -> Iterator[Finding]:
    """Ask the terminal of this command."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        yield Finding("images", Grade.UNKNOWN, "images", TerminalText.NONE())
        return
    facts = ask(facts_before_answers(os.environ, 1), os.environ, 0, 1)
    yield finding(facts, ascii_only=prefers_ascii(os.environ))


def finding(facts: TerminalFacts, *, ascii_only: bool = False) -> Finding:
    """Return what a terminal's facts mean for images."""
    data = {"name": facts.name, "colours": facts.colours, "cell": facts.cell, "pixels": facts.pixels}
    if ascii_only:
        remedy = TerminalText.MORE_CHARACTERS()
        return Finding("images", Grade.NOTE, "images", TerminalText.ASCII(), remedy, {**data, "pixels": ""})
    text = (TerminalText.PIXELS if protocol_of(facts) else TerminalText.BLOCKS)(facts=facts.line())
    remedy = why_no_graphics(facts.pixels)
    if not facts.pixels:
        remedy = TerminalText.MORE_PIXELS() if facts.colours == TRUE_COLOUR else TerminalText.MORE_COLOURS()
    return Finding("images", Grade.NOTE if remedy else Grade.OK, "images", text, remedy, data)
