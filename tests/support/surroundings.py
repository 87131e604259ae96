"""Pretends things about the machine that the program runs on."""

from __future__ import annotations

import io
import os
import socket
import sys
import time
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest


def set_stdin(patch: pytest.MonkeyPatch, content: str | IO[Any], *, is_terminal: bool = False) -> None:
    stream = io.StringIO(content) if isinstance(content, str) else content
    if is_terminal:
        patch.setattr(stream, "isatty", lambda: True)
    patch.setattr(sys, "stdin", stream)


def print_to_terminal(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(sys.stdout, "isatty", lambda: True)


def set_user(patch: pytest.MonkeyPatch, user: int) -> None:
    patch.setattr(os, "geteuid", lambda: user)


def set_wall_clock(patch: pytest.MonkeyPatch, now: Callable[[], float]) -> None:
    patch.setattr(time, "time", now)


def hide_modules(patch: pytest.MonkeyPatch, *names: str) -> None:
    """Let Python neither find nor import these modules."""
    for name in names:
        patch.setitem(sys.modules, name, None)


def set_foreground(patch: pytest.MonkeyPatch, *, is_ours: bool) -> None:
    """Let this process be in the foreground of every terminal, or of none."""
    patch.setattr(os, "tcgetpgrp", lambda _: os.getpgrp() + (not is_ours))


def offer_bluetooth(patch: pytest.MonkeyPatch) -> None:
    """Let this Python have sockets for Bluetooth, as a distribution's has."""
    patch.setattr(socket, "AF_BLUETOOTH", 31, raising=False)


def forbid_access(patch: pytest.MonkeyPatch) -> None:
    """Let the user have no right to any file."""
    patch.setattr(os, "access", lambda *_: False)
