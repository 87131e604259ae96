"""Answers operators' questions about managed nodes, and gives their orders."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import EnginePart, Level, LinkError, link_named, one_line, operator, sanitize_text
from rsb_extras.node_control import GROUPS
from rsb_extras.node_control.change_records import GROUP_NAME, NODE_NAME, ChangeText, Managed
from rsb_extras.node_control.change_requests import ChangeNodes, ListManaged, ManagedSide
from rsb_extras.node_control.link_changes import LinkChanges
from rsb_extras.node_control.node_changer import ChangeAsker, ChangeCode, NodeChanger

if TYPE_CHECKING:
    from rsb_bridge.feature_api import Bridge, Link, Snapshot
    from rsb_extras.node_control.change_records import ChangeOutcome


class ChangesPart(EnginePart):
    def __init__(self, bridge: Bridge) -> None:
        super().__init__()
        self._bridge = bridge
        self._changer = bridge.context.shared(NodeChanger)
        self.handlers = {ListManaged: self._list, ChangeNodes: self._change}
        self.by_key = (((GROUPS.name,), lambda: None),)  # it is read whenever it is needed

    def tick(self, snapshot: Snapshot) -> None:
        self._changer.services.tick()

    async def _list(self, command: ListManaged) -> tuple[ManagedSide, ...]:
        if command.link:
            return (await self._of_link(link_named(command.link, self._bridge.links())),)
        sides = await asyncio.gather(self._own(), *map(self._of_link, self._bridge.links()))
        return tuple(side for side in sides if side.managed != Managed() or side.problem)

    async def _own(self) -> ManagedSide:
        return ManagedSide(managed=await self._changer.managed(ChangeAsker(operator())))

    async def _of_link(self, link: Link) -> ManagedSide:
        try:
            return ManagedSide(link.name, await link.extensions.find(LinkChanges).managed())
        except LinkError as error:
            return ManagedSide(link.name, problem=sanitize_text(str(error)))

    async def _change(self, command: ChangeNodes) -> ChangeOutcome:
        target, action = command.target, command.action
        if (NODE_NAME if "/" in target else GROUP_NAME).fullmatch(
            target
        ) is None:  # the other side would take it for a broken message
            raise LinkError(f"{one_line(target)} is neither a node's full name nor a group's: /part/part, or nav")
        if not command.link:
            return await self._changer.run(target, action, ChangeAsker(operator()))
        link = link_named(command.link, self._bridge.links())
        what, log = f"{target} of {link.name}", self._bridge.log
        log.add(ChangeCode.BEGAN, f"{what}: {action} asked for", link=link.name)
        try:
            outcome = await link.extensions.find(LinkChanges).run(target, action)
        except LinkError as error:
            log.add(ChangeCode.FAILED, f"{what}: {action}: {error}, asked for", level=Level.WARNING, link=link.name)
            raise
        level = Level.INFO if outcome.done else Level.WARNING
        code = ChangeCode.ENDED if outcome.done else ChangeCode.REFUSED if outcome.refused else ChangeCode.FAILED
        log.add(code, f"{what}: {ChangeText.of(action, outcome)}, asked for", level=level, link=link.name)
        return outcome

    async def close(self) -> None:
        await self._changer.close()
