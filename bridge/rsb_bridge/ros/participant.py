"""A participant in one ROS domain and its raw endpoints, without rclpy's executors (`rsb_bridge.ros.native`)."""

from __future__ import annotations

import itertools
import os
import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import msgspec
from rclpy.context import Context

from rsb_bridge.model.limits import DOMAIN, TEXT_LENGTH, TOPIC_LENGTH
from rsb_bridge.model.names import ANNOUNCEMENT_TOPIC, is_bridge, is_topic_name
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.ros.arrivals import EventArrivals, WaitSetArrivals
from rsb_bridge.ros.bridge_participants import BridgeParticipants
from rsb_bridge.ros.distribution import described
from rsb_bridge.ros.memory import profile_variable, prompt_writer
from rsb_bridge.ros.native.description_service import ask_node
from rsb_bridge.ros.native.fast_dds_profiles import load_profiles
from rsb_bridge.ros.native.librcl import TakeBuffer, graph_guard_condition, reset_error
from rsb_bridge.ros.native.rcl_conversions import endpoint_of, safe_type_name
from rsb_bridge.ros.native.rclpy_extension import (
    PUBLISHERS,
    SERVICES,
    SUBSCRIPTIONS,
    TOPICS,
    Handle,
    LivelinessOfPublishers,
    UntakenResponses,
    ask,
    names_of_node,
    nodes_of,
    reason_of,
)
from rsb_bridge.ros.raw_types import borrow_service, borrow_type
from rsb_bridge.ros.ros_interface import Endpoint, NodeEnds, RosError, RosProblem
from rsb_bridge.ros.security import Security
from rsb_bridge.ros.self_test import ARGUMENTS, FAST_DDS, findings
from rsb_bridge.ros.service_endpoints import (
    CallerTable,
    RawServiceClient,
    RawServiceServer,
    TypedClient,
    TypedServer,
    callers_in_graph,
    servers_in_graph,
)
from rsb_bridge.ros.topic_endpoints import Reader, Writer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from rsb_bridge.ros.arrivals import Arrivals, Incoming
    from rsb_bridge.ros.native.named_types import BorrowedType
    from rsb_bridge.ros.native.rclpy_extension import Entity, Kind, OwnNode, Question
    from rsb_bridge.ros.publication_numbers import PublicationNumbers
    from rsb_bridge.ros.ros_interface import TopicSpec

_TRY_AGAIN = 0.1
"""s. After that, kept answers are tried again if nothing happens before: half of the interval between two attempts."""
_DIFFERENT_LEASES = 1000
"""Readers that may have the same lease at a time. A round figure: the last one's is 1 ms longer."""
_KEPT = 5000  # messages: Fast DDS's limit on a history that keeps all
_MOST_PROMPT = 4096
_prompt: set[str] = set()
"""Topics whose writers have `prompt_writer`, and how many may have it. The number is a round figure."""
_DEEP = 1000
"""Messages. A writer that keeps fewer may have overwritten what a reader lacks before it asks, which by the default
profile takes up to 0.5 s. As many come in that time at 2 kHz."""

_CALLS = Qos("reliable", "volatile", "keep_last", _KEPT)
"""The QoS of all services, with a greater depth: simultaneous calls must not displace each other."""


class Participant:
    """Our own node in one domain, and *mirrored* nodes, which have the names of nodes of another domain.

    All are of one context, whose enclave is the own node's name: by that, other bridges know mirrored nodes.

    Attributes:
        shortfalls: what does not work with this ROS, in an operator's words.
        arrivals: which endpoints something has come to.

    The graph may be asked from any thread; `wait`, and to take from endpoints, belong to one thread.
    """

    def __init__(self, domain_id: int, node_name: str, *, own_profiles: bool = False) -> None:
        """Join the domain.

        Args:
            own_profiles: whether the profiles of Fast DDS's endpoints are the bridge's, and not a user's.

        Raises:
            RosError: the domain cannot be joined.
        """
        if domain_id not in DOMAIN:
            raise RosError(RosProblem.NO_SUCH_DOMAIN(domain=domain_id, domains=DOMAIN))
        found, self._context = findings(), Context()
        # A secured context has the enclave whose keys it uses.
        self._why_no_mirrors = RosProblem.NO_MIRROR_SECURED() if Security(os.environ).is_on else ""
        if found.middleware != FAST_DDS:  # whose ids of endpoints name the participant, as tests show
            self._why_no_mirrors = RosProblem.NO_MIRROR_MIDDLEWARE(middleware=found.middleware)
        enclave = () if self._why_no_mirrors else ("--enclave", f"/{node_name}")
        self._new_node = found.node
        self._mirrored: dict[str, OwnNode] = {}
        try:
            self._context.init([*ARGUMENTS, *enclave], domain_id=domain_id)
            self._node = found.node(node_name, self._context)
        except RuntimeError as error:
            self._context.try_shutdown()  # `shutdown` raises if `init` has failed
            reason = Security(os.environ).why_not_joined(reason_of(error))
            raise RosError(f"ROS domain {domain_id} cannot be joined: {reason}") from error
        self.shortfalls = found.shortfalls
        self._name = self._node.handle.get_fully_qualified_name()
        tells = WaitSetArrivals if found.no_arrivals else EventArrivals
        try:
            self.arrivals: Arrivals = tells(self._context, graph_guard_condition(self._node.handle.pointer))
        except OSError as error:
            self._leave_domain()
            raise RosError(f"ROS domain {domain_id} cannot be joined: {error}") from error
        self._graph_version = 0
        self._bridges = BridgeParticipants(self._announcers, lambda: self._graph_version)
        self._late: dict[RawServiceServer, None] = {}
        self._buffer = TakeBuffer()
        self._untaken = UntakenResponses(self._context)
        self._lease_numbers = itertools.count()
        self._own_profiles = own_profiles
        # The middleware has a participant's entities locked while it asks a type support that is in Python, where the
        # GIL may change hands: nobody may have it then and want that lock.
        self._entities = threading.RLock()

    def leave(self) -> None:
        """Leave the domain; every endpoint is closed before."""
        self._buffer.free()
        self._untaken.close()
        self.arrivals.close()
        self._leave_domain()

    def _leave_domain(self) -> None:
        for node in (*self._mirrored.values(), self._node):
            node.destroy()
        self._context.shutdown()
        self._context.destroy()

    def node_names(self) -> list[str]:
        """The full names of all nodes but our own and mirrored ones, whichever bridge mirrors them."""
        found = nodes_of(self._node.handle)
        names = (name for name, enclave in found if name != self._name and (name == enclave or not is_bridge(enclave)))
        return [sanitize_text(name, TEXT_LENGTH) for name in names]

    def mirrored_by_others(self) -> dict[str, str]:
        """The full names of nodes that other bridges mirror here, each with its bridge's."""
        others = (each for each in nodes_of(self._node.handle) if self._name != each[1] != each[0])
        return {sanitize_text(name, TEXT_LENGTH): enclave for name, enclave in others if is_bridge(enclave)}

    def add_mirror(self, name: str) -> None:
        """Make a node of that full name, for endpoints that are created with it as their `node`.

        Raises:
            RosError: ROS refuses the name, or nodes cannot be mirrored here.
        """
        if self._why_no_mirrors:
            raise RosError(self._why_no_mirrors)
        namespace, _, base = name.rpartition("/")
        try:
            with self._entities:
                self._mirrored[name] = self._new_node(base, self._context, namespace or "/")
        except (RuntimeError, ValueError) as error:
            reset_error()
            raise RosError(f"{name} cannot be mirrored: {reason_of(error)}") from error

    def remove_mirror(self, name: str) -> None:
        """End a node of `add_mirror`. The graph has it until its endpoints are freed."""
        if (node := self._mirrored.pop(name, None)) is not None:
            with self._entities:
                node.destroy()

    def ends_of(self, node: str) -> NodeEnds:
        """The names that a node uses."""
        namespace, _, name = node.rpartition("/")
        return NodeEnds(*map(_named, names_of_node(self._node.handle, name, namespace or "/")))

    def topics(self) -> dict[str, list[str]]:
        """Every topic that ROS can subscribe to, our own node's too, with its type names."""
        return _named(self._ask(TOPICS))

    def services(self) -> dict[str, list[str]]:
        """Every service, our own node's too, with its type names."""
        return _named(ask(SERVICES, self._node.handle))

    def publishers(self, topic: str) -> list[Endpoint]:
        """The publishers on a topic, our own left out."""
        return self._others(self._ask(PUBLISHERS, topic))

    def subscriptions(self, topic: str) -> list[Endpoint]:
        """The subscriptions on a topic, our own left out."""
        return self._others(self._ask(SUBSCRIPTIONS, topic))

    def servers(self, service: str) -> list[Endpoint]:
        """The servers of a service, our own left out."""
        return self._not_own(servers_in_graph(self._ask_dds, service))

    def callers(self, service: str) -> list[Endpoint]:
        """The clients of a service, our own left out."""
        return self._not_own(callers_in_graph(self._ask_dds, service))

    def ask_description(
        self, node: str, type_name: str, type_hash: str, still_wanted: Callable[[], bool]
    ) -> str | None:
        """Ask another node for the description of a type, see `rsb_bridge.ros.native.description_service.ask_node`.

        Raises:
            RosError: rcl failed.
        """
        try:
            return ask_node(self._node, self._context, node, type_name, type_hash, still_wanted, self._entities)
        except RuntimeError as error:
            reset_error()
            raise RosError(f"{node} cannot be asked: {reason_of(error)}") from error

    def create_reader(
        self, spec: TopicSpec, numbers: PublicationNumbers | None = None, *, express: bool = False, node: str = ""
    ) -> Reader:
        """Create a raw subscription.

        Args:
            node: the mirrored node that has it, here and below; without such a node, our own.

        Raises:
            RosError: the type, the name or the QoS will not do.
        """
        # The history of a latched topic may begin with any number, as its publisher keeps the newest only.
        earlier = None if spec.qos.latched else frozenset(each.gid for each in self.publishers(spec.topic))
        # By it, Fast DDS drops what is not stamped, or by a clock that is wrong. A route knows the ages (`route.age`).
        qos = msgspec.structs.replace(spec.qos, lifespan=0.0)
        if lease := qos.liveliness_lease_duration:
            # Fast DDS tells only the first of a participant's readers with the same lease who is alive.
            lease += next(self._lease_numbers) % _DIFFERENT_LEASES * 1e-6
            qos = msgspec.structs.replace(qos, liveliness_lease_duration=lease)
        handle = self._create("subscription", spec.topic, borrow_type(spec.type_name, spec.type_hash), qos, node)
        liveliness = LivelinessOfPublishers(handle.rclpy) if lease else None
        return Reader(handle, self._buffer, earlier, numbers, liveliness, express=express)

    def create_writer(self, spec: TopicSpec, node: str = "") -> Writer:
        """Create a raw publisher; errors as `create_reader`.

        One that keeps all would make its caller wait 100 ms a message once a slow reader has fallen a whole history
        behind, and then refuse the message; so it keeps the same number and lets the oldest go instead.
        """
        topic, type_name, type_hash, qos = spec
        if qos.history == "keep_all":
            qos = msgspec.structs.replace(qos, history="keep_last", depth=_KEPT)
        with self._entities:
            if self._own_profiles and qos.reliability == "reliable" and (qos.latched or qos.depth < _DEEP):
                _be_prompt(topic)
            borrowed = borrow_type(type_name, type_hash)
            handle = self._create("publisher", topic, borrowed, qos, node)
        writer = Writer(handle, borrowed.interface)
        self._bridges.know(writer.gid, self._name)
        return writer

    def create_server(
        self, service: str, type_name: str, type_hash: str, node: str = ""
    ) -> RawServiceServer | TypedServer:
        """Create a raw service; errors as `create_reader`."""
        borrowed = borrow_service(type_name, type_hash)
        handle = self._create("service", service, borrowed.type, _CALLS, node)
        name: str = handle.rclpy.name
        if not borrowed.raw:
            return TypedServer(handle, name, borrowed.type.interface)
        callers_of = CallerTable(self._ask_dds, name, _CALLS, lambda: self._graph_version)
        return RawServiceServer(handle, name, callers_of, self._have_tried)

    def create_client(self, service: str, type_name: str, type_hash: str) -> RawServiceClient | TypedClient:
        """Create a raw client of a service; errors as `create_reader`."""
        borrowed = borrow_service(type_name, type_hash)
        handle = self._create("client", service, borrowed.type, _CALLS)
        name: str = handle.rclpy.service_name
        if not borrowed.raw:
            return TypedClient(handle, name, self._untaken, borrowed.type.interface)
        return RawServiceClient(handle, name, self._untaken)

    def wait(self, longest: float | None = None, rest: float = 0.0) -> tuple[list[int], bool]:
        """Wait as `Arrivals.wait` does, and try late answers again."""
        addresses, graph_changed = self.arrivals.wait(_TRY_AGAIN if self._late else longest, rest)
        # Before the late answers, which look for their callers in the graph as it is now.
        self._graph_version += graph_changed
        if self._late:
            self._try_again()
        return addresses, graph_changed

    def free(self, endpoint: Incoming) -> None:
        """Free an endpoint, on the thread that waits."""
        self.arrivals.remove(endpoint)
        endpoint.close()

    def _try_again(self) -> None:
        """Try late answers again."""
        for server in tuple(self._late):
            # Before the attempt: an answer that another thread keeps meanwhile puts the server in again.
            del self._late[server]
            if server.try_again():
                self._late[server] = None

    def wake(self) -> None:
        """Make `wait` return, now or the next time it is called. From any thread."""
        self.arrivals.wake()

    def _have_tried(self, server: RawServiceServer) -> None:
        """Have `wait` try a server's late answers again."""
        self._late[server] = None
        self.wake()

    def _create(self, kind: Kind, name: str, borrowed: BorrowedType, qos: Qos, node: str = "") -> Handle:
        with ExitStack() as failed, self._entities:
            failed.callback(borrowed.give_back)
            made = self._create_of(self._mirrored.get(node, self._node), kind, name, borrowed.interface, qos)
            handle = Handle(made, borrowed.give_back, self._entities)
            failed.pop_all()
        return handle

    def _create_of(self, node: OwnNode, kind: Kind, name: str, interface: type, qos: Qos) -> Entity:
        try:
            return node.create(kind, interface, name, qos)
        except ValueError as error:
            reset_error()  # rclpy leaves it set, and rcl then writes to the terminal
            noun = "service" if kind in {"service", "client"} else "topic"
            raise RosError(RosProblem.INVALID_NAME(name=name, kind=noun)) from error
        except RuntimeError as error:
            raise RosError(f"{name}: {reason_of(error)}") from error
        except TypeError as error:
            raise RosError(RosProblem.LACKS(distribution=described(), name=f"rclpy's {kind}")) from error

    def _ask_dds(self, question: Any, topic: str) -> Any:
        return self._ask(question, topic, mangled=True)

    def _ask(self, question: Question, *arguments: str, mangled: bool = False) -> Any:
        return ask(question, self._node.handle, *arguments, mangled)  # names as DDS has them, or as ROS

    def _others(self, infos: list[dict[str, Any]]) -> list[Endpoint]:
        return self._not_own(map(endpoint_of, infos))

    def _not_own(self, endpoints: Iterable[Endpoint]) -> list[Endpoint]:
        """Leave out our own endpoints; those of other bridges get their own nodes' names."""
        owned = map(self._bridges.owned, endpoints)
        return [each for each in owned if each.node != self._name]

    def _announcers(self) -> list[Endpoint]:
        return [endpoint_of(info) for info in self._ask(PUBLISHERS, ANNOUNCEMENT_TOPIC)]


def _be_prompt(topic: str) -> None:
    """Have Fast DDS give this process's writers on a topic, from now on, the profile that asks readers soon.

    Only the first `_MOST_PROMPT` topics of a process get it, as Fast DDS keeps profiles, and peers choose names.
    """
    if topic not in _prompt and len(_prompt) < _MOST_PROMPT:
        _prompt.add(topic)
        load_profiles(prompt_writer(profile_variable(os.environ)).replace("prompt_writer", topic).encode())


def _named(found: list[tuple[str, list[str]]]) -> dict[str, list[str]]:
    """Names that ROS can use, with their types."""
    return {
        name: [safe_type_name(each) for each in types]
        for name, types in found
        if len(name) <= TOPIC_LENGTH and is_topic_name(name)
    }
