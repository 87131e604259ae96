"""Names that have to be armed, or have a `max_age`. A session's demand belongs to the name, on every route."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final, TypeAlias

import msgspec

from rsb_bridge.model.lanes import LANES
from rsb_bridge.model.max_age import ARMED, default_max_age, smallest_max_age
from rsb_bridge.model.names import server_topic
from rsb_bridge.model.patterns import Pattern, is_pattern
from rsb_bridge.model.qos import AUTO
from rsb_bridge.model.session import DEADMAN, Armed, Client, Identity, Kind, Session, Topic
from rsb_bridge.model.type_names import expand_type_name

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

PEER_DEMANDS: Final = "the other side's session"
"""The origin of a demand that the other side makes."""
_KINDS_OF_SERVICES: Final[tuple[Kind, ...]] = ("action", "parameters")

SourceKey: TypeAlias = tuple[str, Identity | str]
"""An entry by its client's name (empty in a client's session) and its identity; an entry of `armed` by its name."""


@dataclass(frozen=True, slots=True)
class Source:
    """One line of a session that demands arming or a `max_age`.

    Attributes:
        key: identifies the entry.
        name: a name or a pattern on this side.
        deadman: in seconds, or 0 for none.
        kind: of the names, or None for every kind.
        type: of the names, or an empty string for every type.
        on_client: the name as the client has it, to which `excepts` refers.
        excepts: names and patterns on the client that a pattern leaves out.
        arm: whether it demands arming.
        max_age: in seconds, 0 for no limit, or None if it says nothing.
    """

    key: SourceKey
    name: str
    deadman: float
    kind: Kind | None = None
    type: str = ""
    on_client: str = ""
    excepts: tuple[str, ...] = ()
    arm: bool = True
    max_age: float | None = None

    @property
    def is_pattern(self) -> bool:
        """Whether it is a pattern, and matches many names."""
        return is_pattern(self.name)


@dataclass(frozen=True, slots=True)
class Demand:
    """The demand on one name, of all lines that match it.

    Attributes:
        deadman: the shortest time in seconds, or 0 for none.
        max_age: the smallest limit in seconds, 0 for no limit, or None if no line says anything.
        sources: the lines that demand arming.
    """

    deadman: float
    max_age: float | None
    sources: tuple[Source, ...]

    @property
    def arm(self) -> bool:
        """Whether it has to be armed."""
        return bool(self.sources)


NO_DEMAND: Final = Demand(0.0, None, ())
"""The demand on a name that no line matches."""


def local_name(topic: Topic, client: str, *, on_server: bool, use_name: bool) -> str:
    """Return the name of an entry on the side that has the session.

    Args:
        topic: the entry, as the client sees it.
        client: the client's name.
        on_server: whether the side is a server.
        use_name: whether the server prefixes the client's topics.
    """
    if not on_server:
        return topic.topic
    return topic.remote_topic or (server_topic(topic.topic, client) if use_name else topic.topic)


def sources_of_entries(topics: Iterable[Topic], client: str, *, on_server: bool, use_name: bool) -> Iterator[Source]:
    """Yield the entries of one link that demand anything; `local_name` has the same arguments."""
    for topic in topics:
        if topic.arm or topic.max_age is not None:
            name = local_name(topic, client, on_server=on_server, use_name=use_name)
            key = client if on_server else "", topic.identity
            type_name = full_type(topic.type) if topic.is_pattern else ""
            yield Source(
                key,
                name,
                topic.deadman_seconds if topic.arm else 0.0,
                topic.kind,
                type_name,
                topic.topic,
                topic.excepts,
                arm=topic.arm,
                max_age=default_max_age(topic.max_age, armed=topic.arm),
            )


def sources_of_names(armed: Iterable[str | Armed]) -> Iterator[Source]:
    """Yield what a session's `armed` demands."""
    for each in armed:
        entry = Armed(each) if isinstance(each, str) else each
        key = "", f"{entry.kind or ''} {entry.type or ''} {entry.name}".strip()
        max_age = default_max_age(entry.max_age, armed=True)
        type_name = full_type(entry.type or AUTO)
        yield Source(key, entry.name, entry.deadman_seconds, entry.kind, type_name, max_age=max_age)


def sources_of(session: Session) -> Iterator[Source]:
    """Yield every line of a session that demands anything."""
    yield from sources_of_names(session.armed)
    if session.role == "client":
        yield from sources_of_entries(session.topics, session.name, on_server=False, use_name=False)
        return
    for client in session.accepted_clients:
        use_name = session.use_name if client.use_name is None else client.use_name
        yield from sources_of_entries(client.topics, client.name, on_server=True, use_name=use_name)


class Demands:
    """Demands on names, from the lines of a session.

    Args:
        sources: the lines, in any order: all that match a name count.
    """

    def __init__(self, sources: Iterable[Source] = ()) -> None:
        self.sources = tuple(dict.fromkeys(sources))
        self._by_name: dict[str, list[Source]] = {}
        self._patterns: list[tuple[str, Pattern, Pattern, tuple[Pattern, ...], Source]] = []
        self._of_client: dict[str, list[Source]] = {}
        for source in self.sources:
            if source.is_pattern:
                excepts = tuple(map(_pattern, source.excepts))
                on_client = _pattern(source.on_client or source.name)
                beginning = source.name.partition("*")[0].rstrip("/")  # of all names that match
                self._patterns.append((beginning, _pattern(source.name), on_client, excepts, source))
            else:
                self._by_name.setdefault(source.name, []).append(source)
            if source.key[0]:
                self._of_client.setdefault(source.key[0], []).append(source)

    def of(
        self, kind: Kind, name: str, type_name: str = "", *, client: str = "", client_name: str = ""
    ) -> Demand | None:
        """Return the demand on a name, or None if no line matches it.

        A service of an action or of a node's parameters has the demands of both. A server's entries for a client match
        the client's name, too: a client that bridges it to another name of the server ends no demand.

        Args:
            kind: of what has the name.
            name: on this side.
            type_name: its type, or an empty string if it is unknown: then lines of every type match.
            client: on a server, the client's name.
            client_name: on a server, what the client calls it.
        """
        type_name = full_type(type_name or AUTO)
        found = dict.fromkeys(
            each
            for kind_, name_, client_name_ in _related(kind, name, client_name)
            for each in (*self._matching(kind_, name_), *self._matching_of_client(kind_, client, client_name_))
            if not (each.type and type_name and kind == kind_) or each.type == type_name
        )
        if not found:
            return None
        return Demand(
            min((each.deadman for each in found if each.deadman), default=0.0),
            smallest_max_age(each.max_age for each in found),
            tuple(each for each in found if each.arm),
        )

    def _matching(self, kind: Kind | None, name: str) -> Iterator[Source]:
        for source in self._by_name.get(name, ()):
            if source.kind in (None, kind):
                yield source
        for beginning, pattern, on_client, excepts, source in self._patterns:
            if not name.startswith(beginning) or source.kind not in (None, kind):
                continue
            if (parts := pattern.match(name)) is not None:
                client_name = on_client.fill(parts)
                if all(each.match(client_name) is None for each in excepts):
                    yield source

    def _matching_of_client(self, kind: Kind, client: str, name: str) -> Iterator[Source]:
        for source in self._of_client.get(client, ()):
            if source.kind not in (None, kind) or not _matches(source.on_client, name):
                continue
            if not any(_matches(each, name) for each in source.excepts):
                yield source

    def _covers(self, old: Source) -> bool:
        """Whether every name of a source is demanded by one of these, at least as carefully."""
        if old.is_pattern:
            found: Iterable[Source] = (
                new for *_, new in self._patterns if new.name == old.name and set(new.excepts) <= set(old.excepts)
            )
        else:
            found = self._matching(old.kind, old.name)
        return any(
            new.key == old.key
            or (_is_as_short(new.deadman, old.deadman) and _is_as_short(new.max_age or 0.0, old.max_age or 0.0))
            for new in found
            if new.arm and new.kind in (None, old.kind) and new.type in ("", old.type)
        )

    def missing(self, old: Iterable[Source]) -> dict[Source, tuple[Source, ...]]:
        """Return the sources whose demand for arming these do not cover, each with sources that demand the rest."""
        by_key = {source.key: source for source in self.sources if source.arm}
        unchanged = set(self.sources)
        found: dict[Source, tuple[Source, ...]] = {}
        for source in old:
            if not source.arm or source in unchanged or self._covers(source):
                continue
            whole = kept_whole(source)
            new = by_key.get(source.key)
            same = new is not None and (new.name, new.kind, new.type) == (source.name, source.kind, source.type)
            if new is None or not (same and source.is_pattern):
                found[source] = (whole,)
                continue
            left_out = [_on_this_side(each, source) for each in new.excepts if each not in source.excepts]
            rest = [whole] if None in left_out else [_kept(source, each) for each in left_out if each]
            if rest := [each for each in rest if not self._covers(each)]:
                found[source] = tuple(rest)
        return found


def demand_on_entry(demands: Demands, session: Session, client: Client | None, topic: Topic) -> Demand:
    """Return the demand on the name of an entry, which is no pattern.

    Args:
        demands: of the session.
        session: with the entry.
        client: on a server, the client whose entry it is, or None.
        topic: the entry.
    """
    owner = "" if client is None else client.name
    use_name = session.use_name if client is None or client.use_name is None else client.use_name
    name = local_name(topic, owner, on_server=client is not None, use_name=use_name)
    return demands.of(topic.kind, name, topic.type, client=owner, client_name=topic.topic) or NO_DEMAND


def _kept(source: Source, name: str) -> Source:
    """Return a source for `armed` that demands a name, as carefully as another source."""
    entry = Armed(name, deadman=_unless(source.deadman, DEADMAN), max_age=_unless(source.max_age, ARMED))
    if is_pattern(name):
        entry = msgspec.structs.replace(entry, kind=source.kind, type=source.type or None)
    return next(sources_of_names([entry]))


def _unless(seconds: float | None, default: float) -> float | None:
    return None if seconds == default else seconds


def _is_as_short(new: float, old: float) -> bool:
    """Whether a limit is at least as short as another one; 0 is none."""
    return not old or 0 < new <= old


def kept_whole(source: Source) -> Source:
    """Return a source for `armed` that demands all that another one does."""
    return _kept(source, source.name)


def as_armed(source: Source) -> str | Armed:
    """Return the entry of `armed` for one of its sources."""
    deadman, max_age = _unless(source.deadman, DEADMAN), _unless(source.max_age, ARMED)
    entry = Armed(source.name, source.kind, source.type or None, deadman, max_age)
    return source.name if entry == Armed(source.name) else entry


def full_type(name: str) -> str:
    """Return the full name of a type in a session, or an empty string for ``auto``."""
    if name == AUTO:
        return ""
    try:
        return expand_type_name(name)
    except ValueError:  # a problem of its own, which `check` reports
        return name


def _on_this_side(name: str, source: Source) -> str | None:
    """Return this side's name for a name that a pattern leaves out on the client, or None if that is not certain."""
    if source.name == source.on_client:
        return name
    if not is_pattern(name) and (parts := _pattern(source.on_client).match(name)) is not None:
        return _pattern(source.name).fill(parts)
    return None


def _matches(name_or_pattern: str, name: str) -> bool:
    if is_pattern(name_or_pattern):
        return _pattern(name_or_pattern).match(name) is not None
    return name == name_or_pattern


@lru_cache(4096)
def _pattern(text: str) -> Pattern:
    """Return a pattern, which takes about 0.1 ms to make."""
    return Pattern(text)


def _without(suffix: str, name: str) -> str:
    return name.removesuffix(suffix) if name.endswith(suffix) else ""


def _related(kind: Kind, name: str, client_name: str) -> Iterator[tuple[Kind, str, str]]:
    """Yield a name's two sides, and for services the names that consist of them, or of which they consist."""
    yield kind, name, client_name
    if kind == "service":
        for other in _KINDS_OF_SERVICES:
            for lane in LANES[other]:
                if lane.limited and not lane.is_topic:
                    yield other, _without(lane.suffix, name), _without(lane.suffix, client_name)
    else:
        for lane in LANES[kind]:
            if lane.limited and not lane.is_topic:
                yield "service", name + lane.suffix, client_name + lane.suffix


def describe(source: Source, places: Mapping[SourceKey, str]) -> str:
    """Return the line that demands arming, for an operator: ``pattern /cmd* in robot.yaml:20``.

    Args:
        source: the line.
        places: where the lines are, by their keys.
    """
    place = places.get(source.key, "this session")
    if not source.is_pattern:
        return place
    return f"pattern {source.on_client or source.name} {'in ' if ':' in place else ''}{place}"
