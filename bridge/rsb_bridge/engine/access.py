"""The operators that may attach over a network. The engine grants the rights; servers ask for them on any thread."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.config.keys import KeyFileError, key_warnings, unshared_keys
from rsb_bridge.config.operator_keys import granted_operators, operator_changes, operator_key_problem
from rsb_bridge.model.budgets import Strangers
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import operator
from rsb_bridge.model.snapshot import Level

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from rsb_bridge.config.keys import Key
    from rsb_bridge.config.operator_keys import Granted
    from rsb_bridge.model.clock import Clock
    from rsb_bridge.model.session import Session
    from rsb_bridge.telemetry.event_log import EventLog


class Access:
    """The operators of one engine.

    Args:
        name: the engine's; an operator's console has to ask for it.
        events: where it is recorded who attaches, and who is refused.
        strangers: the engine's budget of those who have not proven a key yet, or None for one of its own.

    Attributes:
        granted: by the operators' names; replaced as a whole.
    """

    def __init__(self, name: str, events: EventLog, clock: Clock, strangers: Strangers | None = None) -> None:
        self.name = name
        self.events = events
        self.clock = clock
        self.strangers = strangers or Strangers()
        self.granted: Mapping[str, Granted] = {}
        self._watchers: list[Callable[[], None]] = []

    def now(self) -> float:
        """Return the time (s) on a clock that nobody sets."""
        return self.clock.steady()

    def watch(self, changed: Callable[[], None]) -> None:
        """Have a function called whenever `granted` is another, on the engine's thread."""
        self._watchers.append(changed)

    def grant(self, granted: Mapping[str, Granted]) -> None:
        """Permit these operators to attach, and no others."""
        self.granted = granted
        for changed in self._watchers:
            changed()

    def check_link(self, keys: Mapping[str, tuple[Key, ...]]) -> None:
        """Check that no operator has the key of a client that is to be accepted.

        Args:
            keys: by the client's name.

        Raises:
            EngineError: an operator has such a key.
        """
        if problem := operator_key_problem({name: each.key for name, each in self.granted.items()}, keys):
            raise EngineError(problem)

    def reload(self, granted: Mapping[str, Granted], *, dry_run: bool) -> list[str]:
        """Grant the rights of a changed session.

        Args:
            granted: by the operators' names.
            dry_run: whether to report only, and change nothing.

        Returns:
            The changes in words.
        """
        texts = operator_changes(self.granted, granted)
        if texts and not dry_run:
            self.grant(granted)
            for text in texts:
                said = f"reload by {operator()}: {text}"
                self.events.add(Level.INFO, EventCode.OPERATOR_RELOADED, said, who=operator())
        return texts

    def warn_of(self, keys: Mapping[str, tuple[Key, ...]], granted: Mapping[str, Granted]) -> None:
        """Record warnings about the key files of operators and links."""
        all_keys = {**keys, **{f"operator {name}": (each.key,) for name, each in granted.items()}}
        for warning in key_warnings(all_keys, self.clock.time_ns() / 1e9):
            self.events.add(Level.WARNING, EventCode.KEY_WARNING, warning)


def load_keys(session: Session, base: Path) -> tuple[dict[str, tuple[Key, ...]], dict[str, Granted]]:
    """Return the keys of each client, and what operators may do.

    Raises:
        EngineError: a key is missing, or two have the same that must not.
    """
    try:
        keys = unshared_keys(session, base)
        return keys, granted_operators(session, base, keys)
    except KeyFileError as error:
        raise EngineError(str(error)) from None
