"""The comparison of two recordings for people: a table of the topics, what else was found, and the verdict."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Wording, join_first, plural
from rsb_console.notation.formats import milliseconds, span
from rsb_extras.audit.audited_topic import OPENING
from rsb_extras.audit.directions import SECOND
from rsb_extras.audit.unanswered import CALL_TIME

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_extras.audit.audited_topic import AuditedTopic
    from rsb_extras.audit.comparing import AuditReport, Breach, RecordingFacts

_HEADS = (
    "topic", "", "QoS", "near", "far", "lost", "doubled", "disordered", "early", "undecided", "outside", "elsewhere",
    "p50 ms", "p99 ms", "latched",
)  # fmt: skip
_WAYS = {"to_far": "->", "to_near": "<-"}
_NONE = "-"
_NAMED = 20  # topics in a sentence; the others are counted. A round figure
_SILENCES = 10  # of a topic on a side; the others are counted. A round figure
_OFFSETS = {
    "option": "as you say",
    "two_ways": "by messages both ways, ± {uncertainty}",
    "least_age": "by the fastest message; ages are what the others took longer",
    "assumed": "assumed, as no message is there just once; ages say little",
}


class AuditText(Wording):
    """Texts of the audit's report."""

    NO_ROOM = "the folder for temporary files cannot hold the audit ({reason}): set TMPDIR to one with more room"
    RECORDING = "{side:<4}  {path}: {messages:,} messages of {topics} topics, {seconds:.1f} s from {start}"
    CUT = "{side:<4}  {path}: {reason}; read as far as it goes"
    JOINED = "{side:<4}  {path}: {count} recordings, one behind the other; all are read"
    CLOCKS = "Both cover {overlap:.1f} s. FAR's clock is {offset} {direction}: {by}."
    NO_OVERLAP = "The recordings have no time in common: nothing can be judged."
    EARLY = "early: before the topic's first message that crossed, in its first {opening:g} s."
    UNDECIDED = "undecided: sent so late that it may have been on its way when a recording ended."
    OUTSIDE = "outside: not arrived, but only the sender's recording covers their time, so they are not judged."
    ELSEWHERE = "elsewhere: only on the receiving side."
    BY_ORDER = "{topic}: {count:,} of {all:,} messages equal others; which of them crossed is told by their order"
    NOT_JUDGED = "not judged, as the sides have no message in common (not bridged, or changed on the way): {topics}"
    ASSUMED = "from NEAR to FAR, as nothing says otherwise (--back): {topics}"
    UNKNOWN_QOS = (
        "{topic}: the recording does not say which QoS holds, or its publishers differ; what is lost is no failure"
    )
    PADDING = (
        "{topic}: the recordings do not both describe {type}; padding inside its messages counts as content, so that "
        "what is lost may have crossed"
    )
    SEVERAL = "{topic}: several publishers, which the recording does not tell apart; their order is not judged"
    ONLY = "only in {side}: {topics}"
    SILENCE = "{topic}: silent on {side} from {start} for {seconds:.1f} s; on {other_side} {other:,} {messages}"
    TO_END = "{topic}: silent on {side} from {start} on, {seconds:.1f} s; on {other_side} {other:,} {messages}"
    MORE_SILENCES = "{topic}: {count} more silences on {side}; some may be its sender's"
    SENDER = "{topic}: its sender on {side} was silent {count} {times}, {which}for {seconds:.1f} s at most"
    CALLS = "{service} on {side}, by its {seen_by}: {asked:,} calls, {unanswered:,} unanswered for {seconds:g} s"
    GOALS = "{action}: {goals:,} goals, {unanswered:,} ended on one side only, {unfinished:,} not ended"
    FAILED = "MISSING  {name}: {what}"
    NOTHING = "MISSING  the recordings have nothing in common: are they of the same time? Do names differ (--pair)?"
    SHORTER = "MISSING  {side}: nothing recorded for {seconds} s at its begin or end (--overlap allows it)"
    PASSED = "All that QoS promises has crossed, as far as the recordings show; {judged} of {all} topics were judged."


def lines_of(report: AuditReport) -> Iterator[str]:
    yield from _recording("NEAR", report.near)
    yield from _recording("FAR", report.far)
    if not report.overlap:
        yield AuditText.NO_OVERLAP()
    else:
        by = _OFFSETS[report.offset_by].format(uncertainty=span(report.offset_uncertainty or 0.0))
        direction = "behind" if report.offset < 0 else "ahead"
        yield AuditText.CLOCKS(overlap=report.overlap, offset=span(abs(report.offset)), direction=direction, by=by)
    if report.topics:
        yield ""
        yield from _table(report.topics)
        judged = [each for each in report.topics if not each.nothing_common]
        if any(each.early for each in judged):
            yield AuditText.EARLY(opening=OPENING / SECOND)
        if any(each.undecided for each in judged):
            yield AuditText.UNDECIDED()
        if any(each.outside for each in judged):
            yield AuditText.OUTSIDE()
        if any(each.elsewhere for each in judged):
            yield AuditText.ELSEWHERE()
    for more in (_notes, _silences, _answers, _verdict):
        lines = list(more(report))
        if lines:
            yield ""
            yield from lines


def _recording(side: str, facts: RecordingFacts) -> Iterator[str]:
    yield AuditText.RECORDING(
        side=side,
        path=facts.path,
        messages=facts.messages,
        topics=facts.topics,
        seconds=facts.last - facts.first,
        start=f"{_moment(facts.first):%Y-%m-%d %H:%M:%S}",
    )
    if facts.joined:
        yield AuditText.JOINED(side=side, path=facts.path, count=facts.joined + 1)
    if facts.cut:
        yield AuditText.CUT(side=side, path=facts.path, reason=facts.cut)


def _table(topics: Sequence[AuditedTopic]) -> Iterator[str]:
    rows = [_HEADS, *(_row(each) for each in topics)]
    # A column without any figure of its own takes no room.
    shown = [at for at in range(len(_HEADS)) if at < 7 or any(row[at] not in ("0", _NONE) for row in rows[1:])]
    widths = [max(len(row[at]) for row in rows) for at in shown]
    for row in rows:
        first, way, *others = (row[at] for at in shown)
        cells = [f"{cell:>{width}}" for cell, width in zip(others, widths[2:], strict=True)]
        yield "  ".join([f"{first:<{widths[0]}}", f"{way:<{widths[1]}}", *cells]).rstrip()


def _row(topic: AuditedTopic) -> tuple[str, ...]:
    counted = (
        topic.lost, topic.doubled, topic.disordered, topic.early, topic.undecided, topic.outside, topic.elsewhere,
    )  # fmt: skip
    ages = (topic.age_p50, topic.age_p99)
    return (
        topic.topic if topic.topic == topic.far_topic else f"{topic.topic} = {topic.far_topic}",
        _WAYS[topic.way],
        {True: "reliable", False: "best effort", None: "?"}[topic.reliable],
        f"{topic.near:,}",
        f"{topic.far:,}",
        *(_NONE if topic.nothing_common or count is None else f"{count:,}" for count in counted),
        *(_NONE if age is None else milliseconds(age) for age in ages),
        topic.latched_value or _NONE,
    )


def _notes(report: AuditReport) -> Iterator[str]:
    judged = [topic for topic in report.topics if not topic.nothing_common]
    if others := [topic.topic for topic in report.topics if topic.nothing_common]:
        yield AuditText.NOT_JUDGED(topics=join_first(others, _NAMED))
    if assumed := [topic.topic for topic in judged if topic.way_by == "assumed"]:
        yield AuditText.ASSUMED(topics=join_first(assumed, _NAMED))
    for topic in report.topics:
        if not topic.described and (topic.nothing_common or topic.lost or topic.elsewhere):
            yield AuditText.PADDING(topic=topic.topic, type=topic.type)
    for topic in judged:
        if topic.by_order:
            yield AuditText.BY_ORDER(topic=topic.topic, count=topic.by_order, all=topic.matched)
        if topic.reliable is None:
            yield AuditText.UNKNOWN_QOS(topic=topic.topic)
        if topic.disordered is None:
            yield AuditText.SEVERAL(topic=topic.topic)
    for side, names in (("NEAR", report.only_near), ("FAR", report.only_far)):
        if names:
            yield AuditText.ONLY(side=side, topics=join_first(names, _NAMED))


def _silences(report: AuditReport) -> Iterator[str]:
    """Yield silences of the receiving side while the other one sent, and how often the sender itself was silent."""
    for topic in (each for each in report.topics if not each.nothing_common):
        sender, receiver = ("near", "far") if topic.way == "to_far" else ("far", "near")
        own = [gap for gap in topic.gaps[receiver] if gap.other]
        for gap in own[:_SILENCES]:
            yield (AuditText.TO_END if gap.open else AuditText.SILENCE)(
                topic=topic.topic,
                side=receiver.upper(),
                start=f"{_moment(gap.start):%H:%M:%S.%f}"[:-3],
                seconds=gap.end - gap.start,
                other_side=sender.upper(),
                other=gap.other,
                messages=plural(gap.other, "message"),
            )
        if more := len(own[_SILENCES:]) + topic.more_gaps[receiver]:
            yield AuditText.MORE_SILENCES(topic=topic.topic, side=receiver.upper(), count=more)
        if sent := topic.gaps[sender]:
            count = len(sent) + topic.more_gaps[sender]
            longest = max(gap.end - gap.start for gap in sent)
            yield AuditText.SENDER(
                topic=topic.topic,
                side=sender.upper(),
                count=count,
                times=plural(count, "time"),
                seconds=longest,
                which=f"the first {len(sent)} " if count > len(sent) else "",
            )


def _answers(report: AuditReport) -> Iterator[str]:
    for call in report.calls:
        yield AuditText.CALLS(
            service=call.service,
            side=call.side.upper(),
            seen_by=call.seen_by,
            asked=call.asked,
            unanswered=call.unanswered,
            seconds=CALL_TIME / SECOND,
        )
    for goal in report.goals:
        yield AuditText.GOALS(
            action=goal.action, goals=goal.goals, unanswered=goal.unanswered, unfinished=goal.unfinished
        )


def _verdict(report: AuditReport) -> Iterator[str]:
    for breach in report.breaches:
        if breach.kind == "nothing_compared":
            yield AuditText.NOTHING()
        elif breach.kind == "shorter":
            yield AuditText.SHORTER(side=breach.name.upper(), seconds=breach.count)
        else:
            yield AuditText.FAILED(name=breach.name, what=_what(breach))
    if not report.breaches:
        judged = sum(not topic.nothing_common for topic in report.topics)
        everything = len(report.topics) + len(report.only_near) + len(report.only_far)
        yield AuditText.PASSED(judged=judged, all=everything)


def _what(breach: Breach) -> str:
    count, messages = f"{breach.count:,}", plural(breach.count, "message")
    return {
        "lost": f"{count} {messages} lost",
        "doubled": f"{count} {messages} more than were sent",
        "disordered": f"{count} {messages} after a later one",
        "latched_old": "the latched message at the end is an old one",
        "latched_absent": "the latched message at the end is not there",
        "not_judged": "no message is the same on both sides; name the topics that should cross (--topic)",
        "not_crossed": f"none of {count} {messages} has crossed",
        "call": f"{count} {plural(breach.count, 'call')} without an answer",
        "goal": f"{count} {plural(breach.count, 'goal')} ended on one side only",
    }[breach.kind]


def _moment(seconds: float) -> datetime:
    """Return local time, or its beginning for what no calendar has."""
    try:
        return datetime.fromtimestamp(seconds)
    except (ValueError, OverflowError, OSError):
        return datetime.fromtimestamp(0)
