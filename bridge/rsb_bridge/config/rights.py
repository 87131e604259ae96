"""Rights of the other side of a link, and of operators: the entries of a session, and what they permit."""

from __future__ import annotations

import fnmatch
import re
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import msgspec

from rsb_bridge.config.decoding import join, read, show
from rsb_bridge.config.file_form import LISTS
from rsb_bridge.config.keys import KeyFileError, fingerprint, key_path, read_key
from rsb_bridge.config.topic_rules import rate_problems, service_names
from rsb_bridge.config.yaml_text import SessionError, inline, read_yaml
from rsb_bridge.model import transports
from rsb_bridge.model.benchmark import is_bench_topic
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.limits import NAME_BYTES, OPERATORS, PORTS_PER_CLIENT
from rsb_bridge.model.names import client_topic
from rsb_bridge.model.patterns import Pattern, is_pattern
from rsb_bridge.model.session import Grant, May, Problem
from rsb_bridge.model.text import is_clean, join_first
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Collection, Hashable, Iterator, Mapping, Sequence, Set

    from rsb_bridge.config.keys import Key
    from rsb_bridge.model.benchmark import Leave
    from rsb_bridge.model.session import Client, Direction, Identity, Kind, Operator, Session

TOPIC_USES: Final[tuple[May, May]] = ("publish", "read")
CALL_USES: Final[tuple[May, May]] = ("call", "serve")
"""What a peer may do here that sends messages or requests, and that takes them."""
_MOST_LEAVE = 1e6
_ENTRY = re.compile(r"\{[^{}]*\}?|[^\s,{]+")
"""A mapping, or a word: entries have blanks or commas between them."""
_NAMED = 6
_LISTED_AS: dict[May, tuple[Direction, str]] = {
    "publish": ("receive", "direction: receive"),
    "call": ("receive", "provider: client"),
    "serve": ("transmit", "provider: server"),
}
"""How a client lists what it has the server do."""
_OF_PARAMETERS = {lane.suffix for lane in LANES["parameters"] if lane.suffix}
MOVES_A_ROBOT = {
    "/cmd_vel": ("/cmd_vel",),
    "/joint_*": ("/joint_states", "/joint_trajectory", "/joint_command"),
    "/tf": ("/tf",),
    "/clock": ("/clock",),
}
"""Patterns of topics by which a robot moves, or thinks that it does, each with names that it stands for."""
ONLY_READ = frozenset(
    {"describe_parameters", "get_parameter_types", "get_parameters", "list_parameters"}  # rcl_interfaces
    | {"get_available_states", "get_available_transitions", "get_state", "get_transition_graph"}  # lifecycle_msgs
    | {"get_logger_levels", "get_type_description"}
)
"""The last parts of the names of ROS's own services that change nothing.

What any other service does cannot be told from its name or its type: ``std_srvs/srv/Trigger`` may dock a robot. So all
others count as changing it, and every action and every node's parameters, which can be set, do.
"""
_NOTHING = "nothing"
EVERY_CALL = "any service, action and parameter"
"""Entry of `Listing.acts`, if nothing limits the peer's calls."""
_KINDS: dict[Kind, str] = {"action": " (action)", "parameters": " (parameters)"}


class RightsMistake(Wording):
    """A mistake in an entry of `allow` or `deny`, or in the limits of a benchmark."""

    TYPED = "{entry}: {problem}"
    NO_PROTOCOLS = "the list is empty: leave protocol out, or name one"
    RATE_OF_DENIED = "belongs under allow: what is denied has no rate"
    NO_PATTERN = "missing: give a pattern as topics, or as services"
    BOTH = "has topics beside it: make an entry of each"
    UNRELIABLE = "{protocol} carries no calls: leave it out"
    OTHER_USE = "{may} is for {others}: a {noun} takes {uses}, or leave may out for both"
    NO_MATCH = "{pattern} matches no {noun}: a pattern begins with / or * (/robot1/*)"
    SLASHES = "{pattern} matches no {noun}: names have one / before each part, and none at the end"
    LIMIT = "{value} is out of range: above 0, at most {limit}"


class OperatorMistake(Wording):
    """A mistake in a session's operators."""

    TOO_MANY = "{count} are too many: at most {limit}"
    TWICE = "{name} is the name of operator number {number} already"
    KEY_FILE_INVALID = "{file} is not a file name: give the file of the operator's key"
    NAME_UNPRINTABLE = "{name} is not a name: give printable characters"
    NAME_TOO_LONG = "has {length} bytes in UTF-8; at most {limit}"
    SHARED_KEY = (
        "operator {name} has the key of {other}, and whoever has it could take either's place: make a key of its own "
        "with `rsb-console keygen`"
    )


class OperatorChange(Wording):
    """The effect of a changed session on its operators."""

    REMOVED = "operator {name}: removed, and detached"
    ADDED = "operator {name}: added, {right}"
    CHANGED = "operator {name}: {before} → {after}; detached, and attaches again"


class DeniedText(Wording):
    """The reason why a peer may not use a topic or a service."""

    DENIED = "{owner} denies {use} to {peer}"
    OTHER_PROTOCOL = "{owner} allows {use} to {peer} over {protocols} only"
    NOT_ALLOWED = "{owner} does not let {peer} {may} {use}"
    NO_BENCHMARK = "{owner} does not let {peer} measure this link"


class DeniedRemedy(Wording):
    """The change of a session file that would allow it."""

    CHANGE_DENY = "deny {place} has {entry}"
    CHANGE_ALLOW = "allow {place} has {entry}"
    ADD_BENCH = "add bench: {{}} {place}"
    ADD_ALLOW = "add {entry} to allow {place}"
    LIST = "list it under {list} {place}, with {direction}"
    LIST_OR_ALLOW = "list it under {list} {place}, with {direction}, or add {entry} to allow there"


class GrantError(ValueError):
    """An operator's text is no entry of `allow` or `deny`."""


def protocols_of(grant: Grant) -> tuple[str, ...]:
    """What may carry the topics of an entry; empty: anything."""
    return grant.protocol if isinstance(grant.protocol, tuple) else (grant.protocol,) if grant.protocol else ()


def typed_grants(text: str) -> tuple[str | Grant, ...]:
    """The entries in a line: ``/camera/*, {topics: /cmd_vel, may: publish, max_rate: 10}``.

    Raises:
        GrantError: one of them is none.
    """
    return tuple(_typed(entry) for entry in _ENTRY.findall(text))


def _typed(entry: str) -> str | Grant:
    if not entry.startswith("{"):
        return entry
    problems: list[Problem] = []
    try:
        data = read_yaml(entry, Path()).data
    except SessionError as error:
        raise GrantError(RightsMistake.TYPED(entry=show(entry), problem=error.problems[0].message)) from None
    grant = read(data, Grant, problems)
    if problems:
        raise GrantError("; ".join(map(str, problems)))
    return grant


def allowing(entry: str | Grant) -> Grant:
    """An entry of `allow`; a pattern alone is about topics, so that nobody allows services unawares."""
    return Grant(entry) if isinstance(entry, str) else entry


def denying(entry: str | Grant) -> Grant:
    """An entry of `deny`; a pattern alone is about whatever has such a name."""
    return Grant(entry, entry) if isinstance(entry, str) else entry


def grant_problems(holder: Client | Session, location: str) -> Iterator[Problem]:
    """Mistakes in `allow` and `deny`."""
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
            yield from rate_problems(grant.max_rate, join(here, "max_rate"))


def _subject_problems(grant: Grant, here: str) -> Iterator[Problem]:
    """Mistakes in what an entry is about, and in what may be done with that."""
    if grant.topics is None and grant.services is None:
        yield Problem(join(here, "topics"), RightsMistake.NO_PATTERN())
        return
    if grant.topics is not None and grant.services is not None:
        yield Problem(join(here, "services"), RightsMistake.BOTH())
        return
    if grant.topics is not None:
        noun, uses, others = "topic", TOPIC_USES, "services"
        yield from _pattern_problems(grant.topics, noun, join(here, "topics"))
    else:
        noun, uses, others = "service", CALL_USES, "topics"
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


def leave_problems(leave: Leave | None, location: str) -> Iterator[Problem]:
    """Mistakes in what a benchmark may cause."""
    if leave is None:
        return
    yield from rate_problems(leave.max_rate, join(location, "max_rate"))
    for key, value in (("seconds", leave.seconds), ("megabytes", leave.megabytes)):
        if not 0 < value <= _MOST_LEAVE:
            yield Problem(join(location, key), RightsMistake.LIMIT(value=f"{value:g}", limit=f"{_MOST_LEAVE:g}"))


class Use(NamedTuple):
    """What a peer wants to do with a topic, a service, an action or a node's parameters.

    Attributes:
        topic: its name on this side.
        may: publish it here or read it here; of what is not a topic, call what this side's nodes provide, or serve:
            provide what is offered to them.
        protocol: what carries it; empty: that is not known yet.
        kind: what it is.
    """

    topic: str
    may: May
    protocol: str = ""
    kind: Kind = "topic"

    def __str__(self) -> str:
        nouns = {"topic": "", "parameters": "the parameters of "}
        return f"{nouns.get(self.kind, f'{self.kind} ')}{self.topic}"


def uses(kind: Kind) -> tuple[May, May]:
    """What a peer may do with a kind: where it sends the messages or requests, and where it takes them."""
    return TOPIC_USES if kind == "topic" else CALL_USES


class Refusal(NamedTuple):
    """Why a peer may not do something.

    Attributes:
        reason: what this side says to it.
        remedy: what in which session file would allow it.
    """

    reason: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.reason}: {self.remedy}"


@dataclass(frozen=True, slots=True)
class Rights:
    """What one peer may do here.

    Attributes:
        peer: who: the client's name; on a client: ``the server``.
        owner: who says so: ``the server``, or the client's name.
        place: where `allow` and `deny` are: ``under client robot1 in pc's session file``.
        allow: what it may do; empty: everything, or on a client what `listed` says.
        deny: what it may not do all the same.
        prefix: a client's name, which the names of its topics may have before them here.
        listed: on a client, the identities of its own topics (`Topic.identity`), which say what the server may publish,
            call and serve.
        bench: whether it may measure the link, and what it may cause by that.
    """

    peer: str
    owner: str
    place: str
    allow: tuple[Grant, ...]
    deny: tuple[Grant, ...]
    prefix: str = ""
    listed: Set[Identity] | None = None
    bench: Leave | None = None

    def refusal(self, use: Use) -> Refusal | None:
        """Why the peer may not do something; None: it may."""
        if is_bench_topic(use.topic):
            return None if self.bench is not None and use.kind == "topic" else self._no_leave()
        for grant in self._about(self.deny, use, also=_meant_by(use)):
            if not grant.protocol or use.protocol in protocols_of(grant):
                return Refusal(
                    DeniedText.DENIED(owner=self.owner, use=use, peer=self.peer),
                    DeniedRemedy.CHANGE_DENY(place=self.place, entry=_text(grant)),
                )
        allowing = self._about(self.allow, use)
        for grant in allowing:
            if grant.protocol and use.protocol and use.protocol not in protocols_of(grant):
                only = join_first(protocols_of(grant), _NAMED)
                reason = DeniedText.OTHER_PROTOCOL(owner=self.owner, use=use, peer=self.peer, protocols=only)
                return Refusal(reason, DeniedRemedy.CHANGE_ALLOW(place=self.place, entry=_text(grant)))
        if allowing or self._by_default(use):
            return None
        reason = DeniedText.NOT_ALLOWED(owner=self.owner, peer=self.peer, may=use.may, use=use)
        return Refusal(reason, self._remedy(use))

    def _no_leave(self) -> Refusal:
        reason = DeniedText.NO_BENCHMARK(owner=self.owner, peer=self.peer)
        where = f"to {self.place.removeprefix('of ')}" if self.place.startswith("of ") else self.place
        return Refusal(reason, DeniedRemedy.ADD_BENCH(place=where))

    def max_rate(self, use: Use) -> float:
        """The most messages or calls a second that may cross, whoever asked for them; 0: there is no limit."""
        return min((grant.max_rate for grant in self._about(self.allow, use) if grant.max_rate), default=0.0)

    def shows(self, topic: str, kind: Kind = "topic") -> bool:
        """Whether the peer may know of a topic or of what else there is: it may do something with it."""
        return any(self.refusal(Use(topic, may, kind=kind)) is None for may in uses(kind))

    def _by_default(self, use: Use) -> bool:
        """Whether the peer may do what no entry of `allow` is about."""
        if self.listed is not None and use.may != "read":
            return (use.kind, use.topic, _LISTED_AS[use.may][0]) in self.listed
        return not self.allow

    def _remedy(self, use: Use) -> str:
        entry = f"{{{'topics' if use.kind == 'topic' else 'services'}: {use.topic}, may: {use.may}}}"
        if self.listed is None or use.may == "read":
            return DeniedRemedy.ADD_ALLOW(entry=entry, place=self.place)
        remedy = DeniedRemedy.LIST_OR_ALLOW if self.allow else DeniedRemedy.LIST
        return remedy(list=LISTS[use.kind], place=self.place, direction=_LISTED_AS[use.may][1], entry=entry)

    def _about(self, grants: Sequence[Grant], use: Use, also: Sequence[str] = ()) -> list[Grant]:
        """The entries that say something about such a use, by its name or by other names."""
        own = (use.topic, *also)
        names = {*own, *(client_topic(name, self.prefix) or name for name in own if self.prefix)}
        return [
            grant
            for grant in grants
            if grant.may in (None, use.may)
            and (pattern := grant.topics if use.kind == "topic" else grant.services) is not None
            and any(fnmatch.fnmatchcase(name, pattern) for name in names)
        ]


def rights_of_client(client: Client, server: str) -> Rights:
    """What a client may do on the server of that name."""
    return Rights(
        client.name,
        "the server",
        f"of client {client.name} in the session file of {server}",
        tuple(map(allowing, client.allow)),
        tuple(map(denying, client.deny)),
        prefix=client.name,
        bench=client.bench,
    )


def rights_of_server(session: Session, listed: Set[Identity] | None = None) -> Rights:
    """What the server may do on a client.

    Args:
        session: the client's.
        listed: the identities of the client's topics as operators have left them; None: as the session says.
    """
    if listed is None:
        listed = {topic.identity for topic in session.topics}
    return Rights(
        "the server",
        session.name,
        f"in the session file of {session.name}",
        tuple(map(allowing, session.allow)),
        tuple(map(denying, session.deny)),
        listed=listed,
        bench=session.bench,
    )


class _Everything(frozenset["Identity"]):
    """A set that has everything."""

    def __contains__(self, _: object) -> bool:
        return True


def as_if_listed(rights: Rights) -> Rights:
    """What a peer may do with what this side's session lists, whatever that is."""
    return rights if rights.listed is None else replace(rights, listed=_Everything())


def listed_as(may: May) -> Direction:
    """The direction of what a client lists, and by that has the server do."""
    return _LISTED_AS[may][0]


def _meant_by(use: Use) -> list[str]:
    """The other names by which an entry of `deny` means what is used.

    Who denies one service of an action or of a node's parameters denies what would bridge it with the others, and who
    denies a node's parameters denies each service of them.
    """
    if use.kind == "service":
        node, _, last = use.topic.rpartition("/")
        return [node] if f"/{last}" in _OF_PARAMETERS else []
    return [] if use.kind == "topic" else service_names(use.kind, use.topic)


def _text(grant: Grant) -> str:
    """An entry as it is in a session file."""
    plain = msgspec.to_builtins(grant)
    if grant.topics == grant.services or plain.keys() == {"topics"}:
        return grant.topics or ""
    return inline(plain)


class Row(NamedTuple):
    """What one peer may do with some topics or services.

    Attributes:
        peer: the client's name; on a client: ``the server``.
        may: ``publish``, ``read`` or both; of services, actions and parameters ``call``, ``serve`` or both.
        topics: which, of this side's domain.
        transports: what may carry them.
        rate: the most messages or calls.
        ports: which ports of their own they may have here; empty: none are bound on this side.
    """

    peer: str
    may: str
    topics: str
    transports: str
    rate: str
    ports: str


class Listing(NamedTuple):
    """What one peer may do here.

    Attributes:
        peer: as in `Row`.
        rows: of the table.
        moves: the patterns of `MOVES_A_ROBOT` that it may publish.
        acts: what it may call, in words, but for `ONLY_READ`.
    """

    peer: str
    rows: tuple[Row, ...]
    moves: tuple[str, ...]
    acts: tuple[str, ...]


def listings(session: Session) -> Iterator[Listing]:
    """What each peer of a session may do on this side."""
    link = transports.of_link(session.server_ip)
    carried = (link.name, *link.companions, *(("bluetooth",) if session.bluetooth_address else ()))
    if session.role == "client":
        yield _listing(rights_of_server(session), carried, "all", "")
        return
    for client in session.accepted_clients:
        prefixed = session.use_name if client.use_name is None else client.use_name
        within = f"/{client.name}/*" if prefixed else "all"
        listing = _listing(rights_of_client(client, session.name), carried, within, _ports(session))
        yield listing._replace(moves=(), acts=()) if prefixed else listing


def _listing(rights: Rights, carried: Sequence[str], within: str, ports: str) -> Listing:
    rows = [*_rows(rights, TOPIC_USES, carried, within, ports)]
    reliable = [name for name in carried if transports.named(name).reliable]
    rows += _rows(rights, CALL_USES, reliable, within, ports)
    return Listing(rights.peer, tuple(rows), tuple(_moves(rights, carried)), tuple(_acts(rights, reliable)))


def _rows(
    rights: Rights, uses: tuple[May, May], carried: Sequence[str], within: str, ports: str
) -> Iterator[Row]:  # fmt: skip
    """What a peer may do with topics, or with what is called: one row where it may do both things with the same."""
    first, second = ([*_allowed(rights, may, carried, within)] for may in uses)
    found = {", ".join(uses): first} if first == second else {uses[0]: first, uses[1]: second}
    for may, allowed in found.items():
        for names, over, rate in allowed:
            yield Row(rights.peer, may, names, over, rate, ports)


def _allowed(rights: Rights, may: May, carried: Sequence[str], within: str) -> Iterator[tuple[str, str, str]]:
    """The topics, transports and rates that a peer may publish or read, or likewise of what is called."""
    groups: dict[tuple[str, str], list[str]] = {}
    anything = (", ".join(carried), "any")
    if rights.listed is not None and may != "read":
        if names := sorted(_listed(rights, may)):
            groups[anything] = names
    elif not rights.allow:
        groups[anything] = [within]
    for grant, pattern in _about(rights.allow, may):
        over = ", ".join(protocols_of(grant)) or anything[0]
        rate = f"{grant.max_rate:g} Hz" if grant.max_rate else "any"
        groups.setdefault((over, rate), []).append(pattern)
    denied = [_without(grant, pattern) for grant, pattern in _about(rights.deny, may)]
    but = f", not {join_first(denied, _NAMED)}" if denied else ""
    for (over, rate), patterns in groups.items():
        limited = f" in {within}" if rights.allow and within != "all" else ""
        yield f"{join_first(patterns, _NAMED)}{limited}{but}", over, rate
    if not groups:
        yield _NOTHING, "-", "-"


def _about(grants: Sequence[Grant], may: May) -> Iterator[tuple[Grant, str]]:
    """The entries that say something about such a use, each with its pattern."""
    for grant in grants:
        pattern = grant.topics if may in TOPIC_USES else grant.services
        if pattern is not None and grant.may in (None, may):
            yield grant, pattern


def _listed(rights: Rights, may: May) -> Iterator[str]:
    """What a client lists, and by that has the server do."""
    for kind, name, direction in rights.listed or ():
        if (kind == "topic") == (may in TOPIC_USES) and direction == listed_as(may):
            yield f"{name}{_KINDS.get(kind, '')}"


def _without(grant: Grant, pattern: str) -> str:
    return f"{pattern} over {join_first(protocols_of(grant), _NAMED)}" if grant.protocol else pattern


def _moves(rights: Rights, carried: Sequence[str]) -> Iterator[str]:
    received = (name for _, name, direction in rights.listed or () if direction == listed_as("publish"))
    followed = [Pattern(name) for name in received if is_pattern(name)]
    for pattern, names in MOVES_A_ROBOT.items():
        listed = [topic for _, topic, _ in rights.listed or () if fnmatch.fnmatchcase(topic, pattern)]
        by_pattern = any(each.match(name) is not None for each in followed for name in names)
        if by_pattern or any(_may(rights, Use(name, "publish"), carried) for name in (*names, *listed)):
            yield pattern


def _acts(rights: Rights, carried: Sequence[str]) -> Iterator[str]:
    """What a peer may call that may change something, as it is allowed."""
    if rights.listed is None and not rights.allow and _may(rights, Use("/any", "call", kind="service"), carried):
        yield EVERY_CALL
    for kind, name, direction in sorted(rights.listed or (), key=itemgetter(1)):
        use = Use(name, "call", kind=kind)
        if kind != "topic" and direction == listed_as("call") and _changes(kind, name) and _may(rights, use, carried):
            yield f"{name}{_KINDS.get(kind, '')}"
    denied = [pattern for grant, pattern in _about(rights.deny, "call") if not grant.protocol]
    for _, pattern in _about(rights.allow, "call"):
        if _changes("service", pattern) and not any(fnmatch.fnmatchcase(pattern, each) for each in denied):
            yield pattern


def _changes(kind: Kind, name: str) -> bool:
    return kind != "service" or name.rpartition("/")[2] not in ONLY_READ


def _may(rights: Rights, use: Use, carried: Sequence[str]) -> bool:
    return any(rights.refusal(use._replace(protocol=protocol)) is None for protocol in carried)


def _ports(session: Session) -> str:
    if session.is_zenoh:
        return "none"
    if session.ports is None:
        return f"any {PORTS_PER_CLIENT}"
    return "none" if session.ports == "none" else join_first([str(port) for port in session.ports], _NAMED) or "none"


@dataclass(frozen=True, slots=True)
class Granted:
    """What an operator may do, and what they prove themselves with.

    Attributes:
        operator: as the session has them.
        key: what is in their key file.
    """

    operator: Operator
    key: Key

    def __str__(self) -> str:
        return f"may {self.operator.may}, key {fingerprint(self.key)}"


def operator_problems(session: Session) -> Iterator[Problem]:
    """All mistakes in a session's operators, as far as can be told without reading their keys."""
    if len(session.operators) > OPERATORS:
        yield Problem("operators", OperatorMistake.TOO_MANY(count=len(session.operators), limit=OPERATORS))
    firsts: dict[str, int] = {}
    for at, operator in enumerate(session.operators):
        location = join("operators", at)
        name, file = operator.name, operator.key_file
        if problem := operator_name_problem(name):
            yield Problem(join(location, "name"), problem)
        elif (first := firsts.setdefault(name, at)) != at:
            text = OperatorMistake.TWICE(name=show(name), number=first + 1)
            yield Problem(join(location, "name"), text)
        if not (file.strip() and file.isprintable()):
            yield Problem(join(location, "key_file"), OperatorMistake.KEY_FILE_INVALID(file=show(file)))


def operator_name_problem(name: str) -> str:
    """Why no operator can be called so; empty: one can."""
    if not name.strip() or not (name.isprintable() and is_clean(name)):
        return OperatorMistake.NAME_UNPRINTABLE(name=show(name))
    if len(name.encode()) > NAME_BYTES:
        return OperatorMistake.NAME_TOO_LONG(length=len(name.encode()), limit=NAME_BYTES)
    return ""


def granted_operators(session: Session, base: Path, keys: Mapping[str, tuple[Key, ...]]) -> dict[str, Granted]:
    """What the operators of a session may do, by their names.

    Args:
        session: whose.
        base: the folder that its key files are relative to.
        keys: of its links, by the clients' names.

    Raises:
        KeyFileError: a key file is not there or holds no key, or an operator has somebody else's key.
    """
    own = {each.name: read_key(key_path(base, each.key_file)) for each in session.operators}
    if problem := operator_key_problem(own, keys):
        raise KeyFileError(problem)
    return {each.name: Granted(each, own[each.name]) for each in session.operators}


def operator_key_problem(own: Mapping[str, Hashable], of_links: Mapping[str, Collection[Hashable]]) -> str:
    """Why operators must not have these keys, and what to do; empty: they may.

    Args:
        own: what is the same for two operators if their keys are, by their names.
        of_links: likewise for each key that is valid on a link, by the clients' names.
    """
    owners = {key: f"the link of {name}" for name, valid in of_links.items() for key in valid}
    for name, key in own.items():
        if other := owners.get(key):
            return OperatorMistake.SHARED_KEY(name=name, other=other)
        owners[key] = f"operator {name}"
    return ""


def operator_changes(old: Mapping[str, Granted], new: Mapping[str, Granted]) -> list[str]:
    """How the operators differ, in words: who is detached by that."""
    texts = [OperatorChange.REMOVED(name=name) for name in old if name not in new]
    for name, granted in new.items():
        before = old.get(name)
        if before is None:
            texts.append(OperatorChange.ADDED(name=name, right=granted))
        elif before != granted:
            texts.append(OperatorChange.CHANGED(name=name, before=before, after=granted))
    return texts
