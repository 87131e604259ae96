"""Real nodes with a lifecycle, of rclpy, in a robot's domain."""

from __future__ import annotations

import gc
import threading
from typing import TYPE_CHECKING, Any

from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from tests.support.bridge import linked
from tests.support.spun import Spun
from tests.support.waiting import eventually

from rsb_bridge.feature import MAY
from rsb_bridge.model.session import session_keys
from rsb_extras.node_control import GROUPS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tests.support.bridge import Bridge

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.session import Topic


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


def linked_sides(
    bridge: Bridge, features: dict[str, Any], topics: Iterable[Topic] = (), **others: Any
) -> tuple[Engine, Engine]:
    """Return the control PC and the robot, which has these features, once they are linked."""
    robot = bridge.client(*topics, features=features, **others)
    pc = bridge.server(**others)
    eventually(lambda: linked(pc) and linked(robot), what="linked")
    return pc, robot


def has(*may: str, **groups: tuple[str, ...]) -> dict[str, Any]:
    """Return the features of a session with groups, whose other side may have some nodes changed."""
    given = {MAY: session_keys()[MAY].type(nodes=may)} if may else {}
    return {**({GROUPS.name: groups} if groups else {}), **given}
