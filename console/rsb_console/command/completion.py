"""Completion in a shell: the words that it offers on TAB, some of them from a running bridge."""

from __future__ import annotations

import os
import re
import sys
import threading
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import argcomplete
from argcomplete.completers import FilesCompleter
from msgspec.structs import fields

from rsb_bridge.config.file_form import KEYS, NAME_KEYS
from rsb_bridge.config.files import typed_path
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.qos import AUTO, PROFILES
from rsb_bridge.model.session import Topic
from rsb_bridge.model.text import is_clean
from rsb_bridge.model.topic_keys import ADDED_KEYS
from rsb_console.command.command_parser import NAMES_IN_ROS
from rsb_console.command.shell import OK, print_lines
from rsb_console.library_internals.argparse_internals import actions_of, commands_of

if TYPE_CHECKING:
    from argparse import Action, ArgumentParser
    from collections.abc import Callable, Collection, Sequence

    from rsb_bridge.control.remote_engine import RemoteEngine

_PATHS = ("PATH", "FILE", "FILE.svg")
"""The metavars of path arguments that stay plain texts."""
_ADAPTERS = Path("/sys/class/bluetooth")
_WAITS = 1.0
"""Seconds for a bridge to answer. On any error nothing is offered: a shell has no place for a message then."""
_DIRECTIONS = ["transmit", "receive"]
_DEFAULTS: dict[str, Any] = {
    "bridge": None, "control": None, "link": "", "kind": None, "kinds": tuple(KEYS), "direction": None,
}  # fmt: skip
_NOT_TYPED = ("direction", *NAME_KEYS.values())
"""Keys that have their own arguments in `add` and `edit`."""


def script(arguments: Namespace) -> int:
    """Print the script that a shell sources to complete the command."""
    for line in argcomplete.shellcode(["rsb-console"], shell=arguments.shell).strip("\n").splitlines():
        print_lines(line)
    return OK


def complete(parser: ArgumentParser, commands: Collection[str]) -> None:
    """Answer a shell's request for completions, made through the environment, and exit.

    Args:
        parser: parser of the command; the `completer` attributes of its actions count.
        commands: names of the commands. Any other word in a command's place is a session file, to be run by `run`.
    """
    line = os.environ.get("COMP_LINE", "")
    # An unfinished word may still become another one.
    words = (line + "_").split()[:-1]
    if len(words) > 1 and words[1] not in (*commands, "--debug"):
        _insert("run", 1)
    elif (at := _bridge_at(parser, words)) is not None:
        _insert("--bridge", at)
    # Without its own default, argcomplete offers files for every word.
    argcomplete.autocomplete(parser, default_completer=_files_where_a_path_is_due)
    sys.exit()


def _insert(word: str, number: int) -> None:
    """Insert a word before word `number` of the line to complete."""
    line = os.environ["COMP_LINE"]
    at = [found.start() for found in re.finditer(r"\S+", line)][number]
    os.environ["COMP_LINE"] = f"{line[:at]}{word} {line[at:]}"
    os.environ["COMP_POINT"] = str(int(os.environ["COMP_POINT"]) + len(word) + 1)


def _bridge_at(parser: ArgumentParser, words: Sequence[str]) -> int | None:
    """Return which word is a bridge's name before a topic, as in ``pause NAME TOPIC``, or None."""
    for number, word in enumerate(words[1:], 1):
        commands = commands_of(parser)
        if commands is None:
            takes = {each.dest for each in actions_of(parser)}
            first = "bridge" in takes and not takes.isdisjoint(NAMES_IN_ROS) and word in bridge_names()
            return number if first else None
        if word not in commands:
            return None
        parser = commands[word]
    return None


def _files_where_a_path_is_due(prefix: str, action: Action, **_: object) -> list[str]:
    if action.type is not Path and action.metavar not in _PATHS:
        return []
    return [each for each in FilesCompleter()(prefix) if is_clean(each)]


def yaml_files(prefix: str, **_: object) -> list[str]:
    """Return the YAML files that complete a path, and folders to look further."""
    folder, slash, start = prefix.rpartition("/")
    try:
        found = sorted(path for path in typed_path(folder + slash).iterdir() if path.name.startswith(start))
    except OSError:
        return []
    return [
        f"{folder}{slash}{path.name}{'/' if path.is_dir() else ''}"
        for path in found
        if (start or not path.name.startswith(".")) and (path.is_dir() or path.suffix in (".yaml", ".yml"))
    ]


def theme_names(**_: object) -> list[str]:
    """Return the shipped themes, and the user's own."""
    from rsb_console.preferences import config_path, shipped_themes  # noqa: PLC0415 (needs Textual)

    folders = (shipped_themes(), config_path() / "themes")
    return sorted({path.stem for folder in folders for path in folder.glob("*.yaml")})


def bridge_names(**_: object) -> list[str]:
    """Return the bridges that run on this machine."""
    from rsb_bridge.control.control_sockets import find_sockets  # noqa: PLC0415 (only for the commands that attach)

    return [path.stem for path in find_sockets(os.environ)]


def bridges_and_files(prefix: str, **_: object) -> list[str]:
    """Return the bridges that run on this machine, and session files."""
    return bridge_names() + yaml_files(prefix)


def adapters(**_: object) -> list[str]:
    """Return the Bluetooth adapters of this machine."""
    return sorted(path.name for path in _ADAPTERS.glob("hci*")) if _ADAPTERS.is_dir() else []


def bridged(parsed_args: Namespace, **_: object) -> list[str]:
    """Return the bridged names of the kinds that the command takes."""
    arguments = _filled(parsed_args)
    kinds = (arguments.kind,) if arguments.kind else arguments.kinds

    def names(engine: RemoteEngine) -> list[str]:
        return [
            route.topic
            for route in engine.snapshot().routes
            if route.spec.kind in kinds
            and arguments.link in ("", route.link)
            and arguments.direction in (None, route.spec.direction)
        ]

    return _bridges_unless_named(arguments) + _asked(arguments, names)


def _bridges_unless_named(arguments: Namespace) -> list[str]:
    """Return the bridges whose name may stand before a topic."""
    is_named = arguments.bridge or arguments.control or getattr(arguments, "topics", None)
    return [] if is_named else bridge_names()


def far_names(parsed_args: Namespace, **_: object) -> list[str]:
    """Return the names on the other side for the typed name."""
    arguments = _filled(parsed_args)

    return _asked(
        arguments,
        lambda engine: [route.remote_topic for route in engine.snapshot().routes if route.topic == arguments.topic],
    )


def available(parsed_args: Namespace, **_: object) -> list[str]:
    """Return the names that can be bridged, from both sides."""
    arguments = _filled(parsed_args)
    kind = arguments.kind or "topic"

    def names(engine: RemoteEngine) -> list[str]:
        links = [arguments.link] if arguments.link else [link.name for link in engine.snapshot().links]
        asked = [engine.topics(side) for side in (None, *links)]
        answers = [future.result(_WAITS) for future in asked if future.exception(_WAITS) is None]
        return [info.topic for answer in answers for info in answer if info.kind == kind]

    return _bridges_unless_named(arguments) + _asked(arguments, names)


def links(parsed_args: Namespace, **_: object) -> list[str]:
    """Return the clients of a bridge, by name."""
    return asked_of_bridge(parsed_args, lambda engine: [link.name for link in engine.snapshot().links])


def asked_of_bridge(parsed_args: Namespace, ask: Callable[[RemoteEngine], list[str]]) -> list[str]:
    """Return the answer of the bridge that the arguments so far name, or an empty list if none answers in time."""
    return _asked(_filled(parsed_args), ask)


def awaited(**_: object) -> list[str]:
    """Return the conditions of `wait`. argcomplete asks for the first word after an option only."""
    return ["flowing", "linked", "stopped"]


def lanes(**_: object) -> list[str]:
    """Return the services of actions and parameters."""
    return sorted({lane.name for kind in LANES for lane in LANES[kind] if lane.name and not lane.is_topic})


def direction_or_keys(prefix: str, parsed_args: Namespace, **_: object) -> list[str]:
    """Return directions or keys for a topic, and only keys for other kinds."""
    directions = _DIRECTIONS if _filled(parsed_args).kind in (None, "topic") else []
    return [*directions, *keys(prefix, parsed_args)]


def keys(prefix: str, parsed_args: Namespace, **_: object) -> list[str]:
    """Return the keys of a topic or a service; after a key and ``=``, its values, if they can be listed."""
    known = KEYS[_filled(parsed_args).kind or "topic"]
    key, is_pair, _value = prefix.partition("=")
    if not is_pair:
        return [f"{each}=" for each in known if each not in _NOT_TYPED]
    return [f"{key}={value}" for value in _VALUES.get(known.get(key, ""), ())]


def _choices(annotation: Any) -> list[str]:
    """Return the values of a literal type or a switch, or an empty list for other types."""
    if annotation is bool:
        return ["true", "false"]
    if get_origin(annotation) is Literal:
        return [str(each) for each in get_args(annotation)]
    return [choice for part in get_args(annotation) for choice in _choices(part)]


_VALUES = {field.name: _choices(field.type) for field in fields(Topic)}
_VALUES |= {name: _choices(key.type) for name, key in ADDED_KEYS.items()}
# These are the values of the key `provider`, whose field is the direction; a topic's direction is no key.
_VALUES |= {"qos": [AUTO, *PROFILES], "direction": ["client", "server"], "type": [AUTO]}


def _filled(parsed_args: Namespace) -> Namespace:
    """Return the arguments so far, with defaults for the missing ones."""
    return Namespace(**{**_DEFAULTS, **vars(parsed_args)})


def _asked(arguments: Namespace, ask: Callable[[RemoteEngine], list[str]]) -> list[str]:
    """Return the answer of a running bridge, or an empty list if none answers in time."""
    from rsb_console.command.target import attached  # noqa: PLC0415 (only for what a running bridge knows)

    found: list[str] = []

    def work() -> None:
        with attached(arguments, read_only=True) as engine:
            found.extend(dict.fromkeys(ask(engine)))

    # A traceback would be written into the line that the operator types.
    threading.excepthook = lambda _: None
    # A daemon does not keep the process, and the shell, waiting for a bridge that hangs.
    asking = threading.Thread(target=work, daemon=True)
    asking.start()
    asking.join(_WAITS)
    return found
