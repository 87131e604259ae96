"""The command palette's entries, from the registry."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from textual.command import DiscoveryHit, Hit, Provider

from rsb_console.actions import ACTIONS, NAMESPACE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from textual.command import Hits

    from rsb_console.actions import Action


class ActionsProvider(Provider):
    """Every action that can be done now, by its words."""

    def _possible(self) -> Iterator[Action]:
        return (action for action in ACTIONS if self.screen.check_action(action.id, ()))

    async def discover(self) -> Hits:
        """All of them, before anything is typed."""
        for action in self._possible():
            yield DiscoveryHit(action.help, partial(self._do, action), help=f"{action.words} · {action.id}")

    async def search(self, query: str) -> Hits:
        """Those that match."""
        matcher = self.matcher(query)
        for action in self._possible():
            score = matcher.match(f"{action.help} {action.words}")
            if score > 0:
                yield Hit(score, matcher.highlight(action.help), partial(self._do, action), help=action.words)

    async def _do(self, action: Action) -> None:
        await self.app.run_action(f"{NAMESPACE[action.group]}.{action.id}")
