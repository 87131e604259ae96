"""Counts of a `Record`, made from what nodes outside of the bridge have published and heard."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

from tests.network.traffic import WRONG

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tests.network.outage_bed import Record

LEAD = 1.0
"""s before a fault at which its window begins: messages that are on their way then are lost with it."""
LIVE = 0.2
"""s; a message that is younger when it comes is live."""
_HOPED_FOR = 2.5
"""Intervals of a topic without a message that are no silence yet: a busy machine makes as many."""
_PARTS = ("delivered", "throttled", "expired", "waiting", "in_flight", "unknown")
_UNTAKEN = ("missed_while_down", "lost_in_dds", "unsubscribed")


class TopicCounts(NamedTuple):
    """A topic's messages, of those published from `LEAD` before the fault on.

    Attributes:
        published: how many.
        lost: how many of these never came.
        early: how many earlier ones never came; the traffic was not steady if there are any.
        doubled: messages, of all, that came once more.
        disordered: messages, of all, that came after a later one.
        silence: the longest time without a message, s; 0 for a latched topic.
        back: s from the end of the cause to the end of that silence; 0 if it ended before or is none; None if it had
            not ended when publishing ended.
        events: publishers that came or went in the listener's domain.
        live: s from the end of that silence until a message came that was younger than `LIVE`; 0 for a latched topic,
            or None if none came.
    """

    published: int
    lost: int
    early: int
    doubled: int
    disordered: int
    silence: float
    back: float | None
    events: int
    live: float | None


class CallCounts(NamedTuple):
    """Calls made from `LEAD` before the fault on.

    Attributes:
        asked: how many.
        answered: of these.
        pending: how many were under way when the fault began.
        kept: of these, answered later.
        twice: calls, of all, that the server had more than once.
        wrong: calls, of all, that got another call's answer.
        events: how often the service came or went in the caller's domain.
    """

    asked: int
    answered: int
    pending: int
    kept: int
    twice: int
    wrong: int
    events: int


class AccountCounts(NamedTuple):
    """The bridge's account of a topic, next to the count from outside, of all messages.

    Attributes:
        published: counted outside.
        accounted: the account's sum: offered for the first time, and not taken.
        heard: different messages, counted outside.
        delivered: the account's.
        dropped: by cause, with the rest of the account that is not delivered and not 0.
        unbalanced: `offered` without its parts.
    """

    published: int
    accounted: int
    heard: int
    delivered: int
    dropped: dict[str, int]
    unbalanced: int


def count_topic(record: Record, name: str, rate: float) -> TopicCounts:
    """Count a topic of `rate` Hz; 0 for a latched one."""
    made, heard = record.made[name], record.heard[name]
    since = record.began - int(LEAD * 1e9)
    came = {number for number, _, _ in heard}
    missing = [at for number, at in enumerate(made, 1) if number not in came]
    newest, seen = 0, set[int]()
    doubled = disordered = 0
    for number, _, _ in heard:
        doubled += number in seen
        disordered += number < newest and number not in seen
        seen.add(number)
        newest = max(newest, number)
    silence = 0.0
    back: float | None = 0.0
    live: float | None = 0.0
    if rate:
        silence, back, ends = _silence([at for _, _, at in heard], record, rate)
        alive = (at for _, published, at in heard if at >= ends and at - published < LIVE * 1e9)
        live = next(((at - ends) / 1e9 for at in alive), None)
    return TopicCounts(
        published=sum(at >= since for at in made),
        lost=sum(at >= since for at in missing),
        early=sum(at < since for at in missing),
        doubled=doubled,
        disordered=disordered,
        silence=silence,
        back=back,
        events=sum(arrived + left for at, arrived, left in record.events[name] if at >= since),
        live=live,
    )


def _silence(arrivals: Sequence[int], record: Record, rate: float) -> tuple[float, float | None, int]:
    """Return the longest silence and the time to its end (s), as `TopicCounts` has them, and when (ns) it ended.

    Without a silence, that is when the fault did.
    """
    since = record.began - int(LEAD * 1e9)
    # Arrivals after the last publication end no silence that publishing has seen.
    within = [since, *(at for at in arrivals if since < at < record.stopped), record.stopped]
    length, ends = max((after - before, after) for before, after in pairwise(within))
    if length < _HOPED_FOR * 1e9 / rate:
        return length / 1e9, 0.0, record.ended
    back = None if ends == record.stopped else max(0.0, (ends - record.ended) / 1e9)
    return length / 1e9, back, ends


def count_calls(record: Record) -> CallCounts:
    since = record.began - int(LEAD * 1e9)
    calls = [each for each in record.calls if each[0] >= since]
    pending = [
        (asked, answered) for asked, answered in calls if asked < record.began and not 0 < answered < record.began
    ]
    return CallCounts(
        asked=len(calls),
        answered=sum(answered > 0 for _, answered in calls),
        pending=len(pending),
        kept=sum(answered > 0 for _, answered in pending),
        twice=len(record.carried_out) - len(set(record.carried_out)),
        wrong=sum(answered == WRONG for _, answered in record.calls),
        events=sum(at >= since for at, _ in record.offers),
    )


def count_account(record: Record, name: str) -> AccountCounts | None:
    """Compare with the account that the sending side has at the end, or return None without a bridge."""
    if not record.accounts:
        return None
    row: dict[str, Any] = record.accounts[name]
    figure = {field: int(row.get(field) or 0) for field in (*_PARTS, "offered", "again", *_UNTAKEN)}
    dropped: dict[str, int] = row.get("dropped") or {}
    others = {field: figure[field] for field in (*_PARTS[1:], *_UNTAKEN) if figure[field]}
    return AccountCounts(
        published=len(record.made[name]),
        accounted=figure["offered"] - figure["again"] + sum(figure[field] for field in _UNTAKEN),
        heard=len({number for number, _, _ in record.heard[name]}),
        delivered=figure["delivered"],
        dropped=dropped | others,
        unbalanced=figure["offered"] - sum(figure[field] for field in _PARTS) - sum(dropped.values()),
    )
