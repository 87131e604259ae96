"""Answers operators' questions about units, and gives their orders."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import (
    Asker,
    EnginePart,
    Level,
    LinkError,
    OrderProblem,
    link_named,
    one_line,
    operator,
    sanitize_text,
)
from rsb_extras.units import UNITS
from rsb_extras.units.link_units import LinkUnits, RunUnit
from rsb_extras.units.unit_records import NAME, UnitText
from rsb_extras.units.unit_requests import ControlUnit, ListUnits, UnitGroup
from rsb_extras.units.unit_runner import UnitCode, UnitProblem, UnitRunner

if TYPE_CHECKING:
    from rsb_bridge.feature_api import Bridge, Link
    from rsb_extras.units.unit_records import UnitOutcome


class UnitsPart(EnginePart):
    def __init__(self, bridge: Bridge) -> None:
        super().__init__()
        self._bridge = bridge
        self._runner = bridge.context.shared(UnitRunner)
        self.handlers = {ListUnits: self._list, ControlUnit: self._control}
        self.by_key = (((UNITS.name,), lambda: None),)  # it is read whenever it is needed

    async def _list(self, command: ListUnits) -> tuple[UnitGroup, ...]:
        if command.link:
            return (await self._of_link(link_named(command.link, self._bridge.links())),)
        own = UnitGroup(units=await self._runner.records(Asker(operator())))
        groups = (own, *await asyncio.gather(*map(self._of_link, self._bridge.links())))
        return tuple(group for group in groups if group.units or group.problem)

    async def _of_link(self, link: Link) -> UnitGroup:
        if not link.linked:
            return UnitGroup(link.name, problem=sanitize_text(OrderProblem.AWAY(reason=link.down_reason)))
        try:
            return UnitGroup(link.name, (await link.extensions.find(LinkUnits).list_of_peer()).units)
        except LinkError as error:
            return UnitGroup(link.name, problem=sanitize_text(str(error)))

    async def _control(self, command: ControlUnit) -> UnitOutcome:
        if not command.link:
            return await self._runner.run(command.unit, command.action, Asker(operator()))
        link = link_named(command.link, self._bridge.links())
        if NAME.fullmatch(command.unit) is None:  # the other side would take it for a broken message
            raise LinkError(UnitProblem.NO_UNIT(owner=link.name, name=one_line(command.unit)))
        what, log = f"unit {command.unit} of {link.name}: {command.action}", self._bridge.log
        log.add(UnitCode.BEGAN, f"{what} asked for", link=link.name)
        try:
            outcome = await link.extensions.find(LinkUnits).give(RunUnit(command.unit, command.action))
        except LinkError as error:
            log.add(UnitCode.FAILED, f"{what}: {error}, asked for", level=Level.WARNING, link=link.name)
            raise
        level = Level.INFO if outcome.done else Level.WARNING
        code = UnitCode.ENDED if outcome.done else UnitCode.REFUSED if outcome.refused else UnitCode.FAILED
        log.add(code, f"{what}: {UnitText.of(command.action, outcome)}, asked for", level=level, link=link.name)
        return outcome

    async def close(self) -> None:
        await self._runner.close()
