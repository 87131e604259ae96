"""The parser of a subcommand."""

from __future__ import annotations

import argparse
import itertools
from typing import TYPE_CHECKING

from rsb_console.library_internals.argparse_internals import actions_of, commands_of, options_of

if TYPE_CHECKING:
    from collections.abc import Sequence

NAMES_IN_ROS = frozenset(("topic", "topics", "node"))
"""Arguments whose full names begin with a slash, unlike a bridge's before them."""


class CommandParser(argparse.ArgumentParser):
    """Takes options in any place, and shows its own usage when it refuses something."""

    _intermixes = False

    def parse_known_args(  # type: ignore[override]  # argparse's is overloaded, by the kind of namespace
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        args = self._bridge_first(args)
        if self._intermixes:  # argparse calls this for the options, then for the rest
            return super().parse_known_args(args, namespace)
        # argparse refuses to intermix options with the words of subcommands.
        plain = commands_of(self) is not None or not {"-h", "--help"}.isdisjoint(
            args or ()
        )  # mixed, the help would leave things out
        parse = super().parse_known_args if plain else self.parse_known_intermixed_args
        self._intermixes = True
        try:
            found, unknown = parse(args, namespace)
        finally:
            self._intermixes = False
        # The main parser would also refuse them, but with its own usage instead of this command's.
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return found, []

    def _bridge_first(self, args: Sequence[str] | None) -> Sequence[str] | None:
        """Return arguments with ``--bridge`` before a bridge's name that stands first, as in ``pause NAME TOPIC``."""
        if not args or "--bridge" not in options_of(self) or args[0].startswith(("-", "/")):
            return args
        return ["--bridge", *args] if self._begins_with_a_bridge(args) else args

    def _begins_with_a_bridge(self, args: Sequence[str]) -> bool:
        """Whether the first word names a bridge: a topic begins with a slash, and a bridge's name does not."""
        words = [word for before, word in itertools.pairwise(("", *args)) if self._is_positional(before, word)]
        own = [action for action in actions_of(self) if not action.option_strings]
        if commands_of(self) is not None:  # `fleet NAME`; a command that is mistyped has words of its own
            known = {name for action in own for name in action.choices or ()}
            return words[0] not in known and known.issuperset(words[1:2])
        if NAMES_IN_ROS.isdisjoint(action.dest for action in own):
            return False
        if len(own) == len(words) == 1 and own[0].nargs == "?":  # `param list NAME`
            return True
        # `ack NAME LINK` has no slash that gives the topic away: the number of words decides.
        one_too_many = all(action.nargs is None for action in own) and len(words) == len(own) + 1
        return one_too_many or any(word.startswith(("/", "*")) for word in words[1:])

    def _is_positional(self, before: str, word: str) -> bool:
        option = options_of(self).get(before)
        return not word.startswith("-") and (option is None or option.nargs == 0)
