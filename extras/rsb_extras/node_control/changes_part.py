"""Answers operators' questions about managed nodes, and gives their orders."""

from __future__ import annotations

import asyncio
from functools import partial
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
from rsb_extras.node_control import GROUPS
from rsb_extras.node_control.change_records import GROUP_NAME, NODE_NAME, ChangeText, Managed
from rsb_extras.node_control.change_requests import ChangeNodes, ListManaged, ManagedSide
from rsb_extras.node_control.link_changes import LinkChanges, RunChange
from rsb_extras.node_control.node_changer import (
    ChangeCode,
    NodeChanger,
    in_words,
    malformed,
)
from rsb_extras.node_control.parameter_nodes import read_pages
from rsb_extras.node_control.parameter_records import AskParameters
from rsb_extras.node_control.parameter_requests import ListParameterNodes, ParameterSide, ReadParameters

if TYPE_CHECKING:
    from rsb_bridge.feature_api import Bridge, Link, Snapshot
    from rsb_extras.node_control.change_records import ChangeOutcome
    from rsb_extras.node_control.parameter_records import NodeParameter


class ChangesPart(EnginePart):
    def __init__(self, bridge: Bridge) -> None:
        super().__init__()
        self._bridge = bridge
        self._changer = bridge.context.shared(NodeChanger)
        self.handlers = {
            ListManaged: self._list,
            ChangeNodes: self._change,
            ListParameterNodes: self._list_parameter_nodes,
            ReadParameters: self._read_parameters,
        }
        self.by_key = (((GROUPS.name,), lambda: None),)  # it is read whenever it is needed

    def tick(self, snapshot: Snapshot) -> None:
        self._changer.services.tick()

    async def _list(self, command: ListManaged) -> tuple[ManagedSide, ...]:
        if command.here:
            return (await self._own(),)
        if command.link:
            return (await self._of_link(link_named(command.link, self._bridge.links())),)
        sides = await asyncio.gather(self._own(), *map(self._of_link, self._bridge.links()))
        return tuple(side for side in sides if side.managed != Managed() or side.problem)

    async def _own(self) -> ManagedSide:
        return ManagedSide(managed=await self._changer.managed(Asker(operator())))

    async def _of_link(self, link: Link) -> ManagedSide:
        if not link.linked:
            return ManagedSide(link.name, problem=sanitize_text(OrderProblem.AWAY(reason=link.down_reason)))
        try:
            return ManagedSide(link.name, (await link.extensions.find(LinkChanges).list_of_peer()).managed)
        except LinkError as error:
            return ManagedSide(link.name, problem=sanitize_text(str(error)))

    async def _list_parameter_nodes(self, command: ListParameterNodes) -> tuple[ParameterSide, ...]:
        if command.link:
            return (await self._parameter_side(link_named(command.link, self._bridge.links())),)
        linked = [link for link in self._bridge.links() if link.linked]
        own = await self._changer.parameters(AskParameters(0), Asker(operator()))
        sides = (ParameterSide(nodes=own.nodes), *await asyncio.gather(*map(self._parameter_side, linked)))
        return tuple(side for side in sides if side.nodes or side.problem)

    async def _parameter_side(self, link: Link) -> ParameterSide:
        try:
            answer = await link.extensions.find(LinkChanges).parameters(AskParameters(0))
        except LinkError as error:
            return ParameterSide(link.name, problem=sanitize_text(str(error)))
        return ParameterSide(link.name, answer.nodes, answer.problem)

    async def _read_parameters(self, command: ReadParameters) -> tuple[NodeParameter, ...]:
        _check_target(command.node)
        if command.link:
            page = link_named(command.link, self._bridge.links()).extensions.find(LinkChanges).parameters
        else:
            page = partial(self._changer.parameters, asker=Asker(operator()))
        return await read_pages(page, command.node, command.names, whole=command.whole)

    async def _change(self, command: ChangeNodes) -> ChangeOutcome:
        target, action = command.target, command.action
        _check_target(target)
        if not command.link:
            asker = Asker(operator())
            return await self._changer.run(target, action, asker, command.values, command.component)
        link = link_named(command.link, self._bridge.links())
        if problem := malformed(target, action, command.values, command.component):
            raise LinkError(problem)
        order = RunChange(target, action, command.values, command.component)
        what, log = f"{target} of {link.name}", self._bridge.log
        log.add(
            ChangeCode.BEGAN,
            f"{what}: {in_words(action, command.values, command.component)} asked for",
            link=link.name,
        )
        try:
            outcome = await link.extensions.find(LinkChanges).give(order)
        except LinkError as error:
            log.add(ChangeCode.FAILED, f"{what}: {action}: {error}, asked for", level=Level.WARNING, link=link.name)
            raise
        level = Level.INFO if outcome.done else Level.WARNING
        code = ChangeCode.ENDED if outcome.done else ChangeCode.REFUSED if outcome.refused else ChangeCode.FAILED
        log.add(code, f"{what}: {ChangeText.of(action, outcome)}, asked for", level=level, link=link.name)
        return outcome

    async def close(self) -> None:
        await self._changer.close()


def _check_target(target: str) -> None:
    """Refuse what the other side would take for a broken message."""
    if (NODE_NAME if "/" in target else GROUP_NAME).fullmatch(target) is None:
        raise LinkError(f"{one_line(target)} is neither a node's full name nor a group's: /part/part, or nav")
