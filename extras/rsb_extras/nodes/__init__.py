"""Nodes: those of the other side with their processes, lives and last lines, on a screen and in the shell."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Feature, SessionKey

if TYPE_CHECKING:
    from collections.abc import Iterable

    import msgspec

    from rsb_bridge.feature_api import Bridge, EnginePart, Extension, Link
    from rsb_console.feature_console import Action, AddCommand, Complete, TileLines

HEAR_ROSOUT = SessionKey("hear_rosout", bool, False, live=True)
"""Whether the bridge hears /rosout while nobody looks, so that a node that ends leaves its last lines."""
SHOW_NODES = SessionKey("show_nodes", bool, True, live=True, of_peer=True)
"""Whether the other side may see the nodes of this one."""


class NodesFeature(Feature):
    name = "nodes"

    def session_keys(self) -> Iterable[SessionKey[bool]]:
        return HEAR_ROSOUT, SHOW_NODES

    def messages(self) -> Iterable[type[msgspec.Struct]]:
        from rsb_extras.nodes.node_data import AskNode, AskNodes, NodesNews, NodeTold  # noqa: PLC0415 -- see `Feature`

        return AskNodes, NodesNews, AskNode, NodeTold

    def commands(self) -> Iterable[type[msgspec.Struct]]:
        from rsb_extras.nodes.node_data import Nodes, OneNode  # noqa: PLC0415

        return Nodes, OneNode

    def extensions(self, link: Link) -> Iterable[Extension]:
        from rsb_extras.nodes.link_nodes import LinkNodes  # noqa: PLC0415

        return (LinkNodes(link),)

    def parts(self, bridge: Bridge) -> Iterable[EnginePart]:
        from rsb_extras.nodes.nodes_part import NodesPart  # noqa: PLC0415

        return (NodesPart(bridge),)

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from rsb_console.feature_console import bridge_options, subcommand  # noqa: PLC0415

        summary = "list the nodes of the other side, with their processes and last lines"
        parser = add("nodes", subcommand("rsb_extras.nodes.nodes_command:nodes"), summary, after="status")
        complete(parser.add_argument("link", nargs="?", default="", help="the link, if there are several"), "links")
        parser.add_argument("--here", action="store_true", help="the nodes of this side")
        about = "also those without a fault in large namespaces, and those that ROS's tools hide"
        parser.add_argument("--all", action="store_true", help=about)
        bridge_options(parser, complete)

    def tiles(self) -> Iterable[type[TileLines]]:
        from rsb_extras.nodes.node_tile import NodeLines  # noqa: PLC0415

        return (NodeLines,)

    def actions(self) -> Iterable[Action]:
        from rsb_console.feature_console import Action, Group, KeyChapter, late  # noqa: PLC0415

        chapters = (
            KeyChapter(
                "Nodes (O)", "NodesScreen",
                (
                    ("⏎", "Open the node's page; on a namespace, fold or unfold it"),
                    ("t", "Show its topics in the table of topics"),
                    ("/ f", "Filter by name, machine, state and line; faults only"),
                    ("s", "Go on to the next side"),
                    ("esc", "Drop the filters, then close"),
                ),
            ),
        )  # fmt: skip
        return (
            Action(
                "nodes", "O", "nodes", "Show the other side's nodes: what runs there, and what has ended",
                Group.SESSION, also="processes lifecycle rosout died crashed",
                run=late("rsb_extras.nodes.nodes_screen:show_nodes"),
                on_link=late("rsb_extras.nodes.nodes_screen:nodes_of_link"), after="links", chapters=chapters,
            ),
        )  # fmt: skip


FEATURE = NodesFeature()
