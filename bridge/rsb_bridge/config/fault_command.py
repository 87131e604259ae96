"""The command of a session's `on_fault`: its words, its program, and their mistakes."""

from __future__ import annotations

import os
import shlex
import shutil
import stat
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.config.files import kind_of_file, typed_path

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.session import Session

_LONGEST = 8192
"""Characters of all words together."""
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


def program_path(program: str, folder: Path) -> Path | None:
    """Find the file of a program; return None if it does not exist.

    Args:
        program: a name to look for in ``$PATH``, or a path: relative to `folder`, absolute, or starting with ``~``.
        folder: of the session file.
    """
    if "/" in program:
        path = folder / typed_path(program)
        return Path(os.path.abspath(path)) if path.exists() else None  # noqa: PTH100 -- a link's name stays
    found = shutil.which(program)
    return None if found is None else Path(found).absolute()


def program_problem(program: str, folder: Path) -> str:
    """Return the reason why a program cannot be run, or an empty string."""
    path = program_path(program, folder)
    if path is None:
        if "/" in program:
            return f"{program}: no such file (a path is relative to {folder.absolute()})"
        beside = f": write ./{program}" if (folder / program).exists() else ""
        return f"no program {program} in PATH{beside}"
    if not path.is_file():
        return f"{path} is {kind_of_file(path.stat().st_mode)}, not a program"
    if not os.access(path, os.X_OK):
        return f"{path} is not executable: chmod +x {path}"
    return ""


def fault_command_warnings(session: Session, file: Path) -> Iterator[str]:
    """Name the faults of a valid session's command, on this machine and for this user.

    Args:
        session: its `on_fault` may be None.
        file: the session file.
    """
    if session.on_fault is None:
        return
    words = command_words(session.on_fault)
    if problem := program_problem(words[0], file.parent):
        yield f"on_fault: {problem}; until then no command runs; the bridge goes on"
    if marks := [word for word in words if word in _OF_A_SHELL or word.startswith("$")]:
        yield f"on_fault: no shell reads it, so {marks[0]} is a plain argument: put the command into a script"
    program = program_path(words[0], file.parent)
    for path in filter(None, (file, program)):
        if path.exists() and path.stat().st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            yield f"on_fault: other users may change {path}, and so what this user runs: chmod go-w {path}"
