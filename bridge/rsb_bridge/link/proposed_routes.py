"""The topics that this side of a link proposes, as operators have left them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import msgspec

from rsb_bridge.config.topic_rules import transport_of
from rsb_bridge.config.validation import validate_topic
from rsb_bridge.link.extension import Denied, Extension, LinkError
from rsb_bridge.link.peer_operators import acting_operator
from rsb_bridge.link.proposals import (
    ARMING_KEYS,
    check_features,
    check_use,
    check_wanted,
    edited_entry,
    listed_differently,
    proposal_of,
    same_route,
    topic_of,
    use_of,
)
from rsb_bridge.link.questions import Questions
from rsb_bridge.model.demands import effective_max_age
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.topic_keys import of_peer, of_this_side
from rsb_bridge.route.route import Entry, route_key
from rsb_bridge.wire.messages import Edit, EditAnswer

if TYPE_CHECKING:
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.route_table import RouteTable
    from rsb_bridge.model.session import Topic
    from rsb_bridge.route.route import Route

_ANSWERED_WITHIN = 10.0
"""Seconds that the other side has to change an entry. A round figure: nothing was measured."""


class ProposedTopics(Extension):
    """Adds and changes the topics of this side's session, for operators of both sides."""

    def __init__(self, link: BaseLink, table: RouteTable) -> None:
        self._link = link
        self._context = link.context
        self._table = table
        self._questions: Questions[str] = Questions(link, _ANSWERED_WITHIN)
        self._asked = 0
        self.messages = {Edit: self._asked_to_edit, EditAnswer: self._answered}

    def disconnected(self) -> None:
        self._questions.disconnected()

    def all(self) -> tuple[Topic, ...]:
        """Return the topics that the session lists by name, in its order. May be called from any thread."""
        return tuple([route.spec for route in tuple(self._link.routes.values()) if route.listed])

    def add(self, topic: Topic, *, by_pattern: bool = False) -> Route:
        """Bridge one more topic, which this side lists; it takes over a route that a pattern has made.

        Args:
            by_pattern: whether a pattern adds it, whose entry makes the demands.

        Raises:
            LinkError: the topic has a mistake, or is bridged already, and the other side's entry is another one.
        """
        entry = self.entry(topic)
        route = self._link.routes.get(route_key(self._link.name, entry.proposal))
        if route is not None and route.pattern:
            return self.replace(route, entry)
        if route is not None and not (route.here or by_pattern):
            return self._list_too(route, entry)
        return self._table.add(entry, proposed_here=True)

    def _list_too(self, route: Route, entry: Entry) -> Route:
        """List what the other side has opened in this side's session, too, unless the two entries differ."""
        topic = entry.topic
        if route.proposal.by_pattern:  # an entry that names it goes before that
            return self._table.change(route, entry)
        if text := listed_differently(entry, route.proposal, self._link):
            self._table.keep_demand(topic, route.key)  # which holds all the same
            raise LinkError(text)
        route.enter(entry._replace(topic=msgspec.structs.replace(topic, paused=route.pausing.paused)), route.there)
        self._table.listed.add(topic.identity)
        self._context.demands.changed()
        self._context.demands.apply()
        if topic.paused and not route.pausing.paused:
            self._table.pause(route, paused=True)
        return route

    def unlist(self, route: Route) -> None:
        """Take what the other side has opened, and lists, too, out of this side's session."""
        self._table.listed.discard(route.spec.identity)
        theirs = msgspec.structs.replace(topic_of(route.proposal), paused=route.pausing.paused)
        route.enter(None, Entry(theirs, route.proposal))
        self._context.demands.changed()

    def is_bridged(self, topic: Topic) -> bool:
        """Whether a valid topic has a route, possibly under another name on the client."""
        try:
            return route_key(self._link.name, self.entry(topic).proposal) in self._link.routes
        except LinkError:
            return False

    def can_amend(self, route: Route, topic: Topic) -> bool:
        """Whether a route goes on, with its counts, if another valid topic takes its place: only limits differ."""
        return same_route(route.proposal, self.entry(topic).proposal)

    def replace(self, route: Route, entry: Entry) -> Route:
        """Put another entry in the place of one that this side proposes; a pattern no longer controls it.

        The route goes on if only limits differ, else there is a new one.

        Raises:
            LinkError: there is such a route; the old route stays.
        """
        table = self._table
        if (key := route_key(self._link.name, entry.proposal)) != route.key:  # the peer may bridge the new name already
            table.keep_demand(entry.topic, key)
        if not same_route(route.proposal, entry.proposal):
            return table.change(route, entry)
        route.pattern = ""
        table.amend(route, entry)
        return route

    def check_replace(self, route: Route, entry: Entry) -> None:
        """Raise `LinkError` where `replace` or `edit_there` would."""
        if not same_route(route.proposal, entry.proposal):
            self._table.check_add(entry, instead_of=route)

    def entry(self, topic: Topic) -> Entry:
        """Return an entry of this side's session with its proposal; raise `LinkError` if it has a mistake."""
        link, session, prefixed = self._link, self._context.session, self._link.end.prefixed
        for problem in validate_topic(topic, session, client=link.name if prefixed else None):
            raise LinkError(str(problem))
        transport = self._context.transports[transport_of(topic, session).name]
        proposal = proposal_of(topic, transport, client_name=link.name, use_name=prefixed, profile=link.profile)
        check_features(use_of(proposal, is_client=link.is_client), session)
        return Entry(topic, proposal)

    # --- entries of the other side's session

    def names(self, entry: Entry) -> tuple[str, str]:
        """Return the key that an entry's route has, or will have, and the topic's name on this side."""
        proposal = entry.proposal
        return route_key(self._link.name, proposal), use_of(proposal, is_client=self._link.is_client).topic

    def demand(self, route: Route, topic: Topic) -> Topic:
        """Have this side's session demand what an edit of a route says that the other side lists.

        Returns:
            The edit without that: what is left to ask the other side for.

        Raises:
            LinkError: this session has no place for it.
        """
        old, here = route.spec, route.here
        new: dict[str, Any] = {name: getattr(topic, name) for name in ARMING_KEYS}
        # Each session that lists a topic has its own values of features' keys.
        new["features"] = of_peer((old if here is None else topic).features) | of_this_side(topic.features)
        if all(getattr(old, name) == value for name, value in new.items()):
            return topic
        if here is not None:
            proposal = msgspec.structs.replace(here.proposal, features=of_peer(topic.features))
            route.enter(Entry(msgspec.structs.replace(old, **new), proposal), route.there)
            self._context.demands.changed()
        elif new["features"] != old.features:
            raise LinkError(Denied.KEY_OF_SIDE(topic=route.local_topic, keys=", ".join(of_this_side(topic.features))))
        elif topic.arm:
            self._table.arming.keep_demand(self.names(self.entry(topic))[1], topic)
        elif topic.limits != old.limits:
            raise LinkError(Denied.LIMITS_OF_PEER(topic=route.local_topic))
        left = {name: getattr(route.spec, name) for name in ARMING_KEYS}
        features = of_this_side(route.spec.features) | of_peer(topic.features)
        return msgspec.structs.replace(topic, **left, features=features)

    async def edit_there(self, route: Route, topic: Topic) -> None:
        """Have the other side change its entry of a route.

        Raises:
            LinkError: it is out of reach, or does not change it.
        """
        was_listed, question = route.listed, self.question(route, topic)
        if topic.paused and not route.pausing.paused:
            self._table.pause(route, paused=True)
        if question is not None:
            if not (self._link.linked and question.route):
                raise LinkError(Denied.OUT_OF_REACH(topic=route.local_topic))
            if problem := await self._questions.ask(question.number, question):
                raise LinkError(f"refused by the other side: {problem}")
        entry = self.entry(topic)
        new = self._link.routes.get(self.names(entry)[0])
        if new is not None and new.pausing.paused and not topic.paused:
            self._table.pause(new, paused=False)
        if new is not None and was_listed and not new.listed:  # under another name
            self._list_too(new, entry)

    def question(self, route: Route, topic: Topic) -> Edit | None:
        """Return the message that asks the other side to put a topic in a route's place, or None if nothing differs."""
        running = (msgspec.structs.replace(each, paused=False) for each in (route.spec, topic))
        seen, wanted = (self.entry(each).proposal for each in running)
        if seen == wanted:
            return None
        self._asked += 1
        route_id = self._link.ids.last_of(route)
        return Edit(number=self._asked, route=route_id, seen=seen, wanted=wanted, who=acting_operator())

    def _answered(self, message: EditAnswer) -> None:
        self._questions.answered(message.number, message.problem)

    def _asked_to_edit(self, message: Edit) -> None:
        problem = ""
        try:
            self._edit_for_peer(message)
        except LinkError as error:
            problem = sanitize_text(str(error))

        async def answer() -> None:  # after the new proposal, whose task has begun before
            self._link.send(EditAnswer(message.number, problem))

        self._link.spawn(answer())

    def _edit_for_peer(self, message: Edit) -> None:
        """Change an entry as the peer asks for it; raise `LinkError` if the peer may not have that."""
        link, route = self._link, self._link.ids.find(message.route)
        if route is None or not (route.proposed_here and route.purpose.in_graph):
            raise LinkError(Denied.NOT_LISTED(topic=message.wanted.topic))
        check_wanted(message.wanted, link)
        seen, wanted = message.seen, message.wanted
        if (wanted.topic, wanted.remote_topic) != (seen.topic, seen.remote_topic):
            wanted = link.end.with_local_name(wanted)  # with `use_name`, a client reaches only its own names
        before = route.spec
        topic = edited_entry(before, seen, wanted, link)
        renamed = (before.identity, before.remote_topic) != (topic.identity, topic.remote_topic)
        if before.arm and renamed:  # the demand on each name that it had would stay, and a peer makes none grow
            raise LinkError(Denied.ARMED_THERE(topic=message.wanted.topic))
        ages = [effective_max_age((each.max_age,), armed=True) or math.inf for each in (before, topic)]
        if route.arming.required and ages[1] > ages[0]:
            raise LinkError(Denied.AGE_OF_ARMED(topic=message.wanted.topic))
        if before.port != topic.port and not link.is_client:
            raise LinkError(Denied.PORT_OF_SERVER(topic=message.wanted.topic))
        entry = self.entry(topic)
        use = use_of(entry.proposal, is_client=link.is_client)
        if use != use_of(route.proposal, is_client=link.is_client):
            check_use(use, link)
        new = self.replace(route, entry)
        self._table.changed_by_peer = True
        self._table.peer_operators.edited(new, message.who, before)
