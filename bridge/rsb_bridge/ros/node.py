"""One domain's ROS graph and our node in it: `RosNode` is the `rsb_bridge.ros.api.RosInterface` of a real robot."""

from __future__ import annotations

import logging
import os
import re
import secrets
import threading
from collections import defaultdict, deque
from typing import TYPE_CHECKING, TypeAlias

from rsb_bridge.model.qos import incompatible
from rsb_bridge.ros.api import RosError
from rsb_bridge.ros.middleware import check_middleware
from rsb_bridge.ros.typesupport import hash_of, installed_class

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.api import Endpoint, OnFailure, Publisher, Sink, Subscription
    from rsb_bridge.ros.rcl import Participant, Reader, Writer

_Key: TypeAlias = "tuple[str, Hashable]"
"""A topic, and who our endpoints on it belong to."""

_log = logging.getLogger(__name__)

_BATCH = 64
"""Messages taken from one subscription before the next has its turn."""

_CLOSED_REMEMBERED = 1000
"""Publishers of our own that were closed: their messages are still known as ours."""

_STOP_WITHIN = 1.0  # s


class RosNode:
    """Joins a domain, drains its subscriptions on a thread of its own, publishes. Used once: start, then stop.

    Endpoints are freed on that thread, between waits, so that the wait set never holds one that is gone.

    Args:
        domain_id: ROS domain.
        name: the session's; the node's name is made of it, and is unique.
    """

    def __init__(self, domain_id: int, name: str) -> None:
        self.instance_id = secrets.token_hex(4)
        self._domain_id = domain_id
        self.node_name = f"rsb_{re.sub(r'[^A-Za-z0-9_]', '_', name)[:64]}_{self.instance_id}"
        self._lock = threading.Lock()
        self._asking = threading.Lock()
        """Held by whoever asks another node something: the domain is not left meanwhile."""
        self._participant: Participant | None = None
        self._thread: threading.Thread | None = None
        self._subscriptions: dict[int, _Subscription] = {}  # by reader's address; replaced, never changed
        self._publishers: frozenset[_Publisher] = frozenset()  # likewise
        self._retired: deque[Reader] = deque()
        self._on_graph_change: Callable[[], None] = _nothing
        self._on_failure: Callable[[str], None] = _log.error
        self._failure = ""
        self._own: defaultdict[_Key, set[bytes]] = defaultdict(set)
        self._closed: deque[tuple[_Key, bytes]] = deque()  # in `_own` still: what they published may be on its way

    def start(self) -> None:
        """Join the domain and start the thread.

        Raises:
            RosError: rclpy or the middleware is missing, or the domain could not be joined.
        """
        check_middleware(os.environ)
        try:
            from rsb_bridge.ros.rcl import Participant  # noqa: PLC0415  only a node that starts needs rclpy
        except ImportError as error:
            raise RosError(
                f"ROS 2 cannot be used ({error}): pip install 'rsb-console[ros]' on x86-64 Linux, "
                "or source /opt/ros/jazzy/setup.bash before starting"
            ) from error
        if self._thread is not None:
            raise RosError("a ROS node is started once")
        participant = self._participant = Participant(self._domain_id, self.node_name)
        self._thread = threading.Thread(target=self._run, args=(participant,), name="ros", daemon=True)
        self._thread.start()

    def watch(self, on_graph_change: Callable[[], None], on_failure: Callable[[str], None]) -> None:
        """Have functions called; see `rsb_bridge.ros.api.RosInterface.watch`."""
        self._on_graph_change, self._on_failure = on_graph_change, on_failure
        if self._failure:
            on_failure(self._failure)

    def stop(self) -> None:
        """Close every endpoint, leave the domain, end the thread. May be called twice, and from a sink.

        It takes 1 s at most: a sink that still blocks then is left behind, and the domain as soon as it returns.
        """
        with self._lock:
            participant, self._participant = self._participant, None
            if participant is not None:
                participant.wake()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(_STOP_WITHIN)

    def topics(self) -> dict[str, list[str]]:
        """Every topic of the graph with its type names; topics that only our own node holds are left out."""
        participant = self._joined()
        own = {each.topic for each in self._subscriptions.values()} | {each.topic for each in self._publishers}
        return {
            topic: types
            for topic, types in participant.topics().items()
            if topic not in own or participant.publishers(topic) or participant.subscriptions(topic)
        }

    def publishers(self, topic: str) -> list[Endpoint]:
        """The publishers on a topic, our own node's left out."""
        return self._joined().publishers(topic)

    def subscriptions(self, topic: str) -> list[Endpoint]:
        """The subscriptions on a topic, our own node's left out."""
        return self._joined().subscriptions(topic)

    def installed_hash(self, type_name: str) -> str | None:
        """The type hash of a message type that is installed here, else None."""
        try:
            installed = installed_class(type_name)
        except ValueError:
            return None
        return None if installed is None else hash_of(installed)

    def installed_description(self, type_name: str) -> str | None:
        """The text of the description of a message type that is installed here, else None."""
        from rsb_bridge.ros.descriptions import installed_description  # noqa: PLC0415  as in `start`

        try:
            return installed_description(type_name)
        except ValueError:
            return None

    def ask_description(
        self, node: str, type_name: str, type_hash: str, still_wanted: Callable[[], bool]
    ) -> str | None:
        """Ask a node for a type's description; see `rsb_bridge.ros.api.RosInterface.ask_description`."""
        with self._asking:
            participant = self._joined()
            return participant.ask_description(
                node, type_name, type_hash, lambda: self._participant is participant and still_wanted()
            )

    def subscribe(
        self,
        topic: str,
        type_name: str,
        type_hash: str,
        qos: Qos,
        sink: Sink,
        origin: Hashable,
        on_failure: OnFailure | None = None,
    ) -> Subscription:
        """Subscribe raw; see `rsb_bridge.ros.api.RosInterface.subscribe`."""
        with self._lock:
            participant = self._joined()
            reader = participant.create_reader(topic, type_name, type_hash, qos)
            own = self._own[reader.topic, origin]
            subscription = _Subscription(reader, qos, sink, on_failure, own, self._retire)
            self._subscriptions = {**self._subscriptions, reader.address: subscription}
            participant.wake()
        return subscription

    def advertise(self, topic: str, type_name: str, type_hash: str, qos: Qos, origin: Hashable) -> Publisher:
        """Create a raw publisher; see `rsb_bridge.ros.api.RosInterface.advertise`."""
        with self._lock:
            writer = self._joined().create_writer(topic, type_name, type_hash, qos)
            self._own[writer.topic, origin].add(writer.gid)
            publisher = _Publisher(writer, qos, self, (writer.topic, origin))
            self._publishers |= {publisher}
        return publisher

    def own_subscriptions(self, topic: str, offered: Qos) -> int:
        """How many of our own subscriptions match a publisher of that QoS on a topic."""
        own = self._subscriptions.values()
        return sum(each.topic == topic and not incompatible(offered, each.qos) for each in own)

    def forget(self, publisher: _Publisher) -> None:
        """Drop a publisher that was closed."""
        with self._lock:
            if publisher not in self._publishers:
                return
            self._publishers -= {publisher}
            self._closed.append((publisher.key, publisher.gid))
            if len(self._closed) > _CLOSED_REMEMBERED:
                key, gid = self._closed.popleft()
                self._own[key].discard(gid)
                if not self._own[key] and not any(each.own is self._own[key] for each in self._subscriptions.values()):
                    del self._own[key]

    def _joined(self) -> Participant:
        participant = self._participant
        if participant is None:
            raise RosError("the ROS node is not running")
        return participant

    def _retire(self, subscription: _Subscription) -> None:
        """Have the thread free a subscription's reader. It is out of `_subscriptions` before it is in `_retired`."""
        reader = subscription.reader
        with self._lock:
            if self._subscriptions.get(reader.address) is subscription:
                self._subscriptions = {
                    address: each for address, each in self._subscriptions.items() if each is not subscription
                }
                self._retired.append(reader)
                if self._participant is not None:
                    self._participant.wake()

    def _run(self, participant: Participant) -> None:
        try:
            while self._participant is participant:
                while self._retired:
                    self._retired.popleft().close()
                subscriptions = self._subscriptions
                ready = participant.wait([each.reader for each in subscriptions.values()])
                for address in ready.readers:
                    if self._participant is participant:
                        subscriptions[address].deliver()
                if ready.graph_changed:
                    self._on_graph_change()
        except Exception as error:  # noqa: BLE001 — whatever it is, the thread must not end unnoticed
            self._failure = f"the thread that serves ROS failed: {error}"
            self._on_failure(self._failure)
        finally:
            self._leave(participant)

    def _leave(self, participant: Participant) -> None:
        with self._lock:
            self._participant = None
            readers = [*self._retired, *(each.reader for each in self._subscriptions.values())]
            publishers, self._publishers = self._publishers, frozenset()
            self._subscriptions = {}
            self._retired.clear()
        for reader in readers:
            reader.close()
        for publisher in publishers:
            publisher.writer.close()
        with self._asking:
            participant.leave()


class _Subscription:
    """A reader, and the sink that its messages go to."""

    def __init__(
        self,
        reader: Reader,
        qos: Qos,
        sink: Sink,
        on_failure: OnFailure | None,
        own: set[bytes],
        retire: Callable[[_Subscription], None],
    ) -> None:
        self.reader = reader
        self.topic = reader.topic
        self.qos = qos
        self._sink = sink
        self._on_failure = on_failure
        self.own = own
        self._retire = retire
        self._delivering = threading.RLock()  # a sink may close its own subscription
        self._closed = False

    @property
    def lost(self) -> int:
        return self.reader.lost

    def deliver(self) -> None:
        """Take one batch and hand it on."""
        with self._delivering:
            if self._closed:
                return
            try:
                batch = self.reader.take(_BATCH, self.own)
            except RosError as error:
                self.close()
                if self._on_failure is not None:
                    self._on_failure(error)
                return
            if batch:
                self._sink(batch)

    def close(self) -> None:
        with self._delivering:
            self._closed = True
        self._retire(self)


class _Publisher:
    """A writer that counts other nodes' subscriptions only."""

    def __init__(self, writer: Writer, qos: Qos, node: RosNode, key: _Key) -> None:
        self.writer = writer
        self.key = key
        self.topic = writer.topic
        self.publish = writer.publish
        self.gid = writer.gid
        self._qos = qos
        self._node = node

    @property
    def subscriber_count(self) -> int:
        own = self._node.own_subscriptions(self.topic, self._qos)
        return max(0, self.writer.matched - own)

    def close(self) -> None:
        self._node.forget(self)
        self.writer.close()


def _nothing() -> None:
    """Nobody watches the graph."""
