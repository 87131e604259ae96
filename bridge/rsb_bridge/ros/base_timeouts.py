"""Asks nodes whether they stop a robot by themselves: ``python -m rsb_bridge.ros.base_timeouts DOMAIN TOPIC...``.

Prints, as JSON, the nodes that subscribe to each topic, and of each the parameters that sound like a timeout with their
values, or null for a node that does not answer. It publishes and sets nothing.
"""

from __future__ import annotations

import json
import re
import sys
import time
from typing import TYPE_CHECKING, Any, TypeAlias

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import HIDDEN_NODE_PREFIX, Node

from rsb_bridge.ros.self_test import ARGUMENTS

if TYPE_CHECKING:
    from collections.abc import Sequence

Timeouts: TypeAlias = dict[str, dict[str, dict[str, Any] | None]]

_NAMES = re.compile(r"(^|[._])(cmd\w*|command\w*|vel\w*|twist\w*|input)[._]?\w*time_?out|watchdog|dead_?man")
"""``cmd_vel_timeout`` of diff_drive_controller and its like, ``command_timeout``, ``watchdog_period`` …"""
_FOUND_WITHIN = 3.0
"""s that a node that starts may need to find running nodes (docs/performance.md)."""
_ANSWERS_WITHIN = 2.0
"""s. A round figure: the doctor waits for 30 s in all."""
_VALUES = {
    ParameterType.PARAMETER_BOOL: "bool_value",
    ParameterType.PARAMETER_INTEGER: "integer_value",
    ParameterType.PARAMETER_DOUBLE: "double_value",
}


class _Asking:
    """A node that asks others."""

    def __init__(self, domain: int) -> None:
        self._context = Context()
        self._context.init(ARGUMENTS, domain_id=domain)
        self._node = Node("_rsb_doctor", context=self._context, enable_rosout=False, start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)

    def close(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.shutdown()

    def listeners(self, topics: Sequence[str]) -> dict[str, list[str]]:
        """Return the nodes that subscribe to each topic, without bridges."""
        until = time.monotonic() + _FOUND_WITHIN
        while time.monotonic() < until:
            self._executor.spin_once(0.1)
        return {topic: self._listeners(topic) for topic in topics}

    def _listeners(self, topic: str) -> list[str]:
        infos = self._node.get_subscriptions_info_by_topic(topic)
        # A node with two subscriptions is listed twice, and asked once.
        names = {(each.node_namespace.rstrip("/"), each.node_name) for each in infos}
        return sorted(f"{space}/{name}" for space, name in names if not name.startswith(HIDDEN_NODE_PREFIX))

    def timeouts(self, node: str) -> dict[str, Any] | None:
        """Return a node's parameters that sound like a timeout, or None if it does not answer."""
        listed = self._ask(ListParameters, f"{node}/list_parameters", ListParameters.Request())
        if listed is None:
            return None
        names = [each for each in listed.result.names if _NAMES.search(each)]
        values = self._ask(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=names))
        if values is None:
            return None
        return {
            name: getattr(value, _VALUES[value.type])
            for name, value in zip(names, values.values, strict=True)
            if value.type in _VALUES
        }

    def _ask(self, kind: Any, service: str, request: Any) -> Any:
        client = self._node.create_client(kind, service)
        try:
            if not client.wait_for_service(_ANSWERS_WITHIN):
                return None
            future = client.call_async(request)
            self._executor.spin_until_future_complete(future, _ANSWERS_WITHIN)
            return future.result() if future.done() else None
        finally:
            self._node.destroy_client(client)


def base_timeouts(domain: int, topics: Sequence[str]) -> Timeouts:
    """Return what the nodes say that subscribe to topics in a domain."""
    asking = _Asking(domain)
    try:
        found = asking.listeners(topics)
        return {topic: {node: asking.timeouts(node) for node in nodes} for topic, nodes in found.items()}
    finally:
        asking.close()


if __name__ == "__main__":
    print(json.dumps(base_timeouts(int(sys.argv[1]), sys.argv[2:])))  # noqa: T201
