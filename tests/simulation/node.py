"""An engine's node in a simulated ROS domain."""

from __future__ import annotations

import contextvars
from typing import TYPE_CHECKING, Any

from tests.simulation.ros import Domain, Reader, Writer
from tests.simulation.services import Client, Server

from rsb_bridge.ros.discovery import Discovery
from rsb_bridge.ros.no_ros import NoMirrors
from rsb_bridge.ros.ros_interface import Endpoint, NodeEnds, RosError
from rsb_bridge.ros.ros_thread import LONGEST_WAIT, RosTurns

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from rsb_bridge.model.calls import Fields
    from rsb_bridge.ros.publication_numbers import PublicationNumbers
    from rsb_bridge.ros.ros_interface import (
        LostPort,
        Mirroring,
        OnFailure,
        RawMessage,
        RequestSink,
        ResponseSink,
        Sink,
        TopicSpec,
    )


class Node:
    """The engine's node in a domain: `rsb_bridge.ros.ros_interface.RosInterface`."""

    def __init__(self, domain: Domain, name: str, instance_id: str) -> None:
        self.instance_id = instance_id
        self.shortfalls: tuple[str, ...] = ()
        self.discovery = Discovery({})
        self.mirrors: Mirroring = NoMirrors()
        self.turns = RosTurns(self._turn_on, domain.loop.time)
        self.writers: dict[Writer, None] = {}
        self.readers: dict[Reader, None] = {}
        self.servers_of_ours: dict[Server, None] = {}
        self.clients_of_ours: dict[Client, None] = {}
        self.on_writer: Callable[[Writer, Hashable], None] | None = None
        self.on_reader: Callable[[Reader, Hashable], None] | None = None
        self._domain = domain
        self.node_name = f"_rsb_{name}_{instance_id}"
        self._name = f"/{self.node_name}"
        self._stopped = self._stalled = False

    def start(self) -> None:
        """It is in the domain already."""

    def watch(self, on_graph_change: Callable[[], None], on_failure: Callable[[str], None]) -> None:
        """Its thread, which it does not have, never fails."""
        context = contextvars.copy_context()
        self._domain.watch(self, lambda: context.run(on_graph_change))

    def _turn_on(self) -> None:
        self._domain.loop.call_later(LONGEST_WAIT, self._turn)

    def _turn(self) -> None:
        if self.turns.watched and not self._stopped:
            if not self._stalled:
                self.turns.turned()
            self._turn_on()

    def stall(self) -> None:
        """Have its thread stand still: it takes no messages, and does not turn. Calls go on."""
        self._stalled = True
        for reader in self.readers:
            reader.stalled = True

    def go_on(self) -> None:
        self._stalled = False
        for reader in self.readers:
            reader.go_on()

    def _taking(self, sink: Sink) -> Sink:
        def take(batch: Sequence[RawMessage]) -> None:
            if self.turns.watched:
                self.turns.turned()
            sink(batch)

        return take

    def lost_ports(self) -> frozenset[LostPort]:
        return frozenset()

    def stop(self) -> None:
        self._domain.unwatch(self)
        self._stopped = True
        for end in self._ends():
            end.close()

    def die(self) -> None:
        """The node's process is gone without a word: nobody hears of it any more, but others see its endpoints on."""
        self._domain.unwatch(self)
        self._stopped = True
        for end in self._ends():
            end.close(killed=True)

    def _ends(self) -> list[Writer | Reader | Server | Client]:
        return [*self.writers, *self.readers, *self.servers_of_ours, *self.clients_of_ours]

    def node_names(self) -> list[str]:
        return []

    def ends_of(self, node: str) -> NodeEnds:
        return NodeEnds()

    def topics(self) -> dict[str, list[str]]:
        found = self._domain.topics()
        return {
            topic: sorted(types)
            for topic, types in found.items()
            if self.publishers(topic) or self.subscriptions(topic)
        }

    def publishers(self, topic: str) -> list[Endpoint]:
        self._check_running()
        return [_endpoint(each) for each in self._domain.writers(topic) if each.node != self._name]

    def subscriptions(self, topic: str) -> list[Endpoint]:
        self._check_running()
        return [_endpoint(each) for each in self._domain.readers(topic) if each.node != self._name]

    def serialize(self, type_name: str, fields: Fields, now: int) -> bytes:
        if (write := self._domain.written.get(type_name)) is None:
            raise RosError(f"{type_name} is not installed here")
        return write(fields)

    def installed_description(self, type_name: str) -> str | None:
        return None

    def ask_description(self, *_: object) -> str | None:
        return None

    def survives_foreign_keys(self, _: str) -> bool:
        return True

    def installed_hash(self, type_name: str) -> str | None:
        return self._domain.installed.get(type_name)

    def subscribe(
        self,
        spec: TopicSpec,
        sink: Sink,
        origin: Hashable,
        on_failure: OnFailure | None = None,
        numbers: PublicationNumbers | None = None,
        *,
        express: bool = False,
    ) -> Reader:
        self._check_type(spec.type_name, spec.type_hash)
        reader = Reader(self._domain, self._name, *spec, self._taking(sink), origin, on_failure, numbers)
        reader.stalled, reader.in_turns = self._stalled, not express
        _keep(self.readers, reader)
        if self.on_reader is not None:
            self.on_reader(reader, origin)
        return reader

    def advertise(self, spec: TopicSpec, origin: Hashable) -> Writer:
        self._check_type(spec.type_name, spec.type_hash)
        writer = Writer(self._domain, self._name, *spec, origin)
        _keep(self.writers, writer)
        if self.on_writer is not None:
            self.on_writer(writer, origin)
        return writer

    def takes(self, topic: str, besides: Hashable) -> bool:
        own = (self._name, besides)
        return any(each.node == self._name and each.origin != own for each in self._domain.readers(topic))

    def services(self) -> dict[str, list[str]]:
        found = self._domain.services.names()
        return {name: sorted(types) for name, types in found.items() if self.servers(name) or self.callers(name)}

    def servers(self, service: str) -> list[Endpoint]:
        self._check_running()
        return [_endpoint(each) for each in self._domain.services.servers[service] if each.node != self._name]

    def callers(self, service: str) -> list[Endpoint]:
        self._check_running()
        return [_endpoint(each) for each in self._domain.services.clients[service] if each.node != self._name]

    def installed_service_hash(self, type_name: str) -> str | None:
        return self._domain.installed.get(type_name)

    def serve(
        self,
        service: str,
        type_name: str,
        type_hash: str,
        sink: RequestSink,
        on_failure: OnFailure | None = None,
        origin: Hashable = None,
    ) -> Server:
        self._check_type(type_name, type_hash)
        server = Server(self._domain.services, self._name, service, type_name, type_hash, sink, on_failure)
        _keep(self.servers_of_ours, server)
        return server

    def call_service(
        self, service: str, type_name: str, type_hash: str, sink: ResponseSink, on_failure: OnFailure | None = None
    ) -> Client:
        self._check_type(type_name, type_hash)
        client = Client(self._domain.services, self._name, service, type_name, type_hash, sink, on_failure)
        _keep(self.clients_of_ours, client)
        return client

    def _check_running(self) -> None:
        if self._stopped:
            raise RosError("the ROS node is not running")

    def _check_type(self, type_name: str, type_hash: str) -> None:
        self._check_running()
        if not type_hash and type_name not in self._domain.installed:
            raise RosError(f"{type_name} is not installed here, and its hash is not known")


def _keep(kept: dict[Any, None], end: Any) -> None:
    for other in [each for each in kept if each.closed]:
        del kept[other]
    kept[end] = None


def _endpoint(end: Writer | Reader | Server | Client) -> Endpoint:
    return Endpoint(end.node, end.type_name, end.type_hash, end.seen_qos, end.gid)
