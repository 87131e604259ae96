"""The events of many nodes' parameters, by one subscription: all nodes of a domain publish on one topic.

With a subscription for each bridged node, each event would be copied, taken and read once per bridged node. So the
nodes of one link share a subscription. Links do not share one, since a link must not get its own messages back
(`rsb_bridge.ros.ros_interface.RosInterface.subscribe`). An event is rcl_interfaces/msg/ParameterEvent, serialized.
"""

from __future__ import annotations

import struct
from contextlib import ExitStack
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from rsb_bridge.cdr.decoder import HEADER_LENGTH
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from rsb_bridge.ros.ros_interface import (
        OnFailure,
        RawMessage,
        RosError,
        RosInterface,
        Sink,
        Subscription,
        TopicSpec,
    )

    _Key: TypeAlias = tuple[TopicSpec, Hashable]
    """A topic, and the link that its events go to."""

LONGEST = 256 << 10
"""Bytes of an event that gets another name: some 2,000 parameters that changed at once. Each takes 10 µs."""

_BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}  # CDR_BE, CDR_LE
_NO_OPTIONS = b"\x00\x00"  # the encapsulation header's: the number of padding bytes at the end
_STAMP = 8
_LISTS = 3  # of parameters: new, changed, deleted
_ARRAYS = (1, 1, 8, 8)  # of a ParameterValue: bytes, bools, integers, doubles; bytes of an element


class InvalidEvent(Wording):
    """The reasons why a message is not a parameter event."""

    TOO_LONG = "it has {length:,} bytes, and at most {limit:,} are looked through"


class ParameterEventError(ValueError):
    """A message is no parameter event; the text says how it shows."""


def node_of(payload: bytes) -> str:
    """Return the full name of the node whose parameters an event is about.

    Args:
        payload: the message with its encapsulation header.

    Raises:
        ParameterEventError: it is none.
    """
    reader = _Reader(payload)
    reader.take(_STAMP, 4)
    name = reader.string()
    if name[-1:] != b"\0":
        raise ParameterEventError("the node's name has no end")
    return name[:-1].decode("utf-8", "replace")


def with_node(payload: bytes, node: str) -> bytes:
    """Return the same event of a node of another name.

    Args:
        payload: the message with its encapsulation header.
        node: the full name to put into it.

    Raises:
        ParameterEventError: it is none, or longer than `LONGEST`.
    """
    if len(payload) > LONGEST:
        raise ParameterEventError(InvalidEvent.TOO_LONG(length=len(payload), limit=LONGEST))
    name = node.encode() + b"\0"
    reader = _Reader(payload)
    stamp = reader.take(_STAMP, 4)
    reader.string()
    copy = _Copy(reader, bytearray(payload[:2] + _NO_OPTIONS + stamp))
    copy.out += struct.pack(f"{reader.order}I", len(name)) + name
    for _ in range(_LISTS):
        for _ in range(copy.length()):
            copy.string()  # the parameter's name
            copy.take(2, 1)  # its type, the bool
            copy.take(8, 8)  # the integer
            copy.take(8, 8)  # the double
            copy.string()
            for size in _ARRAYS:
                if count := copy.length():  # an empty array has no padding before its elements
                    copy.take(count * size, size)
            for _ in range(copy.length()):
                copy.string()
    return bytes(copy.out)


class _Reader:
    """Reads from the beginning on; no step passes over fewer bytes than its own, so that reading ends."""

    def __init__(self, payload: bytes) -> None:
        order = _BYTE_ORDERS.get(payload[:2])
        if order is None or len(payload) < HEADER_LENGTH:
            raise ParameterEventError("it does not begin as XCDR1")
        self.order = order
        self.payload = payload
        self.at = HEADER_LENGTH

    def take(self, size: int, alignment: int) -> bytes:
        start = self.at + (HEADER_LENGTH - self.at) % alignment
        if size > len(self.payload) - start:
            raise ParameterEventError(f"it ends after {len(self.payload):,} bytes, before its content does")
        self.at = start + size
        return self.payload[start : self.at]

    def length(self) -> int:
        (length,) = struct.unpack(f"{self.order}I", self.take(4, 4))
        return int(length)

    def string(self) -> bytes:
        return self.take(self.length(), 1)


class _Copy:
    """Writes what it reads, aligned where it comes to stand."""

    def __init__(self, reader: _Reader, out: bytearray) -> None:
        self._reader = reader
        self.out = out

    def take(self, size: int, alignment: int) -> None:
        content = self._reader.take(size, alignment)
        self.out += bytes((HEADER_LENGTH - len(self.out)) % alignment) + content

    def length(self) -> int:
        length = self._reader.length()
        self.out += bytes((HEADER_LENGTH - len(self.out)) % 4) + struct.pack(f"{self._reader.order}I", length)
        return length

    def string(self) -> None:
        self.take(self.length(), 1)


class _Listener(NamedTuple):
    node: str
    sink: Sink
    on_failure: OnFailure


class ParameterEvents:
    """All that an engine listens to. Everything but the taking of messages is on the I/O loop.

    Args:
        call: does something on the I/O loop, from another thread.
    """

    def __init__(self, ros: RosInterface, call: Callable[[Callable[[], None]], None]) -> None:
        self._ros = ros
        self._call = call
        self._shared: dict[_Key, _Shared] = {}

    def listen(self, topic: TopicSpec, link: Hashable, node: str, sink: Sink, on_failure: OnFailure) -> ExitStack:
        """Listen to the events of one node, until what is returned is closed.

        Args:
            sink: gets its events, on the ROS thread; and of what is no event at all, one of all sinks does.
            on_failure: called once if the subscription fails, which then is closed.

        Raises:
            RosError: it cannot be subscribed to.
        """
        key = topic, link
        shared = self._shared.get(key)
        if shared is None:
            shared = _Shared()

            def failed(error: RosError) -> None:
                self._call(lambda: self._failed(key, shared, error))

            shared.subscription = self._ros.subscribe(topic, shared.receive, link, failed)
            self._shared[key] = shared
        listener = _Listener(node, sink, on_failure)
        shared.listen((*shared.listeners, listener))
        ending = ExitStack()
        ending.callback(self._end, key, shared, listener)
        return ending

    def _end(self, key: _Key, shared: _Shared, listener: _Listener) -> None:
        shared.listen(tuple(each for each in shared.listeners if each is not listener))
        # One that has failed is closed already, and another may have its place.
        if not shared.listeners and self._shared.get(key) is shared:
            del self._shared[key]
            shared.subscription.close()

    def _failed(self, key: _Key, shared: _Shared, error: RosError) -> None:
        if self._shared.get(key) is shared:
            del self._shared[key]
            for listener in shared.listeners:
                listener.on_failure(error)


class _Shared:
    """One subscription, and who listens."""

    def __init__(self) -> None:
        self.subscription: Subscription
        self.listeners: tuple[_Listener, ...] = ()
        self._by_node: dict[str, list[Sink]] = {}  # never changed, only replaced: the ROS thread reads it

    def listen(self, listeners: tuple[_Listener, ...]) -> None:
        by_node: dict[str, list[Sink]] = {}
        for each in listeners:
            by_node.setdefault(each.node, []).append(each.sink)
        self.listeners, self._by_node = listeners, by_node

    def receive(self, batch: Sequence[RawMessage]) -> None:
        """On the ROS thread: hand each event to those who listen to its node."""
        sinks = self._by_node
        found: dict[str, list[RawMessage]] = {}
        for message in batch:
            try:
                node = node_of(message.payload)
            except ParameterEventError:
                node = next(iter(sinks), "")  # its sink reports the error
            if node in sinks:
                found.setdefault(node, []).append(message)
        for node, messages in found.items():
            for sink in sinks[node]:
                sink(messages)
