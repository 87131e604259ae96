"""Recognize the thesis's ``bringup.yaml``: it holds the ROS parameters of the bridge's nodes."""

from __future__ import annotations

from typing import Any


def bridge_nodes(data: object) -> dict[str, dict[str, Any]]:
    """The parameters of each bridge node, by the node's name.

    Args:
        data: the file as plain data, of any shape.
    """
    nodes = {}
    for node, content in (data if isinstance(data, dict) else {}).items():
        parameters = content.get("ros__parameters") if isinstance(content, dict) else None
        if isinstance(parameters, dict) and "server_ip" in parameters:
            nodes[node] = parameters
    return nodes
