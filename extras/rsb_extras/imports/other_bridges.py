"""Other bridges whose files can be imported: whose a file is, by its shape, and what an import takes and gives."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any, NamedTuple

from rsb_bridge.feature_api import Wording

if TYPE_CHECKING:
    from rsb_bridge.feature_api import Session
    from rsb_bridge.model.session import Role

ZENOH_PLUGIN = "ros2dds"
_DOMAINS = {"from_domain", "to_domain"}


class OtherFile(Wording):
    """The reason why a file is no session."""

    CONVERT = "this is a file of {origin}: convert it with `rsb-console import {path}`"


class OtherBridge(Enum):
    """A bridge whose configuration can be imported; the value is its name."""

    THESIS = "ros2_socket_bridge"
    DOMAIN_BRIDGE = "domain_bridge"
    ZENOH_BRIDGE = "zenoh-bridge-ros2dds"


class Choices(NamedTuple):
    """The caller's choices, which come before the file's."""

    name: str | None = None  # of the bridge, or None for the file's, if it has one
    role: Role | None = None  # or None for the file's
    server_port: int | str | None = None  # or None for the file's. Text that is no number is a problem like any other
    key_file: str | None = None  # the key's path, relative to the session's future file
    use_name: bool = False  # prefix the client's topics on the server
    use_encryption: bool = True
    domain_id: int | str | None = None  # None: the file's, or `$ROS_DOMAIN_ID`. Text as for `server_port`


class Imported(NamedTuple):
    """The sessions of a file."""

    sessions: dict[str, Session]
    """By the name of their file without ``.yaml``. A file of one session has none to propose: it is empty."""
    notes: list[str]  # what differs from the other bridge, or could not be carried over, one line each
    new_keys: tuple[str, ...] = ()
    """Key files that the sessions name and that do not exist yet, relative to the sessions' folder."""


def origin_of(data: object) -> OtherBridge | None:
    """Return the bridge whose configuration this is, or None if it is none of them.

    Args:
        data: a file as plain data, of any shape.
    """
    if not isinstance(data, dict):
        return None
    topics, plugins = data.get("topics"), data.get("plugins")
    if isinstance(topics, dict):
        entries = [each for each in topics.values() if isinstance(each, dict)]
        if any(_DOMAINS & each.keys() for each in (data, *entries)):
            return OtherBridge.DOMAIN_BRIDGE
    if isinstance(plugins, dict) and ZENOH_PLUGIN in plugins:
        return OtherBridge.ZENOH_BRIDGE
    return OtherBridge.THESIS if bridge_nodes(data) else None


def bridge_nodes(data: object) -> dict[str, dict[str, Any]]:
    """Return the parameters of each bridge node, by the node's name.

    Args:
        data: the file as plain data, of any shape.
    """
    nodes = {}
    for node, content in (data if isinstance(data, dict) else {}).items():
        parameters = content.get("ros__parameters") if isinstance(content, dict) else None
        if isinstance(parameters, dict) and "server_ip" in parameters:
            nodes[node] = parameters
    return nodes
