"""Asks managed nodes for their states, rarely, and only while somebody looks."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import RosError, sanitize_text

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from rsb_bridge.feature_api import Context
    from rsb_bridge.ros.ros_interface import Response, ServiceClient

SERVICE, TYPE = "/get_state", "lifecycle_msgs/srv/GetState"
NO_ANSWER = "no answer"
_MOST = 100
"""Managed nodes that are asked; each takes a client. A round figure, four times as many as Nav2 has."""
_ASKED_EVERY = 5.0
_AT_ONCE = 5
"""New clients, and questions, in one second: discovery and nodes have other work."""
_REQUEST = b"\x00\x01\x00\x00\x00"
"""An empty message (CDR): its one byte is what ROS puts into structures without members."""
_ORDERS = {b"\x00\x00": "big", b"\x00\x01": "little"}
_LENGTH = 32


@dataclass
class _Managed:
    """A managed node that is asked."""

    client: ServiceClient
    asked_at: float = float("-inf")
    is_waiting: bool = False


class LifecycleStates:
    """The states of managed nodes.

    Args:
        told: takes a node's name and its state.
    """

    def __init__(self, context: Context, told: Callable[[str, str], None]) -> None:
        self._context = context
        self._told = told
        self._managed: dict[str, _Managed] = {}
        self._opening: dict[str, asyncio.Task[None]] = {}

    def ask(self, nodes: Collection[str]) -> None:
        """Ask some of the managed nodes, by their names. To be called once a second."""
        for name in self._managed.keys() - nodes:
            self._managed.pop(name).client.close()
        new = [name for name in nodes if name not in self._managed and name not in self._opening]
        for name in new[: min(_AT_ONCE, max(0, _MOST - len(self._managed) - len(self._opening)))]:
            self._opening[name] = self._context.loop.create_task(self._open(name))
        now = self._context.now()
        due = sorted(
            (each.asked_at, name) for name, each in self._managed.items() if now - each.asked_at > _ASKED_EVERY
        )
        for _, name in due[:_AT_ONCE]:
            self._ask(name, now)

    def close(self) -> None:
        """Ask no more, and forget the clients."""
        for each in self._managed.values():
            each.client.close()
        self._managed = {}
        for opening in self._opening.values():
            opening.cancel()
        self._opening = {}

    async def _open(self, name: str) -> None:
        context = self._context
        try:
            servers = await asyncio.to_thread(context.ros.servers, name + SERVICE)
            if servers and servers[0].type_name == TYPE:
                take = partial(self._answered, name)
                client = context.ros.call_service(
                    name + SERVICE, TYPE, servers[0].type_hash, lambda answers: context.call(partial(take, answers))
                )
                self._managed[name] = _Managed(client)
        except RosError:
            pass  # it has gone, or its type is not usable here: its state stays unknown
        finally:
            if self._opening.get(name) is asyncio.current_task():  # else it is closed, and perhaps opened again
                del self._opening[name]

    def _ask(self, name: str, now: float) -> None:
        managed = self._managed[name]
        if managed.is_waiting:
            self._told(name, NO_ANSWER)
        managed.asked_at = now  # also if it is not ready: it must not keep the others waiting
        if managed.client.ready:
            managed.is_waiting = True
            with contextlib.suppress(RosError):
                managed.client.call(_REQUEST)

    def _answered(self, name: str, answers: Sequence[Response]) -> None:
        if (managed := self._managed.get(name)) is not None:
            managed.is_waiting = False
            if state := state_in(answers[-1].payload):
                self._told(name, state)


def state_in(payload: bytes) -> str:
    """Return the label of a `lifecycle_msgs/msg/State`, or an empty string if it is none."""
    order = _ORDERS.get(payload[:2])
    if order is None or len(payload) < 12:
        return ""
    length = int.from_bytes(payload[8:12], order)  # type: ignore[arg-type]  # one of the two
    return sanitize_text(payload[12 : 12 + max(0, length - 1)].decode("utf-8", "replace"), _LENGTH)
