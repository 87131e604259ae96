"""What each peer of a session may do here, as a table."""

from __future__ import annotations

import fnmatch
from operator import itemgetter
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.config.grants import CALL_USES, TOPIC_USES, protocols_of
from rsb_bridge.config.rights import Use, listed_as, rights_of_client, rights_of_server
from rsb_bridge.model import transports
from rsb_bridge.model.limits import PORTS_PER_CLIENT
from rsb_bridge.model.patterns import Pattern, is_pattern
from rsb_bridge.model.text import join_first

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.config.rights import Rights
    from rsb_bridge.model.session import Grant, Kind, May, Session

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
_NAMED = 6
_NOTHING = "nothing"
_KINDS: dict[Kind, str] = {"action": " (action)", "parameters": " (parameters)"}


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
        yield "any service, action and parameter"
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
