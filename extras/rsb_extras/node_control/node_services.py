"""Calls services of this side's nodes, by the bridge's own node."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from rsb_bridge.feature_api import RosError, Wording
from rsb_extras.node_control.change_records import NODE_NAME

if TYPE_CHECKING:
    from collections.abc import Awaitable, Sequence

    from rsb_bridge.feature_api import Context, Endpoint
    from rsb_bridge.ros.ros_interface import Response, ServiceClient

A = TypeVar("A")
B = TypeVar("B")

_KEPT_FOR = 10.0
"""s for which an unused client is kept: each is announced in the whole domain. A round figure."""
_LOOK_EVERY, _LOOK_AGAIN = 0.02, 0.2
"""s between two looks whether a client has met its server, and whether that is the only one. Round figures."""


async def nodes_serving(
    context: Context, service: str, type_name: str, most: int, *, also: str = ""
) -> tuple[str, ...]:
    """Return the names of the nodes of this side's domain that have a service, sorted, at most so many.

    Args:
        service: ``/get_state``, behind a node's name.
        also: another service that they must have, or empty.
    """
    try:
        services = await asyncio.to_thread(context.ros.services)
    except RosError:
        return ()
    found = (
        name.removesuffix(service) for name, types in services.items() if name.endswith(service) and type_name in types
    )
    # A DDS program without ROS may have any name: the other side would take it for a broken message.
    names = (name for name in found if NODE_NAME.fullmatch(name) and (not also or name + also in services))
    return tuple(sorted(names))[:most]


async def both(first: Awaitable[A], second: Awaitable[B]) -> tuple[A, B]:
    """Await two calls at once. If both fail, the first's error is raised: which is known first is chance."""
    one, other = await asyncio.gather(first, second, return_exceptions=True)
    if isinstance(one, BaseException):
        raise one
    if isinstance(other, BaseException):
        raise other
    return one, other


class NodeServiceProblem(Wording):
    """The reason why a node's service gives no answer."""

    GONE = "{node} does not run, or has no service {service}"
    TWICE = "{count} nodes are named {node}, or DDS lists one that has ended (for 20 s): ask again, or end all but one"
    OTHER = "{node} has {service} of another type, {found}"
    SILENT = "{node} did not answer within {seconds:g} s: look at its state before you ask again"


class NodeSilentError(Exception):
    """A call has no answer; the text says why, for an operator."""


@dataclass
class _Kept:
    """A client of one service.

    Attributes:
        waiting: those who wait for an answer, by its number.
        used: s, when it was used last.
    """

    type_hash: str
    used: float
    client: ServiceClient = field(init=False)
    waiting: dict[int, asyncio.Future[bytes]] = field(default_factory=dict)

    def answered(self, answers: Sequence[Response]) -> None:
        for each in answers:
            waiting = self.waiting.pop(each.number, None)
            if waiting is not None and not waiting.done():
                waiting.set_result(each.payload)


class NodeServices:
    """Calls services of nodes, and keeps its clients for some seconds."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._kept: dict[str, _Kept] = {}

    async def call(self, node: str, service: str, type_name: str, request: bytes, within: float) -> bytes:
        """Call a service of a node, ``/change_state``, and return its answer.

        Raises:
            NodeSilentError: there is no answer.
        """
        try:
            async with asyncio.timeout(within):
                kept = await self._client(node, service, type_name)
                kept.used = self._context.now() + within
                while not kept.client.ready:  # noqa: ASYNC110 -- DDS tells nobody
                    await asyncio.sleep(_LOOK_EVERY)
                number = kept.client.call(request)
                kept.waiting[number] = self._context.loop.create_future()
                try:
                    return await kept.waiting[number]
                finally:
                    kept.waiting.pop(number, None)
                    kept.used = self._context.now()
        except TimeoutError:
            count = len(await self._servers(node + service))
            text = NodeServiceProblem.TWICE if count > 1 else NodeServiceProblem.SILENT
            raise NodeSilentError(text(node=node, seconds=within, count=count)) from None
        except RosError as error:
            raise NodeSilentError(str(error)) from None

    async def _servers(self, name: str) -> list[Endpoint]:
        return await asyncio.to_thread(self._context.ros.servers, name)

    async def _client(self, node: str, service: str, type_name: str) -> _Kept:
        name = node + service
        # A node that has just been started again stands beside the one that has ended, as long as DDS lists that.
        while len(servers := await self._servers(name)) > 1:  # noqa: ASYNC110 -- nobody tells of its end
            await asyncio.sleep(_LOOK_AGAIN)
        if not servers:
            raise NodeSilentError(NodeServiceProblem.GONE(node=node, service=service))
        found = servers[0]
        if found.type_name != type_name:
            raise NodeSilentError(NodeServiceProblem.OTHER(node=node, service=service, found=found.type_name))
        kept = self._kept.get(name)
        if kept is not None and kept.type_hash == found.type_hash:
            return kept
        if kept is not None:
            kept.client.close()
        kept = _Kept(found.type_hash, self._context.now())
        take = kept.answered
        kept.client = self._context.ros.call_service(
            name, type_name, found.type_hash, lambda answers: self._context.call(partial(take, answers))
        )
        self._kept[name] = kept
        return kept

    def tick(self) -> None:
        """Close what is not used any more. To be called once a second."""
        now = self._context.now()
        for name, kept in tuple(self._kept.items()):
            if now - kept.used > _KEPT_FOR:
                self._kept.pop(name).client.close()

    def close(self) -> None:
        """Close all clients."""
        for kept in self._kept.values():
            kept.client.close()
        self._kept = {}
