"""Undoes the last changes that this console's operator made to the running bridge."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import KW_ONLY, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

import msgspec

from rsb_bridge.config.session_changes import changes, described
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import undoing
from rsb_bridge.model.names import client_topic, server_topic
from rsb_bridge.model.patterns import Pattern
from rsb_console.notation.formats import PatternRow, Row, pattern_rows, rows_of

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator, Sequence
    from concurrent.futures import Future

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.snapshot import Event, Snapshot

T = TypeVar("T")
R = TypeVar("R", bound="Row")
STEPS = 20
"""Most changes to remember; the oldest are forgotten first. A round figure."""

_BY_OPERATORS = frozenset(
    {
        EventCode.OPERATOR_ADDED,
        EventCode.OPERATOR_EDITED,
        EventCode.OPERATOR_REMOVED,
        EventCode.OPERATOR_PAUSED,
        EventCode.OPERATOR_RESUMED,
    }
)


class CannotUndoError(Exception):
    """A change cannot be undone; the message has the reason and the remedy."""


class Undo(NamedTuple):
    """One undo.

    Attributes:
        title: title of the question.
        lines: the effect of the undo.
        yes: the label of its button.
        careful: whether the question's focus begins on No.
        act: does it; raises an EngineError if the bridge refuses.
    """

    title: str
    lines: tuple[str, ...]
    yes: str
    careful: bool
    act: Callable[[EngineApi], Coroutine[Any, Any, None]]


@dataclass(frozen=True, slots=True)
class Change(ABC):
    """One change by an operator.

    Attributes:
        topic: the name on this side.
        since: the number of the last event before the change.
    """

    link: str
    topic: str
    since: int

    @abstractmethod
    def undo(self, now: Snapshot, events: Sequence[Event]) -> Undo:
        """Return the undo of the change.

        Args:
            events: the engine's, the newest last.

        Raises:
            CannotUndoError: somebody else has changed the same since, or it is gone.
        """

    def _refuse(self, problem: str, events: Sequence[Event]) -> CannotUndoError:
        """Return the error, with the operator of the last change if an event names one."""
        about = self._since(events)
        by = f" by {about[-1].who}" if len(about) > 1 and about[-1].who else ""  # the first is of this change itself
        return CannotUndoError(f"{self.topic}: {problem}{by}; your change is not undone")

    def _since(self, events: Sequence[Event]) -> list[Event]:
        """Return what operators have done with the topic since, beginning with this change itself."""
        return [
            event
            for event in events
            if event.number > self.since
            and event.code in _BY_OPERATORS
            and (event.topic, event.link) == (self.topic, self.link)
        ]

    def _entry(self, key: str, now: Snapshot, events: Sequence[Event]) -> Row:
        found = find_entry(now, key)
        if found is None:
            raise self._refuse("removed meanwhile", events)
        return found

    def _unchanged(self, key: str, expected: Topic, now: Snapshot, events: Sequence[Event]) -> Row:
        """Return the entry, unless somebody has changed it since."""
        found = self._entry(key, now, events)
        if differences := changes(expected, found.spec):
            raise self._refuse(f"changed meanwhile ({', '.join(differences)})", events)
        return found


@dataclass(frozen=True, slots=True)
class Added(Change):
    """A topic was added.

    Attributes:
        spec: the topic as the client sees it.
    """

    _: KW_ONLY
    key: str
    spec: Topic

    def undo(self, now: Snapshot, events: Sequence[Event]) -> Undo:
        entry = self._unchanged(self.key, self.spec, now, events)
        rows = patterns_of(now, self.link, self.spec)
        claiming = [(row.key, row.spec) for row in rows if _claims(row.spec, self.spec)]

        async def act(engine: EngineApi) -> None:
            await _command(engine.remove_topic, self.key)
            # The removal makes an exception in each pattern that matches, which this takes back.
            for key, pattern in claiming:
                left_out = msgspec.structs.replace(pattern, excepts=(*pattern.excepts, self.spec.topic))
                await _command(partial(engine.edit_topic, seen=left_out), key, pattern)

        lines = [
            f"removes {described(entry.spec)}",
            f"It stops crossing at once, on both sides of the link {self.link}.",
        ]
        if self.spec.arm:
            lines.append("Its name still has to be armed (armed in the session).")
        lines += [f"The pattern {pattern.topic} matches it, and bridges it from then on." for _, pattern in claiming]
        return Undo(f"Undo the addition: remove {self.topic}?", tuple(lines), "Remove", True, act)


@dataclass(frozen=True, slots=True)
class Edited(Change):
    """A topic was edited.

    Attributes:
        key: key of its route after the edit.
        pattern: the pattern that had made its route, or empty.
    """

    _: KW_ONLY
    key: str
    old: Topic
    new: Topic
    pattern: str = ""

    def undo(self, now: Snapshot, events: Sequence[Event]) -> Undo:
        self._unchanged(self.key, self.new, now, events)
        # An edit takes a new name as this side's, and one that stays as the client's.
        old = named_here(self.old, now, self.link) if self.old.topic != self.new.topic else self.old

        async def act(engine: EngineApi) -> None:
            drops = self.new.arm and not old.arm
            await _command(partial(engine.edit_topic, drop_arm=drops, seen=self.new), self.key, old)

        warnings = list(_warnings(self.new, self.old))
        lines = [*changes(self.new, self.old), *warnings]
        if self.new.arm and self.old.arm is self.new.arm:
            lines.append(_DISARMED)
        if self.pattern:
            lines.append(f"It stays an entry of its own: the pattern {self.pattern} does not bridge it again.")
        return Undo(f"Undo the edit of {self.topic}?", tuple(lines), "Undo", bool(warnings), act)


@dataclass(frozen=True, slots=True)
class Removed(Change):
    """A topic was removed.

    Attributes:
        spec: the topic as the client sees it.
        pattern: the pattern that had made its route, or empty.
        patterns: the link's patterns before, by their keys: a removal makes an exception in every matching pattern.
    """

    _: KW_ONLY
    key: str
    spec: Topic
    pattern: str
    patterns: tuple[tuple[str, Topic], ...]

    def undo(self, now: Snapshot, events: Sequence[Event]) -> Undo:
        if find_entry(now, self.key) is not None:
            raise self._refuse("it is bridged again", events)
        if all(link.name != self.link for link in now.links):
            raise CannotUndoError(f"{self.topic}: {self.link} was removed; the topic is not added again")
        excepted = list(self._excepted(now))
        if self.pattern and not any(pattern.topic == self.pattern for _, _, pattern in excepted):
            raise self._refuse(f"the pattern {self.pattern} that brought it was changed meanwhile", events)
        topic = named_here(self.spec, now, self.link)

        async def act(engine: EngineApi) -> None:
            if not self.pattern:
                await _command(engine.add_topic, topic, self.link)
            for key, seen, pattern in excepted:
                await _command(partial(engine.edit_topic, seen=seen), key, pattern)

        if self.pattern:
            lines = [f"the pattern {self.pattern} brings it again"]
            back = msgspec.structs.replace(self.spec, paused=False)
        else:
            lines = [f"adds {described(self.spec)}"]
            lines += [f"The pattern {pattern.topic} no longer leaves it out." for _, _, pattern in excepted]
            back = self.spec
        if self.spec.is_pattern and patterns_of(now, self.link):
            lines.append("It comes after the link's other patterns, which win where both match.")
        if back.paused:
            lines.append("It comes back paused.")
        elif back.arm:
            lines.append(_DISARMED)
        else:
            lines.append("It crosses again at once" + (", though it was paused." if self.spec.paused else "."))
        return Undo(f"Undo the removal of {self.topic}?", tuple(lines), "Add again", True, act)

    def _excepted(self, now: Snapshot) -> Iterator[tuple[str, Topic, Topic]]:
        """Yield the patterns to which the removal added an exception, each with its key, and without the exception."""
        name, before = self.spec.topic, dict(self.patterns)
        for row in patterns_of(now, self.link, self.spec):
            if row.key in before and name in row.spec.excepts and name not in before[row.key].excepts:
                excepts = tuple(each for each in row.spec.excepts if each != name)
                yield row.key, row.spec, msgspec.structs.replace(row.spec, excepts=excepts)


@dataclass(frozen=True, slots=True)
class Paused(Change):
    """A topic was paused or resumed.

    Attributes:
        mixed: whether a pattern's topics were partly paused before.
    """

    _: KW_ONLY
    key: str
    paused: bool
    mixed: bool = False

    def undo(self, now: Snapshot, events: Sequence[Event]) -> Undo:
        entry = self._entry(self.key, now, events)
        if entry.spec.paused != self.paused:
            raise self._refuse(f"it was {'resumed' if self.paused else 'paused'} meanwhile", events)
        # Taken back and done again by somebody else, it is theirs. This console's own later changes are undone already.
        if len({event.who for event in self._since(events)}) > 1:
            raise self._refuse("somebody else has changed it meanwhile", events)
        if self.mixed:
            raise CannotUndoError(
                f"{self.topic}: some of its topics were paused before and some not: resume them one by one"
            )

        async def act(engine: EngineApi) -> None:
            await _command(engine.pause, self.key, not self.paused)

        if self.paused:
            means = _DISARMED if entry.spec.arm else "It crosses again at once."
            return Undo(f"Undo the pause of {self.topic}?", ("paused true → false", means), "Resume", True, act)
        means = "It carries nothing until it is resumed."
        return Undo(f"Undo the resuming of {self.topic}?", ("paused false → true", means), "Pause", False, act)


_DISARMED = "It stays disarmed until you arm it (A)."


class Changes:
    """The changes of this console that can be undone, the last one first."""

    def __init__(self) -> None:
        self._changes: deque[Change] = deque(maxlen=STEPS)
        self.dropped = False
        """Whether a change of this bridge was here before."""
        self.is_undoing = False
        """Whether a question stands, or is carried out, whether to undo one."""

    def __len__(self) -> int:
        return len(self._changes)

    @property
    def last(self) -> Change | None:
        """The newest change, or None."""
        return self._changes[-1] if self._changes else None

    def add(self, change: Change) -> None:
        """Remember a change that the bridge has made."""
        self._changes.append(change)

    def drop(self, change: Change) -> None:
        """Forget a change that is undone or cannot be."""
        # Another session may have cleared them while the question was open.
        if change in self._changes:
            self._changes.remove(change)
            self.dropped = True

    def clear(self) -> None:
        """Forget all of them: another bridge is shown."""
        self._changes.clear()
        self.dropped = False


def find_entry(now: Snapshot, key: str) -> Row | None:
    """Return the route or the pattern of a key, or None."""
    return next((each for each in rows_of(now) if each.key == key), None)


def present(row: R, now: Snapshot) -> R:
    """Return the present state of a row: a frozen list shows an old one, and one that a picture has hidden."""
    return cast("R", find_entry(now, row.key) or row)


def patterns_of(now: Snapshot, link: str, like: Topic | None = None) -> list[PatternRow]:
    """Return the patterns of a link; if `like` is given, only of its kind and direction."""
    return [
        row
        for row in pattern_rows(now)
        if row.link == link and (like is None or (row.spec.kind, row.spec.direction) == (like.kind, like.direction))
    ]


def named_by_client(topic: Topic, now: Snapshot, link: str) -> Topic:
    """Return an operator's topic under the client's name for it."""
    name = client_topic(topic.topic, link) if _prefixed(topic, now, link) else None
    return topic if name is None else msgspec.structs.replace(topic, topic=name)


def named_here(topic: Topic, now: Snapshot, link: str) -> Topic:
    """Return a topic under the name that a command of this side needs, from the client's name for it."""
    if not _prefixed(topic, now, link) or client_topic(topic.topic, link) is None:
        return topic
    return msgspec.structs.replace(topic, topic=server_topic(topic.topic, link))  # the command expects this side's name


def _prefixed(topic: Topic, now: Snapshot, link: str) -> bool:
    prefixed = any(each.name == link and each.use_name for each in now.links)
    return now.role == "server" and prefixed and topic.remote_topic is None


def _claims(pattern: Topic, topic: Topic) -> bool:
    excepted = any(Pattern(each).match(topic.topic) is not None for each in pattern.excepts)
    return not topic.is_pattern and Pattern(pattern.topic).match(topic.topic) is not None and not excepted


def _warnings(new: Topic, old: Topic) -> Iterator[str]:
    """Warn of messages that are held back now and would cross after the undo."""
    if new.arm and not old.arm:
        yield "This drops arm: true: it crosses without being armed."
    # 0 means that no key is needed, however long it takes.
    elif new.arm and (old.deadman_seconds or float("inf")) > (new.deadman_seconds or float("inf")):
        yield "It stays armed longer while no key is pressed (deadman)."
    if new.paused and not old.paused:
        yield "It is resumed, and crosses again at once."


async def _command(command: Callable[..., Future[T]], *arguments: object) -> None:
    """Run an engine's command as an undo."""
    with undoing():
        future = command(*arguments)
    await asyncio.wrap_future(future)
