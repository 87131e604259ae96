"""The topics that this side of a link proposes, as operators have left them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.config.topic_rules import transport_of
from rsb_bridge.config.validation import validate_topic
from rsb_bridge.link.extension import LinkError
from rsb_bridge.link.proposals import check_driver_topic, proposal_of, same_route, use_of
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.route.route import route_key

if TYPE_CHECKING:
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.route_table import RouteTable
    from rsb_bridge.model.session import Topic
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import Propose


class ProposedTopics:
    """Adds and changes topics in a link's route table."""

    def __init__(self, link: BaseLink, table: RouteTable) -> None:
        self._link = link
        self._context = link.context
        self._table = table

    def all(self) -> tuple[Topic, ...]:
        """Return the topics that this side proposes by name, in the session's order. May be called from any thread."""
        routes = tuple(self._link.routes.values())
        listed = [route for route in routes if route.proposed_here and not route.pattern and route.purpose.in_graph]
        return (*(route.spec for route in listed), *tuple(self._table.superseded.values()))

    def add(self, topic: Topic, *, by_pattern: bool = False) -> Route:
        """Bridge one more topic, which this side proposes; it takes over a route that a pattern has made.

        Args:
            by_pattern: whether a pattern adds it, whose entry makes the demands.

        Raises:
            LinkError: the topic has a mistake, or is bridged already.
        """
        proposal = self._proposal(topic)
        route = self._link.routes.get(route_key(self._link.name, proposal))
        if route is not None and route.pattern:
            return self.replace(route, topic)
        return self._table.add(topic, proposal, proposed_here=True, by_pattern=by_pattern)

    def check(self, topic: Topic) -> None:
        """Check a pattern.

        Raises:
            LinkError: it has a mistake.
        """
        for problem in validate_topic(topic, self._context.session):
            raise LinkError(str(problem))

    def is_bridged(self, topic: Topic) -> bool:
        """Whether a valid topic has a route, possibly under another name on the client."""
        try:
            return route_key(self._link.name, self._proposal(topic)) in self._link.routes
        except LinkError:
            return False

    def can_amend(self, route: Route, topic: Topic) -> bool:
        """Whether a route can go on, with its counts, if another topic takes its place.

        Raises:
            LinkError: the topic has a mistake.
        """
        return _can_amend(route, self._proposal(topic))

    def replace(self, route: Route, topic: Topic) -> Route:
        """Put another topic in a route's place; a pattern no longer controls it.

        The route goes on if only limits differ, else there is a new one.

        Raises:
            LinkError: the topic has a mistake, or there is such a route; the old route stays.
        """
        table, proposal = self._table, self._proposal(topic)
        if (key := route_key(self._link.name, proposal)) != route.key:  # the peer may bridge the new name already
            table.keep_demand(topic, key)
        self._check_replace(route, topic, proposal)  # before the old route gives way: if it is refused, that one stays
        if _can_amend(route, proposal):
            route.pattern = ""
            table.amend(route, topic, proposal)
            return route
        at = list(self._link.routes).index(route.key)
        new = table.add(topic, proposal, proposed_here=True, replaces=table.give_way(route))
        new.edits_peer = route.edits_peer or not route.proposed_here
        new.arming.follow(route.arming)
        table.move(new, at)
        return new

    def restore(self, topic: Topic) -> None:
        """Propose an entry of this side again, whose place the other side's own had taken."""
        try:
            self.add(topic)
        except LinkError as error:
            self._link.log(
                Level.WARNING,
                EventCode.ROUTE_REFUSED,
                f"{topic.topic}: left out until a reload: {error}",
                topic=topic.topic,
            )

    def check_replace(self, route: Route, topic: Topic) -> None:
        """Raise `LinkError` where `replace` would."""
        self._check_replace(route, topic, self._proposal(topic))

    def _check_replace(self, route: Route, topic: Topic, proposal: Propose) -> None:
        if not _can_amend(route, proposal):
            self._table.check_add(topic, proposal, route_key(self._link.name, proposal), instead_of=route)

    def _proposal(self, topic: Topic) -> Propose:
        name, prefixed, transports = self._link.name, self._link.prefixed, self._context.transports
        for problem in validate_topic(topic, self._context.session, client=name if prefixed else None):
            raise LinkError(str(problem))
        transport = transports[transport_of(topic, self._context.session).name]
        proposal = proposal_of(topic, transport, client_name=name, use_name=prefixed, profile=self._link.profile)
        check_driver_topic(use_of(proposal, is_client=self._link.is_client), self._context.session)
        return proposal


def _can_amend(route: Route, proposal: Propose) -> bool:
    """Whether a route can go on as this is proposed: nothing but limits change, and its proposer can be asked."""
    return same_route(route.proposal, proposal) and bool(route.proposed_here or route.id)
