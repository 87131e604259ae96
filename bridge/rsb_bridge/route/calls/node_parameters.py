"""Parameter events of one node, and the reason why a node's parameters cannot be reached."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.verdict import Cause
from rsb_bridge.model.wording import Wording
from rsb_bridge.ros.parameter_events import ParameterEventError, node_of, with_node
from rsb_bridge.route.calls.calls_verdict import Trouble

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.ros.ros_interface import RosInterface

_EVERY_NODE_HAS = "/get_type_description"
"""A service of nearly every node, with parameters or without."""


class NoParameters(Wording):
    """Reasons why the parameters of a node that runs cannot be reached."""

    SOME_SERVICES = "{missing}: {node} has only some of the parameter services"
    NO_SERVICES = "{node} is in domain {domain}, but has no parameter services: it was started without them"


def own_event(event: bytes, node: str, remote_node: str) -> bytes | None:
    """Return a node's event under the name that the node has on the other side, or None if it is another node's.

    Raises:
        ParameterEventError: it cannot be read.
    """
    if node_of(event) != node:
        return None
    return event if remote_node == node else with_node(event, remote_node)


def foreign_event(event: bytes, node: str) -> str:
    """Return the reason why an event may not be published for a node, or an empty string."""
    try:
        return "" if node_of(event) == node else "it is about another node"
    except ParameterEventError as error:
        return str(error)


def why_no_parameters(
    ros: RosInterface, node: str, services: Iterable[str], domain_id: int, missing: Trouble
) -> Trouble:
    """Return why a node's parameters cannot be reached; `missing` says that the node does not answer.

    The node may be there without parameters, or with a part of the services.
    """
    if any(ros.servers(service) for service in services):
        text = NoParameters.SOME_SERVICES(missing=missing.text, node=node)
        return Trouble(Cause.NO_PARAMETERS, text)
    if ros.servers(node + _EVERY_NODE_HAS):
        text = NoParameters.NO_SERVICES(node=node, domain=domain_id)
        return Trouble(Cause.NO_PARAMETERS, text)
    return missing
