"""The command palette's entries, from the registry."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from textual.command import DiscoveryHit, Hit, Provider

from rsb_console.actions.registry import NAMESPACE

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from textual.command import Hits

    from rsb_console.actions.registry import Action


@runtime_checkable
class LabelsKeys(Protocol):
    """An app that knows the keys of actions, as `rsb_console.console.Console` does.

    Attributes:
        actions: all that it has.
    """

    actions: Sequence[Action]

    def key_labels(self, action: Action) -> list[str]:
        """The keys of an action, as they are written on a keyboard."""
        ...


class ActionsProvider(Provider):
    """Finds the actions that are possible now, and shows their keys."""

    def _possible(self) -> Iterator[Action]:
        assert isinstance(self.app, LabelsKeys)
        return (action for action in self.app.actions if self.screen.check_action(action.id, ()))

    async def discover(self) -> Hits:
        for action in self._possible():
            yield DiscoveryHit(action.help, partial(self._run, action), help=self._keys(action))

    async def search(self, query: str) -> Hits:
        matcher = self.matcher(query)
        for action in self._possible():
            score = matcher.match(f"{action.help} {action.label} {action.also}")
            if score > 0:
                yield Hit(score, matcher.highlight(action.help), partial(self._run, action), help=self._keys(action))

    def _keys(self, action: Action) -> str:
        assert isinstance(self.app, LabelsKeys)
        return "  ".join(self.app.key_labels(action))

    async def _run(self, action: Action) -> None:
        await self.app.run_action(f"{NAMESPACE[action.group]}.{action.id}")
