"""The comparison of two recordings: clocks, topics, calls and goals, and their breaches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.model.names import OF_EVERY_NODE
from rsb_extras.audit.audited_topic import IN_FLIGHT, OPENING, Audit, AuditedTopic
from rsb_extras.audit.directions import SECOND, OffsetBy, directions
from rsb_extras.audit.recorded import index_topics, new_database, read_recording
from rsb_extras.audit.topic_pairs import PairError, PairText, is_named, pair_topics
from rsb_extras.audit.unanswered import CALL_TIME, GOAL_STATUS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Sequence
    from pathlib import Path

    from rsb_bridge.model.patterns import Pattern
    from rsb_extras.audit.directions import Clocks, Way
    from rsb_extras.audit.recorded import ReadRecording, TopicRows
    from rsb_extras.audit.topic_pairs import Paired, TopicPair
    from rsb_extras.audit.unanswered import SeenGoals


@dataclass(frozen=True)
class AuditOptions:
    """The options of an audit.

    Attributes:
        topics: those that count and have to cross; without any, all count.
        pairs: names of topics that belong together.
        back: topics that go from FAR to NEAR.
        forth: topics that go from NEAR to FAR.
        offset: s that FAR's clock is ahead, or None to find out.
        gap: s.
        overlap: whether one recording may be shorter.
    """

    topics: Sequence[Pattern] = ()
    pairs: Sequence[tuple[str, str]] = ()
    back: Sequence[Pattern] = ()
    forth: Sequence[Pattern] = ()
    offset: float | None = None
    gap: float = 1.0
    overlap: bool = False


class RecordingFacts(msgspec.Struct, frozen=True):
    """One of the two recordings. Times are s since the epoch.

    Attributes:
        joined: number of recordings that stand behind another one in the same file.
        cut: why the rest was not read, or empty.
    """

    path: str
    messages: int
    topics: int
    first: float
    last: float
    joined: int
    cut: str


class AuditedCalls(msgspec.Struct, frozen=True):
    """Calls of a service in the recording of a `side`, as the events of its ``caller`` or ``provider`` tell."""

    service: str
    side: str
    seen_by: str
    asked: int
    unanswered: int


class AuditedGoals(msgspec.Struct, frozen=True):
    """Goals of an action: how many have ended on one side only, and how many on neither."""

    action: str
    far_action: str
    goals: int
    unanswered: int
    unfinished: int


class Breach(msgspec.Struct, frozen=True):
    """A promise of QoS, or a topic that the user named, that the recordings do not show.

    Attributes:
        kind: ``lost``, ``doubled``, ``disordered``, ``latched_old``, ``latched_absent``, ``not_crossed``, ``call``,
            ``goal``; ``not_judged`` if both sides have a topic, and no message of it is the same; ``shorter`` if a side
            where messages arrive has none for `count` seconds at its begin or end; or ``nothing_compared`` if the
            recordings have no message or no time in common.
        name: of the topic, service, action or side.
    """

    kind: str
    name: str
    count: int


class AuditReport(msgspec.Struct, frozen=True):
    """All that two recordings say.

    Attributes:
        overlap: s that both cover.
        offset: s that FAR's clock is ahead; `offset_by` is what says so.
        only_near, only_far: topics that only one side has.
    """

    near: RecordingFacts
    far: RecordingFacts
    overlap: float
    offset: float
    offset_by: OffsetBy
    offset_uncertainty: float | None
    topics: list[AuditedTopic]
    calls: list[AuditedCalls]
    goals: list[AuditedGoals]
    only_near: list[str]
    only_far: list[str]
    breaches: list[Breach]


def compare(near_path: Path, far_path: Path, options: AuditOptions) -> AuditReport:
    """Compare the recordings of two sides.

    Raises:
        RecordingError: one is no recording.
        PairError: a topic that the user names is not there.
        sqlite3.Error: the folder for temporary files has no room.
    """
    database = new_database()
    try:
        near, far = read_recording(near_path, "near", database), read_recording(far_path, "far", database)
        paired = pair_topics(near, far, options.pairs, options.topics)
        _check_named(options, paired, near, far)
        index_topics(database, ((pair.near, pair.far) for pair in paired.pairs))
        told = None if options.offset is None else round(options.offset * SECOND)
        ways, clocks = directions(
            database, near, far, paired.pairs, back=options.back, forth=options.forth, offset=told
        )
        audit = Audit(database, near, far, clocks, options.gap)
        topics = [audit.compare(pair, way) for pair, way in zip(paired.pairs, ways, strict=True)]
    finally:
        database.close()
    calls = [*_calls(near, "near", options.topics), *_calls(far, "far", options.topics)]
    goals = list(_goals(near, far, paired.pairs, (audit.begin, audit.end - IN_FLIGHT), clocks.offset))
    overlap = max(audit.end - audit.begin, 0) / SECOND
    breaches = [*_topic_breaches(topics, paired, options), *_other_breaches(calls, goals)]
    if not options.overlap:
        breaches += _shorter(near, far, clocks, {topic.way for topic in topics if not topic.nothing_common})
    if not overlap or not any(topic.matched for topic in topics):
        breaches.append(Breach("nothing_compared", "", 0))
    return AuditReport(
        _facts(near),
        _facts(far),
        overlap,
        clocks.offset / SECOND,
        clocks.by,
        None if clocks.uncertainty is None else clocks.uncertainty / SECOND,
        topics,
        calls,
        goals,
        [topic.name for topic in paired.only_near],
        [topic.name for topic in paired.only_far],
        breaches,
    )


def _check_named(options: AuditOptions, paired: Paired, near: ReadRecording, far: ReadRecording) -> None:
    pairs = {topic.name for pair in paired.pairs for topic in (pair.near, pair.far)}
    alone = {topic.name for topic in (*paired.only_near, *paired.only_far)}
    others = {name for side in (near, far) for name in (*side.calls, *side.goals)}
    for option, patterns, names in (
        ("--topic", options.topics, pairs | alone | others),
        ("--back", options.back, pairs),
        ("--forth", options.forth, pairs),
    ):
        for pattern in patterns:
            if not is_named([pattern], *names):
                raise PairError(PairText.NO_TOPIC(option=option, pattern=pattern.text))


def _calls(recording: ReadRecording, side: str, patterns: Sequence[Pattern]) -> Iterator[AuditedCalls]:
    for service, calls in sorted(recording.calls.items()):
        if patterns and not is_named(patterns, service):
            continue
        unanswered = calls.unanswered(recording.last - CALL_TIME)
        for seen_by, asked in calls.asked.items():
            if asked:
                yield AuditedCalls(service, side, seen_by, asked, unanswered[seen_by])


def _goals(
    near: ReadRecording, far: ReadRecording, pairs: Sequence[TopicPair], common: tuple[int, int], offset: int
) -> Iterator[AuditedGoals]:
    begin, end = common
    for pair in pairs:
        here, there = near.goals.get(_action(pair.near)), far.goals.get(_action(pair.far))
        if here is not None and there is not None:
            both = here.goals.keys() | there.goals.keys()
            yield AuditedGoals(
                _action(pair.near),
                _action(pair.far),
                len(both),
                _ended_only(here, there, begin, end) + _ended_only(there, here, begin + offset, end + offset),
                sum(not (here.has_ended(goal) or there.has_ended(goal)) for goal in both),
            )


def _action(topic: TopicRows) -> str:
    return topic.name.removesuffix(GOAL_STATUS)


def _ended_only(here: SeenGoals, there: SeenGoals, begin: int, end: int) -> int:
    """Count goals that ended in one recording between two moments on its clock, and never in the other one."""
    ended = (goal for goal, (has_ended, time) in here.goals.items() if has_ended and begin <= time <= end)
    return sum(not there.has_ended(goal) for goal in ended)


def _facts(recording: ReadRecording) -> RecordingFacts:
    return RecordingFacts(
        str(recording.path),
        recording.messages,
        len(recording.topics),
        recording.first / SECOND,
        recording.last / SECOND,
        recording.joined,
        recording.cut,
    )


def _topic_breaches(topics: Iterable[AuditedTopic], paired: Paired, options: AuditOptions) -> Iterator[Breach]:
    for result in topics:
        yield from (Breach(kind, result.topic, count) for kind, count in result.breaches())
        if result.nothing_common:
            sent = result.near if result.way == "to_far" else result.far
            if result.paired_by == "option" or is_named(options.topics, result.topic, result.far_topic):
                yield Breach("not_crossed", result.topic, sent)
            elif result.topic not in OF_EVERY_NODE:
                yield Breach("not_judged", result.topic, sent)
    for topic in (*paired.only_near, *paired.only_far):
        if is_named(options.topics, topic.name):
            yield Breach("not_crossed", topic.name, topic.messages)


def _shorter(near: ReadRecording, far: ReadRecording, clocks: Clocks, ways: Collection[Way]) -> Iterator[Breach]:
    """Yield the side where messages should arrive, and do not for longer than a recorder may be late.

    A bridge that has died leaves such a recording, if nobody else sends there.
    """
    begins, ends = (near.first, far.first - clocks.offset), (near.last, far.last - clocks.offset)
    for way, side, sign in (("to_far", "far", 1), ("to_near", "near", -1)):
        missing = max(sign * (begins[1] - begins[0]), sign * (ends[0] - ends[1]))
        if missing > OPENING and way in ways:
            yield Breach("shorter", side, round(missing / SECOND))


def _other_breaches(calls: Iterable[AuditedCalls], goals: Iterable[AuditedGoals]) -> Iterator[Breach]:
    for call in calls:
        if call.unanswered:
            yield Breach("call", call.service, call.unanswered)
    for goal in goals:
        if goal.unanswered:
            yield Breach("goal", goal.action, goal.unanswered)
