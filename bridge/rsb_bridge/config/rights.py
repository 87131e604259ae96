"""Rights of the other side of a link: the entries of a session, and what they permit."""

from __future__ import annotations

import fnmatch
import re
from dataclasses import dataclass, field, replace
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import msgspec

from rsb_bridge.config.decoding import join, read, show
from rsb_bridge.config.file_form import LISTS
from rsb_bridge.config.topic_rules import range_problems, service_names
from rsb_bridge.config.yaml_text import SessionError, inline, read_yaml
from rsb_bridge.model import transports
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.limits import NO_PORT, PORTS_PER_CLIENT
from rsb_bridge.model.names import client_topic
from rsb_bridge.model.patterns import Pattern, is_pattern
from rsb_bridge.model.session import Grant, May, Problem
from rsb_bridge.model.text import join_first
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence, Set

    from rsb_bridge.model.session import Client, Direction, Identity, Kind, Session

TOPIC_USES: Final[tuple[May, May]] = ("publish", "read")
CALL_USES: Final[tuple[May, May]] = ("call", "serve")
"""The two rights of a peer: to send messages or requests here, and to take them."""
_TOPIC_ENTRIES: Final[tuple[May, ...]] = (*TOPIC_USES, "look")  # the right to read includes the right to look
_ENTRY = re.compile(r"\{[^{}]*\}?|[^\s,{]+")
"""A mapping, or a word: entries have blanks or commas between them. Without its last brace, YAML refuses it."""
_NAMED = 6
_LISTED_AS: dict[May, tuple[Direction, str]] = {
    "publish": ("receive", "direction: receive"),
    "call": ("receive", "provider: client"),
    "serve": ("transmit", "provider: server"),
}
"""The direction of a client's entry for each right of the server, and its text in a session file."""
_OF_PARAMETERS = {lane.suffix for lane in LANES["parameters"] if lane.suffix}
MOVES_A_ROBOT = {
    "/cmd_vel": ("/cmd_vel",),
    "/joint_*": ("/joint_states", "/joint_trajectory", "/joint_command"),
    "/tf": ("/tf",),
    "/clock": ("/clock",),
}
"""Patterns of topics by which a robot moves, or believes that it moves, each with examples of names."""
ONLY_READ = frozenset(
    {"describe_parameters", "get_parameter_types", "get_parameters", "list_parameters"}  # rcl_interfaces
    | {"get_available_states", "get_available_transitions", "get_state", "get_transition_graph"}  # lifecycle_msgs
    | {"get_logger_levels", "get_type_description"}
)
"""The last parts of the names of ROS's own services that change nothing.

Neither name nor type tells the effect of any other service: ``std_srvs/srv/Trigger`` may dock a robot. So all others
count as changing it, as do all actions and all nodes' parameters, because these can be set.
"""
EVERY_CALL = "any service, action and parameter"  # entry of `Listing.acts`, if nothing limits the peer's calls
_KINDS: dict[Kind, str] = {"action": " (action)", "parameters": " (parameters)"}


class RightsMistake(Wording):
    """A mistake in an entry of `allow` or `deny`."""

    NO_PROTOCOLS = "the list is empty: leave protocol out, or name one"
    RATE_OF_DENIED = "belongs under allow: what is denied has no rate"
    NO_PATTERN = "missing: give a pattern as topics, or as services"
    BOTH = "topics and services are in one entry: make an entry for each"
    UNRELIABLE = "{protocol} carries no calls: leave it out"
    OTHER_USE = "{may} is for {others}: a {noun} takes {uses}, or leave may out for all"
    NO_MATCH = "{pattern} matches no {noun}: a pattern begins with / or * (/robot1/*)"
    SLASHES = "{pattern} matches no {noun}: names have one / before each part, and none at the end"


class Place(Wording):
    """The part of a session file that has a peer's `allow` and `deny`."""

    ON_SERVER = "of client {client} in the session file of {server}"
    ON_CLIENT = "in the session file of {client}"


class DeniedText(Wording):
    """The reason why a peer may not use a topic or a service."""

    DENIED = "{owner} denies {use} to {peer}"
    OTHER_PROTOCOL = "{owner} allows {use} to {peer} over {protocols} only"
    NOT_ALLOWED = "{owner} does not let {peer} {may} {use}"


class DeniedRemedy(Wording):
    """The change of a session file that would allow it."""

    CHANGE_DENY = "change {entry} in deny {place}"
    CHANGE_ALLOW = "change {entry} in allow {place}"
    ADD_LOOK = "add {{topics: PATTERN, may: look}} to allow {place}"
    NARROW_DENY = "narrow {entry} in deny {place}, which includes look"
    ADD_ALLOW = "add {entry} to allow {place}"
    LIST = "list it under {list} {place}, with {direction}"
    LIST_OR_ALLOW = "list it under {list} {place}, with {direction}, or add {entry} to allow there"


class GrantError(ValueError):
    """An operator's text is no entry of `allow` or `deny`."""


def protocols_of(grant: Grant) -> tuple[str, ...]:
    """Return the transports that an entry permits, or none if it permits all."""
    return grant.protocol if isinstance(grant.protocol, tuple) else (grant.protocol,) if grant.protocol else ()


def typed_grants(text: str) -> tuple[str | Grant, ...]:
    """Return the entries in a line: ``/camera/*, {topics: /cmd_vel, may: publish, max_rate: 10}``.

    Raises:
        GrantError: one of them is none.
    """
    entries: list[str | Grant] = []
    for entry in _ENTRY.findall(text):
        if not entry.startswith("{"):
            entries.append(entry)
            continue
        problems: list[Problem] = []
        try:
            entries.append(read(read_yaml(entry, Path()).data, Grant, problems))
        except SessionError as error:
            raise GrantError(f"{show(entry)}: {error.problems[0].message}") from None
        if problems:
            raise GrantError("; ".join(map(str, problems)))
    return tuple(entries)


def allowing(entry: str | Grant) -> Grant:
    """Return an entry of `allow`; a pattern alone is about topics, so that nobody allows services unawares."""
    return Grant(entry) if isinstance(entry, str) else entry


def denying(entry: str | Grant) -> Grant:
    """Return an entry of `deny`; a pattern alone is about topics, services, actions and parameters."""
    return Grant(entry, entry) if isinstance(entry, str) else entry


def grant_problems(holder: Client | Session, location: str) -> Iterator[Problem]:
    for key, entries in (("allow", holder.allow), ("deny", holder.deny)):
        for at, grant in enumerate(entries):
            here = join(join(location, key), at)
            if isinstance(grant, str):
                yield from _pattern_problems(grant, "topic", here)
                continue
            yield from _subject_problems(grant, here)
            if grant.protocol == ():
                yield Problem(join(here, "protocol"), RightsMistake.NO_PROTOCOLS())
            if key == "deny" and grant.max_rate is not None:
                yield Problem(join(here, "max_rate"), RightsMistake.RATE_OF_DENIED())
            yield from range_problems(grant, here)


def _subject_problems(grant: Grant, here: str) -> Iterator[Problem]:
    """Mistakes in what an entry is about, and in what may be done with that."""
    if grant.topics is None and grant.services is None:
        yield Problem(join(here, "topics"), RightsMistake.NO_PATTERN())
        return
    if grant.topics is not None and grant.services is not None:
        yield Problem(join(here, "services"), RightsMistake.BOTH())
        return
    if grant.topics is not None:
        noun, uses, others = "topic", _TOPIC_ENTRIES, "services"
        yield from _pattern_problems(grant.topics, noun, join(here, "topics"))
    else:
        noun, uses, others = "service", tuple(CALL_USES), "topics"
        yield from _pattern_problems(grant.services or "", noun, join(here, "services"))
        for protocol in protocols_of(grant):
            if not transports.named(protocol).reliable:
                yield Problem(join(here, "protocol"), RightsMistake.UNRELIABLE(protocol=protocol))
    if grant.may is not None and grant.may not in uses:
        message = RightsMistake.OTHER_USE(may=grant.may, others=others, noun=noun, uses=" or ".join(uses))
        yield Problem(join(here, "may"), message)


def _pattern_problems(pattern: str, noun: str, location: str) -> Iterator[Problem]:
    if not (pattern.startswith(("/", "*")) and pattern.isprintable()):
        yield Problem(location, RightsMistake.NO_MATCH(pattern=show(pattern), noun=noun))
    elif pattern.endswith("/") or "//" in pattern:
        yield Problem(location, RightsMistake.SLASHES(pattern=show(pattern), noun=noun))


class Use(NamedTuple):
    """A peer's use of a topic, a service, an action or a node's parameters by its name on this side."""

    topic: str
    may: May  # ``publish`` or ``read`` a topic here; ``call`` a service of this side's nodes, or ``serve`` one to them
    protocol: str = ""  # the transport, or an empty string if it is not known yet
    kind: Kind = "topic"

    def __str__(self) -> str:
        nouns = {"topic": "", "parameters": "the parameters of "}
        return f"{nouns.get(self.kind, f'{self.kind} ')}{self.topic}"


def uses(kind: Kind) -> tuple[May, May]:
    """Return the two rights for a kind: to send messages or requests here, and to take them."""
    return TOPIC_USES if kind == "topic" else CALL_USES


class DeniedUse(NamedTuple):
    """The reason, for the peer, and the change of a session file that would allow the use."""

    reason: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.reason}: {self.remedy}"


@dataclass(frozen=True, slots=True)
class Rights:
    """The rights of one peer on this side."""

    peer: str  # the client's name; on a client ``the server``
    owner: str  # the side with the session file: ``the server``, or the client's name
    place: str
    """The part of the session file that has `allow` and `deny`: ``of client robot1 in the session file of pc``."""
    allow: tuple[Grant, ...]  # the uses that it permits. If empty, it permits all; on a client, `listed`
    deny: tuple[Grant, ...]  # the uses that it forbids. It is stronger than `allow`
    prefix: str = ""  # a client's name, which the names of its topics may have before them here
    listed: Set[Identity] | None = None
    """On a client, the identities of its own topics (`Topic.identity`), which say what the server may publish, call and
    serve."""
    features: Mapping[str, Any] = field(default_factory=dict)
    """The rights that features give the peer, by key of session files (`SessionKey.of`)."""

    def refusal(self, use: Use) -> DeniedUse | None:
        """Return the reason why the peer may not do something, or None if it may."""
        # While the transport is not known, an entry about some of them denies nothing yet.
        for grant in self._about(self.deny, use, also=_meant_by(use)):
            if not grant.protocol or use.protocol in protocols_of(grant):
                return DeniedUse(
                    DeniedText.DENIED(owner=self.owner, use=use, peer=self.peer),
                    DeniedRemedy.CHANGE_DENY(place=self.place, entry=_text(grant)),
                )
        allowing = self._about(self.allow, use)
        for grant in allowing:
            if grant.protocol and use.protocol and use.protocol not in protocols_of(grant):
                only = join_first(protocols_of(grant), _NAMED)
                reason = DeniedText.OTHER_PROTOCOL(owner=self.owner, use=use, peer=self.peer, protocols=only)
                return DeniedUse(reason, DeniedRemedy.CHANGE_ALLOW(place=self.place, entry=_text(grant)))
        if self.listed is None or use.may not in _LISTED_AS:
            if allowing or not self.allow:
                return None
            remedy, listed_as = DeniedRemedy.ADD_ALLOW, ""
        else:  # the entries of a client say what the server may publish, call and serve
            direction, listed_as = _LISTED_AS[use.may]
            if allowing or (use.kind, use.topic, direction) in self.listed:
                return None
            remedy = DeniedRemedy.LIST_OR_ALLOW if self.allow else DeniedRemedy.LIST
        entry = f"{{{'topics' if use.kind == 'topic' else 'services'}: {use.topic}, may: {use.may}}}"
        return DeniedUse(
            DeniedText.NOT_ALLOWED(owner=self.owner, peer=self.peer, may=use.may, use=use),
            remedy(list=LISTS[use.kind], place=self.place, direction=listed_as, entry=entry),
        )

    def no_look(self) -> DeniedUse | None:
        """Return the reason why the peer may look at no topic at all, or None. Each topic is checked when it looks."""
        reason = f"{self.owner} does not let {self.peer} look at any topic"
        for grant in self.deny:
            # Only what every name matches: /*/* leaves /scan.
            is_any = grant.topics is not None and not grant.topics.removeprefix("/").strip("*")
            if is_any and _covers(grant, "look") and not grant.protocol:
                return DeniedUse(reason, DeniedRemedy.NARROW_DENY(entry=_text(grant), place=self.place))
        if self.allow and not any(grant.topics and _covers(grant, "look") for grant in self.allow):
            return DeniedUse(reason, DeniedRemedy.ADD_LOOK(place=self.place))
        return None

    def max_rate(self, use: Use) -> float:
        """Return the limit of messages or calls in Hz, or 0 for none. Requests of either side share it."""
        return min((grant.max_rate for grant in self._about(self.allow, use) if grant.max_rate), default=0.0)

    def shows(self, topic: str, kind: Kind = "topic") -> bool:
        """Whether the peer may know of a name: it has at least one right to use it."""
        return any(self.refusal(Use(topic, may, kind=kind)) is None for may in uses(kind))

    def _about(self, grants: Sequence[Grant], use: Use, also: Sequence[str] = ()) -> list[Grant]:
        """Return the entries that apply to a use, by its name or by other names."""
        if not grants:
            return []
        own = (use.topic, *also)
        names = {*own, *(client_topic(name, self.prefix) or name for name in own if self.prefix)}
        return [
            grant
            for grant in grants
            if _covers(grant, use.may)
            and (pattern := grant.topics if use.kind == "topic" else grant.services) is not None
            and any(fnmatch.fnmatchcase(name, pattern) for name in names)
        ]


def _covers(grant: Grant, may: May) -> bool:
    """Whether an entry is about a right: an entry about reading is about looking, too."""
    return grant.may in (None, may) or (may == "look" and grant.may == "read")


def rights_of_client(client: Client, server: str) -> Rights:
    return Rights(
        client.name,
        "the server",
        Place.ON_SERVER(client=client.name, server=server),
        tuple(map(allowing, client.allow)),
        tuple(map(denying, client.deny)),
        prefix=client.name,
        features=client.features,
    )


def rights_of_server(session: Session, listed: Set[Identity] | None = None) -> Rights:
    """Return the rights of the server on a client.

    Args:
        listed: the identities of the client's topics at present, or None for the topics in its session.
    """
    if listed is None:
        listed = {topic.identity for topic in session.topics}
    return Rights(
        "the server",
        session.name,
        Place.ON_CLIENT(client=session.name),
        tuple(map(allowing, session.allow)),
        tuple(map(denying, session.deny)),
        listed=listed,
        features=session.features,
    )


def as_if_listed(rights: Rights) -> Rights:
    """Return the rights as if this side's session listed every topic."""
    return rights if rights.listed is None else replace(rights, listed=_Everything())


class _Everything(frozenset["Identity"]):
    def __contains__(self, _: object) -> bool:
        return True


def _meant_by(use: Use) -> list[str]:
    """Return the other names under which an entry of `deny` forbids a use.

    An entry that denies one service of an action or of a node's parameters denies all of them, because they are bridged
    together. An entry that denies a node's parameters denies each service of them.
    """
    if use.kind == "service":
        node, _, last = use.topic.rpartition("/")
        return [node] if f"/{last}" in _OF_PARAMETERS else []
    return [] if use.kind == "topic" else service_names(use.kind, use.topic)


def _text(grant: Grant) -> str:
    """Return an entry as it is in a session file."""
    plain = msgspec.to_builtins(grant)
    if grant.topics == grant.services or plain.keys() == {"topics"}:  # both: `denying` makes them of a pattern
        return grant.topics or ""
    return inline(plain)


# --- what the rights come to, for operators


class RightsRow(NamedTuple):
    """The rights of one peer to some topics or services."""

    peer: str  # the client's name; on a client ``the server``
    may: str  # ``publish``, ``read`` or both; of services, actions and parameters ``call``, ``serve`` or both
    topics: str  # patterns of names in this side's domain
    transports: str
    rate: str  # the limit of messages or calls
    ports: str  # the ports that they may have here, or an empty string if this side binds none


class Listing(NamedTuple):
    """All rights of one peer on this side."""

    peer: str  # as in `RightsRow`
    rows: tuple[RightsRow, ...]
    moves: tuple[str, ...]  # the patterns of `MOVES_A_ROBOT` that it may publish
    acts: tuple[str, ...]  # the names that it may call, except for `ONLY_READ`


def listings(session: Session) -> Iterator[Listing]:
    """Yield the rights of each peer of a session on this side."""
    carried = session.crossing
    if session.role == "client":
        yield _listing(rights_of_server(session), carried, "all", "")
        return
    if transports.of_link(session.server_ip).topic_ports is NO_PORT or session.ports == "none":
        ports = "none"
    elif session.ports is None:
        ports = f"any {PORTS_PER_CLIENT}"
    else:
        ports = join_first([str(port) for port in session.ports], _NAMED) or "none"
    for client in session.accepted_clients:
        prefixed = client.is_prefixed(session)
        within = f"/{client.name}/*" if prefixed else "all"
        listing = _listing(rights_of_client(client, session.name), carried, within, ports)
        # Behind its prefix, it reaches no name by which the server's own nodes move or act.
        yield listing._replace(moves=(), acts=()) if prefixed else listing


def _listing(rights: Rights, carried: Sequence[str], within: str, ports: str) -> Listing:
    """Return the rights of a peer.

    Args:
        carried: the transports of the link.
        within: the names that it may have at all.
        ports: as in `RightsRow`.
    """
    reliable = [name for name in carried if transports.named(name).reliable]
    rows: list[RightsRow] = []
    for (one, other), over in ((TOPIC_USES, carried), (CALL_USES, reliable)):
        found: dict[str, list[tuple[str, str, str]]] = {
            may: list(_allowed(rights, may, over, within)) for may in (one, other)
        }
        if found[one] == found[other]:
            found = {f"{one}, {other}": found[one]}
        # Else looking follows reading, and a row of its own would repeat that.
        if one in TOPIC_USES and any(grant.may == "look" for grant in (*rights.allow, *rights.deny)):
            found["look"] = list(_allowed(rights, "look", over, within))
        rows += [RightsRow(rights.peer, may, *columns, ports) for may, each in found.items() for columns in each]
    return Listing(rights.peer, tuple(rows), tuple(_moves(rights, carried)), tuple(_acts(rights, reliable)))


def _allowed(rights: Rights, may: May, carried: Sequence[str], within: str) -> Iterator[tuple[str, str, str]]:
    """Yield names, transports and rates for one right."""
    groups: dict[tuple[str, str], list[str]] = {}
    anything = (", ".join(carried), "any")
    if rights.listed is not None and may in _LISTED_AS:
        names = [
            f"{name}{_KINDS.get(kind, '')}"
            for kind, name, direction in rights.listed
            if (kind == "topic") == (may in TOPIC_USES) and direction == _LISTED_AS[may][0]
        ]
        if names:
            groups[anything] = sorted(names)
    elif not rights.allow:
        groups[anything] = [within]
    for grant, pattern in _about(rights.allow, may):
        over = ", ".join(protocols_of(grant)) or anything[0]
        rate = f"{grant.max_rate:g} Hz" if grant.max_rate else "any"
        groups.setdefault((over, rate), []).append(pattern)
    denied = [
        f"{pattern} over {join_first(protocols_of(grant), _NAMED)}" if grant.protocol else pattern
        for grant, pattern in _about(rights.deny, may)
    ]
    but = f", not {join_first(denied, _NAMED)}" if denied else ""
    limited = f" in {within}" if rights.allow and within != "all" else ""
    for (over, rate), patterns in groups.items():
        yield f"{join_first(patterns, _NAMED)}{limited}{but}", over, rate
    if not groups:
        yield "nothing", "-", "-"


def _about(grants: Sequence[Grant], may: May) -> Iterator[tuple[Grant, str]]:
    """Yield the entries that apply to a right, each with its pattern."""
    for grant in grants:
        pattern = grant.topics if may in _TOPIC_ENTRIES else grant.services
        if pattern is not None and _covers(grant, may):
            yield grant, pattern


def _moves(rights: Rights, carried: Sequence[str]) -> Iterator[str]:
    received = (name for _, name, direction in rights.listed or () if direction == _LISTED_AS["publish"][0])
    followed = [Pattern(name) for name in received if is_pattern(name)]
    for pattern, names in MOVES_A_ROBOT.items():
        listed = [topic for _, topic, _ in rights.listed or () if fnmatch.fnmatchcase(topic, pattern)]
        by_pattern = any(each.match(name) is not None for each in followed for name in names)
        if by_pattern or any(_may(rights, Use(name, "publish"), carried) for name in (*names, *listed)):
            yield pattern


def _acts(rights: Rights, carried: Sequence[str]) -> Iterator[str]:
    """Yield the names and patterns of calls that may change something and that a peer may make."""
    if rights.listed is None and not rights.allow and _may(rights, Use("/any", "call", kind="service"), carried):
        yield EVERY_CALL
    for kind, name, direction in sorted(rights.listed or (), key=itemgetter(1)):
        called_here = kind != "topic" and direction == _LISTED_AS["call"][0]
        if called_here and _changes(kind, name) and _may(rights, Use(name, "call", kind=kind), carried):
            yield f"{name}{_KINDS.get(kind, '')}"
    denied = [pattern for grant, pattern in _about(rights.deny, "call") if not grant.protocol]
    for _, pattern in _about(rights.allow, "call"):
        if _changes("service", pattern) and not any(fnmatch.fnmatchcase(pattern, each) for each in denied):
            yield pattern


def _changes(kind: Kind, name: str) -> bool:
    return kind != "service" or name.rpartition("/")[2] not in ONLY_READ


def _may(rights: Rights, use: Use, carried: Sequence[str]) -> bool:
    return any(rights.refusal(use._replace(protocol=protocol)) is None for protocol in carried)
