"""A scripted engine whose topics flow."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from tests.console.scripted import ScriptedEngine

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import RouteSnapshot


class Running(ScriptedEngine):
    """An engine whose topics have ten more messages a second, of 100 bytes each, at each look.

    Attributes:
        waits: whether it stays as it is until the command has seen it, however often the server looks.
        seen: whether the command has seen it.
    """

    step = 10
    waits = seen = False

    def snapshot(self) -> Any:
        if self.waits and not self.seen:
            return self.now
        self.seen = False
        now = self.now
        routes = tuple(self._more(each) for each in now.routes)
        self.now = replace(now, time=now.time + 1, routes=routes)
        return self.now

    def _more(self, before: RouteSnapshot) -> RouteSnapshot:
        ledger = before.ledger
        return replace(
            before,
            messages_total=before.messages_total + self.step,
            bytes_total=before.bytes_total + 100 * self.step,
            ledger=replace(ledger, offered=ledger.offered + 2 * self.step, delivered=ledger.delivered + self.step),
            history=(*before.history, self.step)[-120:],
        )
