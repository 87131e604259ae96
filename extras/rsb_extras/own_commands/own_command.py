"""An operator's commands: how ``console.yaml`` lists them, and the actions that they become."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, get_args

import msgspec
from textual.keys import Keys, key_to_character

from rsb_bridge.feature_api import Wording, join_first
from rsb_bridge.model.text import is_clean
from rsb_console.feature_console import Action, ConsoleSetting, Group, late
from rsb_console.library_internals.textual_internals import key_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

Where = Literal["all", "link", "topic"]
PLACEHOLDERS: Mapping[str, Where] = {
    "robot": "link",
    "topic": "topic",
    "link": "link",
    "type": "topic",
    "state": "link",
}
"""What has to be under the cursor for each; a topic has a link, too."""
_HAS: Mapping[str, tuple[str, ...]] = {"all": ("all",), "link": ("all", "link"), "topic": ("all", "link", "topic")}
_PLACEHOLDER = re.compile(r"(?<![${])\{([a-z_]+)\}(?!\})")
_OF_SCREENS = frozenset(
    {"tab", "shift+tab", "ctrl+c", "ctrl+p", "ctrl+q", "left", "right", "ctrl+pageup", "ctrl+pagedown"}
)
"""Keys that the console's lists and Textual use besides the actions."""
_NAMED_KEYS = frozenset(key.value for key in Keys)
_LONGEST_RUN, _LONGEST_DESCRIPTION, _LONGEST_LABEL = 8192, 60, 16  # characters
_MOST = 64
"""Commands in the file: a round figure, more than there are free keys to remember."""
_PLACE = "rsb_extras.own_commands.command_keys"


class CommandMistake(Wording):
    """Mistakes in the setting ``commands``."""

    LEFT_OUT = "Commands left out"
    OF_OTHERS = "no command of console.yaml runs as this user: {reason}"
    NO_MAPPING = 'commands: map keys to commands, like Y: {{run: "uptime"}}'
    TOO_MANY = "commands: at most {most} are possible"
    NO_KEY = "commands.{key}: {key} is no key; give one like X, f9 or ctrl+g"
    TAKEN = "commands.{key}: the console needs {key} for itself; give another key"
    NO_COMMAND = 'commands.{key}: give at least run, like {{run: "uptime"}}'
    FIELD = "commands.{key}.{field}: {problem}"
    UNKNOWN_FIELDS = "commands.{key}: {fields}: not part of a command; it has {known}"
    NO_TEXT = "give a text in quotation marks, of 1 to {most} printable characters"
    NO_SWITCH = "give true or false"
    NO_PLACE = "give one of {places}"
    NO_PLACEHOLDER = "{{{name}}} is no placeholder; there are {known}. For the shell, write {{ {name} }}"
    NEEDS_PLACE = "{{{name}}} needs where: {places}"


class OwnCommand(msgspec.Struct, frozen=True, kw_only=True):
    """One command of the operator's.

    Attributes:
        key: Textual key name.
        run: a line for ``/bin/sh``, with placeholders.
        where: what must be under the cursor.
        confirm: whether to ask first.
        changes: whether ``--readonly`` disables it.
        interactive: whether it gets the terminal, instead of a pane for its output.
    """

    key: str
    run: str
    description: str
    where: Where
    confirm: bool
    changes: bool
    interactive: bool

    @property
    def id(self) -> str:
        return "command_" + re.sub(r"\W", "_", self.key)

    @property
    def placeholders(self) -> frozenset[str]:
        return frozenset(_PLACEHOLDER.findall(self.run))

    def line(self, values: Mapping[str, str]) -> str:
        """Return the line for the shell.

        Raises:
            UnsafeValueError: a value is empty, or a shell would read more in it than a word.
        """
        for name in sorted(self.placeholders):
            if not is_plain(values[name]):
                raise UnsafeValueError(name, values[name])
        return _PLACEHOLDER.sub(lambda found: values[found[1]], self.run)


@dataclass
class UnsafeValueError(Exception):
    """A value that no quotation marks make safe on all the ways that a command may take."""

    name: str
    value: str


def is_plain(value: str) -> bool:
    """Whether a value is one word to any shell, without quotation marks, and no option.

    A value that needs quotation marks is refused: they would protect it from the first shell only, and from none within
    others. ``ssh {robot} ros2 topic info {topic}`` has the robot's shell read it again.
    """
    return bool(value) and shlex.quote(value) == value and not value.startswith("-")


def action_of(command: OwnCommand) -> Action:
    """Return the action of a command, for key, help, palette and footer."""
    has_link = command.where == "link"
    return Action(
        command.id, command.key, _short(command.description), command.description, Group.OWN,
        changes=command.changes, needs_topic=command.where == "topic", in_footer=True,
        run=partial(late(f"{_PLACE}:run_on_main"), command),
        possible=partial(late(f"{_PLACE}:has_link"), command) if has_link else None,
        on_link=partial(late(f"{_PLACE}:run_on_link"), command) if has_link else None,
        also=command.run,
    )  # fmt: skip


def _short(description: str) -> str:
    return description if len(description) <= _LONGEST_LABEL else f"{description[: _LONGEST_LABEL - 1].rstrip()}…"


def read_commands(given: object) -> tuple[OwnCommand, ...]:
    """Read the setting; raise ValueError with the first mistake."""
    if not isinstance(given, dict):
        raise ValueError(CommandMistake.NO_MAPPING())  # noqa: TRY004 -- as `ConsoleSetting.read` has to
    if len(given) > _MOST:
        raise ValueError(CommandMistake.TOO_MANY(most=_MOST))
    return tuple(_read_command(str(key), fields) for key, fields in given.items())


def _read_command(key: str, fields: object) -> OwnCommand:
    name = key_of(key) if len(key) == 1 else key
    last = name.rpartition("+")[2]
    if name not in _NAMED_KEYS and last not in _NAMED_KEYS and key_to_character(last) is None:
        raise ValueError(CommandMistake.NO_KEY(key=key))
    if name in _OF_SCREENS:
        raise ValueError(CommandMistake.TAKEN(key=key))
    if not isinstance(fields, dict) or "run" not in fields:
        raise ValueError(CommandMistake.NO_COMMAND(key=key))
    known = [each for each in OwnCommand.__struct_fields__ if each != "key"]
    if unknown := [str(each) for each in fields if each not in known]:
        shown = {"fields": ", ".join(unknown), "known": join_first(known, len(known))}
        raise ValueError(CommandMistake.UNKNOWN_FIELDS(key=key, **shown))
    for field, problem in _problems(fields):
        raise ValueError(CommandMistake.FIELD(key=key, field=field, problem=problem))
    run = fields["run"].strip()
    defaults = {
        "description": run.splitlines()[0][:_LONGEST_DESCRIPTION],
        "where": "all",
        "confirm": False,
        "changes": True,
        "interactive": False,
    }
    return OwnCommand(**{**defaults, **fields, "key": name, "run": run})


def _problems(fields: dict[str, Any]) -> Iterator[tuple[str, str]]:
    for field, most in (("run", _LONGEST_RUN), ("description", _LONGEST_DESCRIPTION)):
        value = fields.get(field, "x")
        if not isinstance(value, str) or not value.strip() or len(value) > most or not _is_printable(value, field):
            yield field, CommandMistake.NO_TEXT(most=most)
    for field in ("confirm", "changes", "interactive"):
        if not isinstance(fields.get(field, True), bool):
            yield field, CommandMistake.NO_SWITCH()
    where = fields.get("where", "all")
    if where not in get_args(Where):
        yield "where", CommandMistake.NO_PLACE(places=join_first(get_args(Where), 3))
    elif problem := _run_problem(fields["run"], where):
        yield "run", problem


def _is_printable(value: str, field: str) -> bool:
    return is_clean(value.replace("\n", "").replace("\t", "") if field == "run" else value)


def _run_problem(run: str, where: Where) -> str:
    for name in _PLACEHOLDER.findall(run):
        if name not in PLACEHOLDERS:
            known = ", ".join(f"{{{each}}}" for each in PLACEHOLDERS)
            return CommandMistake.NO_PLACEHOLDER(name=name, known=known)
        if PLACEHOLDERS[name] not in _HAS[where]:
            places = [place for place, has in _HAS.items() if PLACEHOLDERS[name] in has]
            return CommandMistake.NEEDS_PLACE(name=name, places=" or ".join(places))
    return ""


COMMANDS: ConsoleSetting[tuple[OwnCommand, ...]] = ConsoleSetting("commands", (), read_commands)
