"""A session's rights as operators read them: rows of a table, and what a peer may move or change."""

from __future__ import annotations

import fnmatch
from operator import itemgetter
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.config.grants import CALL_USES, TOPIC_ENTRIES, TOPIC_USES, covers, protocols_of
from rsb_bridge.config.rights import LISTED_AS, Rights, Use, rights_of_client, rights_of_server
from rsb_bridge.model import transports
from rsb_bridge.model.limits import NO_PORT, PORTS_PER_CLIENT
from rsb_bridge.model.motion import NAMES_OF_MOTION
from rsb_bridge.model.patterns import Pattern, is_pattern
from rsb_bridge.model.text import join_first

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_bridge.model.session import Grant, Kind, May, Session

_NAMED = 6
_BELIEVED = {"/joint_*": ("/joint_states",), "/tf": ("/tf",), "/clock": ("/clock",)}
MOVES_A_ROBOT = {
    pattern: (*(name for name in NAMES_OF_MOTION if fnmatch.fnmatchcase(name, pattern)), *_BELIEVED.get(pattern, ()))
    for pattern in ("/cmd_vel", "/joint_*", "/joy", "*/commands", "/tf", "/clock")
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
    if transports.of_link(session.host).topic_ports is NO_PORT or session.ports == "none":
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
    if rights.listed is not None and may in LISTED_AS:
        names = [
            f"{name}{_KINDS.get(kind, '')}"
            for kind, name, direction in rights.listed
            if (kind == "topic") == (may in TOPIC_USES) and direction == LISTED_AS[may][0]
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
        pattern = grant.topics if may in TOPIC_ENTRIES else grant.services
        if pattern is not None and covers(grant, may):
            yield grant, pattern


def _moves(rights: Rights, carried: Sequence[str]) -> Iterator[str]:
    received = (name for _, name, direction in rights.listed or () if direction == LISTED_AS["publish"][0])
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
        called_here = kind != "topic" and direction == LISTED_AS["call"][0]
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
