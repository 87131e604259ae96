"""The nodes of a link's other side that stand here, and the link's endpoints on them."""

from __future__ import annotations

from enum import StrEnum
from math import inf
from typing import TYPE_CHECKING, Final

from rsb_bridge.feature_api import Extension, Level, RosError
from rsb_bridge.model.names import OF_EVERY_NODE, client_topic, server_topic
from rsb_extras.mirrored_nodes import GRAPH, MIRRORED, MirrorCount
from rsb_extras.mirrored_nodes.mirror_table import MirrorTable, NotMirrored, is_mirrorable
from rsb_extras.nodes.link_nodes import LinkNodes

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from rsb_bridge.feature_api import Link, Route
    from rsb_bridge.ros.ros_interface import EndPlace

MOST: Final = 200
"""Nodes of one link."""
_A_SECOND: Final = 50
"""Nodes that are made in a second, and topics that are moved, at most: 0.1 ms and 1 ms each. A round figure."""
_LISTED_WITHIN: Final = 10.0
"""s in which the other side lists a node whose topic or link came first. A round figure: it reads 50 nodes a second."""
_MOST_REASONS: Final = 8


class MirrorCode(StrEnum):
    LEFT_OUT = "mirrored_nodes.left_out"


class LinkMirrors(Extension):
    """Mirrors the nodes of one link's other side. `MirrorsPart` has it look each second."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._table = link.context.shared(MirrorTable)
        self._mine: dict[str, float] = {}  # names here, with the time (s) until which each stands without being listed
        self._placed: dict[EndPlace, str] = {}
        self._left_out: dict[str, str] = {}  # reasons, by names
        self._logged: set[str] = set()

    @property
    def wanted(self) -> bool:
        return GRAPH.of(self._link.end.rights).nodes

    @property
    def is_at_work(self) -> bool:
        return self.wanted or bool(self._mine or self._placed)

    def connected(self) -> None:
        """Keep the nodes of a link that has come back between two looks until the new association's list comes."""
        self._mine = dict.fromkeys(self._mine, self._link.context.now() + _LISTED_WITHIN)

    def link_fields(self) -> Mapping[str, MirrorCount]:
        if not self.wanted:
            return {}
        return {MIRRORED.name: MirrorCount(len(self._mine), tuple(self._left_out.values())[:_MOST_REASONS])}

    # --- once a second

    def update(self) -> None:
        """Mirror the nodes that run on the other side, and no others; have their topics and services belong to them."""
        self._left_out = {}
        if not (self.wanted and self._shows_nodes()):
            self.end()
            self._log()
            return
        nodes, now = self._link.extensions.find(LinkNodes).book.nodes, self._link.context.now()
        running = {self._name_here(name) for name, each in nodes.items() if each.ended is None and is_mirrorable(name)}
        if unlisted := {name for name, until in self._mine.items() if until <= now}:
            self._mine |= dict.fromkeys(unlisted & self._names_of_ends(), now + _LISTED_WITHIN)
        leaving = set[str]()
        for name, until in self._mine.items():
            if clash := self._table.clash(name, self._link.name):
                self._left_out[name] = clash
            if clash or (name not in running and (until == inf or now >= until)):
                leaving.add(name)
            elif name in running:
                self._mine[name] = inf
        new = sorted(running - self._mine.keys() - self._left_out.keys())
        for name in new[:_A_SECOND]:
            self._stands(name, inf)
        if len(self._mine) >= MOST and running - self._mine.keys() - self._left_out.keys():
            self._left_out[""] = NotMirrored.TOO_MANY(limit=MOST)
        self._place_all(leaving)
        self._log()

    def end(self) -> None:
        """Mirror nothing: the association is over, or nobody wants it any more."""
        self._place_all({*self._mine})

    def _shows_nodes(self) -> bool:
        there = self._link.extensions.find(LinkNodes)
        shown = there.keep_looking()
        if there.book.why_not:
            self._left_out[""] = NotMirrored.NOT_SHOWN(reason=there.book.why_not)
        elif not shown and self._link.linked:
            self._left_out[""] = NotMirrored.LACKS()
        return shown

    def _log(self) -> None:
        reasons = set(self._left_out.values())
        for text in sorted(reasons - self._logged)[:_MOST_REASONS]:
            self._link.log(Level.WARNING, MirrorCode.LEFT_OUT, text)
        self._logged = reasons

    # --- nodes

    def _name_here(self, node: str) -> str:
        """Return the name here of one of the other side's nodes: with the prefix that topics have."""
        link = self._link
        if not link.end.use_name:
            return node
        return (client_topic(node, link.name) or node) if link.is_client else server_topic(node, link.name)

    def _stands(self, name: str, until: float) -> bool:
        """Mirror a node unless it is mirrored; return whether it is."""
        if name in self._mine:
            return True
        if len(self._mine) >= MOST or not is_mirrorable(name):  # with its prefix, it may be too long
            return False
        if clash := self._table.clash(name, self._link.name):
            self._left_out[name] = clash
            return False
        try:
            self._table.add(name, self._link.name)
        except RosError as error:
            self._left_out[name] = str(error)
            return False
        self._mine[name] = until
        return True

    # --- endpoints on them

    def place(self, route: Route, nodes: Sequence[str]) -> None:
        """Place the ends of a route that are about to be made on one of these nodes of the other side.

        The list of nodes may not have come yet, or lack a new one. So that no message is sent twice, the node is
        mirrored at once.
        """
        if not self.wanted or _is_of_all(route) or not self._link.extensions.find(LinkNodes).keep_looking():
            return
        until = self._link.context.now() + _LISTED_WITHIN
        names = (self._name_here(node) for node in nodes if is_mirrorable(node))
        self._put(route.half.places, next((name for name in names if self._stands(name, until)), ""))

    def _place_all(self, leaving: set[str]) -> None:
        """Have the ends of all routes belong to the nodes that have them on the other side now.

        Nodes that leave end then. One with an end that cannot be moved yet stays until it can be.
        """
        if not self._mine and not self._placed:
            return
        moved, present, staying = 0, set[object](), self._mine.keys() - leaving
        for route in self._link.routes.values():
            places = () if _is_of_all(route) else route.half.places
            present.update(places)
            # What moves a robot is not interrupted.
            if not places or moved >= _A_SECOND or route.arming.held:
                continue
            before = self._placed.get(places[0], "")
            if (node := self._node_of(route, before, staying)) != before:
                self._put(places, node)
                moved += 1
                if not route.half.move():
                    self._put(places, before)  # tried again in a second
                route.wake()
        self._put(self._placed.keys() - present, "")
        for name in leaving - set(self._placed.values()):
            del self._mine[name]
            self._table.remove(name)

    def _node_of(self, route: Route, before: str, staying: Collection[str]) -> str:
        """Return the mirrored node that has what a route carries, the present one if possible, or an empty string."""
        names = [self._name_here(node) for node in route.half.facts.nodes_there]
        if before in staying and (before in names or not names):
            return before
        return next((name for name in names if name in staying), "")

    def _names_of_ends(self) -> set[str]:
        """Return the names here of nodes that have what is bridged; the list may have no room for them."""
        halves = (route.half for route in self._link.routes.values())
        return {self._name_here(node) for half in halves for node in half.facts.nodes_there}

    def _put(self, places: Iterable[EndPlace], node: str) -> None:
        for each in tuple(places):
            self._link.context.ros.mirrors.place(each, node)
            if node:
                self._placed[each] = node
            else:
                self._placed.pop(each, None)


def _is_of_all(route: Route) -> bool:
    """Whether a route is of no node: an internal one, or one of a topic that each node has."""
    return not route.purpose.in_graph or not {route.topic, route.remote_topic}.isdisjoint(OF_EVERY_NODE)
