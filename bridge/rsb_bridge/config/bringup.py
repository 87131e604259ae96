"""How the thesis's ``bringup.yaml`` is told from other files: by the ROS parameters of the bridge's nodes in it."""

from __future__ import annotations

from typing import Any


def bridge_nodes(data: object) -> dict[str, dict[str, Any]]:
    """The parameters of each node in the file that is a bridge's, by the node's name.

    Args:
        data: the file as plain data; of any shape.
    """
    nodes = {}
    for node, content in (data if isinstance(data, dict) else {}).items():
        parameters = content.get("ros__parameters") if isinstance(content, dict) else None
        if isinstance(parameters, dict) and "server_ip" in parameters:
            nodes[node] = parameters
    return nodes
