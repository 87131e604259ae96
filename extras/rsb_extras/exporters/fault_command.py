"""The command of `on_fault`: its words, and what may be wrong with them."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import program_problem, program_warnings

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

_LONGEST = 8192
"""Characters of all words together: a round figure, far below what the kernel takes (execve(2): 128 KiB a word)."""
_OF_A_SHELL = frozenset({"|", "||", "&", "&&", ";", ">", ">>", "<", "2>&1", "2>"})


def command_words(command: str | Sequence[str]) -> tuple[str, ...]:
    """Split a command into its program and arguments.

    Args:
        command: a list of words, or a text with quotation marks and backslashes as in a shell.

    Raises:
        ValueError: it has no program, an open quotation mark, a NUL character, or too many characters.
    """
    try:
        words = tuple(shlex.split(command)) if isinstance(command, str) else tuple(command)
    except ValueError as error:
        raise ValueError(f"cannot be split into words ({str(error).lower()}): give a list of words instead") from None
    if not words or not words[0]:
        raise ValueError("has no program: give a command, or leave on_fault out")
    if any("\0" in word for word in words):
        raise ValueError("has a NUL character: remove it")
    if sum(map(len, words)) > _LONGEST:
        raise ValueError(f"is longer than {_LONGEST} characters: put it into a script")
    return words


def command_warnings(command: str | Sequence[str], file: Path) -> Iterator[str]:
    """Name the faults of a valid command, on this machine and for this user.

    Args:
        file: of the session.
    """
    words = command_words(command)
    if problem := program_problem(words[0], file.parent):
        yield f"{problem}; until this is corrected, the bridge runs no command on a fault"
    if marks := [word for word in words if word in _OF_A_SHELL or word.startswith("$")]:
        yield f"no shell runs it, so {marks[0]} is a plain argument: put the command into a script"
    yield from program_warnings(words[0], file)
