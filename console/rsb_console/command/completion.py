"""What a shell offers on TAB, beyond the commands and options that argparse knows."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import argcomplete
from argcomplete.completers import FilesCompleter

from rsb_bridge.config.files import typed_path
from rsb_bridge.model.text import is_clean
from rsb_console.command.shell import OK, print_lines

if TYPE_CHECKING:
    from argparse import Action, ArgumentParser, Namespace
    from collections.abc import Collection

    from rsb_console.fleet.memory import Remembered

_PATHS = ("PATH", "FILE", "FILE.svg")
"""The metavars of arguments that are paths, and still texts."""
_ADAPTERS = Path("/sys/class/bluetooth")


def run(name: str, arguments: Namespace) -> int:
    """Print what a shell sources to complete the command. Returns the exit code."""
    assert name == "script"
    for line in argcomplete.shellcode(["rsb-console"], shell=arguments.shell).strip("\n").splitlines():
        print_lines(line)
    return OK


def complete(parser: ArgumentParser, commands: Collection[str]) -> None:
    """Answer the shell that asks through the environment, and exit.

    Args:
        parser: of the command; its actions' `completer` attributes count.
        commands: their names. What stands in a command's place and is none is a session: it is `run` that completes.
    """
    line = os.environ.get("COMP_LINE", "")
    words = line.split()
    if len(words) + line.endswith(" ") > 2 and words[1] not in (*commands, "--debug"):
        os.environ["COMP_LINE"] = line.replace(words[0], f"{words[0]} run", 1)
        os.environ["COMP_POINT"] = str(int(os.environ["COMP_POINT"]) + len(" run"))
    argcomplete.autocomplete(parser, default_completer=_files_where_a_path_is_due)
    sys.exit()


def _files_where_a_path_is_due(prefix: str, action: Action, **_: object) -> list[str]:
    if action.type is not Path and action.metavar not in _PATHS:
        return []
    return [each for each in FilesCompleter()(prefix) if is_clean(each)]


def yaml_files(prefix: str, **_: object) -> list[str]:
    """YAML files that a path which has been begun may become, and folders on the way to more."""
    begun = prefix.rpartition("/")
    folder = typed_path(begun[0] + begun[1])
    try:
        found = sorted(path for path in folder.iterdir() if path.name.startswith(begun[2]))
    except OSError:
        return []
    shown = [path for path in found if begun[2] or not path.name.startswith(".")]
    return [
        f"{begun[0]}{begun[1]}{path.name}{'/' if path.is_dir() else ''}"
        for path in shown
        if path.is_dir() or path.suffix in (".yaml", ".yml")
    ]


def theme_names(**_: object) -> list[str]:
    """The shipped themes, and the user's own."""
    from rsb_console.look.themes import config_path, shipped_path  # noqa: PLC0415 (needs Textual)

    folders = (shipped_path(), config_path() / "themes")
    return sorted({path.stem for folder in folders for path in folder.glob("*.yaml")})


def bridge_names(**_: object) -> list[str]:
    """The bridges that run on this machine."""
    from rsb_bridge.control.control_sockets import find_sockets  # noqa: PLC0415 (only for the commands that attach)

    return [path.stem for path in find_sockets(os.environ)]


def bridges_and_files(prefix: str, **_: object) -> list[str]:
    """The bridges that run on this machine, and session files."""
    return bridge_names() + yaml_files(prefix)


def robots(**_: object) -> list[str]:
    """The robots of fleets, as far as this user has seen them."""
    return sorted({robot.name for robot in _remembered()})


def groups(**_: object) -> list[str]:
    """The groups of those robots."""
    return sorted({robot.group for robot in _remembered()} - {""})


def _remembered() -> list[Remembered]:
    from rsb_console.fleet.memory import Memory, memory_path  # noqa: PLC0415 (only for the commands of a fleet)

    return Memory(memory_path()).all()


def adapters(**_: object) -> list[str]:
    """The Bluetooth adapters of this machine."""
    return sorted(path.name for path in _ADAPTERS.glob("hci*")) if _ADAPTERS.is_dir() else []
