"""The command palette's entries, from the registry."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, cast

from textual.command import DiscoveryHit, Hit, Provider

from rsb_console.actions import ACTIONS, NAMESPACE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from textual.command import Hits

    from rsb_console.actions import Action
    from rsb_console.app import ConsoleApp


class ActionsProvider(Provider):
    """Every action that can be done now, by its words, with its keys."""

    def _possible(self) -> Iterator[Action]:
        return (action for action in ACTIONS if self.screen.check_action(action.id, ()))

    async def discover(self) -> Hits:
        """All of them, before anything is typed."""
        for action in self._possible():
            yield DiscoveryHit(action.help, partial(self._do, action), help=self._keys(action))

    async def search(self, query: str) -> Hits:
        """Those that match."""
        matcher = self.matcher(query)
        for action in self._possible():
            score = matcher.match(f"{action.help} {action.words}")
            if score > 0:
                yield Hit(score, matcher.highlight(action.help), partial(self._do, action), help=self._keys(action))

    def _keys(self, action: Action) -> str:
        return "  ".join(cast("ConsoleApp", self.app).key_labels(action))

    async def _do(self, action: Action) -> None:
        await self.app.run_action(f"{NAMESPACE[action.group]}.{action.id}")
