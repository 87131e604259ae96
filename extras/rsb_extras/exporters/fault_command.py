"""The command of `on_fault`: its words, its program, and what may be wrong with them."""

from __future__ import annotations

import os
import shlex
import shutil
import stat
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.config.files import is_there, kind_of_file, stat_of
from rsb_bridge.feature_api import Wording, typed_path

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_LONGEST = 8192
"""Characters of all words together: a round figure, far below what the kernel takes (execve(2): 128 KiB a word)."""
_OF_A_SHELL = frozenset({"|", "||", "&", "&&", ";", ">", ">>", "<", "2>&1", "2>"})


class ProgramProblem(Wording):
    """The reason why a program cannot be run."""

    NOT_IN_PATH = "no program {program} in PATH"
    NOT_IN_PATH_BUT_HERE = "no program {program} in PATH: write ./{program}"


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

    Raises:
        OSError: it cannot be looked at: a folder on the way is closed to this user, or a name is too long.
    """
    if "/" in program:
        path = folder / typed_path(program)
        return Path(os.path.abspath(path)) if stat_of(path) else None  # noqa: PTH100 -- a link's name stays
    found = shutil.which(program)
    return None if found is None else Path(found).absolute()


def program_problem(program: str, folder: Path) -> str:
    """Return the reason why a program cannot be run, or an empty string."""
    try:
        path = program_path(program, folder)
        if path is None:
            if "/" in program:
                return f"{program}: no such file (a path is relative to {folder.absolute()})"
            is_here = is_there(folder / program)
            return (ProgramProblem.NOT_IN_PATH_BUT_HERE if is_here else ProgramProblem.NOT_IN_PATH)(program=program)
        mode = path.stat().st_mode
    except OSError as error:
        return f"{program} cannot be looked at: {error.strerror}"
    if not stat.S_ISREG(mode):
        return f"{path} is {kind_of_file(mode)}, not a program"
    if not os.access(path, os.X_OK):
        return f"{path} is not executable: chmod +x {path}"
    return ""


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
    with suppress(OSError):  # named above
        program = program_path(words[0], file.parent)
        for path in filter(None, (file, program)):
            status = stat_of(path)
            if status is not None and status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
                yield f"other users can change {path}, which runs as this user: chmod go-w {path}"
