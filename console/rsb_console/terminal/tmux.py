"""Commands to the tmux that the program runs in."""

from __future__ import annotations

import os
import shutil
import subprocess
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

_ANSWERS_WITHIN = 1.0  # s: a round figure; it answers in some ms, but on a busy machine perhaps not in time


def tmux(environ: Mapping[str, str], *command: str, text: str = "", within: float = _ANSWERS_WITHIN) -> str | None:
    """Run a command of tmux, and return its output, or None if the program is not in tmux or that does not answer.

    Args:
        text: its standard input.
        within: s that it may take.
    """
    program = shutil.which("tmux") if environ.get("TMUX") else None
    if program is None:
        return None
    try:
        ran = subprocess.run(  # noqa: S603 -- no shell; the program is tmux
            [program, *command], input=text.encode(), capture_output=True, timeout=within, check=True,
            env={**os.environ, **environ},
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    return ran.stdout.decode(errors="replace")


def told_by_tmux(environ: Mapping[str, str], what: str) -> str:
    """Return what tmux tells of this pane in a format (tmux(1), FORMATS), or an empty string."""
    return tmux(environ, "display-message", "-p", "-t", environ.get("TMUX_PANE", ""), what) or ""
