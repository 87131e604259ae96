"""A stand-in for the ROS side (`rsb_bridge.ros.ros_interface.RosInterface`): ROS does not fit in the machine.

It has one publisher and one subscriber on any topic that a test names, one server and one client of any service, and
hands messages over as the real one does: raw, from a thread of its own.
"""

from __future__ import annotations

import itertools
import queue
import secrets
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Hashable
from functools import partial
from typing import NamedTuple

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import (
    Endpoint,
    Liveliness,
    OnFailure,
    RawMessage,
    Request,
    RequestSink,
    Response,
    ResponseSink,
    Sink,
    TopicSpec,
)
from rsb_bridge.ros.ros_thread import RosTurns

TYPE, HASH = "std_msgs/msg/String", "RIHS01_" + 64 * "0"
SERVICE_TYPE, SERVICE_HASH = "std_srvs/srv/Trigger", f"{HASH}+{HASH}"
_SERVICE_QOS = Qos(depth=0)
_GID = b"talker".ljust(16, b"\0")
"""Of the one publisher that is not the bridge's own."""


class Arrival(NamedTuple):
    """A message that came out.

    Attributes:
        time: s, monotonic.
    """

    payload: bytes
    time: float


class StandIn(NoRos):
    """One domain.

    Attributes:
        instance_id: as a real node's.
        turns: as a real node's; it has no thread.
        offered: the topics that this domain's own nodes publish, with their QoS.
        arrived: what the engine published, by topic.
        answering: the answers of this domain's own nodes, by service, or None for no answer.
    """

    def __init__(self, **offered: Qos) -> None:
        self.instance_id = secrets.token_hex(4)
        self.node_name = f"rsb_{self.instance_id}"
        self.turns = RosTurns()
        self.offered = {f"/{name}": qos for name, qos in offered.items()}
        self.arrived: defaultdict[str, list[Arrival]] = defaultdict(list)
        self.answering: dict[str, Callable[[bytes], bytes | None]] = {}
        self._sinks: dict[str, Sink] = {}
        self._servers: dict[str, _Server] = {}
        self._threads: list[threading.Thread] = []
        self._stopped = threading.Event()

    # --- what tests do

    def publish(self, topic: str, payload: bytes) -> None:
        """Publish as a node of this domain; the message is lost if the engine does not subscribe, as with ROS."""
        sink = self._sinks.get(topic)
        if sink is not None:
            sink((RawMessage(payload, time.time_ns(), _GID),))

    def publish_at(self, rate: float, topic: str, make: Callable[[int], bytes]) -> None:
        """Go on publishing from a thread, at that rate in Hz, until the domain is stopped."""

        def run() -> None:
            number, due = 0, time.monotonic()
            while not self._stopped.wait(max(0.0, due - time.monotonic())):
                self.publish(topic, make(number))
                number += 1
                due += 1 / rate

        self._threads.append(threading.Thread(target=run))
        self._threads[-1].start()

    def subscribed(self, *topics: str) -> bool:
        return all(topic in self._sinks for topic in topics)

    def serves(self, *services: str) -> bool:
        return all(service in self._servers for service in services)

    def call(self, service: str, payload: bytes, within: float) -> bytes:
        """Call a service of the engine as a node of this domain, and return the answer.

        Raises:
            queue.Empty: no answer came within so many s.
        """
        return self._servers[service].ask(payload).get(timeout=within)

    # --- what the engine does

    def stop(self) -> None:
        self._stopped.set()
        for thread in self._threads:
            thread.join()

    def topics(self) -> dict[str, list[str]]:
        return {topic: [TYPE] for topic in self.offered}

    def publishers(self, topic: str) -> list[Endpoint]:
        return [Endpoint("/stand_in", TYPE, HASH, self.offered[topic], _GID)] if topic in self.offered else []

    def installed_hash(self, type_name: str) -> str | None:
        return HASH if type_name == TYPE else None

    def subscribe(
        self,
        spec: TopicSpec,
        sink: Sink,
        origin: Hashable,
        on_failure: OnFailure | None = None,
        numbers: object = None,
        **_: object,
    ) -> _Subscription:
        self._sinks[spec.topic] = sink
        return _Subscription(self._sinks, spec.topic)

    def advertise(self, spec: TopicSpec, origin: Hashable) -> _Publisher:
        return _Publisher(self.arrived[spec.topic])

    def services(self) -> dict[str, list[str]]:
        return {service: [SERVICE_TYPE] for service in self.answering}

    def servers(self, service: str) -> list[Endpoint]:
        found = service in self.answering
        return [Endpoint("/stand_in", SERVICE_TYPE, SERVICE_HASH, _SERVICE_QOS, _GID)] if found else []

    def installed_service_hash(self, type_name: str) -> str | None:
        return SERVICE_HASH if type_name == SERVICE_TYPE else None

    def serve(
        self,
        service: str,
        type_name: str,
        type_hash: str,
        sink: RequestSink,
        on_failure: OnFailure | None = None,
        origin: Hashable = None,
    ) -> _Server:
        server = self._servers[service] = _Server(sink, self._servers, service)
        return server

    def call_service(
        self, service: str, type_name: str, type_hash: str, sink: ResponseSink, on_failure: OnFailure | None = None
    ) -> _Client:
        return _Client(sink, partial(self.answering.get, service))


class _Subscription:
    liveliness = Liveliness(alive=1)
    matched = 1
    refuses = False

    def __init__(self, sinks: dict[str, Sink], topic: str) -> None:
        self._sinks = sinks
        self._topic = topic

    def close(self) -> None:
        self._sinks.pop(self._topic, None)


class _Publisher:
    subscriber_count = 1
    refuses = False
    acknowledged = True

    def __init__(self, arrived: list[Arrival]) -> None:
        self.gid = secrets.token_bytes(16)
        self._arrived = arrived

    def assert_liveliness(self) -> None:
        pass

    def publish(self, payload: bytes) -> None:
        self._arrived.append(Arrival(payload, time.monotonic()))

    def close(self) -> None:
        pass


class _Server:
    def __init__(self, sink: RequestSink, servers: dict[str, _Server], service: str) -> None:
        self._servers = servers
        self._service = service
        self._sink = sink
        self._asked: dict[bytes, queue.SimpleQueue[bytes]] = {}

    def ask(self, payload: bytes) -> queue.SimpleQueue[bytes]:
        """Call it; the answer comes into the queue."""
        caller = secrets.token_bytes(24)
        answer = self._asked[caller] = queue.SimpleQueue()
        self._sink([Request(payload, caller, time.time_ns())])
        return answer

    def answer(self, caller: bytes, payload: bytes) -> None:
        self._asked.pop(caller).put(payload)

    def close(self) -> None:
        self._servers.pop(self._service, None)


class _Client:
    def __init__(self, sink: ResponseSink, answering: Callable[[], Callable[[bytes], bytes | None] | None]) -> None:
        self._sink = sink
        self._answering = answering
        self._numbers = itertools.count(1)

    @property
    def ready(self) -> bool:
        return self._answering() is not None

    def call(self, payload: bytes) -> int:
        number = next(self._numbers)
        threading.Thread(target=self._answer, args=(number, payload)).start()
        return number

    def _answer(self, number: int, payload: bytes) -> None:
        answer = self._answering()
        response = None if answer is None else answer(payload)
        if response is not None:
            self._sink([Response(response, number, time.time_ns())])

    def close(self) -> None:
        self._sink = _nobody


def _nobody(_: object) -> None:
    """A closed client's answers go to."""
