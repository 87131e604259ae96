"""Has each link mirror the nodes of its other side, once a second."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import EnginePart
from rsb_extras.mirrored_nodes import GRAPH
from rsb_extras.mirrored_nodes.link_mirrors import LinkMirrors
from rsb_extras.mirrored_nodes.mirror_table import MirrorTable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.feature_api import Bridge, Route, Snapshot


class MirrorsPart(EnginePart):
    def __init__(self, bridge: Bridge) -> None:
        super().__init__()
        self.by_key = (((GRAPH.name,), lambda: None),)  # it is read whenever it is needed
        self._bridge = bridge
        self._table = bridge.context.shared(MirrorTable)
        self._changes = -1
        self._at_work: Sequence[LinkMirrors] = ()
        bridge.context.place = self._place

    def tick(self, snapshot: Snapshot) -> None:
        found = [link.extensions.find(LinkMirrors) for link in self._bridge.links()]
        for each in self._at_work:
            if each not in found:  # its link was removed
                each.end()
        self._at_work = [each for each in found if each.is_at_work]
        if not self._at_work:
            return
        if (changes := self._bridge.graph_watch.changes) != self._changes:
            self._changes = changes
            self._table.read()
        for each in self._at_work:
            each.update()

    def _place(self, route: Route, nodes: Sequence[str]) -> None:
        for link in self._bridge.links():
            if link is route.peer:
                link.extensions.find(LinkMirrors).place(route, nodes)
