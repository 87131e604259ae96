"""The topics that this side of a link proposes, as operators have left them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.config.topic_rules import transport_of
from rsb_bridge.config.validation import validate_topic
from rsb_bridge.link.errors import LinkError
from rsb_bridge.link.proposals import proposal_of, same_route
from rsb_bridge.model.benchmark import is_bench_topic
from rsb_bridge.model.profiles import PLAIN
from rsb_bridge.route.route import route_key

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.link.route_table import RouteTable
    from rsb_bridge.model.profiles import LinkProfile
    from rsb_bridge.model.session import Topic
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import Propose


class ProposedTopics:
    """Adds and changes topics in a link's route table.

    Args:
        context: its session says what is valid.
        table: the link's routes.
        client_name: the prefix.
        prefixed: whether this side knows that the server puts the prefix before the client's topics.
        profile: gives the link's.
    """

    def __init__(
        self,
        context: Context,
        table: RouteTable,
        client_name: str,
        prefixed: Callable[[], bool],
        profile: Callable[[], LinkProfile] = lambda: PLAIN,
    ) -> None:
        self._context = context
        self._table = table
        self._client_name = client_name
        self._prefixed = prefixed
        self._profile = profile

    def all(self) -> tuple[Topic, ...]:
        """What this side proposes by its name, in a session's order. May be called from any thread."""
        routes = tuple(self._table.routes.values())
        proposed = [route.spec for route in routes if route.proposed_here and not route.pattern]
        topics = [topic for topic in proposed if not is_bench_topic(topic.topic)]
        return (*topics, *tuple(self._table.yielded.values()))

    def add(self, topic: Topic, *, by_pattern: bool = False) -> Route:
        """Bridge one more topic, which this side proposes; where a pattern has made its route, that is the topic's now.

        Args:
            topic: what to bridge.
            by_pattern: a pattern wants it, which demands by itself what it demands.

        Raises:
            LinkError: the topic has a mistake, or there is such a route.
        """
        proposal = self._proposal(topic)
        route = self._table.routes.get(route_key(self._client_name, proposal))
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
        """Whether there is a route for a topic, which has no mistake, be it under another name on the client."""
        try:
            return route_key(self._client_name, self._proposal(topic)) in self._table.routes
        except LinkError:
            return False

    def can_amend(self, route: Route, topic: Topic) -> bool:
        """Whether a route can go on, with its counts, if another topic takes its place.

        Raises:
            LinkError: the topic has a mistake.
        """
        return _can_amend(route, self._proposal(topic))

    def replace(self, route: Route, topic: Topic) -> Route:
        """Put another topic in a route's place, which is no pattern's then.

        The route goes on if only limits differ, else there is a new one.

        Raises:
            LinkError: the topic has a mistake, there is such a route, or its proposer is too old for the change; the
                old route stays.
        """
        table, proposal = self._table, self._proposal(topic)
        if (key := route_key(self._client_name, proposal)) != route.key:
            table.keep_demand(topic, key)
        self._check_replace(route, topic, proposal)
        if _can_amend(route, proposal):
            route.pattern = ""
            table.amend(route, topic, proposal)
            return route
        at = list(table.routes).index(route.key)
        table.remove(route, "edited", told=False)
        new = table.add(topic, proposal, proposed_here=True, edited=True)
        table.move(new, at)
        return new

    def check_replace(self, route: Route, topic: Topic) -> None:
        """Raise `LinkError` where `replace` would."""
        self._check_replace(route, topic, self._proposal(topic))

    def _check_replace(self, route: Route, topic: Topic, proposal: Propose) -> None:
        if not _can_amend(route, proposal):
            self._table.check_add(topic, proposal, route_key(self._client_name, proposal), instead_of=route)
        elif not route.proposed_here and (problem := self._table.unsupported_change(route, proposal)):
            raise LinkError(problem)

    def _proposal(self, topic: Topic) -> Propose:
        name, prefixed, transports = self._client_name, self._prefixed(), self._context.transports
        for problem in validate_topic(topic, self._context.session, client=name if prefixed else None):
            raise LinkError(str(problem))
        transport = transports[transport_of(topic, self._context.session).name]
        return proposal_of(topic, transport, client_name=name, use_name=prefixed, profile=self._profile())


def _can_amend(route: Route, proposal: Propose) -> bool:
    """Whether a route can go on as this is proposed: nothing but limits change, and its proposer can be asked."""
    return same_route(route.proposal, proposal) and bool(route.proposed_here or route.id)
