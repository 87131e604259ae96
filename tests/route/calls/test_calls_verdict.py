"""What a half of a route of calls makes of what it knows."""

from __future__ import annotations

from typing import Any

import pytest

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, Verdict
from rsb_bridge.route.blocking_rules import RouteStatus
from rsb_bridge.route.calls.calls_ledger import REMEDIES
from rsb_bridge.route.calls.calls_verdict import CallsFacts, Trouble, judge_calls
from rsb_bridge.route.combined_verdict import CombinedVerdict, record_of

FINE = CallsFacts(RouteStatus(sends=True, topic="/go"), offered=True, came=True, timeout=5.0, providers="/teller")
NOBODY = Trouble(Cause.NO_SERVER, "no server of /go in domain 2")
GONE = Trouble(Cause.SERVER_GONE, "no server of /go in domain 2 any more")
TWO = Trouble(Cause.SEVERAL_SERVERS, "/go is served by /one and /two")


def verdict_on(**changes: Any) -> Verdict:
    of_route = {name: changes.pop(name) for name in RouteStatus._fields if name in changes}
    return judge_calls(FINE._replace(status=FINE.status._replace(**of_route), **changes))


@pytest.mark.parametrize(
    ("changes", "state", "cause"),
    [
        ({}, State.OK, Cause.NONE),
        ({"link_down": "cut", "unavailable": NOBODY}, State.DOWN, Cause.LINK_DOWN),
        ({"breaking": "reset"}, State.DOWN, Cause.NO_PATH),
        ({"refusal": "denied"}, State.DOWN, Cause.REFUSED),
        ({"loop": "a circle"}, State.DOWN, Cause.LOOP),
        ({"paused": True, "unavailable": NOBODY}, State.PAUSED, Cause.PAUSED),
        ({"disarmed": "unarmed"}, State.DISARMED, Cause.DISARMED),
        ({"no_path": "stuck"}, State.DOWN, Cause.NO_PATH),
        ({"unavailable": NOBODY, "offered": False}, State.WAITING, Cause.NO_SERVER),
        ({"unavailable": GONE, "offered": False}, State.DOWN, Cause.SERVER_GONE),
        ({"unavailable": GONE, "expired": 3, "failing_since": 1.0}, State.DOWN, Cause.SERVER_GONE),
        ({"offered": False, "came": False, "waits_for": "peer accepted"}, State.WAITING, Cause.NO_CALL),
        ({"came": False}, State.WAITING, Cause.NO_CALL),
        ({"expired": 3, "failing_since": 1.0}, State.SLOW, Cause.UNANSWERED),
        ({"unanswered": True, "failing_since": 1.0}, State.SLOW, Cause.UNANSWERED),
        ({"came": False, "came_before": True}, State.WAITING, Cause.NO_CALL),
        ({"refused": {Refused.PAUSED: 1}, "failing_since": 1.0}, State.SLOW, Cause.CALLS_REFUSED),
        ({"expired": 3, "failing_since": 1.0, "warning": TWO}, State.SLOW, Cause.UNANSWERED),
        ({"warning": TWO}, State.UNHEARD, Cause.SEVERAL_SERVERS),
        ({"limit": 5.0}, State.OK, Cause.THROTTLED),
    ],
)
def test_what_counts(changes: dict[str, Any], state: State, cause: Cause) -> None:
    verdict = verdict_on(**changes)
    assert (verdict.state, verdict.cause) == (state, cause)
    assert bool(verdict.text) is (verdict.cause != Cause.NONE)


def test_what_is_refused_most_is_named() -> None:
    refused = {Refused.CALLS_A_SECOND: 1, Refused.CALLS_UNDER_WAY: 30}
    text = judge_calls(FINE._replace(refused=refused, failing_since=0.0)).said(20.0)
    assert "31" in text
    assert REMEDIES[Refused.CALLS_UNDER_WAY] in text


@pytest.mark.parametrize(("trouble", "state"), [(NOBODY, State.WAITING), (GONE, State.DOWN)])
@pytest.mark.parametrize("sends", [True, False])
def test_both_sides_show_the_same(sends: bool, trouble: Trouble, state: State) -> None:
    """Nobody serves it, as the providing side knows; the callers' side waits."""
    near = verdict_on(offered=False, came=False, waits_for="server seen")
    far = judge_calls(CallsFacts(RouteStatus(sends=False, topic="/go"), unavailable=trouble))
    own, others = (near, far) if sends else (far, near)
    both = CombinedVerdict(sends=sends, peer_name="the other")
    both.take(record_of(others), 0.0)
    shown, from_peer = both.shown(own)
    assert (shown.state, shown.cause) == (state, trouble.cause)
    assert from_peer is sends
