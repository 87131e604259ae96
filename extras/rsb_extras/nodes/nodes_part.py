"""Answers consoles' questions about nodes, and keeps the book of this side's."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import asdict

from rsb_bridge.feature_api import EnginePart, link_named
from rsb_extras.nodes import HEAR_ROSOUT, SHOW_NODES
from rsb_extras.nodes.link_nodes import LinkNodes
from rsb_extras.nodes.node_data import Nodes, NodesSeen, OneNode
from rsb_extras.nodes.node_watch import NodeWatch

if TYPE_CHECKING:
    from rsb_bridge.feature_api import Bridge, Snapshot
    from rsb_extras.nodes.node_data import NodeDetails


class NodesPart(EnginePart):
    def __init__(self, bridge: Bridge) -> None:
        super().__init__()
        self._bridge = bridge
        self._watch = bridge.context.shared(NodeWatch)
        self.handlers = {Nodes: self._nodes, OneNode: self._one}
        self.by_key = (((HEAR_ROSOUT.name, SHOW_NODES.name), lambda: None),)  # they are read when they are needed

    def tick(self, snapshot: Snapshot) -> None:
        self._watch.tick(self._bridge.graph_watch.changes)

    async def close(self) -> None:
        self._watch.close()

    async def _nodes(self, command: Nodes) -> NodesSeen:
        now = round(self._bridge.context.now())
        if command.link is None:
            self._watch.look()
            await self._watch.ready()
            return NodesSeen(**asdict(self._watch.book.changes(command.book, command.since, now)))
        there = self._there(command.link)
        await there.look()
        found = there.book.changes(command.book, command.since, now)
        return NodesSeen(**asdict(found), age=round(there.age))

    async def _one(self, command: OneNode) -> NodeDetails:
        if command.link is None:
            self._watch.look()
            await self._watch.ready()
            return self._watch.details(command.node, command.topic)
        return await self._there(command.link).one(command.node, command.topic)

    def _there(self, link: str) -> LinkNodes:
        return link_named(link, self._bridge.links()).extensions.find(LinkNodes)
