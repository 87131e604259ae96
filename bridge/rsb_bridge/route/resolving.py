"""Finds the type, the type's hash and the QoS of a route's messages.

The session may name the type, publishers have types, and the other side's graph may know one.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from rsb_bridge.cdr.description import TypeVersion
from rsb_bridge.model.demands import full_type
from rsb_bridge.model.qos import match_publishers
from rsb_bridge.model.text import join_first
from rsb_bridge.model.type_names import expand_type_name
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_graph import Sought, are_alike
from rsb_bridge.route.combined_verdict import node_names, nodes_by, who_publish
from rsb_bridge.route.listeners import PublishedAs

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import Endpoint
    from rsb_bridge.route.loop_filter import LoopFilter
    from rsb_bridge.route.route import Route

_MOST_NODES, _MOST_TYPES = 3, 4  # named of each type, and in one sentence


class Resolved(NamedTuple):
    """Type and QoS of the messages that a route sends."""

    type: str
    type_hash: str
    qos: Qos
    warning: str  # the publishers that are left out, for an operator, or empty
    keyed: bool  # whether its publishers' type has a key


class Elsewhere(NamedTuple):
    """A place where a topic without a publisher is published instead.

    Attributes:
        cause: `Cause.SIMILAR_NAME` or `Cause.PUBLISHED_THERE`.
        text: for an operator, with the remedy as a question.
    """

    cause: Cause
    text: str


class UnresolvedError(Exception):
    """The type or the QoS is not known yet; the message says why, and is empty where there is no publisher."""

    def __init__(self, why: str, *, cause: Cause) -> None:
        super().__init__(why)
        self.cause = cause

    @property
    def clash(self) -> bool:
        """Whether the publishers have no type that can be sent, so that nothing may be sent until they have."""
        return self.cause is Cause.TYPE_CONFLICT


class Resolver:
    """Finds type and QoS of one route's messages. Asked again whenever the graph may have changed."""

    def __init__(self, route: Route) -> None:
        self.published_there = PublishedAs()  # on the receiving side
        self.hint = TypeVersion()  # the type that the topic has on the receiving side
        self.publisher_qos: Qos | None = None  # that all publishers offer, or None without any
        self.publisher_nodes: tuple[str, ...] = ()  # some of their nodes
        self.unresolved: UnresolvedError | None = None  # the reason why type or QoS is unknown
        self._route, self._context, self._proposal = route, route.context, route.proposal
        self._used = TypeVersion()
        self._publishers: Sequence[Endpoint] = ()
        self._keyed = False  # by the last publishers
        self._nodes: frozenset[str] = frozenset()  # of the last publishers
        self._moved = "", 0.0  # the topic that these publish now, and s since the epoch when that was first seen

    def update(self, publishers: Sequence[Endpoint]) -> None:
        """Take the topic's present publishers."""
        self._publishers, self.publisher_nodes = publishers, node_names(publishers)
        if publishers:
            self._nodes = frozenset([each.node for each in publishers])
        self.publisher_qos = match_publishers([each.qos for each in publishers]) if publishers else None

    def resolve(self, used: TypeVersion, loop_filter: LoopFilter) -> Resolved | None:
        """Return type and QoS, or None if one is unknown; `unresolved` then has the reason.

        Args:
            used: the type that the route has sent so far.
        """
        self.unresolved, self._used = None, used
        try:
            resolved = self._resolve(used)
            if not loop_filter.table.to_describe():
                raise UnresolvedError(loop_filter.unexplained(), cause=Cause.NO_MESSAGE)
        except UnresolvedError as error:
            self.unresolved = error.with_traceback(None)  # whose frames have this resolver
            return None
        return resolved

    def _resolve(self, used: TypeVersion) -> Resolved:
        proposal, publishers, qos = self._proposal, self._publishers, self.publisher_qos
        wanted = "" if proposal.type in ("", "auto") else expand_type_name(proposal.type)
        name, type_hash = choose_type(publishers, wanted, used, self.hint, self._context.ros.installed_hash)
        if name and not type_hash:
            why = f"{name} is not installed here, and nobody publishes it yet"
            raise UnresolvedError(why, cause=Cause.TYPE_UNKNOWN)
        warning = left_out(publishers, wanted, name)
        # Only publishers of the type that is sent: a node with another type must not change the QoS.
        if warning:
            qos = match_publishers([each.qos for each in publishers if each.type_name == name])
        if proposal.qos is not None:
            qos = proposal.qos
        elif qos is not None:
            qos = msgspec.structs.replace(qos, depth=0)
        if not name or qos is None:
            raise UnresolvedError("", cause=Cause.NO_PUBLISHER)
        foreign = {each.node for each in publishers if each.type_name == name and each.has_foreign_key}
        if foreign and not self._context.ros.survives_foreign_keys(name):
            why = f"{name}, which has a key (@key), with a DDS whose messages can end any node here that hears them"
            raise _clash(f"{who_publish(foreign)} {why}: publish it with Fast DDS, or a type without a key")
        if publishers:
            self._keyed = any(each.has_key for each in publishers if each.type_name == name)
        return Resolved(name, type_hash, qos, warning, self._keyed)

    def why(self) -> str:
        """Return the reason why type or QoS is unknown, or an empty string."""
        return str(self.unresolved) or self.no_publisher() if self.unresolved else ""

    def no_publisher(self) -> str:
        """Return a text that says that the topic has no publisher."""
        return no_publisher(self._proposal.topic, self._context.domain, self.elsewhere)

    @property
    def elsewhere(self) -> Elsewhere | None:
        """The place where the topic may be published instead, or None.

        If it had publishers, it is a topic that a node of theirs publishes now.
        """
        if self._publishers:
            return None  # without a search of the graph
        if self.published_there.nodes and not self.published_there.near:
            return self._on_other_side()
        return self._under_near_name() or (self._on_other_side() if self.published_there.nodes else None)

    def _under_near_name(self) -> Elsewhere | None:
        """Find a topic here that may be meant, or one that this topic's publishers publish now."""
        topic, context = self._proposal.topic, self._context
        type_name = self._used.name or full_type(self._proposal.type) or self.hint.name
        meant = context.similar_topics.of(Sought(topic, type_name, self._nodes), self._route.judge_again)
        publishers = context.ros.publishers(meant) if meant else ()
        if self._nodes:
            publishers = [each for each in publishers if each.node in self._nodes]
        if not publishers:
            return None
        if are_alike(topic, meant):
            prefix = self._prefix()
            why = f" The server adds {prefix}" if prefix and topic == prefix + meant else ""
            return Elsewhere(Cause.SIMILAR_NAME, f"did you mean {meant}?{why}")
        who = who_publish({each.node for each in publishers})
        return Elsewhere(Cause.SIMILAR_NAME, f"{who} {meant}{self._since(meant)}, the same type")

    def _prefix(self) -> str:
        """Return what the server writes before the client's name of the topic, or an empty string."""
        route = self._route
        of_server, of_client = self._proposal.topic, route.far_topic
        if not route.peer.is_client:
            of_server, of_client = of_client, of_server
        return of_server.removesuffix(of_client) if of_server.endswith(of_client) else ""

    def _since(self, meant: str) -> str:
        """Return since when the topic's publishers publish another one, or nothing if it never had any."""
        if not self._nodes:
            return ""
        if self._moved[0] != meant:
            self._moved = meant, self._context.wall()
        return f" since {datetime.fromtimestamp(self._moved[1], UTC):%H:%M} UTC"

    def _on_other_side(self) -> Elsewhere:
        """Say that the direction may be wrong: in the entry that lists the topic, on whichever side it is."""
        route, (nodes, near) = self._route, self.published_there
        where = "the server" if route.peer.is_client else route.peer.name
        direction = "transmit" if route.spec.direction == "receive" else "receive"
        remedy = f"direction: {direction}, and that name?" if near else f"direction: {direction}?"
        return Elsewhere(Cause.PUBLISHED_THERE, f"{who_publish(nodes)} {near or 'it'} on {where}: {remedy}")


def no_publisher(topic: str, domain: str, elsewhere: Elsewhere | None = None, *, gone: bool = False) -> str:
    """Says that nobody publishes a topic, or no longer, in this side's domain (`Context.domain`)."""
    hint = "" if elsewhere is None else f"; {elsewhere.text}"
    return f"no publisher of {topic} in domain {domain}{' any more' if gone else ''}{hint}"


def choose_type(
    publishers: Sequence[Endpoint],
    wanted: str,
    used: TypeVersion,
    hint: TypeVersion,
    installed_hash: Callable[[str], str | None],
) -> TypeVersion:
    """Choose the type to send.

    If the publishers disagree, the type in use stays, so that a node with a wrong type does not stop the topic.

    Args:
        wanted: the type that the session names, or empty.
        used: the type that the route has sent so far.
        hint: the type that the topic has on the receiving side.
        installed_hash: gives the hash of a type that is installed here.

    Returns:
        The type, without a name or a hash if that is unknown.

    Raises:
        UnresolvedError: the publishers have no type that can be sent.
    """
    types = nodes_by("type_name", publishers)
    if wanted and types and wanted not in types:
        if used.name == wanted:
            raise _clash(f"publishers send {_named(types)} now, and no longer {wanted}: correct them, or the type")
        raise _clash(f"publishers send {_named(types)}, not {wanted}: correct the type")
    name = wanted or (used.name if used.name in types else next(iter(types), hint.name))
    if not wanted and len(types) > 1 and name != used.name:
        raise _clash(f"publishers disagree on the type: {_named(types)}: set the topic's type")
    versions = nodes_by("type_hash", [each for each in publishers if each.type_name == name])
    if len(versions) > 1:  # DDS compares names only, and would mix their messages
        raise _clash(f"publishers have different versions of {name}: {_named(versions)}: install one version")
    if versions or not name:
        return TypeVersion(name, next(iter(versions), ""))
    hints = (TypeVersion(name, installed_hash(name) or ""), hint, used)
    return next((each for each in hints if each.name == name and each.type_hash), TypeVersion(name))


def left_out(publishers: Sequence[Endpoint], wanted: str, sent: str) -> str:
    """Return a text about the publishers that are not bridged because of their type, or an empty string.

    If the session names the type, publishers of other types are left out on purpose.
    """
    types = nodes_by("type_name", publishers)
    others = {name: nodes for name, nodes in types.items() if name != sent}
    if wanted or not others:
        return ""
    bridged = _named({sent: types.get(sent, set())})
    verb = "is" if len(others) == 1 else "are"
    return f"publishers disagree on the type: {_named(others)} {verb} not bridged, only {bridged}: set the topic's type"


def _clash(why: str) -> UnresolvedError:
    return UnresolvedError(why, cause=Cause.TYPE_CONFLICT)


def _named(nodes: Mapping[str, Iterable[str]]) -> str:
    """Format types or versions, each with its nodes."""
    known = {key: sorted(filter(None, names)) for key, names in nodes.items()}
    parts = [f"{key} (from {join_first(names, _MOST_NODES)})" if names else key for key, names in known.items()]
    return join_first(parts, _MOST_TYPES)
