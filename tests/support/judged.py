"""Halves of routes that consist of facts, as the rules of verdicts read them."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from rsb_bridge.model.audience import NOBODY
from rsb_bridge.model.reason import NO_REASON
from rsb_bridge.model.snapshot import Stage
from rsb_bridge.route.arming import Disarmed
from rsb_bridge.route.blocking_rules import judge, stages_with_link
from rsb_bridge.route.calls.calls_verdict import OF_CALLS
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.topic_verdict import OF_RECEIVER, OF_SENDER
from rsb_bridge.wire.framing import MESSAGE_LIMIT

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.verdict import Verdict

_OF_ROUTE: dict[str, Any] = {
    "sends": True,
    "topic": "/chat",
    "far_topic": "",
    "domain": "0",
    "link_down": None,
    "accepted": None,
    "refusal": NO_REASON,
    "reopens": False,
    "crossing": Crossing.NOT_OPEN,
    "loop": "",
    "paused_by": "",
    "disarmed": "",
    "can_be_armed": True,
    "no_path": None,
    "breaking": "",
    "came": False,
    "came_before": False,
    "limit": 0.0,
    "path": None,
    "full": None,
}
_OF_TOPIC: dict[str, Any] = {
    "endpoints": (),
    "described": False,
    "type_name": "",
    "qos": None,
    "unresolved": None,
    "why_unresolved": "",
    "elsewhere": None,
    "subscribe_failed": "",
    "unmatched": False,
    "refused": False,
    "sizes": (),
    "nameless": (),
    "sent": 0,
    "undelivered": "",
    "audience": NOBODY,
    "others": (),
    "clocks": frozenset(),
    "type_before": "",
    "publisher_nodes": (),
    "drivers": (),
    "left_out": "",
    "stale_since": None,
    "stopped_since": None,
    "new": (),
    "slow_since": None,
    "rate": 0.0,
    "regular": False,
    "expected_rate": None,
    "lost_in_dds": 0,
    "left": 0,
    "loss": None,
    "datagrams": 0,
    "compression": "none",
    "armed": False,
    "late": None,
    "expired": None,
    "malformed": "",
    "loss_unexplained": False,
    "loss_of_full_link": False,
    "shown_cause": "",
}
_OF_CALLS: dict[str, Any] = {
    "offered": False,
    "providers": (),
    "unavailable": None,
    "warning": None,
    "in_flight": 0,
    "expired": 0,
    "waited": False,
    "unanswered": False,
    "refused": {},
    "asked": 0,
    "answered": 0,
    "last_failure": "",
    "malformed": None,
    "failing_since": None,
    "timeout": 0.0,
}


def topic_half(now: float = 0.0, **facts: Any) -> Any:
    """Make a half of a topic's route at `now` (s). Other facts are as in a route that is not open."""
    known = _known(_OF_TOPIC, facts)
    half = _half(known, now)
    half.notices.warning, half.notices.undelivered = known["left_out"], known["undelivered"]
    half.arming.required = known["armed"]
    half.life.described = known["described"]
    half.stages = lambda: stages_with_link(half, (), (Stage("sent", None),))
    half.has_sent = known["sent"] > 0
    half.offered, half.report_now = known["qos"], None
    half.age = SimpleNamespace(late=lambda: known["expired"])
    half.judged = SimpleNamespace(shown_cause=known["shown_cause"])
    half.meter = SimpleNamespace(
        rate=known["rate"], regular=known["regular"], count=len(known["sizes"]), bytes=sum(known["sizes"])
    )
    half.health = SimpleNamespace(
        expected_rate=known["expected_rate"],
        stop=SimpleNamespace(since=known["stopped_since"], new=known["new"]),
        slow=SimpleNamespace(since=known["slow_since"]),
        losses=SimpleNamespace(loss=known["loss"]),
        lost_in_dds=lambda: known["lost_in_dds"],
    )
    half.drivers = SimpleNamespace(
        several=known["drivers"], here=known["drivers"], there=(), are_watched=bool(known["drivers"])
    )
    backlog = SimpleNamespace(exists=known["left"] > 0, left=known["left"])
    half.path = SimpleNamespace(backlog=backlog)
    half.stale_since = lambda crossing: known["stale_since"]
    half.late = lambda: known["late"]
    half.was_full_since = lambda since: known["loss_of_full_link"]
    half.why, half.datagrams = _always(known["why_unresolved"]), _always(known["datagrams"])
    half.failure, half.is_unmatched = known["subscribe_failed"], known["unmatched"]
    half.is_nameless = known["nameless"].__contains__
    half.refuses = half.refused = known["refused"]
    half.ends = _always((known["publisher_nodes"], None, None))
    half.proposal = SimpleNamespace(compression=known["compression"])
    half.resolver = half.subscription = half
    half.of_transforms = None
    for name in (
        "endpoints", "type_name", "qos", "unresolved", "elsewhere", "unmatched", "audience", "others", "clocks",
        "type_before", "malformed", "loss_unexplained",
    ):  # fmt: skip
        setattr(half, name, known[name])
    return half


def calls_half(now: float = 0.0, **facts: Any) -> Any:
    """Make a half of a route of calls at `now` (s). Other facts are as in a route that is not open."""
    known = _known(_OF_CALLS, facts)
    half = _half(known, now)
    half.calls = SimpleNamespace(
        expired_lately=lambda: known["expired"], refused_lately=lambda: Counter(known["refused"])
    )
    for name in ("in_flight", "unanswered", "asked", "answered", "last_failure"):
        setattr(half.calls, name, known[name])
    half.failures = SimpleNamespace(since=known["failing_since"])
    half.call_timeout = known["timeout"]
    half.last_malformed = lambda: known["malformed"]
    known_and_offered = Stage("type known", True), Stage("offered", known["offered"] or None)
    half.end = SimpleNamespace(
        offered=known["offered"],
        warning=known["warning"],
        unavailable=_always(known["unavailable"]),
        nodes=_always(((), known["providers"])),
        stages=_always((Stage("server seen", True, ", ".join(known["providers"])), *known_and_offered)),
    )
    half.stages = lambda: stages_with_link(half, (), (Stage("offered", None),))
    half.waited = known["waited"]
    return half


def _known(facts_of_kind: dict[str, Any], facts: dict[str, Any]) -> dict[str, Any]:
    known = _OF_ROUTE | facts_of_kind
    assert facts.keys() <= known.keys(), facts.keys() - known.keys()
    return known | facts


def _half(known: dict[str, Any], now: float) -> Any:
    """Make what topics and calls have in common."""
    why = Disarmed.NOT_YET if known["can_be_armed"] else Disarmed.LINK_SLOW
    refusal = known["refusal"]
    half = SimpleNamespace(
        outgoing=known["sends"],
        local_topic=known["topic"],
        far_topic=known["far_topic"],
        context=SimpleNamespace(domain=known["domain"], now=_always(now)),
        peer=SimpleNamespace(
            linked=known["link_down"] is None,
            down_reason=known["link_down"] or "",
            suspended_since=None,
            path=SimpleNamespace(fault=known["path"]),
            verdicts=None,
            explain=None,
        ),
        transport=SimpleNamespace(reliable=True, largest_message=MESSAGE_LIMIT),
        life=SimpleNamespace(
            accepted=bool(known["accepted"]), refusal=refusal if known["accepted"] is False else NO_REASON
        ),
        shown_refusal=refusal,
        reopening=SimpleNamespace(reopens=lambda _: known["reopens"]),
        notices=SimpleNamespace(loop=known["loop"]),
        pausing=SimpleNamespace(who=known["paused_by"]),
        arming=SimpleNamespace(why_at=lambda _: (why, known["disarmed"])),
        limit=SimpleNamespace(rate=known["limit"], why="set on purpose (max_rate)"),
        link_full=known["full"],
        breaking=known["breaking"],
        came=known["came"],
        came_before=known["came_before"],
        trouble=lambda: known["no_path"],
        away_text=lambda: known["link_down"] or "the link is down",
    )
    # Its facts are those of all the parts.
    half.route = half.flow = half.carried = half.listeners = half
    return half


def _always(value: Any) -> Callable[[], Any]:
    return lambda: value


def topic_verdict(now: float = 0.0, **facts: Any) -> Verdict:
    half = topic_half(now, **facts)
    return judge(half, facts.get("crossing", Crossing.NOT_OPEN), OF_SENDER if half.outgoing else OF_RECEIVER)[0]


def calls_verdict(now: float = 0.0, **facts: Any) -> Verdict:
    return judge(calls_half(now, **facts), facts.get("crossing", Crossing.NOT_OPEN), OF_CALLS)[0]
