"""Names that require arming, or have `max_age` or `limits`. A session's demand belongs to the name, on every route."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain
from typing import TYPE_CHECKING, Final, Protocol, TypeAlias

import msgspec

from rsb_bridge.model.by_hand import VelocityLimits, can_end, end_text, more_careful_end, smallest_limits
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.names import server_topic
from rsb_bridge.model.patterns import Pattern, is_pattern
from rsb_bridge.model.qos import AUTO
from rsb_bridge.model.session import DEADMAN, ArmedName, Client, Identity, Kind, Session, Topic
from rsb_bridge.model.type_names import expand_type_name
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

PEER_DEMANDS: Final = "the other side's session"
"""The origin of a demand that the other side makes."""


class OriginText(Wording):
    """The source of a demand, for operators."""

    THIS_SESSION = "this session"
    PATTERN = "pattern {pattern} {place}"
    PATTERN_IN_FILE = "pattern {pattern} in {place}"


class DemandText(Wording):
    """Texts for operators about a demand that a session file no longer makes."""

    DROPPED = "{name}: its demand to be armed ends ({origin})"
    STAYS = "{name}: still has to be armed ({origin}): reload with --drop-arm ends that"


_KINDS_OF_SERVICES: Final[tuple[Kind, ...]] = ("action", "parameters")

SourceKey: TypeAlias = tuple[str, Identity | str]
"""A line of `armed` by its client's name and the names that it matches; an entry by its client's name and its identity.

The client's name is empty in a client's session, and of lines of `armed` that no client's entry has added."""


@dataclass(frozen=True, slots=True)
class DemandSource:
    """One line of a session that demands arming, a `max_age` or `limits`.

    Attributes:
        key: the same for lines that match the same names, but for `excepts`.
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
    """Yield the entries of one link that demand anything; `local_name` has the same arguments.

    What an entry demands with `arm` is a line of `armed` (`armed_line`).
    """
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
    return map(line_of, armed)


@lru_cache(4096)
def line_of(each: str | ArmedName) -> DemandSource:
    """Return what an item of `armed` demands."""
    entry = ArmedName(each) if isinstance(each, str) else each
    type_name, client, on_client = full_type(entry.type or AUTO), entry.client or "", entry.topic or entry.name
    far = "" if on_client == entry.name else on_client
    return DemandSource(
        (client, " ".join(filter(None, (entry.kind, type_name, entry.name, far)))),
        entry.name,
        entry.deadman_seconds,
        entry.kind,
        type_name,
        on_client,
        entry.excepts,
        max_age=default_max_age(entry.max_age, armed=True),
        on_end=end_text(entry.on_end),
        limits=entry.limits,
    )


@lru_cache(4096)
def as_armed(source: DemandSource) -> str | ArmedName:
    """Return the item of `armed` for a demand for arming."""
    entry = ArmedName(
        source.name,
        source.kind,
        source.type or None,
        client=source.key[0] or None,
        topic=None if source.on_client in ("", source.name) else source.on_client,
        excepts=source.excepts,
        deadman=_unless(source.deadman, DEADMAN),
        max_age=_unless(source.max_age, ARMED),
        on_end=source.on_end or None,
        limits=source.limits,
    )
    return source.name if entry == ArmedName(source.name) else entry


def _unless(seconds: float | None, default: float) -> float | None:
    return None if seconds == default else seconds


def armed_line(source: DemandSource) -> DemandSource:
    """Return a demand for arming as the line of `armed` says it, which an entry adds there."""
    return line_of(as_armed(source))


def most_careful(lines: Sequence[DemandSource]) -> DemandSource:
    """Return one line instead of several of the same key: it leaves out what all of them leave out."""
    first = lines[0]
    one = replace(
        first,
        deadman=min((each.deadman for each in lines if each.deadman), default=0.0),
        max_age=smallest_max_age(each.max_age for each in lines),
        on_end=more_careful_end(each.on_end for each in lines),
        limits=smallest_limits(each.limits for each in lines),
        excepts=tuple(name for name in first.excepts if all(name in each.excepts for each in lines)),
    )
    return armed_line(one)


def merged(armed: Iterable[str | ArmedName]) -> dict[SourceKey, str | ArmedName]:
    """Return items of `armed` by their keys: of several with the same key, one that demands what each of them does."""
    found: dict[SourceKey, str | ArmedName] = {}
    for each in armed:
        line = line_of(each)
        first = line_of(found.setdefault(line.key, each))
        if first != line and (one := most_careful((first, line))) != first:
            found[line.key] = as_armed(one)
    return found


def all_armed(armed: Iterable[str | ArmedName], entries: Iterable[DemandSource]) -> dict[SourceKey, str | ArmedName]:
    """Return `armed` with the lines of entries, by their keys."""
    return merged((*armed, *(as_armed(each) for each in entries if each.arm)))


def sources_of_topics(session: Session) -> Iterator[DemandSource]:
    """Yield the entries of a session that demand anything."""
    if session.role == "client":
        yield from sources_of_entries(session.topics, session.name, on_server=False, use_name=False)
    else:
        for each in session.accepted_clients:
            yield from sources_of_entries(each.topics, each.name, on_server=True, use_name=each.is_prefixed(session))


def sources_of(session: Session) -> Iterator[DemandSource]:
    """Yield every line of a session that demands anything; entries add theirs to `armed`."""
    yield from sources_of_names(session.armed)
    yield from (armed_line(each) if each.arm else each for each in sources_of_topics(session))


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
        if not self.sources:  # as in most sessions
            return None
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
    """Return the demand on the name of an entry. A pattern has none: its names have.

    Args:
        client: on a server, the client whose entry it is, or None.
    """
    if topic.is_pattern:
        return NO_DEMAND
    owner = "" if client is None else client.name
    use_name = client is not None and client.is_prefixed(session)
    name = local_name(topic, owner, on_server=client is not None, use_name=use_name)
    return demands.of(topic.kind, name, topic.type, client=owner, client_name=topic.topic) or NO_DEMAND


def full_type(name: str) -> str:
    """Return the full name of a type in a session, or an empty string for ``auto`` or none."""
    if name in ("", AUTO):  # which the search for similar names would take 0.1 ms for, once for each route
        return ""
    try:
        return expand_type_name(name)
    except ValueError:  # a problem of its own, which `check` reports
        return name


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


class Holder(Protocol):
    """A link, which has a part of the session's entries."""

    def demand_sources(self) -> Iterable[DemandSource]:
        """Yield the entries that demand anything, as operators have left them."""

    def apply_demands(self) -> None:
        """Reopen the routes whose demands have changed."""

    def demand_dropped(self, source: DemandSource) -> None:
        """Tell the other side that an operator drops a demand."""


class Host(Protocol):
    """The bridge, which has the running session."""

    session: Session

    @property
    def armed_in_file(self) -> tuple[str | ArmedName, ...]:
        """`armed` of the session's file."""

    def demands_changed(self) -> None:
        """Have `RunningDemands.apply` called soon."""

    def demand_dropped(self, source: DemandSource, origin: str) -> None:
        """Log that an operator has dropped a line."""


class RunningDemands:
    """The running session's `armed`, the only list of demands, to which each entry with `arm` adds its line.

    A line stays if its entry changes or goes, and if another session is read. Only an operator takes it out (`end`).
    """

    def __init__(self, host: Host) -> None:
        self._host = host
        self._holders: list[Holder] = []
        self._entries: tuple[DemandSource, ...] = ()
        self._applied: Demands | None = None
        self._places: Mapping[SourceKey, str] = {}
        self._is_stale = self._is_changing = False
        self._set(host.session.armed)

    def register(self, holder: Holder) -> None:
        """Count the entries of one more link."""
        self._holders.append(holder)
        self.changed()

    def unregister(self, holder: Holder) -> None:
        """Forget a link; its demands stay."""
        if holder in self._holders:
            self.read()
            self._holders.remove(holder)
            self.changed()

    def changed(self) -> None:
        """Note that an entry was added, changed or removed."""
        if not self._is_stale:
            self._is_stale = True
            self._host.demands_changed()

    @property
    def written(self) -> tuple[str | ArmedName, ...]:
        """`armed` for the session's file: its own lines, and what neither they nor entries say. From any thread."""
        if not self._lines:  # as in most sessions, and each snapshot asks
            return ()
        lines, in_file = self._lines, merged(self._host.armed_in_file)
        said = all_armed(in_file.values(), self._entries)
        stay = {key: each for key, each in in_file.items() if key in lines}
        return tuple((stay | {key: each for key, each in lines.items() if said.get(key) != each}).values())

    def read(self) -> Demands:
        """Return what is demanded now, also by entries that have just changed."""
        if self._is_stale:
            self._is_stale = False
            entries = tuple(dict.fromkeys(chain.from_iterable(each.demand_sources() for each in self._holders)))
            if entries != self._entries:
                self._entries = entries
                self._set(self._lines.values())
        return self._demands

    def _set(self, armed: Iterable[str | ArmedName]) -> None:
        """Have these lines in `armed`, and that of every present entry."""
        self._lines = all_armed(armed, self._entries)
        items, unarmed = tuple(self._lines.values()), [each for each in self._entries if not each.arm]
        self._demands = Demands((*map(line_of, items), *unarmed))
        if items != self._host.session.armed:
            self._host.session = msgspec.structs.replace(self._host.session, armed=items)

    def keep(self, source: DemandSource) -> None:
        """Demand what an entry demands that cannot be added."""
        self._set((*self._lines.values(), as_armed(source)))
        self._host.demands_changed()

    def use(self, session: Session) -> None:
        """Change to another session, whose entries are yet to come, and keep the lines that it does not have."""
        self.read()
        self._host.session = session
        self._set((*all_armed(session.armed, sources_of_topics(session)).values(), *self._lines.values()))

    # --- what operators end

    @contextlib.contextmanager
    def changing(self) -> Iterator[None]:
        """Change entries: routes are reopened once, at the end."""
        self._is_changing = True
        try:
            yield
        finally:
            self._is_changing = False
            self.apply()

    def ended_by(self, session: Session) -> list[DemandSource]:
        """Return the lines that demand arming of names of which a session does not demand it."""
        new = all_armed(session.armed, sources_of_topics(session))
        excepts = {key: set(line_of(each).excepts) for key, each in new.items()}
        lines = (each for each in self.read().sources if each.arm)
        return [each for each in lines if each.key not in new or not excepts[each.key] <= set(each.excepts)]

    def tell_end(self, lines: Iterable[DemandSource]) -> None:
        """Tell the other side what is about to end, before that closes routes: nothing may refuse it after this."""
        for line in lines:
            for holder in self._holders:
                holder.demand_dropped(line)

    def end(self, lines: Collection[DemandSource], said: Collection[str | ArmedName] = ()) -> None:
        """Take lines out as an operator has agreed to by name. Present entries and the file's lines stay.

        Args:
            said: what other lines say from now on; they leave out no further names.
        """
        if not (lines or said):
            return
        self._is_stale = True  # not every change of an entry is noted that drops its demand
        self.read()
        ended = {each.key for each in lines}
        armed = {key: each for key, each in self._lines.items() if key not in ended}
        for each in said:
            new = line_of(each)
            old = line_of(armed.get(new.key, each))
            excepts = tuple(name for name in new.excepts if name in old.excepts)
            armed[new.key] = each if excepts == new.excepts else as_armed(replace(new, excepts=excepts))
        still = (each for key, each in merged(self._host.armed_in_file).items() if key in armed)
        self._set((*armed.values(), *still))
        stay = {line.key for line in self.read().sources}
        for line in lines:
            if line.key not in stay:
                self._host.demand_dropped(line, self.origin(line))

    def edited(self, old: DemandSource, new: DemandSource) -> None:
        """Have a line say what its entry says by now, unless it demands more than the entry did."""
        if old.key == new.key and most_careful((old, new)) in self.read().sources:
            self.end((), (as_armed(new),))

    def apply(self) -> None:
        """Reopen the routes whose demands have changed."""
        demands = self.read()  # also during a change: an entry that goes again before its end has added its line
        if not self._is_changing and demands is not self._applied:
            self._applied = demands
            for holder in tuple(self._holders):
                holder.apply_demands()

    # --- where the lines are

    def set_places(self, places: Mapping[SourceKey, str]) -> None:
        """Take the lines of a session file, by their keys."""
        self._places = places
        self._applied = None  # routes have to name the lines again
        self._host.demands_changed()

    def origin(self, source: DemandSource) -> str:
        """Return a line that demands something, for an operator."""
        return describe(source, self._places)
