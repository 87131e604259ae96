"""Rights of the other side of a link: what its entries of `allow` and `deny` permit."""

from __future__ import annotations

import fnmatch
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from rsb_bridge.config.file_form import LISTS
from rsb_bridge.config.grants import allowing, covers, denying, entry_text, protocols_of, uses
from rsb_bridge.config.overlaps import service_names
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.names import client_topic
from rsb_bridge.model.text import join_first
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence, Set

    from rsb_bridge.model.session import Client, Direction, Grant, Identity, Kind, May, Session

_NAMED = 6
LISTED_AS: dict[May, tuple[Direction, str]] = {
    "publish": ("receive", "direction: receive"),
    "call": ("receive", "provider: client"),
    "serve": ("transmit", "provider: server"),
}
"""The direction of a client's entry for each right of the server, and its text in a session file."""
_OF_PARAMETERS = {lane.suffix for lane in LANES["parameters"] if lane.suffix}


class Place(Wording):
    """The part of a session file that has a peer's `allow` and `deny`."""

    ON_SERVER = "of client {client} in the session file of {server}"
    ON_CLIENT = "in the session file of {client}"


class DeniedText(Wording):
    """The reason why a peer may not use a topic or a service."""

    DENIED = "{owner} denies {use} to {peer}"
    OTHER_PROTOCOL = "{owner} allows {use} to {peer} over {protocols} only"
    NOT_ALLOWED = "{owner} does not let {peer} {may} {use}"
    NOT_LET = "{owner} does not let {peer} {act}"


class DeniedRemedy(Wording):
    """The change of a session file that would allow it."""

    CHANGE_DENY = "change {entry} in deny {place}"
    CHANGE_ALLOW = "change {entry} in allow {place}"
    ADD_LOOK = "add {{topics: PATTERN, may: look}} to allow {place}"
    NARROW_DENY = "narrow {entry} in deny {place}, which includes look"
    ADD_ALLOW = "add {entry} to allow {place}"
    ADD = "add {entry} {where}"
    LIST = "list it under {list} {place}, with {direction}"
    LIST_OR_ALLOW = "list it under {list} {place}, with {direction}, or add {entry} to allow there"


class Use(NamedTuple):
    """A peer's use of a topic, a service, an action or a node's parameters by its name on this side."""

    topic: str
    may: May  # ``publish`` or ``read`` a topic here; ``call`` a service of this side's nodes, or ``serve`` one to them
    protocol: str = ""  # the transport, or an empty string if it is not known yet
    kind: Kind = "topic"

    def __str__(self) -> str:
        nouns = {"topic": "", "parameters": "the parameters of "}
        return f"{nouns.get(self.kind, f'{self.kind} ')}{self.topic}"


class DeniedUse(NamedTuple):
    """The reason, for the peer, and the change of a session file that would allow the use."""

    reason: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.reason}: {self.remedy}"


@dataclass(frozen=True, slots=True)
class Rights:
    """The rights of one peer on this side."""

    peer: str  # the client's name; on a client ``the server``
    owner: str  # the side with the session file: ``the server``, or the client's name
    place: str
    """The part of the session file that has `allow` and `deny`: ``of client robot1 in the session file of pc``."""
    allow: tuple[Grant, ...]  # the uses that it permits. If empty, it permits all; on a client, `listed`
    deny: tuple[Grant, ...]  # the uses that it forbids. It is stronger than `allow`
    prefix: str = ""  # a client's name, which the names of its topics may have before them here
    listed: Set[Identity] | None = None
    """On a client, the identities of its own topics (`Topic.identity`), which say what the server may publish, call and
    serve."""
    features: Mapping[str, Any] = field(default_factory=dict)
    """The rights that features give the peer, by key of session files (`SessionKey.of`)."""

    def refusal(self, use: Use) -> DeniedUse | None:
        """Return the reason why the peer may not do something, or None if it may."""
        # While the transport is not known, an entry about some of them denies nothing yet.
        for grant in self._about(self.deny, use, also=_meant_by(use)):
            if not grant.protocol or use.protocol in protocols_of(grant):
                return DeniedUse(
                    DeniedText.DENIED(owner=self.owner, use=use, peer=self.peer),
                    DeniedRemedy.CHANGE_DENY(place=self.place, entry=entry_text(grant)),
                )
        allowed = self._about(self.allow, use)
        for grant in allowed:
            if grant.protocol and use.protocol and use.protocol not in protocols_of(grant):
                only = join_first(protocols_of(grant), _NAMED)
                reason = DeniedText.OTHER_PROTOCOL(owner=self.owner, use=use, peer=self.peer, protocols=only)
                return DeniedUse(reason, DeniedRemedy.CHANGE_ALLOW(place=self.place, entry=entry_text(grant)))
        if self.listed is None or use.may not in LISTED_AS:
            if allowed or not self.allow:
                return None
            remedy, listed_as = DeniedRemedy.ADD_ALLOW, ""
        else:  # the entries of a client say what the server may publish, call and serve
            direction, listed_as = LISTED_AS[use.may]
            if allowed or (use.kind, use.topic, direction) in self.listed:
                return None
            remedy = DeniedRemedy.LIST_OR_ALLOW if self.allow else DeniedRemedy.LIST
        entry = f"{{{'topics' if use.kind == 'topic' else 'services'}: {use.topic}, may: {use.may}}}"
        return DeniedUse(
            DeniedText.NOT_ALLOWED(owner=self.owner, peer=self.peer, may=use.may, use=use),
            remedy(list=LISTS[use.kind], place=self.place, direction=listed_as, entry=entry),
        )

    def lacks(self, act: str, entry: str) -> DeniedUse:
        """Return that the peer may not do something that a feature offers, for lack of an entry of the session file."""
        where = f"to {self.place.removeprefix('of ')}" if self.place.startswith("of ") else self.place
        reason = DeniedText.NOT_LET(owner=self.owner, peer=self.peer, act=act)
        return DeniedUse(reason, DeniedRemedy.ADD(entry=entry, where=where))

    def no_look(self) -> DeniedUse | None:
        """Return the reason why the peer may look at no topic at all, or None. Each topic is checked when it looks."""
        reason = DeniedText.NOT_LET(owner=self.owner, peer=self.peer, act="look at any topic")
        for grant in self.deny:
            # Only what every name matches: /*/* leaves /scan.
            is_any = grant.topics is not None and not grant.topics.removeprefix("/").strip("*")
            if is_any and covers(grant, "look") and not grant.protocol:
                return DeniedUse(reason, DeniedRemedy.NARROW_DENY(entry=entry_text(grant), place=self.place))
        if self.allow and not any(grant.topics and covers(grant, "look") for grant in self.allow):
            return DeniedUse(reason, DeniedRemedy.ADD_LOOK(place=self.place))
        return None

    def max_rate(self, use: Use) -> float:
        """Return the limit of messages or calls in Hz, or 0 for none. Requests of either side share it."""
        return min((grant.max_rate for grant in self._about(self.allow, use) if grant.max_rate), default=0.0)

    def shows(self, topic: str, kind: Kind = "topic") -> bool:
        """Whether the peer may know of a name: it has at least one right to use it."""
        return any(self.refusal(Use(topic, may, kind=kind)) is None for may in uses(kind))

    def _about(self, grants: Sequence[Grant], use: Use, also: Sequence[str] = ()) -> list[Grant]:
        """Return the entries that apply to a use, by its name or by other names."""
        if not grants:
            return []
        own = (use.topic, *also)
        names = {*own, *(client_topic(name, self.prefix) or name for name in own if self.prefix)}
        return [
            grant
            for grant in grants
            if covers(grant, use.may)
            and (pattern := grant.topics if use.kind == "topic" else grant.services) is not None
            and any(fnmatch.fnmatchcase(name, pattern) for name in names)
        ]


def rights_of_client(client: Client, server: str) -> Rights:
    return Rights(
        client.name,
        "the server",
        Place.ON_SERVER(client=client.name, server=server),
        tuple(map(allowing, client.allow)),
        tuple(map(denying, client.deny)),
        prefix=client.name,
        features=client.features,
    )


def rights_of_server(session: Session, listed: Set[Identity] | None = None) -> Rights:
    """Return the rights of the server on a client.

    Args:
        listed: the identities of the client's topics at present, or None for the topics in its session.
    """
    if listed is None:
        listed = {topic.identity for topic in session.topics}
    return Rights(
        "the server",
        session.name,
        Place.ON_CLIENT(client=session.name),
        tuple(map(allowing, session.allow)),
        tuple(map(denying, session.deny)),
        listed=listed,
        features=session.features,
    )


def as_if_listed(rights: Rights) -> Rights:
    """Return the rights as if this side's session listed every topic."""
    return rights if rights.listed is None else replace(rights, listed=_Everything())


class _Everything(frozenset["Identity"]):
    def __contains__(self, _: object) -> bool:
        return True


def _meant_by(use: Use) -> list[str]:
    """Return the other names under which an entry of `deny` forbids a use.

    An entry that denies one service of an action or of a node's parameters denies all of them, because they are bridged
    together. An entry that denies a node's parameters denies each service of them.
    """
    if use.kind == "service":
        node, _, last = use.topic.rpartition("/")
        return [node] if f"/{last}" in _OF_PARAMETERS else []
    return [] if use.kind == "topic" else service_names(use.kind, use.topic)
