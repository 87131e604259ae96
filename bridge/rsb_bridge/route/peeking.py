"""Viewing a route's messages: the next one that passes is copied for each waiting viewer."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import msgspec

from rsb_bridge.model.snapshot import PEEK_LIMIT, PeekedMessage
from rsb_bridge.ros.ros_interface import RosError, TopicSpec

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import RawMessage

# Round figures, which bound what looking costs a bridge: nothing was measured.
LOOKERS = 32  # viewers at a time
EVERY = 0.5  # s, at least, between two copies from one route
LOOKS_FOR = 3.0  # s after a copy for which its viewer is still there: it asks again after a pause
BYTES_A_SECOND = 16 << 20  # of all viewers together; one that would exceed it waits
WAITS_AT_MOST = 10.0  # s; a viewer asks again after that, so that one that is gone does not keep its place
_LATE_JOINER = ("late joiner",)  # differs from the names of all links


class PeekError(Exception):
    """A message cannot be viewed now; the text gives the reason."""


Tap: TypeAlias = "Callable[[bytes, int, int, bytes, int], None]"
"""Gets each message once it has come from ROS, or once it is published. Called on the I/O thread.

It takes the serialized message; when it passed, in ns since the epoch on this machine's clock; when it was published on
the sending side, as far as known, else the same; the id of its publisher, or nothing on the receiving side; its number
among that publisher's messages, from 1, or 0 if unknown.
"""


class PeekSlot:
    """The slot for a copy of a route's next message, and the tap that gets all messages.

    Args:
        tap: may be changed by `set_tap`.

    Attributes:
        wanted: whether a viewer waits, or there is a tap. The route checks only this while messages pass.
        free_at: s, from when on the next message may be copied.
        changed: called when a viewer comes or goes, or the tap changes.
    """

    def __init__(self, tap: Tap | None = None) -> None:
        self.tap = tap
        self.wanted = tap is not None
        self.free_at = float("-inf")
        self.changed: Callable[[], None] = lambda: None
        self._waiting: set[asyncio.Future[PeekedMessage]] = set()
        self._looked_at = float("-inf")

    def is_used(self, now: float) -> bool:
        """Whether there is a tap, or a viewer has waited lately, at `now` (s)."""
        return self.wanted or now - self._looked_at < LOOKS_FOR

    @property
    def is_awaited(self) -> bool:
        """Whether a viewer waits."""
        return bool(self._waiting)

    def set_tap(self, tap: Tap | None) -> None:
        self.tap = tap
        self.wanted = tap is not None or self.is_awaited
        self.changed()

    def put(self, message: PeekedMessage, now: float) -> None:
        waiting, self._waiting = self._waiting, set()
        self.wanted = self.tap is not None
        self.free_at = now + EVERY
        for future in waiting:
            # A viewer that gave up has cancelled it.
            if not future.done():
                future.set_result(message)

    async def next(self) -> PeekedMessage:
        future: asyncio.Future[PeekedMessage] = asyncio.get_running_loop().create_future()
        self._waiting.add(future)
        self.wanted = True
        self.changed()
        try:
            return await future
        finally:
            self._waiting.discard(future)
            self.wanted = self.tap is not None or self.is_awaited
            self._looked_at = future.get_loop().time()
            self.changed()


class Peekable(Protocol):
    """The members of a half that viewing its messages uses."""

    peek_slot: PeekSlot
    qos: Qos | None
    carried: Any
    route: Any


class Peeking:
    """Limits and runs all viewing of an engine's messages."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._lookers = 0
        self._free_at = float("-inf")

    async def peek(self, flow: Peekable, *, kept: bool) -> PeekedMessage | None:
        """Wait for a message of a route.

        Args:
            kept: take the message that a late joiner gets, if the topic is latched.

        Returns:
            The message, or None if none has passed for a while.

        Raises:
            PeekError: there are too many viewers already.
        """
        if self._lookers >= LOOKERS:
            raise PeekError(f"{LOOKERS} message views are open here already: close one of them")
        self._lookers += 1
        try:
            async with asyncio.timeout(WAITS_AT_MOST):
                if (left := max(self._free_at, flow.peek_slot.free_at) - self._context.now()) > 0:
                    await asyncio.sleep(left)
                if kept and flow.qos is not None and flow.qos.latched:
                    message = await self._first_of(flow, flow.qos)
                else:
                    message = await flow.peek_slot.next()
        except TimeoutError:
            return None
        finally:
            self._lookers -= 1
        self._free_at = max(self._free_at, self._context.now()) + len(message.payload) / BYTES_A_SECOND
        return message

    async def _first_of(self, flow: Peekable, qos: Qos) -> PeekedMessage:
        """Return the first message that a late joiner on this side gets."""
        context = self._context
        first: asyncio.Future[PeekedMessage] = context.loop.create_future()

        def take(batch: Sequence[RawMessage]) -> None:
            # The last message of each publisher comes, in any order.
            newest = max(batch, key=lambda message: message.stamp)
            context.call(lambda: show(newest))

        def show(message: RawMessage) -> None:
            if not first.done():
                first.set_result(peeked(flow, message.payload, message.stamp, is_kept=True))

        # what this node publishes is what late joiners get on the receiving side, and none of theirs on the other
        origin = flow.route.peer.name if flow.route.outgoing else _LATE_JOINER
        depth_one = msgspec.structs.replace(qos, history="keep_last", depth=1)
        spec = TopicSpec(flow.route.local_topic, flow.carried.type_name, flow.carried.type_hash, depth_one)
        try:
            subscription = context.ros.subscribe(spec, take, origin)
        except RosError as error:
            raise PeekError(str(error)) from None
        try:
            return await first
        finally:
            subscription.close()


def peeked(
    flow: Peekable,
    payload: bytes,
    time_ns: int,
    *,
    is_kept: bool = False,
    latency: float | None = None,
    clock: tuple[float | None, float | None] = (None, None),
) -> PeekedMessage:
    """Copy the beginning of a message for a viewer.

    Args:
        time_ns: arrival on this side, ns since the epoch.
        is_kept: whether it was kept for late joiners.
        latency: seconds that it took over the link, or None.
        clock: offset of the peer's clock and its uncertainty, in seconds.
    """
    offset, uncertainty = clock
    return PeekedMessage(
        payload=bytes(payload[:PEEK_LIMIT]),
        size=len(payload),
        type_name=flow.carried.type_name,
        type_hash=flow.carried.type_hash,
        time=time_ns / 1e9,
        outgoing=flow.route.outgoing,
        is_kept=is_kept,
        latency=latency,
        clock_offset=offset,
        clock_uncertainty=uncertainty,
    )
