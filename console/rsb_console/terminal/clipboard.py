"""Copy over SSH: OSC 52 to the operator's own terminal; inside tmux, through tmux."""

from __future__ import annotations

import os
import shutil
import subprocess
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from textual.app import App

_SHOWN = 200  # characters


def copy(app: App[object], text: str) -> str:
    """Copy `text`.

    Returns:
        What to tell the operator.
    """
    tmux = shutil.which("tmux") if os.environ.get("TMUX") else None
    if tmux is not None:  # tmux passes OSC 52 on only where set-clipboard says so; this always fills its own buffer
        command = [tmux, "load-buffer", "-w", "-"]
        try:
            subprocess.run(command, input=text.encode(), timeout=2, check=True, capture_output=True)  # noqa: S603 -- no shell; the program is tmux
        except (subprocess.SubprocessError, OSError):  # on a busy machine it may not answer in time
            pass
        else:
            return f"copied to tmux: {_beginning(text)}"
    app.copy_to_clipboard(text)
    return f"copied: {_beginning(text)}"


def _beginning(text: str) -> str:
    line = text[: _SHOWN + 1].partition("\n")[0]
    return line if len(line) <= _SHOWN else f"{line[:_SHOWN]}…"
