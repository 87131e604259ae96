"""Node control: operators of either side change lifecycles, components and parameters of a robot's nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rsb_bridge.feature_api import Feature, PeerRight, SessionKey

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.feature_api import Bridge, Command, ControlMessageBase, EnginePart, Extension, Link
    from rsb_console.feature_console import Action, AddCommand, Complete

GROUPS: SessionKey[dict[str, tuple[str, ...]]] = SessionKey("groups", dict[str, tuple[str, ...]], {}, live=True)
"""Managed nodes of this side by the names of groups, in the order in which they are brought up."""
MAY_CHANGE: PeerRight[tuple[str, ...]] = PeerRight("nodes", tuple[str, ...], ())
"""The nodes that the other side may have changed, and the groups of which it may have all changed."""


class NodeControl(Feature):
    name = "node_control"
    needs = ("nodes",)

    def session_keys(self) -> Iterable[SessionKey[Any]]:
        return (GROUPS,)

    def rights(self) -> Iterable[PeerRight[Any]]:
        return (MAY_CHANGE,)

    def problems(self, session: Any) -> Iterable[tuple[str, str]]:
        from rsb_extras.node_control import group_rules  # noqa: PLC0415 -- `Feature` says why, here and below

        return group_rules.problems(session)

    def effects(self, session: Any) -> Iterable[str]:
        from rsb_extras.node_control import group_rules  # noqa: PLC0415

        return group_rules.effects(session)

    def messages(self) -> Iterable[type[ControlMessageBase]]:
        from rsb_extras.node_control.link_changes import (  # noqa: PLC0415
            AskManaged,
            ChangeEnded,
            ManagedAnswer,
            RunChange,
        )
        from rsb_extras.node_control.parameter_records import AskParameters, ParametersAnswer  # noqa: PLC0415

        return AskManaged, ManagedAnswer, RunChange, ChangeEnded, AskParameters, ParametersAnswer

    def extensions(self, link: Link) -> Iterable[Extension]:
        from rsb_extras.node_control.link_changes import LinkChanges  # noqa: PLC0415

        return (LinkChanges(link),)

    def commands(self) -> Iterable[type[Command[Any]]]:
        from rsb_extras.node_control.change_requests import ChangeNodes, ListManaged  # noqa: PLC0415
        from rsb_extras.node_control.parameter_requests import ListParameterNodes, ReadParameters  # noqa: PLC0415

        return ListManaged, ChangeNodes, ListParameterNodes, ReadParameters

    def parts(self, bridge: Bridge) -> Iterable[EnginePart]:
        from rsb_extras.node_control.changes_part import ChangesPart  # noqa: PLC0415

        return (ChangesPart(bridge),)

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from rsb_extras.node_control.component_arguments import add_component  # noqa: PLC0415
        from rsb_extras.node_control.lifecycle_arguments import add_lifecycle  # noqa: PLC0415
        from rsb_extras.node_control.param_arguments import add_param  # noqa: PLC0415

        add_lifecycle(add, complete)
        add_component(add, complete)
        add_param(add, complete)

    def actions(self) -> Iterable[Action]:
        from rsb_console.feature_console import Action, Group, OnNode, late  # noqa: PLC0415
        from rsb_extras.node_control.lifecycle_arguments import CHAPTERS  # noqa: PLC0415
        from rsb_extras.node_control.param_arguments import CHAPTERS as PARAMETER_CHAPTERS  # noqa: PLC0415

        screen = "rsb_extras.node_control.lifecycle_screen"
        return (
            Action(
                "lifecycle", "X", "lifecycle", "Show managed nodes, groups and containers; change them",
                Group.OPERATE, also="configure activate deactivate cleanup shutdown up down nav2 component load",
                run=late(f"{screen}:show_lifecycle"), chapters=CHAPTERS,
                on_node=OnNode("x", "x lifecycle", late(f"{screen}:lifecycle_of_node")),
            ),
            Action(
                "parameters", "H", "parameters", "Show nodes, and the parameters of the one on which p is pressed",
                Group.OPERATE, also="param rqt_reconfigure tune settings",
                run=late("rsb_extras.nodes.nodes_screen:show_nodes"), chapters=PARAMETER_CHAPTERS, after="lifecycle",
                on_node=OnNode(
                    "p", "p parameters", late("rsb_extras.node_control.parameters_screen:parameters_of_node")
                ),
            ),
        )  # fmt: skip


FEATURE = NodeControl()
