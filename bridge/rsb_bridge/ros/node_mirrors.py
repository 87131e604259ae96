"""The mirrored nodes of a `RosNode`: `rsb_bridge.ros.ros_interface.Mirroring`."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable

    from rsb_bridge.ros.participant import Participant
    from rsb_bridge.ros.ros_interface import EndPlace


class NodeMirrors:
    """Makes and ends mirrored nodes, and knows which endpoints belong to them.

    Args:
        joined: returns the participant, or raises `RosError` if the node is not running.
        lock: held while endpoints are made.
    """

    def __init__(self, joined: Callable[[], Participant], lock: threading.Lock) -> None:
        self._joined = joined
        self._lock = lock
        self._places: dict[EndPlace, str] = {}

    def by_others(self) -> dict[str, str]:
        return self._joined().mirrored_by_others()

    def add(self, node: str) -> None:
        with self._lock:
            self._joined().add_mirror(node)

    def remove(self, node: str) -> None:
        with self._lock:
            self._joined().remove_mirror(node)

    def place(self, end: EndPlace, node: str) -> None:
        if node:
            self._places[end] = node
        else:
            self._places.pop(end, None)

    def node_of(self, end: EndPlace) -> str:
        return self._places.get(end, "")
