"""What a peer proposes, checked before this side takes it up, and held to what the peer may do from then on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from rsb_bridge.config.rights import Rights, Use, uses
from rsb_bridge.config.topic_rules import overlap
from rsb_bridge.config.validation import validate_topic
from rsb_bridge.link.errors import LinkError
from rsb_bridge.link.proposals import kind_of, topic_of
from rsb_bridge.model.limits import ROUTES_PER_LINK, ROUTES_PROPOSED_BY_SERVER
from rsb_bridge.model.patterns import is_pattern

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from rsb_bridge.model.session import Session, Topic
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import Propose


class Authority(Protocol):
    """What decides about a peer's proposals: its link."""

    is_client: bool

    @property
    def rights(self) -> Rights:
        """What the peer may do here."""
        ...

    def bench_refusal(self, topic: str) -> str:
        """Why the peer may not measure the link now with a topic; empty: it may, or the topic is an ordinary one."""
        ...

    def with_local_name(self, proposal: Propose) -> Propose:
        """The peer's proposal with this side's name for the topic."""
        ...


def authorized(proposal: Propose, authority: Authority, session: Session) -> Propose:
    """The peer's proposal as this side takes it up, with this side's name for the topic.

    Raises:
        LinkError: the peer may not have it.
    """
    if is_pattern(proposal.topic + proposal.remote_topic):
        raise LinkError(f"{proposal.topic} is a pattern: the other side has to propose each that matches by its name")
    for problem in validate_topic(topic_of(proposal)):  # first: a prefix can make a valid name of an invalid one
        raise LinkError(str(problem))
    ours = authority.with_local_name(proposal)
    use = use_of(ours, is_client=authority.is_client)
    if refusal := authority.rights.refusal(use):
        raise LinkError(str(refusal))
    if refused := authority.bench_refusal(use.topic):
        raise LinkError(refused)
    for problem in validate_topic(topic_of(ours), session):
        raise LinkError(str(problem))
    if use.may == "publish" and use.topic == session.shutdown_topic:
        raise LinkError(f"{use.topic} is this side's shutdown topic: only its own domain may publish on it")
    return ours


def use_of(proposal: Propose, *, is_client: bool) -> Use:
    """What a peer does here with what it proposes, of a proposal that has this side's name for that."""
    kind = kind_of(proposal)
    sends, takes = uses(kind)
    if proposal.from_client != is_client:
        return Use(proposal.remote_topic, sends, proposal.transport, kind)
    return Use(proposal.topic, takes, proposal.transport, kind)


def check_room(routes: Collection[Route], session: Session) -> None:
    """Check that a peer may have this side keep one more route.

    Raises:
        LinkError: there are too many.
    """
    if len(routes) >= ROUTES_PER_LINK:
        raise LinkError(f"this link has {ROUTES_PER_LINK} topics and services already, which is the limit")
    if session.role == "server":
        return
    proposed = sum(1 for route in routes if not route.proposed_here)
    if proposed >= ROUTES_PROPOSED_BY_SERVER:
        raise LinkError(
            f"{session.name} has {proposed} topics and services of the server's already, which is the limit: "
            f"list further ones in the session file of {session.name}"
        )


def check_overlap(topic: Topic, routes: Iterable[Route]) -> None:
    """Check that no service of a new route is bridged already.

    Raises:
        LinkError: one is, by a route that is open or that this side proposes.
    """
    if clash := overlap(topic, [route.spec for route in routes if route.id or route.proposed_here]):
        raise LinkError(clash)


def denied(routes: Collection[Route], rights: Rights, *, is_client: bool) -> dict[Route, str]:
    """The routes that the peer proposed and may not have by these rights, each with the reason."""
    found = {
        route: rights.refusal(use_of(route.proposal, is_client=is_client))
        for route in routes
        if not route.proposed_here
    }
    return {route: str(refusal) for route, refusal in found.items() if refusal}


def allow_rate(route: Route, authority: Authority) -> bool:
    """Have a route keep to the rate that the peer may have; whether that is another one than before."""
    return route.limit.allow_here(authority.rights.max_rate(use_of(route.proposal, is_client=authority.is_client)))
