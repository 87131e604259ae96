"""Names that require arming, or have `max_age` or `limits`. A session's demand belongs to the name, on every route."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain
from typing import TYPE_CHECKING, Final, Protocol, TypeAlias

from rsb_bridge.model.by_hand import VelocityLimits, can_end, end_text, more_careful_end, smallest_limits
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.names import expand_type_name, server_topic
from rsb_bridge.model.patterns import Pattern, is_pattern
from rsb_bridge.model.qos import AUTO
from rsb_bridge.model.session import DEADMAN, ArmedName, Client, Identity, Kind, Session, Topic
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

PEER_DEMANDS: Final = "the other side's session"
"""The origin of a demand that the other side makes."""


class OriginText(Wording):
    """The source of a demand, for operators."""

    THIS_SESSION = "this session"
    ADDED = "added by {who}"
    KEPT = "kept since a change by {who}"
    PATTERN = "pattern {pattern} {place}"
    PATTERN_IN_FILE = "pattern {pattern} in {place}"


class DemandText(Wording):
    """Texts for operators about a demand that a session file no longer makes."""

    DROPPED = "{name}: its demand to be armed ends ({origin})"
    STAYS = "{name}: still has to be armed ({origin}): reload with --drop-arm ends that"


_KINDS_OF_SERVICES: Final[tuple[Kind, ...]] = ("action", "parameters")

SourceKey: TypeAlias = tuple[str, Identity | str]
"""An entry by its client's name (empty in a client's session) and its identity; an entry of `armed` by its name."""


@dataclass(frozen=True, slots=True)
class DemandSource:
    """One line of a session that demands arming, a `max_age` or `limits`.

    Attributes:
        name: a name or a pattern on this side.
        deadman: in seconds, or 0 for none.
        kind: of the names, or None for every kind.
        type: of the names, or an empty string for every type.
        on_client: the name as the client has it, to which `excepts` refers.
        excepts: names and patterns on the client that a pattern leaves out.
        max_age: in seconds, 0 for no limit, or None if it says nothing.
        on_end: what the robot gets when an arming ends, as of `by_hand.end_text`.
        limits: what a hand may ask, or None for any velocity.
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
    on_end: str = ""
    limits: VelocityLimits | None = None

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
        on_end: what the robot gets when an arming ends, or an empty string if no line says anything.
        limits: the smallest of all lines, or None for any velocity.
        limited_by: the lines with a number that is in `limits`.
    """

    deadman: float
    max_age: float | None
    sources: tuple[DemandSource, ...]
    on_end: str = ""
    limits: VelocityLimits | None = None
    limited_by: tuple[DemandSource, ...] = ()

    @property
    def arm(self) -> bool:
        """Whether it requires arming."""
        return bool(self.sources)


NO_DEMAND: Final = Demand(0.0, None, ())
"""The demand on a name that no line matches."""


def local_name(topic: Topic, client: str, *, on_server: bool, use_name: bool) -> str:
    """Return the name of an entry on the side that has the session.

    Args:
        topic: the entry, as the client sees it.
        use_name: whether the server prefixes the client's topics.
    """
    if not on_server:
        return topic.topic
    return topic.remote_topic or (server_topic(topic.topic, client) if use_name else topic.topic)


def sources_of_entries(
    topics: Iterable[Topic], client: str, *, on_server: bool, use_name: bool
) -> Iterator[DemandSource]:
    """Yield the entries of one link that demand anything; `local_name` has the same arguments."""
    for topic in topics:
        if topic.arm or topic.max_age is not None or topic.limits is not None:
            name = local_name(topic, client, on_server=on_server, use_name=use_name)
            key = client if on_server else "", topic.identity
            type_name = full_type(topic.type) if topic.is_pattern else ""
            yield DemandSource(
                key,
                name,
                topic.deadman_seconds if topic.arm else 0.0,
                topic.kind,
                type_name,
                topic.topic,
                topic.excepts,
                arm=topic.arm,
                max_age=default_max_age(topic.max_age, armed=topic.arm),
                on_end=end_text(topic.on_end),
                limits=topic.limits,
            )


def sources_of_names(armed: Iterable[str | ArmedName]) -> Iterator[DemandSource]:
    """Yield what a session's `armed` demands."""
    for each in armed:
        entry = ArmedName(each) if isinstance(each, str) else each
        key = "", f"{entry.kind or ''} {entry.type or ''} {entry.name}".strip()
        max_age = default_max_age(entry.max_age, armed=True)
        type_name = full_type(entry.type or AUTO)
        on_end = end_text(entry.on_end)
        yield DemandSource(
            key,
            entry.name,
            entry.deadman_seconds,
            entry.kind,
            type_name,
            max_age=max_age,
            on_end=on_end,
            limits=entry.limits,
        )


def sources_of(session: Session) -> Iterator[DemandSource]:
    """Yield every line of a session that demands anything."""
    yield from sources_of_names(session.armed)
    if session.role == "client":
        yield from sources_of_entries(session.topics, session.name, on_server=False, use_name=False)
        return
    for client in session.accepted_clients:
        use_name = client.is_prefixed(session)
        yield from sources_of_entries(client.topics, client.name, on_server=True, use_name=use_name)


class Demands:
    """Demands on names, from the lines of a session.

    Args:
        sources: the lines, in any order: all that match a name count.
    """

    def __init__(self, sources: Iterable[DemandSource] = ()) -> None:
        self.sources = tuple(dict.fromkeys(sources))
        self._by_name: dict[str, list[DemandSource]] = {}
        self._patterns: list[tuple[str, Pattern, Pattern, tuple[Pattern, ...], DemandSource]] = []
        self._of_client: dict[str, list[DemandSource]] = {}
        for source in self.sources:
            if source.is_pattern:
                excepts = tuple(map(_pattern, source.excepts))
                on_client = _pattern(source.on_client or source.name)
                beginning = source.name.partition("*")[0]  # of all names that match
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
        limits = smallest_limits(each.limits for each in found) if kind == "topic" else None
        return Demand(
            min((each.deadman for each in found if each.deadman), default=0.0),
            smallest_max_age(each.max_age for each in found),
            tuple(each for each in found if each.arm),
            more_careful_end(each.on_end for each in found if can_end(kind, each.on_end)),
            limits,
            tuple(each for each in found if limits is not None and each.limits and each.limits.are_in(limits)),
        )

    def _matching(self, kind: Kind | None, name: str) -> Iterator[DemandSource]:
        for source in self._by_name.get(name, ()):
            if source.kind in (None, kind):
                yield source
        for beginning, pattern, on_client, excepts, source in self._patterns:
            # Before the regular expression: a server of many robots has the patterns of each.
            if not name.startswith(beginning) or source.kind not in (None, kind):
                continue
            if (parts := pattern.match(name)) is not None:
                client_name = on_client.fill(parts)
                if all(each.match(client_name) is None for each in excepts):
                    yield source

    def _matching_of_client(self, kind: Kind, client: str, name: str) -> Iterator[DemandSource]:
        for source in self._of_client.get(client, ()):
            if source.kind not in (None, kind) or not _matches(source.on_client, name):
                continue
            if not any(_matches(each, name) for each in source.excepts):
                yield source


def demand_on_entry(demands: Demands, session: Session, client: Client | None, topic: Topic) -> Demand:
    """Return the demand on the name of an entry, which is no pattern.

    Args:
        client: on a server, the client whose entry it is, or None.
    """
    owner = "" if client is None else client.name
    use_name = client is not None and client.is_prefixed(session)
    name = local_name(topic, owner, on_server=client is not None, use_name=use_name)
    return demands.of(topic.kind, name, topic.type, client=owner, client_name=topic.topic) or NO_DEMAND


Lines: TypeAlias = "dict[tuple[SourceKey, str, str], DemandSource]"
"""Lines that demand arming, by their keys, names on this side and types. What else they say can be edited."""


def lines_of(sources: Iterable[DemandSource]) -> Lines:
    """Return the sources that demand arming."""
    return {_line(source): source for source in sources if source.arm}


def _line(source: DemandSource) -> tuple[SourceKey, str, str]:
    return source.key, source.name, source.type


def outliving(before: Iterable[DemandSource], new: Lines) -> Iterator[tuple[DemandSource, str]]:
    """Yield the demands for arming that stay although these lines do not make them: a source, and the name.

    A line that is still there may say anything else, except that it leaves out further names.
    """
    for source in before:
        if not source.arm:
            continue
        if (now := new.get(_line(source))) is None:
            yield source, source.name
        else:
            names = (name for name in now.excepts if name not in source.excepts)
            yield from ((source, _on_this_side(name, source) or source.name) for name in names)


def kept(source: DemandSource, name: str) -> DemandSource:
    """Return a source for `armed` that demands a name, as carefully as another source."""
    has_kind = is_pattern(name) or isinstance(source.key[1], str)
    kind, type_name = (source.kind, source.type) if has_kind else (None, "")
    new = replace(source, name=name, kind=kind, type=type_name, on_client="", excepts=())
    # By way of the file's form, so that it equals the source that is read from `armed` later.
    return next(sources_of_names([as_armed(new)]))


def _unless(seconds: float | None, default: float) -> float | None:
    return None if seconds == default else seconds


def as_armed(source: DemandSource) -> str | ArmedName:
    """Return the entry of `armed` for one of its sources."""
    deadman, max_age = _unless(source.deadman, DEADMAN), _unless(source.max_age, ARMED)
    on_end, type_name = source.on_end or None, source.type or None
    entry = ArmedName(source.name, source.kind, type_name, deadman, max_age, on_end, source.limits)
    return source.name if entry == ArmedName(source.name) else entry


def full_type(name: str) -> str:
    """Return the full name of a type in a session, or an empty string for ``auto``."""
    if name == AUTO:
        return ""
    try:
        return expand_type_name(name)
    except ValueError:  # a problem of its own, which `check` reports
        return name


def _on_this_side(name: str, source: DemandSource) -> str | None:
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
    # Lanes that are not limited stop or watch a robot: no demand may hold them up.
    if kind == "service":
        for other in _KINDS_OF_SERVICES:
            for lane in LANES[other]:
                if lane.limited and not lane.is_topic:
                    yield other, _without(lane.suffix, name), _without(lane.suffix, client_name)
    else:
        for lane in LANES[kind]:
            if lane.limited and not lane.is_topic:
                yield "service", name + lane.suffix, client_name + lane.suffix


def describe(source: DemandSource, places: Mapping[SourceKey, str]) -> str:
    """Return a line that demands something, for an operator: ``pattern /cmd* in robot.yaml:20``.

    Args:
        places: where the lines are, by their keys.
    """
    place = places.get(source.key, OriginText.THIS_SESSION())
    if not source.is_pattern:
        return place
    text = OriginText.PATTERN_IN_FILE if ":" in place else OriginText.PATTERN
    return text(pattern=source.on_client or source.name, place=place)


ARMED = 1.0
"""The limit (s) of topics that require arming, unless a session sets another one."""


def default_max_age(seconds: float | None, *, armed: bool) -> float | None:
    """Return what a line of a session demands: s, 0 for no limit, or None if it says nothing.

    Args:
        seconds: what it sets, or None if it sets nothing.
        armed: whether it demands arming.
    """
    return ARMED if seconds is None and armed else seconds


def smallest_max_age(demands: Iterable[float | None]) -> float | None:
    """Return the smallest limit (s) of several demands, 0 for no limit, or None if no demand sets one.

    A demand of 0 asks for no limit, and does not lift the limits of others.
    """
    given = [each for each in demands if each is not None]
    return min(filter(None, given), default=0.0) if given else None


def effective_max_age(demands: Iterable[float | None], *, armed: bool) -> float:
    """Return the limit (s) that holds, or 0 for no limit.

    Args:
        demands: of both sides, as in `smallest_max_age`.
        armed: whether either side demands that it is armed.
    """
    return default_max_age(smallest_max_age(demands), armed=armed) or 0.0


MOST_ARMED: Final = 1000
"""Entries of `armed` beyond which a pattern is kept as a whole, instead of the names that it leaves out."""


class Holder(Protocol):
    """A link, which has a part of the session's entries."""

    def demand_sources(self) -> Iterable[DemandSource]:
        """Yield the entries that demand arming, as operators have left them."""

    def apply_demands(self) -> None:
        """Reopen the routes whose demands have changed."""

    def demand_dropped(self, source: DemandSource) -> None:
        """Tell the other side that an operator drops a demand."""


class RunningDemands:
    """The present demands for arming: each entry adds its demand, and only an operator drops one.

    An edited entry demands what it says now. If it goes, or its name changes, its demand stays, as a line of `armed`.
    Lines without `arm` go with their entries.

    Args:
        armed: returns the running session's `armed`.
        soon: has `apply` called soon.
        kept: is called with a source whose entry is gone, and its origin.
        dropped: is called with a source that an operator has dropped, and its origin.
    """

    def __init__(
        self,
        armed: Callable[[], tuple[str | ArmedName, ...]],
        set_armed: Callable[[tuple[str | ArmedName, ...]], None],
        soon: Callable[[], object],
        kept: Callable[[DemandSource, str], None],
        dropped: Callable[[DemandSource, str], None],
    ) -> None:
        self._armed = armed
        self._set_armed = set_armed
        self._soon = soon
        self._kept = kept
        self._dropped = dropped
        self._holders: list[Holder] = []
        self._demands = Demands()
        self._given: tuple[str | ArmedName, ...] = ()
        self._applied: tuple[DemandSource, ...] | None = ()
        self._is_stale = True
        self._is_due = self._is_changing = False
        self._who = ""
        self._dropping: dict[DemandSource, str] = {}
        self._places: Mapping[SourceKey, str] = {}
        self._changed_by: dict[SourceKey, str] = {}

    # --- the entries

    def register(self, holder: Holder) -> None:
        """Count the entries of one more link."""
        self._holders.append(holder)
        self.changed()

    def unregister(self, holder: Holder) -> None:
        """Forget a link; its demands stay."""
        if holder in self._holders:
            self._holders.remove(holder)
            self.changed()

    def changed(self) -> None:
        """Note that an entry was added, changed or removed."""
        self._is_stale = True
        if not self._is_due:
            self._is_due = True
            self._soon()

    def of(
        self, kind: Kind, name: str, type_name: str = "", *, client: str = "", client_name: str = ""
    ) -> Demand | None:
        """Return the present demand on a name; `Demands.of` has the same arguments."""
        return self._read().of(kind, name, type_name, client=client, client_name=client_name)

    @property
    def sources(self) -> tuple[DemandSource, ...]:
        """The lines that demand anything now."""
        return self._read().sources

    def keep(self, source: DemandSource) -> None:
        """Demand what an entry demands that cannot be added."""
        self._keep([(source, source.name)])
        self.changed()

    def _read(self) -> Demands:
        """Take in changes. No demand gets lost by them."""
        # A reload replaces `armed` with the session, steps before it calls `changed`.
        if self._is_stale or self._given is not self._armed():
            before, present = self._demands.sources, self._present()
            if present != before:  # it is equal after most changes, of which peers can cause many
                new = lines_of(present)
                self._keep(outliving(before, new))
                if self._who:
                    known = self._places.keys() | {source.key for source in before}
                    new_keys = (key for key, *_ in new if key not in known)
                    self._changed_by = dict.fromkeys(new_keys, self._who) | self._changed_by
                # Once more: keeping may have added to `armed`.
                self._demands = Demands(self._present())
                still = {source.key for source in self._demands.sources}
                self._changed_by = {key: who for key, who in self._changed_by.items() if key in still}
            self._is_stale, self._given = False, self._armed()
        return self._demands

    def _present(self) -> tuple[DemandSource, ...]:
        entries = chain.from_iterable(holder.demand_sources() for holder in self._holders)
        return tuple(dict.fromkeys((*sources_of_names(self._armed()), *entries)))

    def _keep(self, stay: Iterable[tuple[DemandSource, str]]) -> None:
        """Demand names in `armed`, each as carefully as a source."""
        armed = list(self._armed())
        known = set(sources_of_names(armed))
        for old, name in stay:
            source = kept(old, old.name if len(armed) >= MOST_ARMED else name)
            if source in known:
                continue
            known.add(source)
            armed.append(as_armed(source))
            if not self._dropping.keys() & {old, source}:
                self._kept(old, self.origin(old))
            self._changed_by[source.key] = self._who or "the other side"
        self._set_armed(tuple(armed))

    # --- changes by operators

    @contextlib.contextmanager
    def changing(self, who: str) -> Iterator[None]:
        """Change entries. What `drop` is given meanwhile is dropped at the end, unless the change fails.

        Args:
            who: makes the change, in words.
        """
        self._read()  # earlier changes are not this operator's
        self._who, self._is_changing = who, True
        try:
            yield
            self._forget()
        finally:
            self._dropping = {}
            self._read()  # before the operator's name is reset
            self._who, self._is_changing = "", False
            self.apply()

    def staying(self, sources: Iterable[DemandSource]) -> dict[DemandSource, str]:
        """Return what would be kept if these lines replaced the present ones, each with the origin of its demand."""
        new = lines_of(sources)
        found = {kept(old, name): self.origin(old) for old, name in outliving(self.sources, new)}
        return {source: origin for source, origin in found.items() if _line(source) not in new}

    def drop(self, sources: Mapping[DemandSource, str]) -> None:
        """Let demands go at the end of the present change, as an operator has agreed to by name.

        The other side learns of it now, before the change closes the routes: nothing may refuse the change after this.

        Args:
            sources: the demands, each with its origin.
        """
        self._dropping |= sources
        for source in sources:
            for holder in self._holders:
                holder.demand_dropped(source)

    def _forget(self) -> None:
        """Drop the demands that an operator has dropped, unless an entry still makes them."""
        self._read()
        gone = {_line(each) for old in self._dropping for each in (old, kept(old, old.name))}
        self._demands = Demands(source for source in self._demands.sources if _line(source) not in gone)
        self._set_armed(tuple(each for each in self._armed() if _line(*sources_of_names([each])) not in gone))
        self.changed()
        still = set(self._read().sources)
        for source, origin in self._dropping.items():
            if source not in still:
                self._dropped(source, origin)

    def apply(self) -> None:
        """Reopen the routes whose demands have changed."""
        if self._is_changing or not self._is_due:
            return
        self._is_due = False
        if (sources := self.sources) != self._applied:
            self._applied = sources
            for holder in tuple(self._holders):
                holder.apply_demands()

    # --- where the lines are

    def set_places(self, places: Mapping[SourceKey, str]) -> None:
        """Take the lines of a session file, by their entries."""
        self._places = places
        self._changed_by = {key: who for key, who in self._changed_by.items() if key not in places}
        self._applied = None  # routes have to name the lines again
        self.changed()

    def origin(self, source: DemandSource) -> str:
        """Return a line that demands something, for an operator."""
        if (who := self._changed_by.get(source.key)) is not None:
            text = OriginText.ADDED if isinstance(source.key[1], tuple) else OriginText.KEPT
            return describe(source, {source.key: text(who=who)})
        return describe(source, self._places)
