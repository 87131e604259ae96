"""Calls that operators make by hand, on either side of a route."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.ros.ros_interface import RosError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.ros.ros_interface import Response, ServiceClient
    from rsb_bridge.wire.records import LaneEntry

_MATCHED_WITHIN = 5.0
"""s for DDS to match a new client with the server that the graph shows. A round figure, as the two below."""
_LOOKED_EVERY = 0.05  # s: DDS has no event for that
_LEFT_LOOKED_EVERY = 1.0  # s: nor for a server that has gone


class CallError(Exception):
    """An operator's call has no answer; the message gives the reason and the remedy."""


class ManualCall:
    """Receives the answer to an operator's call, as a `ServiceServer` does for other callers.

    Args:
        loop: that the operator waits on.

    Attributes:
        answered: the serialized response, or the `CallError`.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.answered: asyncio.Future[bytes] = loop.create_future()

    def answer(self, caller: bytes, payload: bytes) -> None:
        """Take the response; `caller` is ignored."""
        if not self.answered.done():
            self.answered.set_result(payload)

    def fail(self, reason: str) -> None:
        """End the call without an answer."""
        if not self.answered.done():
            self.answered.set_exception(CallError(reason))


async def call_directly(
    context: Context,
    service: str,
    entry: LaneEntry,
    request: bytes,
    within: float | None,
    still_may: Callable[[], None],
) -> bytes:
    """Call a service of this side's domain, even if the link is lost.

    Args:
        entry: its type and hash.
        within: the timeout in s, or None to wait until the answer comes or the task is cancelled.
        still_may: is called right before the request is sent; raises `CallError` if it may not be sent any more.

    Returns:
        The serialized response.

    Raises:
        CallError: no response came.
    """
    call = ManualCall(context.loop)

    def take(responses: Sequence[Response]) -> None:
        # Of two servers, the first answer counts.
        payload = responses[0].payload
        context.call(lambda: call.answer(b"", payload))

    def failed(error: RosError) -> None:
        reason = str(error)
        context.call(lambda: call.fail(reason))

    try:
        client = context.ros.call_service(service, entry.type, entry.type_hash, take, failed)
    except RosError as error:
        raise CallError(str(error)) from None
    try:
        await _until_ready(context, client, service)
        still_may()
        client.call(request)
        async with asyncio.timeout(within):
            return await _answer(client, call, service)
    except RosError as error:
        raise CallError(str(error)) from None
    except TimeoutError:
        raise CallError(f"{service} gave no answer within {within:g} s") from None
    finally:
        client.close()


async def _answer(client: ServiceClient, call: ManualCall, service: str) -> bytes:
    """Wait for the response, or until the server has gone, which ends a wait without a timeout."""
    while not (await asyncio.wait((call.answered,), timeout=_LEFT_LOOKED_EVERY))[0]:
        if not client.ready:
            raise CallError(f"{service} gave no answer: its server has gone")
    return call.answered.result()


async def _until_ready(context: Context, client: ServiceClient, service: str) -> None:
    deadline = context.now() + _MATCHED_WITHIN
    while not client.ready:
        if context.now() > deadline:
            raise CallError(
                f"the server of {service} is in the ROS graph, but cannot be reached: check whether it still runs"
            )
        await asyncio.sleep(_LOOKED_EVERY)
