"""Real nodes with a lifecycle, of rclpy, in a robot's domain."""

from __future__ import annotations

import gc
import threading
from typing import Any

from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from tests.support.spun import Spun

from rsb_bridge.feature import MAY
from rsb_bridge.model.session import session_keys
from rsb_extras.node_control import GROUPS


class _Robust(LifecycleNode):  # type: ignore[misc]  # rclpy has no types
    """A node that notes its transitions.

    Attributes:
        refused: transitions that fail.
        holds: transitions that wait for `go`.
    """

    def __init__(self, name: str, *, taken: list[tuple[str, str]], **how: Any) -> None:
        super().__init__(name, **how)
        self.taken, self.refused, self.holds = taken, set[str](), set[str]()
        self.go = threading.Event()

    def _take(self, transition: str) -> TransitionCallbackReturn:
        self.taken.append((self.get_name(), transition))
        if transition in self.holds:
            self.go.wait(120)
        return TransitionCallbackReturn.FAILURE if transition in self.refused else TransitionCallbackReturn.SUCCESS

    def on_configure(self, state: Any) -> TransitionCallbackReturn:
        return self._take("configure")

    def on_activate(self, state: Any) -> TransitionCallbackReturn:
        return self._take("activate")

    def on_deactivate(self, state: Any) -> TransitionCallbackReturn:
        return self._take("deactivate")

    def on_cleanup(self, state: Any) -> TransitionCallbackReturn:
        return self._take("cleanup")

    def on_shutdown(self, state: Any) -> TransitionCallbackReturn:
        return self._take("shutdown")


class ManagedNodes:
    """Some managed nodes, each with threads of its own.

    Attributes:
        taken: nodes and transitions, in their order.
    """

    def __init__(self, domain_id: int, *names: str) -> None:
        self.taken: list[tuple[str, str]] = []
        self._spun = {
            name: Spun(domain_id, name, _Robust, taken=self.taken, start_parameter_services=False) for name in names
        }

    def __getitem__(self, name: str) -> _Robust:
        node: _Robust = self._spun[name].node
        return node

    def close(self) -> None:
        for each in self._spun.values():
            node = each.node
            node.go.set()
            each.close()
            # rclpy leaves the services of the lifecycle in the graph until the node's state machine is collected.
            for name in [each for each in vars(node) if each.startswith(("_service_", "_state_machine"))]:
                delattr(node, name)
        self._spun = {}
        gc.collect()


def has(*may: str, **groups: tuple[str, ...]) -> dict[str, Any]:
    """Return the features of a session with groups, whose other side may have some nodes changed."""
    given = {MAY: session_keys()[MAY].type(nodes=may)} if may else {}
    return {**({GROUPS.name: groups} if groups else {}), **given}
