"""Units over one link: what its peer may see and ask for here, and what this side's operators ask for there."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import OrderAnswer, OrderBase, OrderEnd, OrderExtension, OrderQuestion
from rsb_extras.units.unit_records import UnitAction, UnitName, UnitOutcome, UnitRecords
from rsb_extras.units.unit_requests import LONGEST
from rsb_extras.units.unit_runner import UnitRunner

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from rsb_bridge.feature_api import Asker, Link


class AskUnits(OrderQuestion, frozen=True):
    """Asks for the other side's units, or for a ticket."""


class UnitAnswer(OrderAnswer, frozen=True):
    """A side's units, or a ticket."""

    units: UnitRecords = ()


class RunUnit(OrderBase, frozen=True):
    """Asks for an action on a unit."""

    unit: UnitName
    action: UnitAction


class UnitEnded(OrderEnd[UnitOutcome], frozen=True):
    """The end of an action, or why it was refused."""


class LinkUnits(OrderExtension[UnitAnswer, RunUnit, UnitOutcome]):
    """One link's units, in both directions."""

    question, answer, order, end, outcome = AskUnits, UnitAnswer, RunUnit, UnitEnded, UnitOutcome
    longest = LONGEST

    def __init__(self, link: Link) -> None:
        super().__init__(link)
        self._runner = link.context.shared(UnitRunner)
        self._runner.links.add(link)

    async def list_for(self, asker: Asker, request: int) -> UnitAnswer:
        return UnitAnswer(request, units=await self._runner.records(asker))

    def carry_out(self, order: RunUnit, asker: Asker) -> Coroutine[None, None, UnitOutcome]:
        return self._runner.run(order.unit, order.action, asker)
