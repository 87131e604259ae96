"""A session: the configuration of one bridge process.

In `rsb_bridge.config`, `decoding` makes it of plain data, `validation` finds its mistakes, and `session_file` reads and
writes its file.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Final, Literal

import msgspec

from rsb_bridge.feature import BRINGS_RIGHTS, MAY, SessionKey
from rsb_bridge.installed_features import added, added_by, guarded
from rsb_bridge.model.by_hand import VelocityLimits, end_text
from rsb_bridge.model.keep import Keep
from rsb_bridge.model.limits import APART
from rsb_bridge.model.patterns import is_pattern
from rsb_bridge.model.qos import Qos, parse_qos
from rsb_bridge.model.text import one_line
from rsb_bridge.model.transport_traits import Compression, is_mac
from rsb_bridge.model.transports import ProfileName, Protocol, of_link
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Mapping

Priority = Literal["low", "normal", "high"]

RANKS: Final[dict[Priority, int]] = {"low": -1, "normal": 0, "high": 1}
"""As a proposal has them, the higher one first, as with DDS's transport priority."""
LOWEST, HIGHEST = -100, 100  # ranks that a newer peer may use; each counts as the word that is nearest
_WEIGHTS: Final[dict[Priority, int]] = {"low": 1, "normal": 4, "high": 16}
"""Not measured by themselves; with them, a high topic on a tunnel of 5 kB/s gets 82 % through, and 72 % without
(bench/README, thin links)."""


def priority_of(rank: int) -> Priority:
    """Return the word for a rank."""
    return "low" if rank < 0 else "high" if rank > 0 else "normal"


def rank_of(topic: Topic) -> int:
    """Return the rank of a topic's share of a full link: what moves robots goes ahead of all."""
    return HIGHEST if topic.arm else RANKS[topic.priority]


def weight_of(rank: int) -> int:
    """Return the weight of a route's share of a full link, relative to the weights of the others."""
    return _WEIGHTS[priority_of(rank)]


DEADMAN = 60.0
"""s: the deadman time of a topic that names none.

A round figure: much less would disarm an operator who only watches, much more would leave a robot armed without one.
"""

CALL_TIMEOUT = 30.0
"""s: until a call is given up whose service names no timeout.

A round figure, longer than any link is silent before it is given up (15 s with the profile of LTE).
"""

Direction = Literal["transmit", "receive"]
Kind = Literal["topic", "service", "action", "parameters"]
Provider = Literal["client", "server"]
Identity = tuple[Kind, str, Direction]  # the key of a topic, unique in a session: kind, name on the client, direction
Role = Literal["client", "server"]
May = Literal["publish", "read", "look", "call", "serve"]
OperatorMay = Literal["look", "change", "take"]


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake in a session."""

    location: str  # the key in the file: ``topics[2].protocol``, or an empty string for the session as a whole
    message: str  # the mistake and its remedy
    line: int | None = None  # of the session file, from 1, or None if there is no file
    place: str = ""  # the location for a person: ``topic /scan, protocol``, or an empty string if it is `location`

    def __str__(self) -> str:
        place = self.place or self.location
        return one_line(f"{place}: {self.message}" if place else self.message)  # it may quote keys of the file


def _write_out(entry: Topic | ArmedName) -> None:
    """Have `on_end` as one text, so that entries can be compared and hashed."""
    if isinstance(entry.on_end, dict):
        msgspec.structs.force_setattr(entry, "on_end", end_text(entry.on_end))


class Topic(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """One bridged topic, service, action or node's parameters, as the *client* sees it (thesis, chapter 3).

    A session file lists services, actions and parameters under keys of their own, and an entry's keys in the order of
    these fields. If the name is a pattern (`rsb_bridge.model.patterns`), the entry is a template for each matching name
    of the sending side.
    """

    topic: str  # its name on the client, absolute (``/scan``); of parameters, their node's
    direction: Direction
    """``transmit`` goes from client to server, ``receive`` the other way; of what is not a topic, the direction of the
    requests."""
    type: str = "auto"
    """``pkg/msg/Name`` (``pkg/srv/Name``, ``pkg/action/Name``), a short thesis name (``LaserScan``), or ``auto``: from
    either side's graph."""
    protocol: Protocol | None = None  # the transport, or None for tcp on an IP link and bluetooth on an RFCOMM link
    port: int | None = None
    """A TCP or UDP port or an RFCOMM channel of its own (topics may share a channel), or None for the link's."""
    qos: str | int | dict[str, Any] = "auto"
    """``auto``, a profile's name, a depth, or a mapping of `rsb_bridge.model.qos.Qos` fields."""
    remote_topic: str | None = None
    """Its name on the server, or None for the same name, after the prefix if `use_name` is set."""
    compression: Compression | None = None  # or None for zstd on Bluetooth and no compression elsewhere
    max_rate: float | None = None  # Hz, or None for no limit
    expected_rate: float | None = None  # Hz, shown with the real rate, or None to learn it
    stale_after: float | None = None  # s without a message until a warning, 0 for no warning, or None for the session's
    late_after: float | None = None
    """s that a message may take until the topic is late, 0 for no limit, or None for the session's."""
    max_age: float | None = None
    """s; an older message or request is dropped instead of published, 0 for no limit, or None for
    `rsb_bridge.model.demands.ARMED` on what requires arming and no limit elsewhere."""
    paused: bool = False  # the topic is set up, and carries nothing until it is resumed
    arm: bool = False  # whether it carries nothing until an operator of either side arms it on a console
    deadman: float | None = None
    """s without a key on that console after which it disarms, 0 for never, or None for `DEADMAN`."""
    on_end: str | dict[str, Any] | None = None
    """The robot gets this when the arming ends: ``zero``, ``none`` or the fields of a message; None for zero of types
    that drive robots, and nothing of others."""
    limits: VelocityLimits | None = None
    """The most that a hand may ask of a robot, or None for any velocity; only of Twist and TwistStamped."""
    kind: Kind = "topic"
    timeout: float | None = None  # s that a call waits for its answer, or None for `CALL_TIMEOUT`; not for topics
    priority: Priority = "normal"  # on a full link, topics of a higher priority get a larger share; only for topics
    keep: float | Keep | None = None
    """All messages of so many s wait for a link that is away or carries too little, or None for what the QoS keeps."""
    lazy: bool | None = None
    """Whether the sending side subscribes only while somebody on the other side does, or None as the profile says."""
    renew: bool = False  # whether it subscribes anew whenever more subscribe on the other side
    express: bool = False  # whether its messages are taken and sent at once, and not together with other topics'
    beat: str | None = None
    """The name that topics share whose limits choose the same stamps, or None for none, and of a pattern its own."""
    excepts: tuple[str, ...] = ()
    """Names on the client that a pattern leaves out, patterns or not; ``except`` in a file."""
    features: dict[str, bool | float | str] = {}
    """Values of the features' keys, by name, without defaults (`feature.EntryKey.of`)."""

    def __post_init__(self) -> None:
        _write_out(self)
        if isinstance(self.keep, Keep) and self.keep.megabytes is None:  # one form, so that entries can be compared
            msgspec.structs.force_setattr(self, "keep", self.keep.seconds)

    def __hash__(self) -> int:
        return hash(self.identity)  # some values are mappings

    @property
    def is_pattern(self) -> bool:
        return is_pattern(self.topic)

    @property
    def identity(self) -> Identity:
        """The key of this topic, unique in a session."""
        return self.kind, self.topic, self.direction

    @property
    def provider(self) -> Provider:
        """The side whose node answers, of what is not a topic."""
        return "server" if self.direction == "transmit" else "client"

    @property
    def call_timeout(self) -> float:
        return CALL_TIMEOUT if self.timeout is None else self.timeout

    @property
    def deadman_seconds(self) -> float:
        """The deadman time (s), or 0 for none."""
        return DEADMAN if self.deadman is None else self.deadman

    @property
    def kept(self) -> Keep | None:
        """`keep`, in one form."""
        return Keep(self.keep) if isinstance(self.keep, int | float) else self.keep

    def parsed_qos(self) -> Qos | None:
        return parse_qos(self.qos)


class Grant(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A right of a link's other side to some topics, or to some services, of this side; in `deny`, a prohibition."""

    topics: str | None = None
    """A pattern (shell glob) of their names on this side; of a client, with or without its prefix."""
    services: str | None = None  # a pattern of the names of services and actions, and of nodes with parameters
    may: May | None = None
    """``publish`` topics here or ``read`` them here; ``call`` what nodes of this side provide, or ``serve``: provide
    what is offered to nodes of this side; or None for both."""
    protocol: Protocol | tuple[Protocol, ...] | None = None  # the transports that may carry them, or None for all
    max_rate: float | None = None
    """Hz, of each topic and direction, or of the calls of each service; None for no limit. Only in `allow`."""


class Client(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A client that a server accepts."""

    name: str  # as in the client's session
    key_file: str | None = None  # its key, or None for the server's `Session.key_file`
    next_key_file: str | None = None
    """The key that replaces it, and is valid, too, or None for none; if `key_file` is None, the default is
    `Session.next_key_file`."""
    use_name: bool | None = None
    """Whether its topics have a prefix on the server, or None for the server's `Session.use_name`."""
    allow: tuple[str | Grant, ...] = ()
    """Its rights, each entry a `Grant`, or a pattern of topics; if empty, it may bridge everything. If several entries
    match a topic, each of them narrows the rights to it."""
    deny: tuple[str | Grant, ...] = ()
    """Names that it may not bridge, each entry a `Grant`, or a pattern of topics and services alike; stronger than
    `allow`."""
    topics: tuple[Topic, ...] = ()  # the topics that the server proposes whenever it links, as the client sees them
    profile: ProfileName | None = None  # of its link, or None for the server's `Session.profile`
    group: str | None = None  # its group of the fleet, or None
    features: dict[str, Any] = {}  # values of the features' keys that are about a peer, as in `Session`

    def is_prefixed(self, session: Session) -> bool:
        """Whether its topics have its name before them on the server of a session."""
        return session.use_name if self.use_name is None else self.use_name


class Operator(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Somebody who may attach to this bridge over a network, with a key of their own."""

    name: str  # in events and logs
    key_file: str  # their key. No other operator and no link may have the same
    may: OperatorMay = "look"
    """``look`` only, or ``change`` what the bridge does, or also ``take`` an arming without asking its holder."""


class ArmedName(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, rename={"excepts": "except"}
):
    """A name that requires arming on this side, on every route. What has no text here is as in `Topic`."""

    name: str  # a name or a pattern on this side
    kind: Kind | None = None  # of what has the name, or None for every kind
    type: str | None = None  # of what has the name, or None for every type
    client: str | None = None
    """On a server, the client whose entry had it: that client's `topic` requires arming under any name."""
    topic: str | None = None  # the name on the client, or None for the same
    excepts: tuple[str, ...] = ()  # names on the client
    deadman: float | None = None
    max_age: float | None = None
    on_end: str | dict[str, Any] | None = None
    limits: VelocityLimits | None = None

    def __post_init__(self) -> None:
        _write_out(self)

    @property
    def deadman_seconds(self) -> float:
        """The deadman time (s), or 0 for none."""
        return DEADMAN if self.deadman is None else self.deadman


class Session(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """The session of one bridge process."""

    name: str  # must match on both sides; the prefix (``/scan`` -> ``/robot1/scan``) when `use_name` is set
    role: Role  # a client connects, a server binds
    server_ip: str | tuple[str, ...]
    """IPv4 or IPv6 address, host name, or Bluetooth MAC, which makes the link RFCOMM. A server binds it. Or a word for
    a transport of a feature. On a client also several addresses over one transport, the preferred one first: a later
    one is for when the ones before do not carry."""
    server_port: int = 0  # TCP and UDP port, or RFCOMM channel, or 0 over what has none
    bluetooth_address: str | None = None
    """MAC of the server's adapter, for single topics over Bluetooth on an IP link. Each names a channel as its port;
    topics with the same channel share it."""
    domain_id: int | None = None  # ROS domain, or None for ``$ROS_DOMAIN_ID``, or 0 without that
    use_name: bool = False  # the client's topics have its name before them on the server, in both directions
    use_encryption: bool = True  # False sends everything in the clear
    key_file: str | None = None  # path, relative to the session file
    next_key_file: str | None = None  # on a server, the key that replaces it. Both are valid as long as it is given
    stale_after: float = 15.0  # s without a message until a topic is stale (thesis: 15), or 0 for never
    late_after: float = 1.0  # s that messages may take until their topic is late, or 0 for no limit
    stale_warnings: int = 5  # how many times to warn of it (thesis: 5)
    outlive: float | None = None
    """s that topics and calls wait for a link whose connection is lost, unless the peer says less; 0 if they do not, or
    None for the profile's."""
    pace: float = APART  # s that messages may wait for others to be sent together, while there are many; 0 if none does
    multipath: bool = False  # streams over TCP may use several ways of this machine, where both kernels can
    check_messages: bool = True  # whether what peers send is checked against its type before ROS gets it
    shutdown_topic: str | None = "/shutdown"
    """The text "shutdown" (``std_msgs/String``) on it closes the sockets on both sides; or None."""
    features: dict[str, Any] = {}  # msgspec gives each session its own
    """Values of the features' keys, by name, without defaults (`feature.SessionKey.of`)."""
    topics: tuple[Topic, ...] = ()
    armed: tuple[str | ArmedName, ...] = ()
    """Names and patterns on this side that require arming, with or without an entry. In a running bridge it is the only
    list of them: each entry with `arm` adds its line (`rsb_bridge.model.demands.RunningDemands`)."""
    clients: tuple[Client, ...] | None = None
    """The clients of a server; empty if it has none yet, or None for one with the session's own name and key."""
    allow: tuple[str | Grant, ...] = ()
    """On a client, the server's rights to bridge, as in `Client`. If empty, the server may read all topics, and
    publish, call and serve the entries of `topics`."""
    deny: tuple[str | Grant, ...] = ()  # on a client, names that the server may not bridge; stronger than `allow`
    ports: tuple[int, ...] | Literal["none"] | None = None
    """TCP and UDP ports that clients' topics may have on the server, or None for any 16 for each client."""
    shared_keys: bool = False
    """Clients are meant to have the same key, though each may then take the other's name and rights."""
    profile: ProfileName | None = None
    """The kind of the link's network, for settings that nothing else sets (`transports.PROFILES`)."""
    operators: tuple[Operator, ...] = ()  # the operators who may attach over a network
    group: str | None = None  # the fleet's group of its robot, or None

    @property
    def own_topics(self) -> tuple[str | None, ...]:
        """The topics of the bridge alone, or None for one that the session does without; patterns leave them out."""
        own = (key for key in session_keys().values() if key.own_topic and not key.shared_topic)
        return self.shutdown_topic, *(key.of(self) for key in own)

    @property
    def hosts(self) -> tuple[str, ...]:
        """All addresses of the server, the preferred one first."""
        return (self.server_ip,) if isinstance(self.server_ip, str) else self.server_ip or ("",)

    @property
    def host(self) -> str:
        """The preferred address of the server."""
        return self.hosts[0]

    @property
    def is_bluetooth(self) -> bool:
        """Whether the link is RFCOMM."""
        return is_mac(self.host)

    @property
    def crossing(self) -> tuple[Protocol, ...]:
        """The transports that topics may choose, the link's own first."""
        link = of_link(self.host)
        radio = self.bluetooth_address is not None and link.ip_ports
        return (link.name, *link.companions, *(("bluetooth",) if radio else ()))

    @property
    def accepted_clients(self) -> tuple[Client, ...]:
        """The clients of a server."""
        if self.clients is not None:
            return self.clients
        of_peer = {name: value for name, value in self.features.items() if name in peer_keys()}
        return (Client(self.name, group=self.group, features=of_peer),)

    def with_clients(self, clients: tuple[Client, ...]) -> Session:
        """Return a server's session with a list of clients, whose entries take over the only client's values."""
        features = {name: value for name, value in self.features.items() if name not in peer_keys()}
        return msgspec.structs.replace(self, clients=clients, features=features)

    @property
    def listed_clients(self) -> tuple[Client, ...]:
        """The clients that the session names."""
        return self.clients or ()

    def entry(self, link: str, identity: Identity) -> Topic | None:
        """Return the entry of a link by its identity, or None if this side does not list it."""
        of_clients = (each.topics for each in self.accepted_clients if each.name == link)
        topics = self.topics if self.role == "client" else next(of_clients, ())
        return next((each for each in topics if each.identity == identity), None)

    @property
    def adapter(self) -> str | None:
        """MAC of the server's Bluetooth adapter, or None if the session does not use one."""
        return self.host if self.is_bluetooth else self.bluetooth_address


class AbsentFeature(Wording):
    KEY = "this installation has no {feature}: install all of rsb-console, or leave the key out"


@cache
def session_keys() -> Mapping[str, SessionKey[Any]]:
    """Return the features' keys of session files, by name."""
    lists = ("services", "actions", "parameters")  # in its file, where `topics` holds all
    taken = (*Session.__struct_fields__, *Client.__struct_fields__, *lists, MAY)
    found = (*added("session_keys", name_of=lambda key: key.name, taken=taken), _may())
    return {key.name: key for key in found}


def _may() -> SessionKey[Any]:
    """Return the key of all rights that features bring."""
    fields: list[tuple[str, Any, Any]] = []
    for feature, right in added_by("rights", name_of=lambda right: right.name, taken=("hints",)):
        field = right.name, right.type, right.default
        with guarded(feature, "rights"):
            msgspec.convert({}, msgspec.defstruct("May", [field], frozen=True))  # its name, default or type may be none
            fields.append(field)
    known = {name for name, _, _ in fields}
    absent = {name: AbsentFeature.KEY(feature=of) for name, of in BRINGS_RIGHTS.items() if name not in known}
    given = msgspec.defstruct(
        "May", fields,
        frozen=True, forbid_unknown_fields=True, omit_defaults=True, namespace={"hints": absent},
    )  # fmt: skip
    return SessionKey(MAY, given, given(), live=True, of_peer=True)


@cache
def peer_keys() -> Mapping[str, SessionKey[Any]]:
    """Return the keys about the other side of a link."""
    return {name: key for name, key in session_keys().items() if key.of_peer}
