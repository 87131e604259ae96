"""What the other side of a link may do here: who decides about a topic asks it, and who lists what is allowed."""

from __future__ import annotations

import fnmatch
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from rsb_bridge.config.call_rules import service_names
from rsb_bridge.config.file_form import LISTS
from rsb_bridge.config.grants import CALL_USES, TOPIC_USES, allowing, denying, protocols_of
from rsb_bridge.config.yaml_text import inline
from rsb_bridge.model.benchmark import is_bench_topic
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.names import client_topic
from rsb_bridge.model.text import join_first

if TYPE_CHECKING:
    from collections.abc import Sequence, Set

    from rsb_bridge.model.benchmark import Leave
    from rsb_bridge.model.session import Client, Direction, Grant, Identity, Kind, May, Session

_NAMED = 6


class Use(NamedTuple):
    """What a peer wants to do with a topic, a service, an action or a node's parameters.

    Attributes:
        topic: its name on this side.
        may: publish it here or read it here; of what is not a topic, call what this side's nodes provide, or serve:
            provide what is offered to them.
        protocol: what carries it; empty: that is not known yet.
        kind: what it is.
    """

    topic: str
    may: May
    protocol: str = ""
    kind: Kind = "topic"

    def __str__(self) -> str:
        nouns = {"topic": "", "parameters": "the parameters of "}
        return f"{nouns.get(self.kind, f'{self.kind} ')}{self.topic}"


def uses(kind: Kind) -> tuple[May, May]:
    """What a peer may do with a kind: where it sends the messages or requests, and where it takes them."""
    return TOPIC_USES if kind == "topic" else CALL_USES


_LISTED_AS: dict[May, tuple[Direction, str]] = {
    "publish": ("receive", "direction: receive"),
    "call": ("receive", "provider: client"),
    "serve": ("transmit", "provider: server"),
}
"""How a client lists what it has the server do."""
_OF_PARAMETERS = {lane.suffix for lane in LANES["parameters"] if lane.suffix}


class Refusal(NamedTuple):
    """Why a peer may not do something.

    Attributes:
        reason: what this side says to it.
        remedy: what in which session file would allow it.
    """

    reason: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.reason}: {self.remedy}"


@dataclass(frozen=True, slots=True)
class Rights:
    """What one peer may do here.

    Attributes:
        peer: who: the client's name; on a client: ``the server``.
        owner: who says so: ``the server``, or the client's name.
        place: where `allow` and `deny` are: ``under client robot1 in pc's session file``.
        allow: what it may do; empty: everything, or on a client what `listed` says.
        deny: what it may not do all the same.
        prefix: a client's name, which the names of its topics may have before them here.
        listed: on a client, the identities of its own topics (`Topic.identity`), which say what the server may publish,
            call and serve.
        bench: whether it may measure the link, and what it may cause by that.
    """

    peer: str
    owner: str
    place: str
    allow: tuple[Grant, ...]
    deny: tuple[Grant, ...]
    prefix: str = ""
    listed: Set[Identity] | None = None
    bench: Leave | None = None

    def refusal(self, use: Use) -> Refusal | None:
        """Why the peer may not do something; None: it may."""
        if is_bench_topic(use.topic):
            return None if self.bench is not None and use.kind == "topic" else self._no_leave()
        for grant in self._about(self.deny, use, also=_meant_by(use)):
            if not grant.protocol or use.protocol in protocols_of(grant):
                return Refusal(f"{self.owner} denies {use} to {self.peer}", f"deny {self.place} has {_text(grant)}")
        allowing = self._about(self.allow, use)
        for grant in allowing:
            if grant.protocol and use.protocol and use.protocol not in protocols_of(grant):
                only = join_first(protocols_of(grant), _NAMED)
                reason = f"{self.owner} allows {use} to {self.peer} over {only} only"
                return Refusal(reason, f"allow {self.place} has {_text(grant)}")
        if allowing or self._by_default(use):
            return None
        return Refusal(f"{self.owner} does not let {self.peer} {use.may} {use}", self._remedy(use))

    def _no_leave(self) -> Refusal:
        reason = f"{self.owner} does not let {self.peer} measure this link"
        where = f"to {self.place.removeprefix('of ')}" if self.place.startswith("of ") else self.place
        return Refusal(reason, f"add bench: {{}} {where}")

    def max_rate(self, use: Use) -> float:
        """The most messages or calls a second that may cross, whoever asked for them; 0: there is no limit."""
        return min((grant.max_rate for grant in self._about(self.allow, use) if grant.max_rate), default=0.0)

    def shows(self, topic: str, kind: Kind = "topic") -> bool:
        """Whether the peer may know of a topic or of what else there is: it may do something with it."""
        return any(self.refusal(Use(topic, may, kind=kind)) is None for may in uses(kind))

    def _by_default(self, use: Use) -> bool:
        """Whether the peer may do what no entry of `allow` is about."""
        if self.listed is not None and use.may != "read":
            return (use.kind, use.topic, _LISTED_AS[use.may][0]) in self.listed
        return not self.allow

    def _remedy(self, use: Use) -> str:
        entry = f"{{{'topics' if use.kind == 'topic' else 'services'}: {use.topic}, may: {use.may}}}"
        if self.listed is None or use.may == "read":
            return f"add {entry} to allow {self.place}"
        listing = f"list it under {LISTS[use.kind]} {self.place}, with {_LISTED_AS[use.may][1]}"
        return f"{listing}, or add {entry} to allow there" if self.allow else listing

    def _about(self, grants: Sequence[Grant], use: Use, also: Sequence[str] = ()) -> list[Grant]:
        """The entries that say something about such a use, by its name or by other names."""
        own = (use.topic, *also)
        names = {*own, *(client_topic(name, self.prefix) or name for name in own if self.prefix)}
        return [
            grant
            for grant in grants
            if grant.may in (None, use.may)
            and (pattern := grant.topics if use.kind == "topic" else grant.services) is not None
            and any(fnmatch.fnmatchcase(name, pattern) for name in names)
        ]


def rights_of_client(client: Client, server: str) -> Rights:
    """What a client may do on the server of that name."""
    return Rights(
        client.name,
        "the server",
        f"of client {client.name} in the session file of {server}",
        tuple(map(allowing, client.allow)),
        tuple(map(denying, client.deny)),
        prefix=client.name,
        bench=client.bench,
    )


def rights_of_server(session: Session, listed: Set[Identity] | None = None) -> Rights:
    """What the server may do on a client.

    Args:
        session: the client's.
        listed: the identities of the client's topics as operators have left them; None: as the session says.
    """
    if listed is None:
        listed = {topic.identity for topic in session.topics}
    return Rights(
        "the server",
        session.name,
        f"in the session file of {session.name}",
        tuple(map(allowing, session.allow)),
        tuple(map(denying, session.deny)),
        listed=listed,
        bench=session.bench,
    )


class _Everything(frozenset["Identity"]):
    """A set that has everything."""

    def __contains__(self, _: object) -> bool:
        return True


def as_if_listed(rights: Rights) -> Rights:
    """What a peer may do with what this side's session lists, whatever that is."""
    return rights if rights.listed is None else replace(rights, listed=_Everything())


def listed_as(may: May) -> Direction:
    """The direction of what a client lists, and by that has the server do."""
    return _LISTED_AS[may][0]


def _meant_by(use: Use) -> list[str]:
    """The other names by which an entry of `deny` means what is used.

    Who denies one service of an action or of a node's parameters denies what would bridge it with the others, and who
    denies a node's parameters denies each service of them.
    """
    if use.kind == "service":
        node, _, last = use.topic.rpartition("/")
        return [node] if f"/{last}" in _OF_PARAMETERS else []
    return [] if use.kind == "topic" else service_names(use.kind, use.topic)


def _text(grant: Grant) -> str:
    """An entry as it is in a session file."""
    plain = msgspec.to_builtins(grant)
    if grant.topics == grant.services or plain.keys() == {"topics"}:
        return grant.topics or ""
    return inline(plain)
