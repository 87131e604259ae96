"""The servers of a route of calls: their types, and whether calls to them would go in a circle.

For each service that a bridge offers, it announces in its domain which bridges the answers cross
(`rsb_bridge.ros.announcements`). The providing half calls no server whose answers cross its callers' domain, or this
one, under the service's name: it would end up calling itself. The callers' half offers no service that a node of its
domain serves already.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.cdr.description import TypeClash, hashes_text
from rsb_bridge.model.hops import MOST_HOPS, Via, hop, node_of_hop, topic_place
from rsb_bridge.model.names import is_bridge
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.calls.calls_end import Trouble
from rsb_bridge.route.combined_verdict import named, nodes_by
from rsb_bridge.wire.records import LaneEntry

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterable, Mapping, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.calls import ServiceMember
    from rsb_bridge.ros.ros_interface import Endpoint, RosInterface
    from rsb_bridge.route.calls.lane_types import TypeComparison
    from rsb_bridge.route.peer import Peer
    from rsb_bridge.route.route import Route

_NAMED = 4
_EXPLAINED_WITHIN = 3.0
"""s that a node has to announce where its answers come from; after that it counts as no bridge. A round
figure."""
_ANNOUNCED_WITHIN = 3.0
"""s within which a living bridge announces its offers to a new one. A round figure."""


class Provision(NamedTuple):
    """The services and topics that a providing half can reach.

    Attributes:
        entries: by lane, or empty if nothing can be called.
        unavailable: the trouble that keeps it from being called, or None.
        warning: the trouble that does not keep it from being called, or None.
    """

    entries: tuple[LaneEntry, ...] = ()
    servers: tuple[Endpoint, ...] = ()
    unavailable: Trouble | None = None
    warning: Trouble | None = None


class UnavailableError(Exception):
    """Nothing can be called now."""

    def __init__(self, cause: Cause, text: str) -> None:
        super().__init__(text)
        self.trouble = Trouble(cause, text)


def provision(
    context: Context, members: Sequence[ServiceMember], name: str, callers_name: str, wanted: str, guard: CallLoopGuard
) -> Provision:
    """Find what can be called here.

    Args:
        name: the route's, on this side.
        callers_name: the route's, on the callers' side.
        wanted: the type that the session names, or empty for any.
    """
    ros = context.ros
    servers: list[Endpoint] = []
    entries: list[LaneEntry] = []
    route_type = wanted
    try:
        for member in members:
            service = member.name_on(name)
            if member.is_topic:
                entries.append(_topic_entry(ros, member, service, route_type))
                continue
            found = guard.servers(service, member.name_on(callers_name))
            if not found:
                raise UnavailableError(Cause.NO_SERVER, f"no server of {service} in domain {context.domain}")
            servers += found
            entry = _service_entry(ros, found, service, member.type_in(wanted))
            route_type = route_type or member.route_type(entry.type)
            entries.append(entry)
    except UnavailableError as error:
        return Provision((), tuple(servers), error.trouble)
    return Provision(tuple(entries), tuple(servers), None, _several(members, name, servers))


def _service_entry(ros: RosInterface, servers: Sequence[Endpoint], service: str, wanted: str) -> LaneEntry:
    types = nodes_by("type_name", servers)
    if wanted and any(each != wanted for each in types):
        raise UnavailableError(
            Cause.TYPE_CONFLICT, f"{service} is served as {_with_nodes(types)}, not as {wanted}: correct the type"
        )
    if len(types) != 1:
        text = f"the servers of {service} disagree on the type: {_with_nodes(types)}: stop one of them"
        raise UnavailableError(Cause.TYPE_CONFLICT, text)
    (type_name,) = types
    versions = nodes_by("type_hash", servers)
    if len(versions) > 1:
        text = f"the servers of {service} have different versions of {type_name}: {_with_nodes(versions)}: install one"
        raise UnavailableError(Cause.TYPE_CONFLICT, text)
    type_hash = next(iter(versions), "") or ros.installed_service_hash(type_name) or ""
    if not type_hash:
        text = f"the version of {type_name} is unknown, as the middleware of its server does not send it: install it"
        raise UnavailableError(Cause.TYPE_UNKNOWN, text)
    return LaneEntry(type_name, type_hash, len(servers))


def _topic_entry(ros: RosInterface, member: ServiceMember, topic: str, route_type: str) -> LaneEntry:
    """Return the type of a lane that is a topic. Publishers of another type on it do not count."""
    type_name = member.type_in(route_type)
    publishers = [each for each in ros.publishers(topic) if each.type_name == type_name]
    hashes = {each.type_hash for each in publishers if each.type_hash}
    type_hash = hashes.pop() if len(hashes) == 1 else ""
    # Not if several versions are published: then the topic stays closed.
    if not hashes:
        type_hash = type_hash or ros.installed_hash(type_name) or ""
    return LaneEntry(type_name, type_hash, len(publishers))


def _several(members: Sequence[ServiceMember], name: str, servers: Iterable[Endpoint]) -> Trouble | None:
    """Return a warning if several nodes provide it, because each of them gets every call.

    Two nodes of the same name are most likely one that was killed and started again: DDS sees the old one for a while.
    """
    nodes = {each.node for each in servers if each.node}
    if len(nodes) < 2:
        return None
    text = f"{name} is served by {named(nodes)}: each gets every call, and the first answer counts; stop all but one"
    return Trouble(Cause.SEVERAL_SERVERS, text)


def types_clash(
    ros: RosInterface,
    members: Sequence[ServiceMember],
    entries: Sequence[LaneEntry],
    names: Sequence[str],
    callers: Mapping[str, Sequence[Endpoint]],
    comparison: TypeComparison,
) -> Trouble | None:
    """Return the trouble if the two sides, or a caller, have other versions of a type, or None.

    Args:
        entries: the other side's types, by lane.
        names: of the lanes on this side.
        callers: of the services on this side, by name.
    """
    for member, entry, name in zip(members, entries, names, strict=True):
        installed = (ros.installed_hash if member.is_topic else ros.installed_service_hash)(entry.type)
        if installed and entry.type_hash and installed != entry.type_hash:
            difference = comparison.difference(entry, installed)
            return Trouble(Cause.TYPE_CONFLICT, TypeClash.VERSIONS(type=entry.type, difference=difference))
        if member.is_topic:
            continue
        all_differ = all(caller.type_name != entry.type for caller in callers[name])
        if all_differ and (others := _called_as_another_type(callers[name], name, entry)) is not None:
            return others
        for caller in callers[name]:
            if caller.type_name == entry.type and caller.type_hash and caller.type_hash != entry.type_hash:
                hashes = hashes_text(entry.type, entry.type_hash, caller.type_hash)
                text = (
                    f"{named([caller.node])} has another version of {entry.type} than the providing side ({hashes}): "
                    "install the same version on both"
                )
                return Trouble(Cause.TYPE_CONFLICT, text)
    return None


def others_called(
    members: Sequence[ServiceMember],
    entries: Sequence[LaneEntry],
    names: Sequence[str],
    callers: Mapping[str, Sequence[Endpoint]],
) -> Trouble | None:
    """Return a warning if some callers get no answer because they use another type; see `types_clash`.

    They do no harm: DDS does not connect them with a server of the right type.
    """
    for member, entry, name in zip(members, entries, names, strict=True):
        if not member.is_topic and (others := _called_as_another_type(callers[name], name, entry)) is not None:
            return others
    return None


def _called_as_another_type(callers: Iterable[Endpoint], name: str, entry: LaneEntry) -> Trouble | None:
    types = nodes_by("type_name", [each for each in callers if each.type_name != entry.type])
    if not types:
        return None
    text = f"{name} is {entry.type}, but is called as {_with_nodes(types)}, which is not answered: correct the type"
    return Trouble(Cause.TYPE_CONFLICT, text)


def _with_nodes(nodes: Mapping[str, set[str]]) -> str:
    return ", ".join(f"{key} (by {named(who)})" for key, who in list(nodes.items())[:_NAMED])


class CallLoopGuard:
    """Finds the servers of a route that calls may go to without coming back in a circle.

    This bridge's own offers for other links count as servers, too.

    Args:
        peer: the side with the callers.

    Attributes:
        waits: whether a server has not announced yet where its answers come from.
    """

    def __init__(self, context: Context, peer: Peer) -> None:
        self.waits = False
        self._via: dict[str, None] = {}
        self._context = context
        self._peer = peer
        self._first_seen: dict[str, dict[bytes, float]] = {}  # by service

    @property
    def via(self) -> Via:
        """The bridges that answers cross before they come here."""
        return tuple(self._via)[: MOST_HOPS - 1]

    def begin(self) -> None:
        """Begin to look at all services of the route again."""
        self.waits = False
        self._via.clear()

    def servers(self, service: str, remote_service: str) -> list[Endpoint]:
        """Return the servers of a service that may be called.

        Args:
            service: its name on this side.
            remote_service: its name on the callers' side.

        Raises:
            UnavailableError: there are some, but none may.
        """
        announcements, ros, now = self._context.announcements, self._context.ros, self._context.now()
        here = topic_place(announcements.bridges, service)
        there = topic_place(self._peer.bridges, remote_service)
        own = hop(ros.node_name, service)
        usable: list[Endpoint] = []
        circular: list[Endpoint] = []
        unexplained: list[Endpoint] = []
        before, first_seen = self._first_seen.get(service, {}), {}
        for server in (*ros.servers(service), *announcements.own_servers(service, self._peer.name)):
            origin = announcements.origin_of_server(server, service)
            if origin is None:
                first_seen[server.gid] = before.get(server.gid, now)
                if is_bridge(server.node) or now - first_seen[server.gid] < _EXPLAINED_WITHIN:
                    unexplained.append(server)
                    continue
            crossed = origin.via if origin is not None else ()
            if not here.isdisjoint(crossed) or not there.isdisjoint((*crossed, own)) or len(crossed) >= MOST_HOPS - 1:
                circular.append(server)
            else:
                usable.append(server)
                self._via.update(dict.fromkeys(crossed))
        self._first_seen[service] = first_seen
        self.waits = self.waits or bool(unexplained)
        if not usable and circular:
            text = (
                f"calls would go in a circle: {service} is answered in domain {self._context.domain_id} by "
                f"{named(each.node for each in circular)} only, which bridges it from the callers' side; "
                "remove this route or that one"
            )
            raise UnavailableError(Cause.LOOP, text)
        if not usable and unexplained:
            nodes = named(each.node for each in unexplained)
            raise UnavailableError(Cause.NO_SERVER, f"waiting for {nodes} to announce where the answers come from")
        return usable


def way_here(via: Via, bridges: tuple[str, ...], remote_service: str) -> Via:
    """Return the bridges that answers cross, the providing one last.

    Args:
        via: the bridges before the providing one.
        bridges: in the providing side's domain, its own first, or empty if they are unknown.
        remote_service: the service's name there.
    """
    return (*via, hop(bridges[0], remote_service)) if bridges else via


class LocalServers:
    """Finds servers on the callers' side that serve the same services: then nothing is offered over the link.

    A killed earlier process of this bridge does not count, although DDS sees it for up to 40 s more. It has this
    bridge's name, and differs from another bridge of that name: it announces nothing, or that the same peer answers.

    Attributes:
        unknown: whether it is still unclear for some server whether it counts.
    """

    def __init__(self, route: Route) -> None:
        self.unknown = False
        self._route = route
        self._context = route.context
        self._peer = route.peer
        self._first_seen: dict[bytes, float] = {}
        self._timer: asyncio.TimerHandle | None = None

    def find_trouble(self, services: Iterable[str], *, offered: bool) -> Trouble | None:
        """Return the trouble that keeps services from being offered here, or None.

        Args:
            services: their names on this side.
            offered: whether they are offered now. If two bridges begin at once, the one with the lesser name goes on.
        """
        context, now = self._context, self._context.now()
        before, self._first_seen, self.unknown = self._first_seen, {}, False
        trouble: Trouble | None = None
        for service in services:
            others = []
            for server in context.ros.servers(service):
                counts = self._counts(server, service, offered=offered)
                if counts is None:
                    seen = self._first_seen[server.gid] = before.get(server.gid, now)
                    self.unknown = self.unknown or now - seen < _ANNOUNCED_WITHIN
                elif counts:
                    others.append(server)
            # The other services are looked at nevertheless, for `unknown`.
            trouble = trouble or self._trouble(service, others)
        # The time may pass without any change of the graph, which has routes look.
        if self.unknown and self._timer is None:
            self._timer = context.loop.call_later(_ANNOUNCED_WITHIN, self._due)
        return trouble

    def nodes(self, services: Iterable[str]) -> list[str]:
        """Return the nodes, but not bridges, that serve some of these services here."""
        nodes = []
        for service in services:
            for server in self._context.ros.servers(service):
                origin = self._context.announcements.origin_of_server(server, service)
                if origin is not None and not origin.via and self._counts(server, service, offered=False):
                    nodes.append(server.node)
        return nodes

    def close(self) -> None:
        """Forget the servers, and stop the timer."""
        self.unknown = False
        self._first_seen.clear()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _due(self) -> None:
        self._timer = None
        self._route.advance()

    def _counts(self, server: Endpoint, service: str, *, offered: bool) -> bool | None:
        """Return whether a server counts, or None for a bridge of our name that has announced nothing."""
        ros, bridges, node = self._context.ros, self._peer.bridges, server.node.lstrip("/")
        origin = self._context.announcements.origin_of_server(server, service)
        yields = offered and origin is not None and bool(origin.via) and ros.node_name < node
        if not node.startswith(ros.node_name.removesuffix(ros.instance_id)):
            return not yields
        if origin is None or not origin.via:  # its announcements may be gone before its servers
            return None
        return not yields and (not bridges or node_of_hop(origin.via[-1]) != bridges[0])

    def _trouble(self, service: str, others: list[Endpoint]) -> Trouble | None:
        if others:
            text = (
                f"{named(each.node for each in others)} serves {service} on the callers' side, too: it is not offered "
                "there a second time; stop that node, or give the bridged one another name"
            )
            return Trouble(Cause.SERVED_HERE, text)
        if self._context.announcements.own_servers(service, self._peer.name):
            text = f"this bridge offers {service} here already, from another link: give one of them another name"
            return Trouble(Cause.SERVED_HERE, text)
        return None
