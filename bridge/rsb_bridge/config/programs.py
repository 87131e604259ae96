"""The programs that a session names: where they are, and what may be wrong with them."""

from __future__ import annotations

import os
import shutil
import stat
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.config.files import is_there, kind_of_file, stat_of, typed_path
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterator


class ProgramProblem(Wording):
    """The reason why a program cannot be run."""

    NOT_IN_PATH = "no program {program} in PATH"
    NOT_IN_PATH_BUT_HERE = "no program {program} in PATH: write ./{program}"


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


def program_warnings(program: str, file: Path) -> Iterator[str]:
    """Name the files and folders by which users other than this one and root could run programs as this user.

    Args:
        program: as of `program_path`.
        file: of the session that names it.
    """
    with suppress(OSError):  # `program_problem` names it
        for path in filter(None, (file, program_path(program, file.parent))):
            yield from _changed_by_others(path)


def _changed_by_others(path: Path) -> Iterator[str]:
    """Yield each reason why other users can change or replace a file, or a link to it."""
    if stat_of(path) is None:
        return
    link, target = Path(os.path.abspath(path)), path.resolve()  # noqa: PTH100 -- a link's name stays
    for each in dict.fromkeys((target, *link.parents, *target.parents)):
        status = each.stat()
        others_write = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
        # With the sticky bit, as of /tmp, nobody can replace another user's file.
        if each != target and status.st_mode & stat.S_ISVTX:
            others_write = 0
        change = f"other users can {'change' if each == target else 'replace'} {path}, which runs as this user"
        if status.st_uid not in (0, os.geteuid()):
            yield f"{change}: {each} belongs to uid {status.st_uid}: chown it, or use a copy in a folder of this user"
        elif others_write:
            yield f"{change}: chmod go-w {each}"
