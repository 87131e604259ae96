"""The events of many nodes' parameters, by one subscription: all nodes of a domain publish on one topic.

With a subscription for each bridged node, each event would be copied, taken and read once per bridged node. So the
nodes of one link share a subscription. Links do not share one, since a link must not get its own messages back
(`rsb_bridge.ros.ros_interface.RosInterface.subscribe`).
"""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from rsb_bridge.cdr.event_node import ParameterEventError, node_of

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

            shared.subscription = self._ros.subscribe(topic, shared.receive, link, failed, express=True)
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
