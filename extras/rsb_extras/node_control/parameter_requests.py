"""What a console asks an engine about nodes' parameters. It has them changed by `change_requests.ChangeNodes`."""

from __future__ import annotations

import msgspec

from rsb_bridge.feature_api import Command, Name, Reason, Right
from rsb_extras.node_control.parameter_records import NodeParameter, ParameterNode


class ParameterSide(msgspec.Struct, frozen=True, omit_defaults=True):
    """The nodes with parameters of one side.

    Attributes:
        link: the link to it, or empty for this side.
        problem: why nothing is known of them, or empty.
    """

    link: Name = ""
    nodes: tuple[ParameterNode, ...] = ()
    problem: Reason = ""


class ListParameterNodes(Command[tuple[ParameterSide, ...]], frozen=True, tag="list_parameter_nodes"):
    """List the nodes with parameters of this side and of all links, or of one link; empty sides are left out."""

    right = Right.LOOK
    is_of_links = True
    refreshes = False
    cancellable = True
    link: str = ""


class ReadParameters(Command[tuple[NodeParameter, ...]], frozen=True, tag="read_parameters"):
    """Read the parameters of a node, sorted by name.

    Attributes:
        names: which of them, or empty for all.
        whole: whether large values are wanted, too.
        link: whose other side has the node, or empty for this side.
    """

    right = Right.LOOK
    is_of_links = True
    refreshes = False
    cancellable = True
    node: str
    names: tuple[str, ...] = ()
    whole: bool = False
    link: str = ""
