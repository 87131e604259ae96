"""Raw endpoints of topics, on rcl through ctypes.

rclpy hides the publisher of a message taken, so rcl is called for it.
"""

from __future__ import annotations

import ctypes
import threading
import time
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Literal

from rsb_bridge.ros.native import cyclone_dds
from rsb_bridge.ros.native.librcl import (
    INFO_ROOM,
    MESSAGE_INFO,
    TAKE_FAILED,
    Serialized,
    address_of,
    gid_of,
    publish_long_message,
    publish_message,
    reset_error,
    take_long_message,
    take_message,
    wait_for_all_acked,
)
from rsb_bridge.ros.native.rclpy_extension import assert_liveliness, deserialize, reason_of, refuses
from rsb_bridge.ros.publication_numbers import PublicationNumbers
from rsb_bridge.ros.ros_interface import Liveliness, RawMessage, RosError, RosProblem, has_key

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from rsb_bridge.ros.native.librcl import TakeBuffer
    from rsb_bridge.ros.native.rclpy_extension import Handle, LivelinessOfPublishers

_LAST_NUMBER = 2**63 - 1
_LARGE = 16 * 1024
"""Bytes from which on a call through ctypes costs less than rclpy's copy."""
_LONG = 256 * 1024
"""Bytes from which on the middleware's copies take longer than it may take to get the GIL back."""
_ENOUGH = 4 << 20
"""Bytes that are taken at once: the first of many large messages would wait for the last, and all be held together.

Without it, 64 messages of 6 MB were.
"""

_new = tuple.__new__  # a NamedTuple's own constructor is a call more


class Reader:
    """A raw subscription, of the thread that takes from it.

    Attributes:
        numbers: of its publishers' messages.
        has_more: whether the last take may have left something.
        express: whether it is taken from at once, also while turns are apart.
    """

    kind: Literal["subscription"] = "subscription"

    def __init__(
        self,
        handle: Handle,
        buffer: TakeBuffer,
        earlier: frozenset[bytes] | None,
        numbers: PublicationNumbers | None = None,
        liveliness: LivelinessOfPublishers | None = None,
        *,
        express: bool = False,
    ) -> None:
        """Begin to count.

        Args:
            buffer: memory for taken messages, shared by the readers of a thread.
            earlier: publishers from before the subscription, or None if each publisher's first messages are history.
            numbers: of the same user's earlier subscriptions to the topic, or None for the first one.
            liveliness: of its publishers, or None if the QoS has no lease.
        """
        self.handle = handle
        self.topic: str = handle.rclpy.get_topic_name()
        self.numbers = numbers or PublicationNumbers(time.monotonic)
        self.numbers.begin(earlier)
        self.has_more = False
        self.express = express
        self._buffer = buffer
        self._info = ctypes.create_string_buffer(INFO_ROOM)
        self._last_size = 0  # bytes that the last message had
        self._guid_of = cyclone_dds.SubscriptionPublishers(handle.address).guid_of if cyclone_dds.is_used() else None
        self._liveliness = liveliness

    def take(self, limit: int, skip: Collection[bytes]) -> list[RawMessage] | None:
        """Take up to `limit` messages, except for the messages of publishers in `skip` (`Writer.told`).

        Stop after `_ENOUGH` bytes. Return None if DDS gives no message, or an empty one, which ROS does not have.

        Raises:
            RosError: rcl failed at the first of them.
        """
        address, buffer, info, numbers = self.handle.address, self._buffer, self._info, self.numbers
        guid_of, last, large, small = self._guid_of, numbers.newest, buffer.large, buffer.small
        buffer_reference, unpack = ctypes.byref(buffer), MESSAGE_INFO.unpack_from
        taken: list[RawMessage] = []
        size = 0
        self.has_more = True
        for _ in range(limit):
            if size >= _ENOUGH:
                break
            # Only a message that is taken shows its size, so the last one decides.
            take = take_message if self._last_size < _LONG else take_long_message
            code = take(address, buffer_reference, info, None)
            if code:
                if code == TAKE_FAILED:
                    self.has_more = False
                    break
                reset_error()
                if taken:  # they have been counted; the next take meets an error that lasts
                    break
                raise RosError(RosProblem.NOT_TAKEN(topic=self.topic, code=code))
            source, stamp, number, _, _, gid = unpack(info)
            length = buffer.length
            if not length:
                break
            self._last_size = length
            size += length
            # It has counted already: a flood of our own messages must not keep the thread from other endpoints.
            if gid in skip:
                buffer.discard()
                continue
            if guid_of is not None:
                # After the comparison with `skip`, which has what the middleware tells.
                gid = guid_of(gid)
            if number > _LAST_NUMBER:
                number = 0  # RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED
            previous = last.get(gid)
            if previous is None:
                previous = numbers.first(gid, number)
            if number > previous + 1:
                numbers.lose(number - previous - 1)
            last[gid] = number
            payload = buffer.taken() if large else small[:length].tobytes()
            taken.append(_new(RawMessage, (payload, stamp, gid, number, 0, source)))
        return taken if size else None

    @property
    def matched(self) -> int:
        """How many publishers match it, our own node's too; 0 once closed."""
        try:
            count: int = self.handle.rclpy.get_publisher_count()
        except RuntimeError:
            return 0
        return count

    @property
    def refuses(self) -> bool:
        """Whether DDS has refused a publisher for a policy that the graph does not show."""
        return refuses("subscription", self.handle.rclpy)

    @property
    def liveliness(self) -> Liveliness:
        """The liveliness of the matching publishers, our own node's too; only asked if the QoS has a lease."""
        told = None if self._liveliness is None else self._liveliness.ask()
        return Liveliness() if told is None else Liveliness(told[0], self.matched - sum(told))

    def close(self) -> None:
        """Free it. To be called once."""
        if self._liveliness is not None:
            self._liveliness.close()
        self.handle.free()


class Writer:
    """A raw publisher, for any thread. It is never freed under a `publish`, which keeps the GIL, or else a lock.

    A thread that closes it during a long `publish` leaves the freeing to the thread that publishes.

    Attributes:
        gid: what the graph, and taken messages, know it by.
        told: what the middleware says of its messages: another id than `gid` where that is Cyclone DDS.
    """

    def __init__(self, handle: Handle, interface: type) -> None:
        """Begin to publish.

        Args:
            interface: the class of the messages.
        """
        self.topic: str = handle.rclpy.get_topic_name()
        self.told = gid_of(handle.address)
        self.gid = cyclone_dds.guid_of_publisher(handle.address) if cyclone_dds.is_used() else self.told
        self._handle = handle
        # From Kilted on, Fast DDS wants the key of each message, which rclpy's typed publishing gives it.
        self._is_keyed = has_key(self.gid)
        self._publish = partial(_publish_typed, handle, interface) if self._is_keyed else handle.rclpy.publish_raw
        self._closed = self._freed = False
        self._using = threading.Lock()

    def publish(self, payload: bytes) -> None:
        """Publish one serialized message.

        Raises:
            RosError: it is closed, the payload is no message, or the middleware refused it.
        """
        if len(payload) < 4:
            raise RosError(f"{self.topic}: {RosProblem.MESSAGE_TOO_SHORT(length=len(payload))}")
        try:
            if len(payload) < _LARGE:
                self._publish(payload)
            elif len(payload) < _LONG:
                self._publish_in_place(publish_message, payload)
            else:
                try:
                    with self._using:
                        if self._closed:
                            raise RosError(f"{self.topic}: {RosProblem.CLOSED()}")
                        self._publish_in_place(publish_long_message, payload)
                finally:
                    if self._closed:
                        self._free()
        except RuntimeError as error:
            reason = RosProblem.CLOSED() if self._closed else reason_of(error)
            raise RosError(f"{self.topic}: {reason}") from error

    def _publish_in_place(self, publish: Callable[..., int], payload: bytes) -> None:
        """Publish without rclpy, which would copy the payload; but one with a key as others."""
        if self._is_keyed:
            self._publish(payload)
            return
        message = Serialized(address_of(payload), len(payload), len(payload))
        code = publish(self._handle.rclpy.pointer, ctypes.byref(message), None)
        if code:
            reset_error()
            raise RuntimeError(f"the middleware refused a message (rcl error {code})")

    @property
    def matched(self) -> int:
        """How many subscriptions match it, our own node's too; 0 once closed."""
        try:
            count: int = self._handle.rclpy.get_subscription_count()
        except RuntimeError:
            return 0
        return count

    @property
    def refuses(self) -> bool:
        """Whether DDS has refused a subscription for a policy that the graph does not show."""
        return refuses("publisher", self._handle.rclpy)

    @property
    def acknowledged(self) -> bool:
        """Whether every reliable subscription has acknowledged all (asked in 2 µs) or not (100 µs); yes once closed."""
        if self._closed:
            return True
        code = wait_for_all_acked(self._handle.rclpy.pointer, 0)
        if code:
            reset_error()
        return not code

    def assert_liveliness(self) -> None:
        """Assert that it is alive, if it is not closed."""
        with suppress(RuntimeError), self._handle.rclpy:
            assert_liveliness(self._handle.rclpy)

    def close(self, *, wait: bool = False) -> None:
        """Free it, during a long `publish` at its end. May be called twice, and from two threads.

        Args:
            wait: whether to return only once it is freed.
        """
        self._closed = True
        self._free(wait=wait)

    def _free(self, *, wait: bool = False) -> None:
        if self._using.acquire(blocking=wait):
            try:
                if not self._freed:
                    self._freed = True
                    self._handle.free()
            finally:
                self._using.release()


def _publish_typed(handle: Handle, interface: type, payload: bytes) -> None:
    handle.rclpy.publish(deserialize(payload, interface))
