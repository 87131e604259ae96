"""One side of a bridge as an operator and a monitor see it: its screen, in a real terminal, and its JSON."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from tests.console.live import COMMAND
from tests.console.tmux import Tmux
from tests.support.commands import rsb_console
from tests.support.waiting import eventually

_LOOK_EVERY = 0.25
"""s between two looks, each of which starts a process."""
_WITHIN = 180.0
"""s."""
_ROOMY = (160, 56)
"""Columns and lines: sentences fit, and all of a topic's details."""


class Side:
    """A console, and the control socket of the bridge that it shows.

    Attributes:
        screen: the console's.
    """

    def __init__(self, folder: Path, control: Path, *command: str) -> None:
        folder.mkdir()
        self._control = str(control)
        self.screen = Tmux(folder, str(COMMAND), *command, "--control", self._control, size=_ROOMY)

    def close(self) -> None:
        self.screen.__exit__()

    # --- as JSON

    def status(self) -> dict[str, Any]:
        """Return the output of `status --json`, without routes and links as long as no bridge runs."""
        (line,) = self._asked("status") or ({},)
        return {"routes": [], "links": {}, **line}

    def route(self, topic: str) -> dict[str, Any]:
        """Return a topic's part of the status, or an empty row."""
        return next((each for each in self.status()["routes"] if each["topic"] == topic), {})

    def events(self) -> list[dict[str, Any]]:
        """Return the output of `events --json`; nothing if the bridge did not answer in time."""
        return [each for each in self._asked("events") if "code" in each]

    def _asked(self, command: str) -> list[dict[str, Any]]:
        printed = rsb_console(command, "--json", "--control", self._control).stdout
        return [json.loads(line) for line in printed.splitlines()]

    # --- on the screen

    def choose(self, topic: str) -> None:
        """Show one topic only, with its details."""
        self.screen.wait_for("● LINKED")
        self.screen("send-keys", "/", "C-u", f"topic:{topic}", "Enter")
        eventually(lambda: f"─ {topic} ─" in self.screen.picture, what=f"{topic} is chosen")

    def detail(self) -> str:
        """Return the text of the detail pane, as one line."""
        return detail_of(self.screen.picture)

    def says(self, *words: str) -> None:
        """Wait until the details of the chosen topic have these words, in this order."""
        deadline = time.monotonic() + _WITHIN
        while not in_order(self.detail(), words):
            assert time.monotonic() < deadline, f"{words} not in\n{self.screen.picture}"
            time.sleep(_LOOK_EVERY)


def every_so_often(look: Any, what: str, within: float = _WITHIN) -> Any:
    """Wait for a condition, like `eventually`, if each check asks a bridge."""
    deadline = time.monotonic() + within
    while not (found := look()):
        assert time.monotonic() < deadline, f"not within {within:g} s: {what}"
        time.sleep(_LOOK_EVERY)
    return found


def in_order(text: str, words: tuple[str, ...]) -> bool:
    """Whether all words are in a text, one after the other."""
    at = 0
    for each in words:
        found = text.find(each, at)
        if found < 0:
            return False
        at = found + len(each)
    return True


def detail_of(picture: str) -> str:
    """The words of the pane to the right, whose lines are broken where the pane ends."""
    lines = picture.splitlines()
    top = next((number for number, line in enumerate(lines) if "┌─ " in line), len(lines))
    pane: list[str] = []
    for line in lines[top + 1 :]:
        column = lines[top].index("┌")
        if line[column : column + 1] != "│":
            break
        pane += line[column + 1 :].split()
    return " ".join(pane)
