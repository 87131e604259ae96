"""Verdicts of a half of a route of calls, from its facts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.support.judged import calls_half, calls_verdict
from tests.support.offline import half_of

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.faults import PathFault
from rsb_bridge.model.reason import Reason
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import Stage, State
from rsb_bridge.model.verdict import Cause, LinkCause, Verdict
from rsb_bridge.route.calls.caller import Caller
from rsb_bridge.route.calls.calls_end import MalformedCall, Trouble
from rsb_bridge.route.calls.calls_ledger import REMEDIES
from rsb_bridge.route.calls.calls_verdict import CallsFacts
from rsb_bridge.route.combined_verdict import CombinedVerdict, record_of
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.wire.messages import Provide
from rsb_bridge.wire.records import LaneEntry, VerdictRecord

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context

FINE: dict[str, Any] = {
    "sends": True, "topic": "/go", "accepted": True, "came": True, "providers": ("/teller",), "offered": True,
    "timeout": 5.0,
}  # fmt: skip
CALL_STAGES = ("server seen", "type known", "link up", "peer accepted", "offered", "called", "answered")
"""Scripts read these names in JSON."""
NOBODY = Trouble(Cause.NO_SERVER, "no server of /go in domain 2")
GONE = Trouble(Cause.SERVER_GONE, "no server of /go in domain 2 any more")
SILENT = PathFault(LinkCause.SILENT, "nothing comes")
TWO = Trouble(Cause.SEVERAL_SERVERS, "/go is served by /one and /two")


def verdict_on(**changes: Any) -> Verdict:
    return calls_verdict(**(FINE | changes))


def stages_on(**changes: Any) -> dict[str, Stage]:
    return {each.name: each for each in CallsFacts.stages(calls_half(**(FINE | changes)))}


@pytest.mark.parametrize(
    ("changes", "state", "cause"),
    [
        ({}, State.OK, Cause.NONE),
        ({"link_down": "cut", "unavailable": NOBODY}, State.DOWN, Cause.LINK_DOWN),
        ({"breaking": "reset"}, State.DOWN, Cause.NO_PATH),
        ({"refusal": Reason("denied")}, State.DOWN, Cause.REFUSED),
        ({"crossing": Crossing.LOOP, "loop": "a circle"}, State.DOWN, Cause.LOOP),
        ({"crossing": Crossing.PAUSED, "unavailable": NOBODY}, State.PAUSED, Cause.PAUSED),
        ({"crossing": Crossing.DISARMED, "disarmed": "unarmed"}, State.DISARMED, Cause.DISARMED),
        ({"no_path": Verdict(State.DOWN, Cause.NO_PATH, "stuck")}, State.DOWN, Cause.NO_PATH),
        ({"unavailable": NOBODY, "offered": False}, State.WAITING, Cause.NO_SERVER),
        ({"unavailable": GONE, "offered": False}, State.DOWN, Cause.SERVER_GONE),
        ({"unavailable": GONE, "expired": 3, "failing_since": 1.0}, State.DOWN, Cause.SERVER_GONE),
        ({"offered": False, "came": False, "accepted": None}, State.WAITING, Cause.NO_CALL),
        ({"came": False}, State.WAITING, Cause.NO_CALL),
        ({"expired": 3, "failing_since": 1.0}, State.SLOW, Cause.UNANSWERED),
        ({"expired": 3, "waited": True, "failing_since": 1.0}, State.SLOW, Cause.CALLS_WAIT),
        ({"unanswered": True, "failing_since": 1.0}, State.SLOW, Cause.UNANSWERED),
        ({"came": False, "came_before": True}, State.WAITING, Cause.NO_CALL),
        ({"refused": {Refused.PAUSED: 1}, "failing_since": 1.0}, State.SLOW, Cause.CALLS_REFUSED),
        ({"path": SILENT, "in_flight": 1}, State.WAITING, Cause.AWAITS_LINK),
        ({"path": SILENT, "in_flight": 0}, State.OK, Cause.NONE),
        ({"expired": 3, "failing_since": 1.0, "warning": TWO}, State.SLOW, Cause.UNANSWERED),
        ({"warning": TWO}, State.UNHEARD, Cause.SEVERAL_SERVERS),
        ({"limit": 5.0}, State.OK, Cause.THROTTLED),
    ],
)
def test_what_counts(changes: dict[str, Any], state: State, cause: Cause) -> None:
    verdict = verdict_on(**changes)
    assert (verdict.state, verdict.cause) == (state, cause)
    assert bool(verdict.text) is (verdict.cause != Cause.NONE)


@pytest.mark.parametrize(
    ("changes", "name", "done", "detail"),
    [
        ({"accepted": None}, "peer accepted", None, ""),
        ({"accepted": False, "refusal": Reason("denied")}, "peer accepted", False, "denied"),
        ({"no_path": Verdict(State.DOWN, Cause.NO_PATH, "stuck")}, "link up", False, "stuck"),
        ({"link_down": "cut"}, "link up", False, "cut"),
        ({"link_down": "cut"}, "server seen", None, ""),
        ({}, "server seen", True, "/teller"),
        ({"asked": 1}, "called", True, ""),
        ({"asked": 1, "last_failure": "late"}, "answered", None, "late"),
        ({"asked": 2, "answered": 1, "last_failure": "late"}, "answered", True, ""),
    ],
)
def test_a_stage_follows_from_the_facts(changes: dict[str, Any], name: str, done: bool | None, detail: str) -> None:
    stages = stages_on(**changes)
    assert tuple(stages) == CALL_STAGES
    assert (stages[name].done, stages[name].detail) == (done, detail)


def test_callers_side_knows_what_other_side_tells(make_context: Callable[..., Context]) -> None:
    half = half_of(Caller, make_context(), Topic("/go", "transmit", kind="service"))
    assert [each.done for each in half.offer.stages()] == [None, None, None]
    half.offer.provided = Provide(route=1)
    seen, _, offered = half.offer.stages()
    assert (seen.done, seen.detail) == (False, "no server of /go on the other side")
    half.route.judged.receive(VerdictRecord("waiting", NOBODY.cause, NOBODY.text, 0.0), 0.0)
    assert half.offer.stages()[0].detail == NOBODY.text
    half.offer.provided = Provide(route=1, lanes=(LaneEntry("zoo/srv/A", "RIHS01_1", 1),), nodes=("/teller",))
    half.carried.type_name = "zoo/srv/A"
    assert half.offer.stages() == (
        Stage("server seen", True, "/teller"),
        Stage("type known", True, "zoo/srv/A"),
        offered,
    )
    half.offer.lanes.retry.failed("rcl", half.offer.provided.lanes)
    assert half.offer.stages()[2] == Stage("offered", False, "rcl; trying again")
    half.route.close("over")


def test_what_is_refused_most_is_named() -> None:
    refused = {Refused.TOO_FAST: 1, Refused.CALLS_UNDER_WAY: 30}
    text = verdict_on(refused=refused, failing_since=0.0).said(20.0)
    assert "31" in text
    assert REMEDIES[Refused.CALLS_UNDER_WAY] in text


def test_malformed_calls_are_named_by_their_field() -> None:
    malformed = MalformedCall("B_Request", "name: too long")
    verdict = verdict_on(refused={Refused.MALFORMED: 1}, malformed=malformed, failing_since=0.0)
    assert "B_Request: name: too long" in verdict.said(20.0)


def test_silent_node_is_not_excused_by_lossy_path() -> None:
    lossy = PathFault(LinkCause.LOSSY, "6 % of packets are lost")
    far, near = (verdict_on(sends=sends, path=lossy, expired=3, failing_since=0.0) for sends in (False, True))
    assert (near.cause, far.cause) == (Cause.LOSSY, Cause.UNANSWERED)
    for sends, own, others in ((True, near, far), (False, far, near)):
        both = CombinedVerdict(sends=sends, peer_name="the other")
        both.receive(record_of(others), 0.0)
        assert both.shown(own).verdict.cause == Cause.UNANSWERED


@pytest.mark.parametrize(("trouble", "state"), [(NOBODY, State.WAITING), (GONE, State.DOWN)])
@pytest.mark.parametrize("sends", [True, False])
def test_both_sides_show_the_same(sends: bool, trouble: Trouble, state: State) -> None:
    """Nobody serves it, as the providing side knows; the callers' side waits."""
    near = verdict_on(offered=False, came=False)
    far = calls_verdict(sends=False, topic="/go", unavailable=trouble)
    own, others = (near, far) if sends else (far, near)
    both = CombinedVerdict(sends=sends, peer_name="the other")
    both.receive(record_of(others), 0.0)
    shown, from_peer = both.shown(own)
    assert (shown.state, shown.cause) == (state, trouble.cause)
    assert from_peer is sends
