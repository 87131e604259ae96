"""Desktop notifications by the terminal: sequences that the operator's own terminal shows, over SSH too."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from rsb_bridge.model.text import sanitize_text
from rsb_console.terminal.tmux import told_by_tmux

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_TITLE_LENGTH, _TEXT_LENGTH = 80, 200  # characters; desktops show fewer
_PASSES_NOTHING: Final = ("0", "off")
"""Of the option allow-passthrough; tmux before 3.3 does not know it, and passes all on."""
_ASKED: Final = "#{client_termname} #{client_termtype}\n#{allow-passthrough}"


def _osc_9(title: str, text: str) -> str:
    # Without the blank, a text that begins with `4;` would be the progress of a taskbar.
    return f"\x1b]9; {title}: {text}\x1b\\"


def _osc_99(title: str, text: str) -> str:
    return f"\x1b]99;i=rsb:d=0;{title}\x1b\\\x1b]99;i=rsb:d=1:p=body;{text}\x1b\\"


def _osc_777(title: str, text: str) -> str:
    return f"\x1b]777;notify;{title.replace(';', ',')};{text}\x1b\\"


_BY_NAME: Final[Mapping[str, Callable[[str, str], str]]] = {
    "kitty": _osc_99, "foot": _osc_777, "rxvt-unicode": _osc_777, "wezterm": _osc_777, "contour": _osc_777,
    "iterm": _osc_9, "ghostty": _osc_9,
}  # fmt: skip
"""By a part of the terminal's name in lower case. Other terminals might print the sequence."""


def names_of_terminal(environ: Mapping[str, str], name: str) -> tuple[str, bool]:
    """Return the names of the terminal that the operator sees, as far as they are known, and whether tmux is before it.

    Within tmux that is tmux's own terminal, or none if tmux passes nothing on to it. It may take a second.

    Args:
        name: the terminal's own (`rsb_console.terminal.terminal_facts.TerminalFacts.name`).
    """
    if not environ.get("TMUX"):
        kitty = "kitty" if environ.get("KITTY_WINDOW_ID") else ""
        return f"{name} {environ.get('TERM', '')} {environ.get('TERM_PROGRAM', '')} {kitty}".lower(), False
    names, _, passes = told_by_tmux(environ, _ASKED).partition("\n")
    return (names.lower() if passes.strip() not in _PASSES_NOTHING else ""), True


def sequence(environ: Mapping[str, str], name: str, title: str, text: str) -> str:
    """Return what makes the terminal show a notification, or an empty string if it is not known to do so."""
    names, in_tmux = names_of_terminal(environ, name)
    make = next((make for name, make in _BY_NAME.items() if name in names), None)
    if make is None:
        return ""
    made = make(sanitize_text(title, _TITLE_LENGTH), sanitize_text(text, _TEXT_LENGTH))
    escaped = made.replace("\x1b", "\x1b\x1b")
    return f"\x1bPtmux;{escaped}\x1b\\" if in_tmux else made
