"""Many stock rclpy nodes with parameters, of one participant: they cost little."""

from __future__ import annotations

import contextlib
import threading

from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from tests.support.participants import join


class Crowd:
    """Nodes ``/NAME0``, ``/NAME1`` and so on, each with the integer ``rate``, spun by one thread until `close`."""

    def __init__(self, domain_id: int, name: str, count: int) -> None:
        def enter() -> Node:
            self._context = Context()
            self._context.init([], domain_id=domain_id)
            self.nodes = [
                Node(f"{name}{number}", context=self._context, enable_rosout=False, use_global_arguments=False)
                for number in range(count)
            ]
            return self.nodes[0]

        join(domain_id, enter, self._leave)
        self._executor = SingleThreadedExecutor(context=self._context)
        for node in self.nodes:
            node.declare_parameter("rate", 0)
            self._executor.add_node(node)
        self._thread = threading.Thread(target=self._spin, name=f"{name}-spin")
        self._thread.start()

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            self._executor.spin()

    def set(self, number: int, rate: int) -> None:
        """Set one node's parameter, which publishes an event."""
        self.nodes[number].set_parameters([Parameter("rate", value=rate)])

    def close(self) -> None:
        """Leave the domain."""
        self._context.shutdown()
        self._thread.join()
        self._executor.shutdown()
        self._leave()

    def _leave(self) -> None:
        for node in self.nodes:
            node.destroy_node()
        self._context.try_shutdown()
        self._context.destroy()
