"""Converts topics to proposals and back, compares the two, and checks a peer's against its rights and its room."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from rsb_bridge import __version__
from rsb_bridge.config.grants import uses
from rsb_bridge.config.rights import Use
from rsb_bridge.config.session_changes import values_apart
from rsb_bridge.config.topic_rules import entry_problems, internal_problems, problems_here
from rsb_bridge.installed_features import failed, features_with
from rsb_bridge.link.extension import Denied, LinkError
from rsb_bridge.model.by_hand import end_text
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.limits import ROUTES_PER_LINK, ROUTES_PROPOSED_BY_SERVER, TEXT_LENGTH
from rsb_bridge.model.names import client_topic, server_topic
from rsb_bridge.model.patterns import is_pattern
from rsb_bridge.model.purposes import TOPIC, Purpose, purposes
from rsb_bridge.model.session import RANKS, Topic, priority_of
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.topic_keys import ADDED_KEYS, CORE_KEYS, of_peer, of_this_side, without_defaults
from rsb_bridge.model.transports import NO_PROFILE, compression_of
from rsb_bridge.route.route import Entry, route_key
from rsb_bridge.wire.messages import Amend, Propose

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rsb_bridge.config.rights import DeniedUse, Rights
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.model.session import Kind, Session
    from rsb_bridge.model.transports import LinkProfile
    from rsb_bridge.route.route import Route
    from rsb_bridge.transport.transport import Transport

T = TypeVar("T")
KINDS: dict[str, Kind] = {kind: kind for kind in LANES}
"""The kinds that this version knows, by their names on the wire."""


def proposal_of(
    topic: Topic,
    transport: Transport,
    *,
    client_name: str,
    use_name: bool,
    profile: LinkProfile = NO_PROFILE,
    purpose: Purpose = TOPIC,
) -> Propose:
    """Return the proposal of a topic to the peer; a value that sets nothing there is 0, or None if 0 is one of its own.

    Args:
        topic: the validated topic, with the client's names.
        use_name: whether the server's name of the topic has the client's name before it.
    """
    on_server = topic.remote_topic or (server_topic(topic.topic, client_name) if use_name else topic.topic)
    from_client = topic.direction == "transmit"
    return Propose(
        route=1,  # its id is given when it is sent
        topic=topic.topic if from_client else on_server,
        remote_topic=on_server if from_client else topic.topic,
        from_client=from_client,
        type="" if topic.type == "auto" else topic.type,
        transport=transport.name,
        qos=topic.parsed_qos(),
        compression=compression_of(topic.compression, profile, transport.compression),
        deadman=topic.deadman_seconds if topic.arm else 0.0,
        on_end=end_text(topic.on_end) if topic.arm else "",
        kind=topic.kind,
        priority=RANKS[topic.priority],
        purpose=purpose.name,
        port=topic.port or 0,
        max_rate=topic.max_rate or 0.0,
        expected_rate=topic.expected_rate or 0.0,
        stale_after=topic.stale_after,
        late_after=topic.late_after,
        max_age=topic.max_age,
        paused=topic.paused,
        arm=topic.arm,
        limits=topic.limits,
        keep=topic.kept,
        beat=topic.beat or "",
        lazy=topic.lazy,
        renew=topic.renew,
        express=topic.express,
        timeout=topic.timeout or 0.0,
        features=of_peer(topic.features) if topic.features else {},
    )


def topic_of(proposal: Propose) -> Topic:
    """Return a peer's proposal as an entry of a session; raise `LinkError` if only newer versions know its kind."""
    here, there = proposal.topic, proposal.remote_topic
    on_client, on_server = (here, there) if proposal.from_client else (there, here)
    return Topic(
        topic=on_client,
        direction="transmit" if proposal.from_client else "receive",
        type=proposal.type or "auto",
        protocol=proposal.transport,
        qos=msgspec.to_builtins(proposal.qos) if proposal.qos else "auto",
        remote_topic=on_server,
        compression=proposal.compression,
        deadman=proposal.deadman if proposal.arm else None,
        on_end=(proposal.on_end or None) if proposal.arm else None,
        kind=_known(KINDS, proposal.kind),
        priority=priority_of(proposal.priority) if proposal.kind == "topic" else "normal",  # calls rank above topics
        port=proposal.port or None,
        max_rate=proposal.max_rate or None,
        expected_rate=proposal.expected_rate or None,
        stale_after=proposal.stale_after,
        late_after=proposal.late_after,
        max_age=proposal.max_age,
        paused=proposal.paused,
        arm=proposal.arm,
        limits=proposal.limits,
        keep=proposal.keep,
        beat=proposal.beat or None,
        lazy=proposal.lazy,
        renew=proposal.renew,
        express=proposal.express,
        timeout=proposal.timeout or None,
        features=_features_of(proposal) if proposal.features else {},
    )


def _features_of(proposal: Propose) -> dict[str, Any]:
    """Return the values of features' keys in a peer's proposal; raise `LinkError` if one is of another type."""
    found = {}
    for name, value in of_peer(proposal.features).items():
        try:
            found[name] = msgspec.convert(value, ADDED_KEYS[name].type)
        except msgspec.ValidationError as error:
            raise LinkError(f"{name}: {error}") from error
    return without_defaults(found)


def _known(names: Mapping[str, T], name: str) -> T:
    """Return the meaning of a name in a peer's proposal; raise `LinkError` if only newer versions know it."""
    if (found := names.get(name)) is None:
        raise LinkError(f"rsb-console {__version__} does not know what {name} is: update it")
    return found


def same_route(one: Propose, other: Propose) -> bool:
    """Whether two proposals differ in nothing but their ids, a pause, and what can change in an open route."""
    of_an_opening = {"route": 1, "paused": False, "pause_revision": 0, "who": "", "place": "", "by_pattern": False}
    one, other = (msgspec.structs.replace(each, **of_an_opening) for each in (amended(one, other), other))
    return one == other


_LIVE = (*(name for name, key in CORE_KEYS.items() if key.live), "features")
"""Keys whose change leaves a route open, and their names on the wire: its *limits*."""


def _limits(source: Propose | Amend | Topic) -> dict[str, Any]:
    return {name: getattr(source, name) for name in _LIVE}


def amended(proposal: Propose, limits: Propose | Amend) -> Propose:
    """Return a proposal with the limits of another one, or of a change."""
    return msgspec.structs.replace(proposal, **_limits(limits))


def amendment(proposal: Propose, route_id: int, who: str = "") -> Amend:
    """Return the message with a proposal's limits; `who` has changed them, or is empty."""
    return Amend(route_id, who=who, **_limits(proposal))


def amended_topic(topic: Topic, limits: Propose) -> Topic:
    """Return a topic with a proposal's limits."""
    changed = _limits(topic_of(limits))
    if topic.features:
        changed["features"] = of_this_side(topic.features) | changed["features"]
    return msgspec.structs.replace(topic, **changed)


def amended_entry(entry: Entry, limits: Propose | Amend) -> Entry:
    """Return an entry with the limits of a proposal, or of a change."""
    proposal = amended(entry.proposal, limits)
    return Entry(amended_topic(entry.topic, proposal), proposal)


def amended_by_peer(entry: Entry, limits: Amend, purpose: Purpose, link: BaseLink) -> Entry:
    """Return the peer's entry with its change; raise `LinkError` if a proposal of that would have a mistake."""
    entry = amended_entry(entry, limits)
    internal = not purpose.in_graph
    found = internal_problems(entry.topic, purpose, link.context.session) if internal else entry_problems(entry.topic)
    for problem in found:
        raise LinkError(str(problem))
    return entry


ARMING_KEYS = ("arm", "deadman", "on_end", "limits")
"""Keys that each session sets for itself: what either one demands holds."""
_OF_SESSION = frozenset({*ARMING_KEYS, "paused", "excepts"})


def edited_entry(entry: Topic, old: Propose, new: Propose, link: BaseLink) -> Topic:
    """Return an entry with what differs between two proposals of it, except what each session demands for itself."""
    before, after = topic_of(old), topic_of(new)
    differing = (name for name in Topic.__struct_fields__ if getattr(after, name) != getattr(before, name))
    changed = {name: getattr(after, name) for name in differing if name not in _OF_SESSION}
    if "features" in changed:
        changed["features"] = of_this_side(entry.features) | after.features
    if changed.keys() & {"topic", "remote_topic"}:
        usual_name = server_topic(after.topic, link.name) if link.end.use_name else after.topic
        changed["remote_topic"] = None if after.remote_topic == usual_name else after.remote_topic
    return msgspec.structs.replace(entry, **changed)


def _with_server_name(proposal: Propose, link: BaseLink) -> Propose:
    """Return this side's proposal with the name that the server gives the topic."""
    field = "remote_topic" if proposal.from_client else "topic"
    name = getattr(proposal, field)
    if link.is_client and link.end.use_name and client_topic(name, link.name) is None:
        proposal = msgspec.structs.replace(proposal, **{field: server_topic(name, link.name)})
    return proposal


def place_of(entry: Topic, link: BaseLink, pattern: str = "") -> str:
    """Return where this side's file lists an entry, or the pattern that has made it, or an empty string."""
    identity = entry.kind, pattern or entry.topic, entry.direction
    return sanitize_text(link.context.in_file.place("" if link.is_client else link.name, identity), TEXT_LENGTH)


def listed_differently(ours: Entry, theirs: Propose, link: BaseLink) -> str:
    """Return how this side's entry differs from the peer's in what both have to agree on, or an empty string."""
    entry = ours.topic
    here, there = topic_of(_with_server_name(ours.proposal, link)), topic_of(theirs)
    own, other = here.parsed_qos(), there.parsed_qos()
    if own and other:  # only the policies that differ
        names = [name for name in own.__struct_fields__ if getattr(own, name) != getattr(other, name)]
        here, there = (
            msgspec.structs.replace(each, qos={name: getattr(qos, name) for name in names})
            for each, qos in ((here, own), (there, other))
        )
    # Each side's profile chooses where an entry leaves that open.
    left_open = {"compression"} if entry.compression is None else set()
    mine, others = values_apart(here, there, leave_out=_OF_SESSION | {"max_age", *ADDED_KEYS} | left_open)
    place, far_place = place_of(entry, link) or Denied.THIS_SESSION(), theirs.place or Denied.ITS_SESSION()
    return Denied.LISTED_DIFFERENTLY(here=place, mine=mine, there=far_place, theirs=others) if mine else ""


def authorized(proposal: Propose, link: BaseLink) -> tuple[Entry, Route | None]:
    """Return the peer's proposal with this side's name for the topic, as an entry, and the route of that name.

    Raises:
        LinkError: it has a mistake, or the peer may not have the topic.
    """
    purpose = _known(purposes(), proposal.purpose)
    if not purpose.in_graph:
        entry = topic_of(proposal)
        _check_internal(entry, proposal, purpose, link)
        return Entry(entry, proposal), link.routes.get(route_key(link.name, proposal))
    entry = check_wanted(proposal, link)
    ours = link.end.with_local_name(proposal)
    if renamed := ours != proposal:
        entry = topic_of(ours)
    for problem in problems_here(entry, link.context.session, renamed=renamed):
        raise LinkError(str(problem))
    own = link.routes.get(route_key(link.name, ours))
    here = own.here if own is not None and own.listed else None
    if here is None or listed_differently(here, ours, link):
        check_use(use_of(ours, is_client=link.is_client), link)  # what this side's session lists needs none
    return Entry(entry, ours), own


def check_wanted(proposal: Propose, link: BaseLink) -> Topic:
    """Return the entry that a peer wants; raise `LinkError` if it has a mistake by itself."""
    if pattern := next(filter(is_pattern, (proposal.topic, proposal.remote_topic)), ""):
        raise LinkError(f"{pattern} is a pattern: the other side has to propose each that matches by its name")
    # Before this side's name is there: a prefix can make a valid name of an invalid one.
    for problem in entry_problems(entry := topic_of(proposal)):
        raise LinkError(str(problem))
    return entry


def check_use(use: Use, link: BaseLink) -> None:
    """Raise `LinkError` if the peer may not use a topic of this side."""
    if refusal := link.end.rights.refusal(use):
        raise LinkError(str(refusal))
    if use.may == "publish" and use.topic == link.context.session.shutdown_topic:
        raise LinkError(Denied.SHUTDOWN_TOPIC(topic=use.topic))
    check_features(use, link.context.session)


def _check_internal(entry: Topic, proposal: Propose, purpose: Purpose, link: BaseLink) -> None:
    """Raise `LinkError` if the peer may not have an internal route, whose name is the same on both sides."""
    for problem in internal_problems(entry, purpose, link.context.session):
        raise LinkError(str(problem))
    if proposal.qos is not None and proposal.qos.latched:
        raise LinkError(f"a route for {purpose.name} needs a QoS that keeps nothing for late joiners")
    if refusal := _refusal(proposal, link, link.end.rights) or link.extensions.serving(purpose).refusal(proposal.topic):
        raise LinkError(str(refusal))


def _refusal(proposal: Propose, link: BaseLink, rights: Rights) -> DeniedUse | None:
    """Return why the peer may not have what it proposed, by this side's names, or None if it may."""
    purpose = purposes()[proposal.purpose]
    if purpose.in_graph:
        return rights.refusal(use_of(proposal, is_client=link.is_client))
    return link.extensions.serving(purpose).denial(rights, sends=proposal.from_client != link.is_client)


def check_features(use: Use, session: Session) -> None:
    """Raise `LinkError` if a feature keeps a topic for itself."""
    for feature in features_with("refusal"):
        if use.kind != "topic":
            continue
        try:
            refusal = feature.refusal(session, use.topic)
        except Exception as error:  # noqa: BLE001 -- of code that is not ours
            failed(feature.name, "refusal", error)
            continue
        if refusal:
            raise LinkError(refusal)


def use_of(proposal: Propose, *, is_client: bool) -> Use:
    """Return the peer's use of a topic on this side, by a proposal with this side's name."""
    kind = _known(KINDS, proposal.kind)
    sends, takes = uses(kind)
    if proposal.from_client != is_client:
        return Use(proposal.remote_topic, sends, proposal.transport, kind)
    return Use(proposal.topic, takes, proposal.transport, kind)


def check_room(link: BaseLink) -> None:
    """Raise `LinkError` if the peer may have this side keep no further route."""
    routes = link.routes.values()
    if len(routes) >= ROUTES_PER_LINK:
        raise LinkError(Denied.TOO_MANY_ROUTES(limit=ROUTES_PER_LINK))
    if not link.is_client:
        return
    proposed = sum(1 for route in routes if not route.proposed_here)
    if proposed >= ROUTES_PROPOSED_BY_SERVER:
        raise LinkError(Denied.TOO_MANY_OF_SERVER(client=link.name, count=proposed))


def denied(link: BaseLink, rights: Rights) -> dict[Route, str]:
    """Return the routes that the peer proposed and may not have by these rights, each with the reason."""
    found = {}
    for route in link.routes.values():
        if not (route.proposed_here or route.listed) and (refusal := _refusal(route.proposal, link, rights)):
            found[route] = str(refusal)
    return found


def allow_rate(route: Route, link: BaseLink) -> bool:
    """Limit a route to the rate that the peer may have. Return whether the limit has changed."""
    if not route.purpose.in_graph:
        return False  # the feature that serves the purpose has limits of its own
    return route.limit.allow_here(link.end.rights.max_rate(use_of(route.proposal, is_client=link.is_client)))
