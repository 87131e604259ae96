"""One domain's ROS graph and our node in it: `RosNode` is the `ros_interface.RosInterface` of a real robot."""

from __future__ import annotations

import logging
import os
import re
import secrets
import threading
import time
from collections import defaultdict, deque
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeVar
from weakref import WeakSet

from rsb_bridge.model.qos import incompatible
from rsb_bridge.ros.discovery import Discovery, whole_graph
from rsb_bridge.ros.distribution import check_libraries, check_middleware, check_shared_memory
from rsb_bridge.ros.memory import histories_that_shrink, large_blocks_kept
from rsb_bridge.ros.native.shared_memory import ReadPorts
from rsb_bridge.ros.native.typesupport import hash_of, installed_class, installed_service, service_hash_of
from rsb_bridge.ros.node_mirrors import NodeMirrors
from rsb_bridge.ros.ros_interface import (
    BATCH,
    EndPlace,
    Liveliness,
    RawMessage,
    Request,
    Response,
    RosError,
    RosProblem,
)
from rsb_bridge.ros.ros_thread import LONGEST_WAIT, RosTurns
from rsb_bridge.ros.security import Security

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from rsb_bridge.model.calls import Fields
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.arrivals import Incoming
    from rsb_bridge.ros.participant import Participant
    from rsb_bridge.ros.publication_numbers import PublicationNumbers
    from rsb_bridge.ros.ros_interface import (
        Endpoint,
        LostPort,
        Mirroring,
        NodeEnds,
        OnFailure,
        Publisher,
        RequestSink,
        ResponseSink,
        ServiceClient,
        ServiceServer,
        Sink,
        Subscription,
        TopicSpec,
    )
    from rsb_bridge.ros.service_endpoints import RawServiceClient, RawServiceServer, TypedClient, TypedServer
    from rsb_bridge.ros.topic_endpoints import Reader, Writer

_Key: TypeAlias = "tuple[str, Hashable]"
"""A topic, and who our endpoints on it belong to."""

_log = logging.getLogger(__name__)

_CLOSED_REMEMBERED = 1000
"""Publishers of our own that were closed: their messages are still known as ours.

A round figure. One that is forgotten too early gets its last messages back, if its topic crosses a link both ways.
"""

_STOP_WITHIN = 1.0
"""s, ten times as long as a sink waits for the I/O loop (`ros_thread._PATIENCE`)."""
_FIRST_REST = 0.001
_RESTS = 10
"""Rests of an endpoint that gives nothing, each twice as long (s) as the one before: together 1 s.

A reader of Fast DDS 2.14 recovers with its publisher's next large message, if there is one: within 10 ms at 100 Hz.
"""
_RECOVERED_AFTER = 1.0
"""s after which an endpoint that gives nothing again has its first rest. A round figure."""
_NOTHING_A_SECOND = 5000
"""Times a second that an endpoint may be given nothing before it rests. DDS reports to each client of a service the
answers of all of them, and to a reader messages that expire before they are taken. A reader with the fault is reported
200,000 times; a round figure between that and what nodes send."""
_Taken = TypeVar("_Taken")


class RosNode:
    """Joins a domain, drains its subscriptions on a thread of its own, publishes. Used once: start, then stop.

    See `rsb_bridge.ros.ros_interface.RosInterface`.

    Endpoints are freed on that thread, between waits, so that none that is gone is waited for.

    Args:
        name: the session's; the node's name is made of it, and is unique.
    """

    def __init__(self, domain_id: int, name: str) -> None:
        self.instance_id = secrets.token_hex(4)
        self._domain_id = domain_id
        # In ROS, a node's name has letters, digits and _ only, and at most 255 of them. A _ at its beginning hides the
        # node: `ros2 param list` asks all others, and waits 5 s for each that has no parameters.
        self.node_name = f"_rsb_{re.sub(r'[^A-Za-z0-9_]', '_', name)[:64]}_{self.instance_id}"
        self.turns = RosTurns(self._wake)
        self.shortfalls: tuple[str, ...] = ()
        self.discovery = Discovery(os.environ)
        self._lock = threading.Lock()
        self._asking = threading.Lock()
        """Held during questions to other nodes, so that the domain is not left meanwhile."""
        self._participant: Participant | None = None
        self._thread: threading.Thread | None = None
        # These two are replaced and never changed, so that the thread, and questions about the graph, need no lock.
        self._drains: dict[int, Drain[Any]] = {}  # by endpoint's address
        self._indexed: tuple[object, dict[str, list[_Subscription]]] = None, {}  # subscriptions by topic, and `_drains`
        self._publishers: frozenset[_Publisher] = frozenset()
        self._writers: WeakSet[Writer] = WeakSet()  # also closed ones that still publish on another thread
        self._retired: deque[Incoming] = deque()
        self._on_graph_change: Callable[[], None] = lambda: None
        self._on_failure: Callable[[str], None] = _log.error
        self._failure = ""
        self._own: defaultdict[_Key, set[bytes]] = defaultdict(set)
        self._closed: deque[tuple[_Key, bytes]] = deque()  # still in `_own`: their messages may yet arrive
        self._ports = ReadPorts()
        self.mirrors: Mirroring = NodeMirrors(self._joined, self._lock)

    def start(self) -> None:
        """Join the domain and start the thread.

        Raises:
            RosError: rclpy or the middleware is missing, or the domain could not be joined.
        """
        # Before rclpy is loaded, as loading it would end the process.
        check_libraries(os.environ)
        check_middleware(os.environ)
        check_shared_memory()
        try:
            from rsb_bridge.ros.participant import Participant  # noqa: PLC0415  only a node that starts needs rclpy
        except ImportError as error:
            raise RosError(RosProblem.NOT_INSTALLED(error=error)) from error
        if self._thread is not None:
            raise RosError(RosProblem.STARTED_TWICE())
        with histories_that_shrink(os.environ) as own_profiles, whole_graph(os.environ):
            participant = Participant(self._domain_id, self.node_name, own_profiles=own_profiles)
        self._participant = participant
        self.shortfalls = (*participant.shortfalls, *filter(None, (Security(os.environ).unsecured(),)))
        self._thread = threading.Thread(target=self._serve, args=(participant,), name="ros", daemon=True)
        self._thread.start()

    def watch(self, on_graph_change: Callable[[], None], on_failure: Callable[[str], None]) -> None:
        self._on_graph_change, self._on_failure = on_graph_change, on_failure
        # The thread may have failed before anybody watched it.
        if self._failure:
            on_failure(self._failure)

    def lost_ports(self) -> frozenset[LostPort]:
        return self._ports.lost()

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

    def node_names(self) -> list[str]:
        return self._joined().node_names()

    def ends_of(self, node: str) -> NodeEnds:
        return self._joined().ends_of(node)

    def topics(self) -> dict[str, list[str]]:
        participant = self._joined()
        # DDS is asked only about our own topics who else has them: each question takes some 50 µs.
        own = {each.topic for each in self._subscriptions()} | {each.topic for each in self._publishers}
        return {
            topic: types
            for topic, types in participant.topics().items()
            if topic not in own or participant.publishers(topic) or participant.subscriptions(topic)
        }

    def publishers(self, topic: str) -> list[Endpoint]:
        return self._joined().publishers(topic)

    def subscriptions(self, topic: str) -> list[Endpoint]:
        return self._joined().subscriptions(topic)

    def installed_hash(self, type_name: str) -> str | None:
        try:
            installed = installed_class(type_name)
        except ValueError:  # a name that a DDS program without ROS gave to its type
            return None
        return None if installed is None else hash_of(installed)

    def survives_foreign_keys(self, type_name: str) -> bool:
        from rsb_bridge.ros.native.named_types import fast_dds_keys  # noqa: PLC0415  as in `start`

        installed = installed_class(type_name) if self.installed_hash(type_name) else None
        return installed is None or not fast_dds_keys(installed)

    def installed_description(self, type_name: str) -> str | None:
        from rsb_bridge.ros.native.rosidl_descriptions import installed_description  # noqa: PLC0415  as in `start`

        try:
            return installed_description(type_name)
        except ValueError:
            return None

    def serialize(self, type_name: str, fields: Fields, now: int) -> bytes:
        from rsb_bridge.ros.written_messages import serialize  # noqa: PLC0415  as in `start`

        return serialize(type_name, fields, now)

    def ask_description(
        self, node: str, type_name: str, type_hash: str, still_wanted: Callable[[], bool]
    ) -> str | None:
        with self._asking:
            participant = self._joined()
            # A stop ends the waiting, as `_leave` waits for the end of this question.
            return participant.ask_description(
                node, type_name, type_hash, lambda: self._participant is participant and still_wanted()
            )

    def subscribe(
        self,
        spec: TopicSpec,
        sink: Sink,
        origin: Hashable,
        on_failure: OnFailure | None = None,
        numbers: PublicationNumbers | None = None,
        *,
        express: bool = False,
    ) -> Subscription:
        with self._lock:
            participant = self._joined()
            node = self.mirrors.node_of(EndPlace("subscription", spec.topic, origin))
            reader = participant.create_reader(spec, numbers, express=express, node=node)
            key = (reader.topic, origin)
            # It gets the set itself: the messages of publishers that this link makes later are left out, too.
            subscription = _Subscription(reader, spec.qos, sink, on_failure, key, self._own[key], self)
            self._drain(subscription, participant)
        return subscription

    def advertise(self, spec: TopicSpec, origin: Hashable) -> Publisher:
        with self._lock:
            writer = self._joined().create_writer(spec, self.mirrors.node_of(EndPlace("publisher", spec.topic, origin)))
            self._writers.add(writer)
            self._own[writer.topic, origin].add(writer.told)
            publisher = _Publisher(writer, spec.qos, self, (writer.topic, origin))
            self._publishers |= {publisher}
        return publisher

    def services(self) -> dict[str, list[str]]:
        participant = self._joined()
        own = {each.service for each in self._drains.values() if isinstance(each, (ServerDrain, ClientDrain))}
        return {
            service: types
            for service, types in participant.services().items()
            if service not in own or participant.servers(service) or participant.callers(service)
        }

    def servers(self, service: str) -> list[Endpoint]:
        return self._joined().servers(service)

    def callers(self, service: str) -> list[Endpoint]:
        return self._joined().callers(service)

    def installed_service_hash(self, type_name: str) -> str | None:
        try:
            installed = installed_service(type_name)
        except ValueError:
            return None
        return None if installed is None else service_hash_of(installed)

    def serve(
        self,
        service: str,
        type_name: str,
        type_hash: str,
        sink: RequestSink,
        on_failure: OnFailure | None = None,
        origin: Hashable = None,
    ) -> ServiceServer:
        with self._lock:
            participant = self._joined()
            node = self.mirrors.node_of(EndPlace("service", service, origin))
            created = participant.create_server(service, type_name, type_hash, node)
            server = ServerDrain(created, sink, on_failure, self.retire)
            self._drain(server, participant)
        return server

    def call_service(
        self, service: str, type_name: str, type_hash: str, sink: ResponseSink, on_failure: OnFailure | None = None
    ) -> ServiceClient:
        with self._lock:
            participant = self._joined()
            created = participant.create_client(service, type_name, type_hash)
            client = ClientDrain(created, sink, on_failure, self.retire)
            self._drain(client, participant)
        return client

    def _own_readers(self, topic: str) -> Sequence[_Subscription]:
        # Each publisher asks at each look at the graph, and there may be hundreds of both.
        if (drains := self._drains) is not self._indexed[0]:
            by_topic: dict[str, list[_Subscription]] = {}
            for each in self._subscriptions():
                by_topic.setdefault(each.topic, []).append(each)
            self._indexed = drains, by_topic
        return self._indexed[1].get(topic, ())

    def own_subscriptions(self, topic: str, offered: Qos) -> int:
        """How many of our own subscriptions match a publisher of that QoS on a topic."""
        # DDS counts a subscription whose QoS does not fit as not matched, so it is not subtracted either.
        return sum(not incompatible(offered, each.qos) for each in self._own_readers(topic))

    def takes(self, topic: str, besides: Hashable) -> bool:
        return any(each.key[1] != besides for each in self._own_readers(topic))

    def own_asserted(self, key: _Key, requested: Qos) -> int:
        """How many of our own publishers of a key are alive for a subscription of that QoS."""
        now = time.monotonic()
        return sum(
            each.key == key
            and now - each.asserted_at < each.qos.liveliness_lease_duration
            and not incompatible(each.qos, requested)
            for each in self._publishers
        )

    def forget(self, publisher: _Publisher) -> None:
        """Drop a publisher that was closed."""
        with self._lock:
            if publisher not in self._publishers:
                return
            self._publishers -= {publisher}
            self._closed.append((publisher.key, publisher.writer.told))
            if len(self._closed) > _CLOSED_REMEMBERED:
                key, told = self._closed.popleft()
                self._own[key].discard(told)
                self._tidy(key)

    def _tidy(self, key: _Key) -> None:
        """Forget a topic on which we neither publish, nor did lately, nor subscribe."""
        own = self._own.get(key)
        # A subscription keeps its set. With another one in its place, messages of later publishers would come back.
        if own is not None and not own and not any(each.own is own for each in self._subscriptions()):
            del self._own[key]

    def _subscriptions(self) -> list[_Subscription]:
        return [each for each in self._drains.values() if isinstance(each, _Subscription)]

    def _joined(self) -> Participant:
        participant = self._participant
        if participant is None:
            raise RosError(RosProblem.NOT_RUNNING())
        return participant

    def _drain(self, drain: Drain[Any], participant: Participant) -> None:
        """Have the thread take from an endpoint.

        Raises:
            RosError: DDS does not tell what comes to it.
        """
        address, before = drain.endpoint.handle.address, self._drains
        # First: what comes to it is reported once.
        self._drains = {**before, address: drain}
        try:
            participant.arrivals.add(drain.endpoint)
        except RosError:
            self._drains = before
            drain.endpoint.close()
            raise

    def retire(self, drain: Drain[Any]) -> None:
        """Have the thread free a drain's endpoint.

        It is out of `_drains` before it is in `_retired`, so that no wait begins with a freed one.
        """
        with self._lock:
            # False for one that is closed twice, also if a later endpoint has its address by now.
            if self._drains.get(drain.endpoint.handle.address) is drain:
                self._drains = {address: each for address, each in self._drains.items() if each is not drain}
                if isinstance(drain, _Subscription):
                    self._tidy(drain.key)
                self._retired.append(drain.endpoint)
                if self._participant is not None:
                    self._participant.wake()

    def _wake(self) -> None:
        # `_leave` takes the lock, too, before it frees what is triggered here.
        with self._lock:
            if self._participant is not None:
                self._participant.wake()

    @large_blocks_kept()
    def _serve(self, participant: Participant) -> None:
        turns, pacing = self.turns, self.turns.pacing
        try:
            while self._participant is participant:
                # Before the wait: what is reported then is there.
                while self._retired:
                    participant.free(self._retired.popleft())
                # Unwatched, it waits without end: no timer wakes a quiet side.
                rest = pacing.rest(time.monotonic()) if pacing.apart else 0.0
                addresses, graph_changed = participant.wait(LONGEST_WAIT if turns.watched else None, rest)
                if turns.watched:
                    turns.turned()
                if addresses:
                    pacing.turned(time.monotonic())
                    self._take(participant, addresses)
                if graph_changed:
                    self._on_graph_change()
        except Exception as error:  # noqa: BLE001 — no error may end the thread unnoticed
            self._failure = RosProblem.THREAD_FAILED(error=error)
            self._on_failure(self._failure)
        finally:
            self._leave(participant)

    def _take(self, participant: Participant, addresses: Sequence[int]) -> None:
        """Take from endpoints that something has come to. What several have brought is handed on together."""
        turns, arrivals = self.turns, participant.arrivals
        turns.gathering = threading.get_ident() if len(addresses) > 1 else 0
        try:
            for address in addresses:
                # A sink of this turn may have closed others, or stopped the node.
                drain = self._drains.get(address)
                if drain is None or self._participant is not participant:
                    continue
                after = drain.deliver(arrivals.repeats)
                if after is not None:
                    arrivals.look_again(address, after)
        finally:
            if turns.gathering:
                turns.gathered()

    def _leave(self, participant: Participant) -> None:
        with self._lock:
            self._participant = None
            endpoints = [*self._retired, *(each.endpoint for each in self._drains.values())]
            writers, self._publishers = tuple(self._writers), frozenset()
            self._drains = {}
            self._retired.clear()
        for endpoint in endpoints:
            participant.free(endpoint)
        for writer in writers:
            writer.close(wait=True)
        with self._asking:
            participant.leave()


class Drain(Generic[_Taken]):
    """Takes from an endpoint until it is closed, or fails.

    Attributes:
        endpoint: which the thread frees.
        rests_until: the endpoint's last rest ends then (`time.monotonic`).
    """

    def __init__(
        self,
        endpoint: Incoming,
        take: Callable[[int], Sequence[_Taken] | None],
        sink: Callable[[Sequence[_Taken]], None],
        on_failure: OnFailure | None,
        retire: Callable[[Drain[_Taken]], None],
    ) -> None:
        """Begin.

        Args:
            take: takes up to so many from it, or returns None if DDS gives nothing.
            retire: has the thread free the endpoint.
        """
        self.endpoint = endpoint
        self.rests_until = 0.0
        self._rests = 0
        self._given_nothing, self._counted_from = 0, 0.0
        self._take = take
        self._sink = sink
        self._on_failure = on_failure
        self._retire = retire
        self._delivering = threading.RLock()  # a sink may close its own endpoint
        self._closed = False

    def deliver(self, repeats: bool) -> float | None:
        """Take one batch and hand it on.

        Args:
            repeats: see `rsb_bridge.ros.arrivals.Arrivals`.

        Returns:
            The time after which to look again, or None if that is needed only once something comes.
        """
        with self._delivering:
            if self._closed:
                return None
            try:
                batch = self._take(BATCH)
                if batch is None:
                    return self._rest() if repeats or self.endpoint.has_more else None
            except RosError as error:
                self.close()
                if self._on_failure is not None:
                    self._on_failure(error)
                return None
            self._rests = 0
            if batch:  # all of it may have been our own messages
                self._sink(batch)
            return 0.0 if self.endpoint.has_more else None

    def _rest(self) -> float:
        """Note that nothing was given. If that happens too often, let the endpoint rest: it would go on for ever.

        Raises:
            RosError: it has given nothing for too long.
        """
        now = time.monotonic()
        if now > self._counted_from + 1.0:
            self._given_nothing, self._counted_from = 0, now
        self._given_nothing += 1
        if self._given_nothing <= _NOTHING_A_SECOND:
            return 0.0
        if now > self.rests_until + _RECOVERED_AFTER:
            self._rests = 0
        if self._rests == _RESTS:
            raise RosError(RosProblem.NOTHING_GIVEN())
        rest = float(_FIRST_REST * 2**self._rests)
        self.rests_until = now + rest
        self._rests += 1
        return rest

    def close(self) -> None:
        """Take no more. The sink is not called again after this returns."""
        with self._delivering:
            self._closed = True
        self._retire(self)


class ServerDrain(Drain[Request]):
    """A service that is offered: `rsb_bridge.ros.ros_interface.ServiceServer`."""

    def __init__(
        self,
        server: RawServiceServer | TypedServer,
        sink: RequestSink,
        on_failure: OnFailure | None,
        retire: Callable[[Drain[Any]], None],
    ) -> None:
        super().__init__(server, server.take, sink, on_failure, retire)
        self.service = server.name
        self.answer = server.answer


class ClientDrain(Drain[Response]):
    """A service that is called: `rsb_bridge.ros.ros_interface.ServiceClient`."""

    def __init__(
        self,
        client: RawServiceClient | TypedClient,
        sink: ResponseSink,
        on_failure: OnFailure | None,
        retire: Callable[[Drain[Any]], None],
    ) -> None:
        super().__init__(client, client.take, sink, on_failure, retire)
        self.service = client.name
        self.call = client.call
        self._client = client

    @property
    def ready(self) -> bool:
        return self._client.ready


class _Subscription(Drain[RawMessage]):
    """A reader, and whose it is."""

    def __init__(
        self,
        reader: Reader,
        qos: Qos,
        sink: Sink,
        on_failure: OnFailure | None,
        key: _Key,
        own: set[bytes],
        node: RosNode,
    ) -> None:
        super().__init__(reader, partial(reader.take, skip=own), sink, on_failure, node.retire)
        self.topic = reader.topic
        self.qos = qos
        self.key = key
        self.own = own
        self._reader = reader
        self._node = node

    @property
    def matched(self) -> int:
        return self._reader.matched

    @property
    def refuses(self) -> bool:
        return self._reader.refuses

    @property
    def liveliness(self) -> Liveliness:
        alive, unjudged = self._reader.liveliness
        return Liveliness(max(0, alive - self._node.own_asserted(self.key, self.qos)), unjudged)


class _Publisher:
    """A writer that counts other nodes' subscriptions only."""

    def __init__(self, writer: Writer, qos: Qos, node: RosNode, key: _Key) -> None:
        self.writer = writer
        self.key = key
        self.topic = writer.topic
        self.publish = writer.publish
        self.gid = writer.gid
        self.qos = qos
        self.asserted_at = float("-inf")
        self._node = node

    @property
    def subscriber_count(self) -> int:
        own = self._node.own_subscriptions(self.topic, self.qos)
        # The two are counted one after the other: a subscription of ours may have come in between.
        return max(0, self.writer.matched - own)

    @property
    def refuses(self) -> bool:
        return self.writer.refuses

    @property
    def acknowledged(self) -> bool:
        return self.writer.acknowledged

    def assert_liveliness(self) -> None:
        self.asserted_at = time.monotonic()
        self.writer.assert_liveliness()

    def close(self) -> None:
        self._node.forget(self)
        self.writer.close()
