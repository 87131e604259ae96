"""A stock rclpy node in a domain, spun by a thread of its own: what answers calls, and asks."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from tests.support.participants import join
from tests.support.waiting import eventually

if TYPE_CHECKING:
    from rclpy.task import Future


class Joined:
    """The node, which nobody spins.

    Args:
        how: the class's further arguments.
    """

    node: Any

    def __init__(self, domain_id: int, name: str, kind: Any = Node, **how: Any) -> None:
        how = {"enable_rosout": False, "use_global_arguments": False, **how}

        def enter() -> Node:
            self.context = Context()
            self.context.init([], domain_id=domain_id)
            self.node = kind(name, context=self.context, **how)
            return self.node

        join(domain_id, enter, self._leave)

    def close(self) -> None:
        self._leave()

    def _leave(self) -> None:
        self.node.destroy_node()
        self.context.try_shutdown()
        self.context.destroy()


class Spun(Joined):
    """The node, and what keeps it going until `close`."""

    threads = 4

    def __init__(self, *arguments: Any, **how: Any) -> None:
        super().__init__(*arguments, **how)
        self._create()
        name = self.node.get_name()
        self._executor = MultiThreadedExecutor(self.threads, context=self.context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, name=f"{name}-spins")
        self._thread.start()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass
        except (
            rclpy_implementation.RCLError
        ):  # rclpy makes a wait set without asking again whether the context is valid
            if self.context.ok():
                raise

    def result(self, future: Future, within: float = 180.0) -> Any:
        """Return the response to a call."""
        eventually(future.done, within, "an answer")
        return future.result()

    def call(self, kind: Any, service: str, request: Any) -> Any:
        client = self.node.create_client(kind, service)
        eventually(client.service_is_ready, what=service)
        try:
            return self.result(client.call_async(request))
        finally:
            self.node.destroy_client(client)

    def close(self) -> None:
        self.context.shutdown()
        self._thread.join()
        self._executor.shutdown()
        self._destroy()
        super().close()

    def _create(self) -> None:
        """Create what rclpy does not create safely in a node that spins: actions, which it calls half made."""

    def _destroy(self) -> None:
        """Destroy what rclpy does not destroy with its node: actions."""
