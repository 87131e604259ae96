"""What the ROS graph says of the services of a route of calls: who provides them, with which types, what is wrong."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.qos import match_publishers
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.calls.names import name_of, route_type_of, type_of
from rsb_bridge.route.calls.verdict import Trouble
from rsb_bridge.route.verdict import named
from rsb_bridge.wire.records import LaneEntry

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from rsb_bridge.model.calls import Lane
    from rsb_bridge.ros.ros_interface import Endpoint, RosInterface


class Provision(NamedTuple):
    """What there is to call.

    Attributes:
        entries: by lane; empty: nothing can be called.
        servers: of all services.
        unavailable: why nothing can be called; None: it can.
        warning: what is wrong though it can; None: nothing.
    """

    entries: tuple[LaneEntry, ...] = ()
    servers: tuple[Endpoint, ...] = ()
    unavailable: Trouble | None = None
    warning: Trouble | None = None


class UnavailableError(Exception):
    """Nothing can be called now.

    Attributes:
        trouble: why.
    """

    def __init__(self, cause: Cause, text: str) -> None:
        super().__init__(text)
        self.trouble = Trouble(cause, text)


def provision(
    ros: RosInterface,
    lanes: Sequence[Lane],
    name: str,
    wanted: str,
    domain_id: int,
    servers_of: Callable[[int], Sequence[Endpoint]],
) -> Provision:
    """See what there is to call here.

    Args:
        ros: the graph.
        lanes: of the route.
        name: the route's, on this side.
        wanted: the type that the session names; empty: any.
        domain_id: of this side, for people.
        servers_of: gives the servers of a lane that may be called; raises `UnavailableError` where none may.
    """
    servers: list[Endpoint] = []
    entries: list[LaneEntry] = []
    route_type = wanted
    try:
        for number, lane in enumerate(lanes):
            service = name_of(lane, name)
            if lane.is_topic:
                entries.append(_topic_entry(ros, lane, service, route_type))
                continue
            found = servers_of(number)
            if not found:
                raise UnavailableError(Cause.NO_SERVER, f"no server of {service} in domain {domain_id}")
            servers += found
            entry = _service_entry(ros, found, service, type_of(lane, wanted))
            route_type = route_type or route_type_of(lane, entry.type)
            entries.append(entry)
    except UnavailableError as error:
        return Provision((), tuple(servers), error.trouble)
    return Provision(tuple(entries), tuple(servers), None, _several(lanes, name, servers))


def _service_entry(ros: RosInterface, servers: Sequence[Endpoint], service: str, wanted: str) -> LaneEntry:
    types = _nodes_by(servers, lambda each: each.type_name)
    if wanted and any(each != wanted for each in types):
        raise UnavailableError(
            Cause.TYPE_CONFLICT, f"{service} is served as {_with_nodes(types)}, not as {wanted}: correct the type"
        )
    if len(types) != 1:
        text = f"the servers of {service} disagree on the type: {_with_nodes(types)}: stop one of them"
        raise UnavailableError(Cause.TYPE_CONFLICT, text)
    (type_name,) = types
    versions = _nodes_by(servers, lambda each: each.type_hash)
    if len(versions) > 1:
        text = f"the servers of {service} have different versions of {type_name}: {_with_nodes(versions)}: install one"
        raise UnavailableError(Cause.TYPE_CONFLICT, text)
    type_hash = next(iter(versions), "") or ros.installed_service_hash(type_name) or ""
    if not type_hash:
        text = f"the version of {type_name} is not known, as the middleware of its server does not say it: install it"
        raise UnavailableError(Cause.TYPE_UNKNOWN, text)
    return LaneEntry(type_name, type_hash, len(servers))


def _topic_entry(ros: RosInterface, lane: Lane, topic: str, route_type: str) -> LaneEntry:
    """Of a lane that is a topic; those that publish something else on it are left out."""
    type_name = type_of(lane, route_type)
    publishers = [each for each in ros.publishers(topic) if each.type_name == type_name]
    hashes = {each.type_hash for each in publishers if each.type_hash}
    type_hash = hashes.pop() if len(hashes) == 1 else ""
    if not hashes:
        type_hash = type_hash or ros.installed_hash(type_name) or ""
    qos = match_publishers([each.qos for each in publishers]) if publishers else None
    return LaneEntry(type_name, type_hash, len(publishers), qos)


def _several(lanes: Sequence[Lane], name: str, servers: Iterable[Endpoint]) -> Trouble | None:
    """Whether several nodes provide it, each of which gets every call.

    The same node's name twice is most likely one that was killed and started again, which DDS still sees for a while.
    """
    nodes = {each.node for each in servers if each.node}
    if len(nodes) < 2:
        return None
    text = f"{name} is served by {named(nodes)}: each gets every call, and the first answer counts; stop all but one"
    return Trouble(Cause.SEVERAL_SERVERS, text)


def types_clash(
    ros: RosInterface,
    lanes: Sequence[Lane],
    entries: Sequence[LaneEntry],
    names: Sequence[str],
    callers: Mapping[str, Sequence[Endpoint]],
) -> Trouble | None:
    """Why calls would not be understood: this side has other versions of the types than the providing side.

    Args:
        ros: this side's graph.
        lanes: of the route.
        entries: what the other side provides, by lane.
        names: of the lanes here.
        callers: of the services here, by name.
    """
    for lane, entry, name in zip(lanes, entries, names, strict=True):
        installed = (ros.installed_hash if lane.is_topic else ros.installed_service_hash)(entry.type)
        if installed and entry.type_hash and installed != entry.type_hash:
            text = (
                f"{entry.type} differs between the two sides ({entry.type_hash} on the providing side, {installed} on "
                "the callers'): install the same version on both"
            )
            return Trouble(Cause.TYPE_CONFLICT, text)
        if lane.is_topic:
            continue
        others = _called_as_another_type(callers[name], name, entry)
        if others is not None and all(caller.type_name != entry.type for caller in callers[name]):
            return others
        for caller in callers[name]:
            if caller.type_name == entry.type and caller.type_hash and caller.type_hash != entry.type_hash:
                text = (
                    f"{named([caller.node])} has another version of {entry.type} ({caller.type_hash}) than the "
                    f"providing side ({entry.type_hash}): install the same version on both"
                )
                return Trouble(Cause.TYPE_CONFLICT, text)
    return None


def others_called(
    lanes: Sequence[Lane],
    entries: Sequence[LaneEntry],
    names: Sequence[str],
    callers: Mapping[str, Sequence[Endpoint]],
) -> Trouble | None:
    """Which callers get no answer, as they call it as another type, beside others that do; see `types_clash`.

    DDS keeps them apart from a server of the right type, so that they do no harm.
    """
    for lane, entry, name in zip(lanes, entries, names, strict=True):
        if not lane.is_topic and (others := _called_as_another_type(callers[name], name, entry)) is not None:
            return others
    return None


def _called_as_another_type(callers: Iterable[Endpoint], name: str, entry: LaneEntry) -> Trouble | None:
    types = _nodes_by([each for each in callers if each.type_name != entry.type], lambda each: each.type_name)
    if not types:
        return None
    text = f"{name} is {entry.type}, but is called as {_with_nodes(types)}, which is not answered: correct the type"
    return Trouble(Cause.TYPE_CONFLICT, text)


def _nodes_by(endpoints: Iterable[Endpoint], what: Callable[[Endpoint], str]) -> Mapping[str, set[str]]:
    """Endpoints' nodes, by something that they have; those that do not have it are left out."""
    nodes: defaultdict[str, set[str]] = defaultdict(set)
    for each in endpoints:
        if key := what(each):
            nodes[key].add(each.node)
    return dict(sorted(nodes.items()))


def _with_nodes(nodes: Mapping[str, set[str]]) -> str:
    return ", ".join(f"{key} (by {named(who)})" for key, who in list(nodes.items())[:_NAMED])


_NAMED = 4
