"""The servers of a route of calls: who provides what, with which types, and which of them may be called or offered.

Every bridge tells, in its domain, by which bridges the answers of each service that it offers come there
(`rsb_bridge.ros.announcements`). The providing half calls no server whose answers come from where its callers are, or
from here, under the service's name: it would end up calling itself. The callers' half offers nothing beside a server
that is there already.
"""

from __future__ import annotations

import re
from collections import defaultdict
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.qos import match_publishers
from rsb_bridge.model.sources import MOST_HOPS, Via, hop, node_of, place
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.calls.call_endpoints import name_of, route_type_of, type_of
from rsb_bridge.route.calls.calls_verdict import Trouble
from rsb_bridge.route.topic_verdict import named
from rsb_bridge.wire.records import LaneEntry

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.calls import Lane
    from rsb_bridge.ros.ros_interface import Endpoint, RosInterface
    from rsb_bridge.route.peer import Peer

_NAMED = 4
_EXPLAINED_WITHIN = 3.0
"""s that a node has to say where the answers of what it offers come from; then it is taken for no bridge."""
_BRIDGE = re.compile(r"/rsb_\w+_[0-9a-f]{8}")
"""The node of a bridge: it is never taken for anything else, however late it says so on a busy machine."""
_ANNOUNCED_WITHIN = 3.0
"""s in which a bridge that is alive has told a new one what it offers."""


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


class Usable(NamedTuple):
    """The servers of a service, sorted.

    Attributes:
        servers: that may be called.
        via: the bridges that their answers cross.
        circular: that must not be called.
        unexplained: of which that is not known yet.
    """

    servers: list[Endpoint]
    via: Via
    circular: list[Endpoint]
    unexplained: list[Endpoint]

    def check(self, service: str, domain_id: int) -> None:
        """Tell why none may be called though there are some.

        Raises:
            UnavailableError: none may.
        """
        if not self.servers and self.circular:
            text = (
                f"calls would go in a circle: {service} is answered in domain {domain_id} by "
                f"{named(each.node for each in self.circular)} only, whose answers come from where its callers are; "
                "remove this route or that one"
            )
            raise UnavailableError(Cause.LOOP, text)
        if not self.servers and self.unexplained:
            nodes = named(each.node for each in self.unexplained)
            raise UnavailableError(Cause.NO_SERVER, f"waiting for {nodes} to announce where the answers come from")


class CallLoopGuard:
    """Sorts the servers of one route's services, this bridge's own offers for other links among them.

    Args:
        context: what every part of the engine shares.
        peer: where the callers are.

    Attributes:
        waits: of some server of the service that was sorted last, it is not known yet whether it may be called.
    """

    def __init__(self, context: Context, peer: Peer) -> None:
        self.waits = False
        self._context = context
        self._peer = peer
        self._first_seen: dict[str, dict[bytes, float]] = {}  # by service

    def sort(self, service: str, remote_service: str) -> Usable:
        """See which servers of a service may be called.

        Args:
            service: its name here.
            remote_service: its name where the callers are.
        """
        announcements, ros, now = self._context.announcements, self._context.ros, self._context.now()
        here = place(announcements.bridges, service)
        there = place(self._peer.bridges, remote_service)
        own = hop(ros.node_name, service)
        usable = Usable([], (), [], [])
        via: dict[str, None] = {}
        before, first_seen = self._first_seen.get(service, {}), {}
        for server in (*ros.servers(service), *announcements.own_servers(service, self._peer.name)):
            origin = announcements.origin_of_server(server, service)
            if origin is None:
                first_seen[server.gid] = before.get(server.gid, now)
                if _BRIDGE.fullmatch(server.node) or now - first_seen[server.gid] < _EXPLAINED_WITHIN:
                    usable.unexplained.append(server)
                    continue
            crossed = origin.via if origin is not None else ()
            if not here.isdisjoint(crossed) or not there.isdisjoint((*crossed, own)) or len(crossed) >= MOST_HOPS - 1:
                usable.circular.append(server)
            else:
                usable.servers.append(server)
                via.update(dict.fromkeys(crossed))
        self._first_seen[service] = first_seen
        self.waits = bool(usable.unexplained)
        return usable._replace(via=tuple(via)[: MOST_HOPS - 1])


def way_here(via: Via, bridges: tuple[str, ...], remote_service: str) -> Via:
    """The bridges that answers cross on their way to the callers' side: those before the providing one, and that one.

    Args:
        via: as the providing side says.
        bridges: in the providing side's domain, its own first; empty: not known.
        remote_service: the service's name there.
    """
    return (*via, hop(bridges[0], remote_service)) if bridges else via


class LocalServers:
    """Finds servers on the callers' side that have what is provided over the link; nothing is offered beside them.

    An earlier process of this bridge that was killed is none, though it is seen for up to 40 s more. It has this one's
    name, and is told from another bridge of that name by the peer that answers its calls, or as it announces nothing.

    Args:
        context: what every part of the engine shares.
        peer: that provides.
        look_again: has the route look.

    Attributes:
        unknown: it cannot be said yet of some server whether it is one.
    """

    def __init__(self, context: Context, peer: Peer, look_again: Callable[[], None]) -> None:
        self.unknown = False
        self._context = context
        self._peer = peer
        self._look_again = look_again
        self._first_seen: dict[bytes, float] = {}
        self._timer: asyncio.TimerHandle | None = None

    def look(self, services: Iterable[str], *, offered: bool) -> Trouble | None:
        """Why services are not offered here; None: there is no rival.

        Args:
            services: their names here.
            offered: they are now. Of two bridges that have begun at once, the one with the lesser name goes on.
        """
        context, now = self._context, self._context.now()
        before, self._first_seen, self.unknown = self._first_seen, {}, False
        trouble: Trouble | None = None
        for service in services:
            rivals = []
            for server in context.ros.servers(service):
                is_rival = self._is_rival(server, service, offered=offered)
                if is_rival is None:
                    seen = self._first_seen[server.gid] = before.get(server.gid, now)
                    self.unknown = self.unknown or now - seen < _ANNOUNCED_WITHIN
                elif is_rival:
                    rivals.append(server)
            trouble = trouble or self._trouble(service, rivals)
        if self.unknown and self._timer is None:
            self._timer = context.loop.call_later(_ANNOUNCED_WITHIN, self._due)
        return trouble

    def nodes(self, services: Iterable[str]) -> list[str]:
        """The nodes, no bridges, that serve some of these here."""
        found = [(service, each) for service in services for each in self._context.ros.servers(service)]
        return [each.node for service, each in found if self._is_node(each, service)]

    def close(self) -> None:
        """Look no more for now."""
        self.unknown = False
        self._first_seen.clear()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _due(self) -> None:
        self._timer = None
        self._look_again()

    def _is_node(self, server: Endpoint, service: str) -> bool:
        origin = self._context.announcements.origin_of_server(server, service)
        return origin is not None and not origin.via and bool(self._is_rival(server, service, offered=False))

    def _is_rival(self, server: Endpoint, service: str, *, offered: bool) -> bool | None:
        """Whether a server is one; None: it is a bridge of our name that has announced nothing."""
        ros, bridges, node = self._context.ros, self._peer.bridges, server.node.lstrip("/")
        origin = self._context.announcements.origin_of_server(server, service)
        yields = offered and origin is not None and bool(origin.via) and ros.node_name < node
        if not node.startswith(ros.node_name.removesuffix(ros.instance_id)):
            return not yields
        if origin is None or not origin.via:  # its announcements may be gone before its servers
            return None
        return not yields and (not bridges or node_of(origin.via[-1]) != bridges[0])

    def _trouble(self, service: str, rivals: list[Endpoint]) -> Trouble | None:
        if rivals:
            text = (
                f"{named(each.node for each in rivals)} serves {service} on the callers' side, too: it is not offered "
                "there a second time; stop that node, or give the bridged one another name"
            )
            return Trouble(Cause.SERVED_HERE, text)
        if self._context.announcements.own_servers(service, self._peer.name):
            text = f"this bridge offers {service} here already, from another link: give one of them another name"
            return Trouble(Cause.SERVED_HERE, text)
        return None
