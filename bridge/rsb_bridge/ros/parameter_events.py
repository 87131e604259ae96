"""The events of many nodes' parameters, by one subscription: all nodes of a domain publish on one topic.

A subscription for each node that is bridged would have each event copied, taken and looked into as often as nodes are
bridged. So those of one link share one; a link's own, as what a link publishes must not come back to it
(`rsb_bridge.ros.api.RosInterface.subscribe`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.cdr.parameter_event import ParameterEventError, node_of

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.api import OnFailure, RawMessage, RosError, RosInterface, Sink, Subscription


class EventsTopic(NamedTuple):
    """What can be listened to by one subscription.

    Attributes:
        name: of the topic.
        type_name: of its messages.
        type_hash: likewise.
        link: for which it is listened to.
    """

    name: str
    type_name: str
    type_hash: str
    link: Hashable


class _Listener(NamedTuple):
    node: str
    sink: Sink
    on_failure: OnFailure


class Listening:
    """One node's events, until `close`.

    Args:
        end: ends it.
    """

    def __init__(self, end: Callable[[], None]) -> None:
        self._end: Callable[[], None] | None = end

    def close(self) -> None:
        """Listen no more. May be called twice."""
        if self._end is not None:
            end, self._end = self._end, None
            end()


class ParameterEvents:
    """All that an engine listens to. Everything but the taking of messages is on the I/O loop.

    Args:
        ros: subscribes.
        call: does something on the I/O loop, from another thread.
    """

    def __init__(self, ros: RosInterface, call: Callable[[Callable[[], None]], None]) -> None:
        self._ros = ros
        self._call = call
        self._shared: dict[EventsTopic, _Shared] = {}

    def listen(self, topic: EventsTopic, qos: Qos, node: str, sink: Sink, on_failure: OnFailure) -> Listening:
        """Listen to the events of one node.

        Args:
            topic: where they are.
            qos: to subscribe with.
            node: its full name.
            sink: gets its events, on the ROS thread; and of what is no event at all, one of all sinks does.
            on_failure: told once if the subscription fails, which then is closed.

        Raises:
            RosError: it cannot be subscribed to.
        """
        shared = self._shared.get(topic)
        if shared is None:
            shared = _Shared()

            def failed(error: RosError) -> None:
                self._call(lambda: self._failed(topic, shared, error))

            shared.subscription = self._ros.subscribe(
                topic.name, topic.type_name, topic.type_hash, qos, shared.take, topic.link, failed
            )
            self._shared[topic] = shared
        listener = _Listener(node, sink, on_failure)
        shared.listeners = (*shared.listeners, listener)
        return Listening(lambda: self._end(topic, shared, listener))

    def _end(self, topic: EventsTopic, shared: _Shared, listener: _Listener) -> None:
        shared.listeners = tuple(each for each in shared.listeners if each is not listener)
        if not shared.listeners and self._shared.get(topic) is shared:
            del self._shared[topic]
            shared.subscription.close()

    def _failed(self, topic: EventsTopic, shared: _Shared, error: RosError) -> None:
        if self._shared.get(topic) is shared:
            del self._shared[topic]
            for listener in shared.listeners:
                listener.on_failure(error)


class _Shared:
    """One subscription, and who listens."""

    def __init__(self) -> None:
        self.subscription: Subscription
        self._listeners: tuple[_Listener, ...] = ()
        self._by_node: dict[str, list[Sink]] = {}  # never changed, only replaced: the ROS thread reads it

    @property
    def listeners(self) -> tuple[_Listener, ...]:
        return self._listeners

    @listeners.setter
    def listeners(self, listeners: tuple[_Listener, ...]) -> None:
        by_node: dict[str, list[Sink]] = {}
        for each in listeners:
            by_node.setdefault(each.node, []).append(each.sink)
        self._listeners, self._by_node = listeners, by_node

    def take(self, batch: Sequence[RawMessage]) -> None:
        """On the ROS thread: hand each event to those who listen to its node."""
        sinks = self._by_node
        found: dict[str, list[RawMessage]] = {}
        for message in batch:
            try:
                node = node_of(message.payload)
            except ParameterEventError:
                node = next(iter(sinks), "")  # whoever gets it says what is wrong with it
            if node in sinks:
                found.setdefault(node, []).append(message)
        for node, messages in found.items():
            for sink in sinks[node]:
                sink(messages)
