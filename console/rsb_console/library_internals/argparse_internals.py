"""The contents of a parser, which argparse offers no way to read or to change."""

from __future__ import annotations

import argparse
from argparse import _SubParsersAction as Subcommands
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

__all__ = ["Subcommands", "actions_of", "commands_of", "forget_default", "options_of", "put_in_order"]


def actions_of(parser: argparse.ArgumentParser) -> Sequence[argparse.Action]:
    """Return all arguments and options of a parser, for completion and for words in any order."""
    return parser._actions


def options_of(parser: argparse.ArgumentParser) -> Mapping[str, argparse.Action]:
    """Return a parser's options by the words that name each."""
    return parser._option_string_actions


def commands_of(parser: argparse.ArgumentParser) -> Mapping[str, argparse.ArgumentParser] | None:
    """Return the parsers of a parser's subcommands by their names, or None if it has none."""
    found = (each.choices for each in actions_of(parser) if isinstance(each, Subcommands))
    return next(found, None)


def forget_default(parser: argparse.ArgumentParser, name: str) -> None:
    """Take back what `set_defaults` set: such a default counts even where a parser's own one is suppressed."""
    parser._defaults.pop(name, None)


def put_in_order(commands: Subcommands[Any], names: Sequence[str]) -> None:
    """Put subcommands in the order of their names, for ``--help``: argparse keeps that in which they were added."""
    commands._choices_actions.sort(key=lambda action: names.index(action.dest))
    for name in names:  # a dict keeps the order in which its keys came
        commands._name_parser_map[name] = commands._name_parser_map.pop(name)
