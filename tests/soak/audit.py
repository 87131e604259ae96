"""Counting messages outside the bridge, and comparing with what both sides' ledgers say."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tests.soak.ledgers import Row, parts

if TYPE_CHECKING:
    from tests.soak.listener import TopicListener
    from tests.soak.messages import Kind
    from tests.soak.stage import Stage

_SETTLES_WITHIN = 60.0
_ANSWERS_WITHIN = 30.0


@dataclass(frozen=True, slots=True)
class _Counts:
    """Counts of one topic while nobody talks."""

    said: int
    heard: int
    newest: int
    row: Row
    kind: Kind


def audit(stage: Stage, seconds: float) -> list[str]:
    """Have all talk for so long while nothing goes wrong, and count.

    Returns:
        What does not add up, in words.
    """
    before, wrong = _settled(stage)
    _tell(stage, "talk")
    stage.live(seconds)
    after, still_wrong = _settled(stage)
    wrong += [*still_wrong, *_late(stage, after)]
    _tell(stage, "talk")
    for name in before.keys() & after.keys():
        wrong += _compare(name, before[name], after[name])
    return wrong


def _late(stage: Stage, counts: dict[str, _Counts]) -> list[str]:
    """Return what late listeners of the latched topics miss while nobody talks."""
    listeners = stage.late_listeners()
    missing = [listener for listener in listeners if listener.name in counts]

    def heard() -> bool:
        for listener in listeners:
            listener.take(time.time)
        missing[:] = [listener for listener in missing if listener.newest != counts[listener.name].said]
        return not missing

    stage.live_until(heard, _ANSWERS_WITHIN)
    for listener in listeners:
        listener.close()
    return [
        f"{listener.name}: a late listener gets message {listener.newest} as the newest of {counts[listener.name].said}"
        for listener in missing
    ]


def _compare(name: str, before: _Counts, after: _Counts) -> list[str]:
    said, heard = after.said - before.said, after.heard - before.heard
    counts = parts(after.row)
    counts.subtract(parts(before.row))
    taken, delivered = counts["offered"] + counts["lost_in_dds"], counts["delivered"]
    lost = {cause: count for cause, count in counts.items() if cause.startswith("dropped") and count}
    wrong = []
    if taken != said:
        wrong.append(f"{name}: {said} published, {taken} taken or lost in DDS, by the ledger")
    if heard > delivered or (heard < delivered and after.kind.keeps_all):
        wrong.append(f"{name}: {heard} heard, {delivered} delivered, by the ledger")
    if after.kind.latched and after.newest != after.said:
        wrong.append(f"{name}: the newest of {after.said} latched messages is {after.newest} at the far end")
    if lost and after.kind.protocol == "tcp":
        wrong.append(f"{name}: lost over TCP while nothing was wrong: {lost}")
    return wrong


def _tell(stage: Stage, words: str) -> dict[str, int]:
    """``talk`` or ``hush``. Returns what has been published, by the topic's name on the server."""
    for talkers in stage.talkers:
        talkers.ask(words)
    assert stage.live_until(lambda: all(each.said is not None for each in stage.talkers), _ANSWERS_WITHIN)
    said = {}
    for place, talkers in enumerate(stage.talkers):
        for topic, count in (talkers.said or {}).items():
            said[f"/robot{place}{topic}" if place else topic] = count
    return said


def _settled(stage: Stage) -> tuple[dict[str, _Counts], list[str]]:
    """Hush, and wait until nothing is in flight and both sides say the same.

    Returns:
        The counts by the topic's name on the server, and for each topic that does not settle what is wrong.
    """
    said, hushed = _tell(stage, "hush"), time.time()
    if not stage.live_until(
        lambda: not any(_open(stage, listener, hushed) for listener in stage.listeners), _SETTLES_WITHIN
    ):
        return {}, [words for listener in stage.listeners if (words := _open(stage, listener, hushed))]
    counts = {}
    for listener in stage.listeners:
        here, _ = _rows(stage, listener)
        assert here is not None
        counts[listener.name] = _Counts(said[listener.name], listener.heard, listener.newest, here, listener.kind)
    return counts, []


def _open(stage: Stage, listener: TopicListener, hushed: float) -> str:
    """Return why a topic has not settled since everybody was hushed, or an empty string if it has."""
    if any(program.told_at < hushed + 1.0 for program in stage.programs):
        return f"{listener.name}: no newer status"
    here, there = _rows(stage, listener)
    if here is None or there is None:
        return f"{listener.name}: no route on one of the sides"
    if here["waiting"] or here["in_flight"]:
        return f"{listener.name}: some wait or are in flight long after the last message: {dict(parts(here))}"
    if parts(here) != parts(there):
        return f"{listener.name}: the sides differ: sender {dict(parts(here))}, receiver {dict(parts(there))}"
    return ""


def _rows(stage: Stage, listener: TopicListener) -> tuple[Row | None, Row | None]:
    robot = listener.name.split("/")[1]
    client = next(each for each in stage.clients if each.name == robot)
    rows = {
        True: next((row for row in client.routes if row["topic"] == listener.kind.topic), None),
        False: next(
            (row for row in stage.server.routes if (row["link"], row["topic"]) == (robot, listener.name)), None
        ),
    }
    from_client = listener.kind.direction == "transmit"
    return rows[from_client], rows[not from_client]
