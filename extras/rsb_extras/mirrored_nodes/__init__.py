"""Mirrored nodes: those of the other side stand in this domain, so that ROS's own tools find them here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from rsb_bridge.feature_api import Feature, SessionKey, ShownField

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.feature_api import Bridge, EnginePart, Extension, Link
    from rsb_console.feature_console import LinkFact


class GraphKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The parts of the other side's graph that stand in this side's.

    Attributes:
        nodes: whether its nodes do.
    """

    nodes: bool = False


class MirrorCount(msgspec.Struct, frozen=True):
    """The nodes of a link's other side that stand here.

    Attributes:
        left_out: reasons why others do not, each with the node and the remedy.
    """

    nodes: int = 0
    left_out: tuple[str, ...] = ()


GRAPH = SessionKey("graph", GraphKeys, GraphKeys(), live=True, of_peer=True)
MIRRORED: ShownField[MirrorCount | None] = ShownField("mirrored", MirrorCount | None, None)


class MirroredNodes(Feature):
    name = "mirrored_nodes"
    needs = ("nodes",)

    def session_keys(self) -> Iterable[SessionKey[Any]]:
        return (GRAPH,)

    def effects(self, session: Any) -> Iterable[str]:
        peers = [each.name for each in session.clients or () if GRAPH.of(each).nodes]
        if not peers and not session.clients and GRAPH.of(session).nodes:
            peers = ["the other side"]
        return [f"the nodes of {each} stand in this domain, too (graph)" for each in peers]

    def extensions(self, link: Link) -> Iterable[Extension]:
        from rsb_extras.mirrored_nodes.link_mirrors import LinkMirrors  # noqa: PLC0415 -- see `Feature`, here and below

        return (LinkMirrors(link),)

    def parts(self, bridge: Bridge) -> Iterable[EnginePart]:
        from rsb_extras.mirrored_nodes.mirrors_part import MirrorsPart  # noqa: PLC0415

        return (MirrorsPart(bridge),)

    def link_facts(self) -> Iterable[LinkFact]:
        from rsb_extras.mirrored_nodes.mirror_lines import FACT  # noqa: PLC0415

        return (FACT,)


FEATURE = MirroredNodes()
