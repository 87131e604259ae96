"""A half's verdict from its facts, and the combination of both halves' verdicts."""

from __future__ import annotations

import re
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.route.topic_verdict_helpers import (
    BEST_EFFORT,
    IMAGE,
    INT,
    LATCHED,
    NOW,
    RECEIVER,
    SENDER,
    STRING,
    TALKER,
    TF,
    endpoint,
    endpoints,
    qos,
    verdict_on,
)
from tests.support.judged import topic_verdict

from rsb_bridge.model.audience import Audience
from rsb_bridge.model.capacity import Fullness
from rsb_bridge.model.faults import PathFault
from rsb_bridge.model.limits import REASON_LENGTH
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.reason import EndCode, Reason
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import EXPIRES, FINE, LASTING, Cause, LinkCause, Verdict, about, worse
from rsb_bridge.route.age import Expired, expired_verdict
from rsb_bridge.route.arming import Disarmed
from rsb_bridge.route.blocking_rules import ACCEPTED, LossyPath
from rsb_bridge.route.combined_verdict import CombinedVerdict, lasting, record_of
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.lateness import QUEUE, WAY, Late, late_verdict
from rsb_bridge.route.lease import Standstill
from rsb_bridge.route.listeners import UnmatchedText, audience
from rsb_bridge.route.resolving import Elsewhere
from rsb_bridge.route.sending import USE_TCP
from rsb_bridge.route.topic_verdict import MAY_BE_LOST, PUBLISHED_NOTHING, STOPPED_PUBLISHING
from rsb_bridge.telemetry.watches import Loss
from rsb_bridge.wire.records import DeafRecord, ReceivedReport, VerdictRecord
from rsb_console.notation import formats

ON_ONE_LINE = 80
"""Characters of a text that the first screen shows whole."""


LOSSY = PathFault(LinkCause.LOSSY, "30 % of packets are lost")
LARGE, SILENT = PathFault(LinkCause.LARGE_PACKETS, "lower the MTU"), PathFault(LinkCause.SILENT, "nothing comes")
LATE = Late(1.4, 0.2, "", None, NOW)
LOST, FULL = Loss(9, 10, "lost on the way", NOW - 2.0), Fullness(5e3, 14e3)
HALF, EXPIRED = Loss(50, 100, "incomplete", NOW - 12.0), Expired(Cause.LINK_SLOW, 325, 333, 0.3, 0.0)
OUT = "Connection timed out"
APART = Reason("max_rate 5", EndCode.LISTED_DIFFERENTLY)
DATA_OUT, PIPE = Reason(OUT, EndCode.TIMED_OUT), Reason("Broken pipe", EndCode.BROKE)
DENIED, STUCK = Reason("denied"), Verdict(State.DOWN, Cause.NO_PATH, "stuck")
MAPPER, ODD = endpoint("/map", LATCHED), endpoint("/odd", type_name=INT)
NOBODYS, HEARD = endpoint("", type_name=INT), Audience(1, ("/rviz",))
KEYED = TALKER._replace(gid=b"\x01\x0f" + bytes(13) + b"\x07")
CAMERA: dict[str, Any] = {
    "endpoints": [endpoint("/camera", BEST_EFFORT, IMAGE)], "type_name": IMAGE, "qos": BEST_EFFORT,
}  # fmt: skip
BOTH, OFFERED = [TALKER, endpoint("/b")], ["/a ", "best_effort", "reliable"]
NEVER: dict[str, Any] = {"came": False}
UNANSWERED: dict[str, Any] = {"crossing": Crossing.NOT_OPEN, "accepted": None}
GONE: dict[str, Any] = {"endpoints": []}
LOOSE: dict[str, Any] = {"endpoints": [endpoint("/a", BEST_EFFORT)]}
ALIKE: dict[str, Any] = {"elsewhere": Elsewhere(Cause.SIMILAR_NAME, "did you mean /char?")}
THERE: dict[str, Any] = {"elsewhere": Elsewhere(Cause.PUBLISHED_THERE, "/lidar publishes it on robot1")}
STALE: dict[str, Any] = {"stale_since": NOW - 20.0}
STOPPED: dict[str, Any] = {"stopped_since": NOW - 3.0, "expected_rate": 10.0}
DOUBLED: dict[str, Any] = {"endpoints": BOTH, "regular": True}
SLOW: dict[str, Any] = {"slow_since": NOW - 8.0, "expected_rate": 20.0}


def unresolved(cause: Cause) -> dict[str, Any]:
    return {"crossing": Crossing.NOT_OPEN, "came": False, "unresolved": cause, "why_unresolved": "as told"}


def test_a_route_that_flows_is_fine() -> None:
    assert verdict_on(SENDER) == verdict_on(RECEIVER) == FINE


@pytest.mark.parametrize(
    ("facts", "changes", "state", "cause", "words"),
    [
        (SENDER, {"link_down": "gone", "refusal": DENIED}, State.DOWN, Cause.LINK_DOWN, ["gone"]),
        (SENDER, {"refusal": DENIED, "crossing": Crossing.PAUSED}, State.DOWN, Cause.REFUSED, ["denied"]),
        (SENDER, {"breaking": OUT, "refusal": DATA_OUT}, State.DOWN, Cause.NO_PATH, [f"({OUT})", "firewalls"]),
        (SENDER, {"refusal": PIPE}, State.DOWN, Cause.NO_PATH, ["Broken pipe"]),
        (RECEIVER, {"refusal": DATA_OUT, "reopens": True}, State.WAITING, Cause.AWAITS_LINK, [f"({OUT})"]),
        (SENDER, {"refusal": PIPE, "reopens": True, "path": LOSSY}, State.DOWN, Cause.LOSSY, [LOSSY.text]),
        (SENDER, {"refusal": DENIED, "reopens": True}, State.DOWN, Cause.REFUSED, ["denied"]),
        (SENDER, {"refusal": APART, "crossing": Crossing.PAUSED}, State.DOWN, Cause.LISTED_DIFFERENTLY, ["max_rate"]),
        (SENDER, {"path": LOSSY, "late": LATE}, State.LATE, Cause.LOSSY, [LOSSY.text]),
        (SENDER, {"path": LOSSY, "loss": LOST}, State.SLOW, Cause.LOSSY, [LOSSY.text]),
        (SENDER, {"path": LOSSY, "no_path": STUCK}, State.DOWN, Cause.LOSSY, [LOSSY.text]),
        (RECEIVER, STALE | {"path": LOSSY}, State.STALE, Cause.LOSSY, [LOSSY.text]),
        (SENDER, {"path": LARGE, "loss": LOST}, State.SLOW, Cause.NO_PATH, ["MTU"]),
        (SENDER, {"path": LARGE, "late": LATE}, State.LATE, Cause.LATE, []),
        (SENDER, {"path": SILENT, "no_path": STUCK}, State.WAITING, Cause.AWAITS_LINK, [SILENT.text]),
        (SENDER, {"path": SILENT, "refusal": DATA_OUT, "reopens": True}, State.WAITING, Cause.AWAITS_LINK,
         [SILENT.text]),
        (RECEIVER, STALE | {"path": SILENT}, State.WAITING, Cause.AWAITS_LINK, [SILENT.text]),
        (SENDER, {"path": SILENT, "late": LATE}, State.WAITING, Cause.AWAITS_LINK, [SILENT.text]),
        (SENDER, {"crossing": Crossing.LOOP, "loop": "round"}, State.DOWN, Cause.LOOP, ["round"]),
        (SENDER, STALE | {"crossing": Crossing.PAUSED}, State.PAUSED, Cause.PAUSED, ["operator"]),
        (RECEIVER, {"no_path": STUCK}, State.DOWN, Cause.NO_PATH, ["stuck"]),
        (SENDER, {"subscribe_failed": "rcl"}, State.DOWN, Cause.SUBSCRIBE_FAILED, ["rcl"]),
        (SENDER, STALE | NEVER | LOOSE, State.DOWN, Cause.QOS_INCOMPATIBLE, [*OFFERED, "qos: auto"]),
        (SENDER, {"endpoints": [TALKER, *LOOSE["endpoints"]]}, State.UNHEARD, Cause.QOS_INCOMPATIBLE, OFFERED),
        (SENDER, {"endpoints": BOTH, "qos": LATCHED}, State.DOWN, Cause.QOS_INCOMPATIBLE,
         ["/b and /talker", "volatile"]),
        (SENDER, {"left_out": f"{INT} of /b"}, State.UNHEARD, Cause.TYPE_CONFLICT, [f"{INT} of /b"]),
        (SENDER, unresolved(Cause.TYPE_CONFLICT), State.DOWN, Cause.TYPE_CONFLICT, ["as told"]),
        (SENDER, GONE | unresolved(Cause.NO_PUBLISHER), State.WAITING, Cause.NO_PUBLISHER, ["as told"]),
        (SENDER, GONE | NEVER | ALIKE, State.WAITING, Cause.SIMILAR_NAME, ["/chat", "domain 2", "/char"]),
        (SENDER, GONE | NEVER | THERE, State.WAITING, Cause.PUBLISHED_THERE, ["domain 2; /lidar", "robot1"]),
        (SENDER, GONE | THERE | unresolved(Cause.NO_PUBLISHER), State.WAITING, Cause.PUBLISHED_THERE, ["as told"]),
        (SENDER, STOPPED | GONE | ALIKE, State.STOPPED, Cause.PUBLISHER_GONE, ["any more", "/char?"]),
        (SENDER, NEVER, State.WAITING, Cause.PUBLISHER_SILENT, [f"/talker {PUBLISHED_NOTHING[0]}"]),
        (SENDER, NEVER | CAMERA, State.WAITING, Cause.PUBLISHER_UNHEARD, [MAY_BE_LOST[0], "large-messages.xml"]),
        (SENDER, NEVER | CAMERA | STALE, State.STALE, Cause.PUBLISHER_UNHEARD, ["20 s", "large-messages.xml"]),
        (SENDER, NEVER | CAMERA | STOPPED, State.STOPPED, Cause.PUBLISHER_UNHEARD, ["10 Hz", "large-messages.xml"]),
        (SENDER, NEVER | LOOSE | {"qos": BEST_EFFORT}, State.WAITING, Cause.PUBLISHER_SILENT, []),
        (SENDER, NEVER | LOOSE | {"qos": BEST_EFFORT, "sizes": [200_000]}, State.WAITING, Cause.PUBLISHER_UNHEARD, []),
        (SENDER, NEVER | LOOSE | {"qos": BEST_EFFORT, "sizes": [200_000], "came_before": True}, State.WAITING,
         Cause.PUBLISHER_SILENT, []),
        (SENDER, NEVER | {"unmatched": True}, State.UNHEARD, Cause.UNMATCHED, [UnmatchedText.OTHER()]),
        (SENDER, STALE | {"unmatched": True, "refused": True}, State.STALE, Cause.UNMATCHED, [UnmatchedText.REFUSED()]),
        (RECEIVER, {"unmatched": True}, State.UNHEARD, Cause.UNMATCHED, ["/rviz does not", UnmatchedText.OTHER()]),
        (RECEIVER, NEVER | {"unmatched": True, "endpoints": [KEYED]}, State.UNHEARD, Cause.UNMATCHED,
         [UnmatchedText.KEY()]),
        (SENDER, NEVER | {"endpoints": [MAPPER]}, State.WAITING, Cause.PUBLISHER_SILENT, ["/map latches", "volatile"]),
        (SENDER, NEVER | STALE | {"endpoints": [MAPPER]}, State.STALE, Cause.PUBLISHER_SILENT, ["/map latches"]),
        (RECEIVER, NEVER, State.WAITING, Cause.NO_MESSAGE, []),
        (SENDER, NEVER | UNANSWERED, State.WAITING, Cause.NO_MESSAGE, [ACCEPTED]),
        (SENDER, STOPPED, State.STOPPED, Cause.PUBLISHER_SILENT, ["3 s", "10 Hz", f"/talker {STOPPED_PUBLISHING[0]}"]),
        (SENDER, STOPPED | GONE, State.STOPPED, Cause.PUBLISHER_GONE, ["/chat", "domain 2"]),
        (SENDER, STOPPED | STALE | {"stopped_since": NOW - 20.0}, State.STOPPED, Cause.PUBLISHER_SILENT,
         ["20 s", "10 Hz"]),
        (SENDER, STALE, State.STALE, Cause.PUBLISHER_SILENT, ["20 s", "/talker"]),
        (SENDER, STALE | GONE, State.STALE, Cause.PUBLISHER_GONE, ["/chat"]),
        (SENDER, STALE | GONE | NEVER, State.STALE, Cause.NO_PUBLISHER, ["/chat"]),
        (SENDER, STOPPED | GONE | NEVER, State.STOPPED, Cause.NO_PUBLISHER, ["/chat"]),
        (SENDER, GONE, State.OK, Cause.PUBLISHER_GONE, ["/chat"]),
        (SENDER, NEVER | {"came_before": True}, State.WAITING, Cause.PUBLISHER_SILENT, ["/talker"]),
        (RECEIVER, STALE, State.STALE, Cause.SILENT, ["20 s"]),
        (SENDER, SLOW | {"rate": 2.02}, State.SLOW, Cause.SLOW, ["2.02 Hz", "20", "8 s", "/talker"]),
        (SENDER, SLOW | {"rate": 2.0, "lost_in_dds": 170}, State.SLOW, Cause.SLOW, ["DDS", "170"]),
        (SENDER, {"loss": HALF, "datagrams": 40}, State.SLOW, Cause.LOSSY, ["(50%)", "12 s", "40 datagrams", USE_TCP]),
        (SENDER, {"loss": Loss(100, 100, "lost on the way", NOW)}, State.DOWN, Cause.LOSSY, ["100", USE_TCP]),
        (SENDER, {"loss": LOST, "full": FULL}, State.SLOW, Cause.LOSSY, [FULL.share]),
        (SENDER, {"loss": LOST, "loss_of_full_link": True}, State.SLOW, Cause.LOSSY, []),
        (SENDER, {"loss": LOST, "loss_unexplained": True}, State.SLOW, Cause.LOSSY, []),
        (SENDER, {"loss": Loss(9, 10, "too large", 0.0)}, State.SLOW, Cause.TOO_LARGE, ["compression: zstd"]),
        (SENDER, {"sent": 0, "undelivered": "70 MB"}, State.DOWN, Cause.TOO_LARGE, ["70 MB"]),
        (SENDER, {"sent": 5, "undelivered": "70 MB"}, State.OK, Cause.NONE, []),
        (SENDER, {"sent": 5, "undelivered": "70 MB", "qos": LATCHED, "endpoints": [endpoint("/talker", LATCHED)]},
         State.SLOW, Cause.TOO_LARGE, ["70 MB"]),
        (RECEIVER, NEVER | {"undelivered": "malformed"}, State.WAITING, Cause.NO_MESSAGE, []),
        (SENDER, {"loss": Loss(9, 10, "queue full", 0.0)}, State.SLOW, Cause.QUEUE_FULL, ["max_rate", "compression"]),
        (SENDER, {"loss": Loss(9, 10, "malformed", 0.0), "malformed": "a.b: too long"}, State.SLOW, Cause.NOT_PUBLISHED,
            ["a.b: too long"]),
        (SENDER, {"loss": Loss(9, 10, "of a newer peer", 0.0)}, State.SLOW, Cause.LOSSY, ["9", "10"]),
        (SENDER, {"loss": Loss(8, 8, "queue full", 0.0), "expired": EXPIRED}, State.LATE, Cause.LINK_SLOW, []),
        (SENDER, {"limit": 5.0}, State.OK, Cause.THROTTLED, ["5 Hz"]),
        (SENDER, DOUBLED, State.OK, Cause.SEVERAL_PUBLISHERS, ["/b and /talker publish it"]),
        (SENDER, DOUBLED | {"endpoints": [TALKER, TALKER]}, State.OK, Cause.SEVERAL_PUBLISHERS,
         ["/talker (2 publishers) publishes it"]),
        (SENDER, DOUBLED | SLOW | {"rate": 2.0}, State.SLOW, Cause.SLOW, ["/b and /talker"]),
        (SENDER, {"endpoints": BOTH}, State.OK, Cause.NONE, []),
        (SENDER, DOUBLED | {"endpoints": [TALKER, endpoint("/_rsb_robot2_0123abcd")]}, State.OK, Cause.NONE, []),
        (SENDER, DOUBLED | {"endpoints": [endpoint(each, type_name=TF) for each in "ab"], "type_name": TF}, State.OK,
         Cause.NONE, []),
        (RECEIVER, GONE, State.UNHEARD, Cause.NO_SUBSCRIBER, ["/robot1/chat", "domain 3"]),
        (RECEIVER, {"qos": BEST_EFFORT}, State.UNHEARD, Cause.QOS_INCOMPATIBLE, ["/rviz ", "reliable", "best_effort"]),
        (RECEIVER, {"endpoints": [TALKER, MAPPER]}, State.UNHEARD, Cause.QOS_INCOMPATIBLE,
         ["/map ", "transient_local"]),
        (RECEIVER, {"endpoints": [endpoint("/rviz"), NOBODYS], "nameless": [b""], "audience": HEARD}, State.OK,
         Cause.TYPE_CONFLICT, ["/rviz", "of no known node", INT]),
        (RECEIVER, NEVER | {"endpoints": [endpoint("/rviz"), NOBODYS], "nameless": [b""], "audience": HEARD},
         State.WAITING, Cause.NO_MESSAGE, []),
        (RECEIVER, {"endpoints": [endpoint("/rviz"), NOBODYS], "audience": HEARD}, State.UNHEARD,
         Cause.TYPE_CONFLICT, [INT]),
        (RECEIVER, {"endpoints": [NOBODYS], "nameless": [b""]}, State.UNHEARD, Cause.TYPE_CONFLICT, [INT]),
        (RECEIVER, {"endpoints": [ODD]}, State.UNHEARD, Cause.TYPE_CONFLICT, ["/odd ", INT, STRING]),
        (RECEIVER, {"endpoints": [ODD], "type_before": INT, "publisher_nodes": ("/lidar",)}, State.UNHEARD,
         Cause.TYPE_CONFLICT, [f"/lidar publishes {STRING} now, /odd has {INT} as before: correct the publisher"]),
        (RECEIVER, {"endpoints": [ODD], "type_before": INT}, State.UNHEARD, Cause.TYPE_CONFLICT,
         [f"it is published as {STRING} now, /odd has {INT} as before"]),
    ],
)  # fmt: skip
def test_each_cause_is_named_in_words(
    facts: dict[str, Any], changes: dict[str, Any], state: State, cause: Cause, words: list[str]
) -> None:
    verdict = verdict_on(facts, **changes)
    assert (verdict.state, verdict.cause) == (state, cause)
    assert [each for each in words if each not in verdict.said(NOW)] == []


def test_a_new_publisher_has_not_stopped() -> None:
    stopped = {"stopped_since": NOW - 3.0, "expected_rate": 10.0, "new": {b"/new"}}
    for listed, who in (
        ([endpoint("/new")], f"/new {PUBLISHED_NOTHING[0]}"),
        ([TALKER, endpoint("/new")], f"/talker {STOPPED_PUBLISHING[0]}"),
    ):
        verdict = verdict_on(SENDER, endpoints=listed, **stopped)
        assert (verdict.state, verdict.cause) == (State.STOPPED, Cause.PUBLISHER_SILENT)
        assert verdict.text.endswith(who)


def test_untaken_publisher_is_not_called_silent() -> None:
    for changes, state in (
        ({"stale_since": NOW - 20.0}, State.STALE),
        ({"stopped_since": NOW - 3.0, "expected_rate": 9.0}, State.STOPPED),
    ):
        assert verdict_on(SENDER, **changes).cause is Cause.PUBLISHER_SILENT
        verdict = verdict_on(SENDER, left_out="/b is not bridged", **changes)
        assert (verdict.state, verdict.cause) == (state, Cause.TYPE_CONFLICT)


def test_subscriber_that_hears_another_publisher_is_told_so() -> None:
    """It does not hear what the bridge brings, so the state is the same; the words say what it hears instead."""
    joystick, lidar = endpoint("/joystick"), endpoint("/lidar", BEST_EFFORT)
    alone = verdict_on(RECEIVER, endpoints=[endpoint("/rviz")], qos=BEST_EFFORT, others=[lidar])
    beside = verdict_on(RECEIVER, endpoints=[endpoint("/rviz")], qos=BEST_EFFORT, others=[joystick, lidar])
    assert (alone.state, alone.cause) == (beside.state, beside.cause) == (State.UNHEARD, Cause.QOS_INCOMPATIBLE)
    assert "only" not in alone.text
    assert "best_effort, so that it hears only /joystick: change" in beside.text
    several = verdict_on(
        RECEIVER, endpoints=[endpoint("/map"), endpoint("/rviz")], qos=BEST_EFFORT, others=[joystick, lidar]
    )
    assert "so that they hear only /joystick: change" in several.text


def test_topic_that_catches_up_is_fine_and_says_what_is_left() -> None:
    flows: dict[str, Any] = {"crossing": Crossing.YES, "sent": 5, "came": True, "endpoints": [endpoint("/talker")]}
    verdict = topic_verdict(left=1412, limit=5.0, sends=True, **flows)
    assert (verdict.state, verdict.cause, verdict.text) == (State.OK, Cause.CATCHING_UP, "catching up, 1,412 left")
    assert topic_verdict(left=0, limit=5.0, sends=True, **flows).cause == Cause.THROTTLED


def test_hearing_subscribers_beside_deaf_ones() -> None:
    asks = [endpoint("/rviz"), endpoint("/ok", BEST_EFFORT)]
    beside = verdict_on(RECEIVER, endpoints=asks, qos=BEST_EFFORT)
    assert (beside.state, beside.cause) == (State.UNHEARD, Cause.QOS_INCOMPATIBLE)
    assert "best_effort, while /ok hears this topic: change" in beside.text
    both = verdict_on(RECEIVER, endpoints=asks, qos=BEST_EFFORT, others=[endpoint("/joystick")])
    assert "so that it hears only /joystick, while /ok hears this topic: change" in both.text
    twice = verdict_on(RECEIVER, endpoints=[endpoint("/rviz"), endpoint("/rviz", BEST_EFFORT)], qos=BEST_EFFORT)
    assert "while" not in twice.text


LOST_PACKETS = {
    "late": Verdict(State.LATE, Cause.LOSSY, LOSSY.text),
    "slow": Verdict(State.SLOW, Cause.LOSSY, LOSSY.text),
    "stuck": Verdict(State.DOWN, Cause.LOSSY, LOSSY.text),
    "fine": FINE,
    "opens": Verdict(State.WAITING, Cause.NO_MESSAGE, "not yet: type known"),
    "dead": Verdict(State.STOPPED, Cause.PUBLISHER_SILENT, "/talker has stopped"),
}
"""A half's verdicts on a path that loses packets."""


def on_lossy_path(*seconds: str, path: PathFault | None = LOSSY, lossy: LossyPath | None = None) -> list[str]:
    """Return the states that are shown for a verdict each second."""
    lossy = lossy or LossyPath()
    shown = [lossy.steady(LOST_PACKETS[each], path, NOW + number) for number, each in enumerate(seconds)]
    return [f"{each.state} {each.cause}".strip() for each in shown]


def test_lossy_path_is_one_state() -> None:
    shown = on_lossy_path("fine", *("late", "stuck", "slow", "opens", "fine", "fine", "stuck", "late") * 10)
    assert shown == ["ok"] + ["slow lossy"] * 80


def test_lossy_path_lets_route_recover_and_die() -> None:
    assert on_lossy_path("late", *["fine"] * 20) == ["slow lossy"] * 20 + ["ok"]
    assert on_lossy_path("late", "dead", "late")[1] == "stopped publisher_silent"
    assert on_lossy_path(*["stuck"] * 21) == ["slow lossy"] * 20 + ["down lossy"]
    lossy = LossyPath()
    on_lossy_path("late", lossy=lossy)
    assert on_lossy_path("fine", path=None, lossy=lossy) == on_lossy_path("fine", lossy=lossy) == ["ok"]


moments = st.sampled_from([None, NOW - 5.0, NOW - 1e6])
losses = st.none() | st.builds(
    lambda lost, more, cause: Loss(lost, lost + more, cause, 0.0),
    st.integers(1, 10**12),
    st.integers(0, 10**12),
    st.sampled_from(["queue full", "incomplete", "anything"]),
)
texts = st.sampled_from(["", "words"])
WAITS = Verdict(State.WAITING, Cause.AWAITS_LINK, "words")
NO_PATH = Verdict(State.DOWN, Cause.NO_PATH, "words")
facts = st.fixed_dictionaries(
    {
        "sends": st.booleans(),
        "link_down": st.sampled_from([None, "", "words"]),
        "accepted": st.sampled_from([None, True, False]),
        "refusal": st.builds(Reason, texts, st.sampled_from(EndCode)),
        "crossing": st.sampled_from(Crossing),
        "disarmed": st.just("words"),
        "loop": st.just("words"),
        "no_path": st.sampled_from([None, WAITS, NO_PATH]),
        "full": st.sampled_from([None, FULL]),
        "came": st.booleans(),
        "limit": st.sampled_from([0.0, 5.0]),
        "endpoints": endpoints,
        "elsewhere": st.sampled_from([None, *ALIKE.values(), *THERE.values()]),
        "described": st.booleans(),
        "type_name": st.sampled_from(["", STRING]),
        "qos": st.none() | qos,
        "unresolved": st.sampled_from([None, Cause.NO_PUBLISHER, Cause.TYPE_UNKNOWN, Cause.TYPE_CONFLICT]),
        "why_unresolved": st.just("why"),
        "subscribe_failed": texts,
        "sent": st.integers(0, 1),
        "left_out": texts,
        "stale_since": moments,
        "stopped_since": moments,
        "slow_since": moments,
        "expected_rate": st.none() | st.floats(0.001, 1e6),
        "loss": losses,
    }
)


@given(facts)
def test_whatever_is_wrong_has_a_cause_and_words(known: dict[str, Any]) -> None:
    verdict = verdict_on(known)
    assert verdict == verdict_on(known)
    if verdict.state is not State.OK:
        assert verdict.cause
        assert 0 < len(verdict.said(NOW)) <= REASON_LENGTH
    if known["link_down"] is not None:
        assert verdict.state is State.DOWN


@given(facts, moments)
def test_a_further_fault_never_makes_it_better(known: dict[str, Any], stale: float | None) -> None:
    before, after = verdict_on(known, stale_since=None), verdict_on(known, stale_since=stale)
    assert after.state.rank <= before.state.rank


verdicts = st.builds(
    Verdict, st.sampled_from(list(State)), st.sampled_from(list(Cause)), st.sampled_from(["", "a", "b"])
).filter(lambda verdict: (verdict.state is State.LATE) == (verdict.cause in {Cause.LATE, *EXPIRES}))


@given(verdicts, verdicts)
def test_both_sides_show_same_worst(one: Verdict, other: Verdict) -> None:
    sender, receiver = CombinedVerdict(sends=True, peer_name="server"), CombinedVerdict(sends=False, peer_name="robot1")
    sender.receive(record_of(other), NOW)
    receiver.receive(record_of(one), NOW)
    shown = [sender.shown(one), receiver.shown(other)]
    own = {
        Cause.LINK_DOWN, Cause.AWAITS_LINK, Cause.REFUSED, Cause.LISTED_DIFFERENTLY, Cause.PAUSED, Cause.DISARMED,
    }  # fmt: skip
    if not own & {one.cause, other.cause}:
        assert len({(each.verdict.state, each.verdict.cause) for each in shown}) == 1
        for each in shown:
            least = min(one.state.rank, other.state.rank)
            assert each.verdict.state.rank <= least or silence_is_explained({one, other})
        assert not all(each.from_peer for each in shown)


def silence_is_explained(said: set[Verdict]) -> bool:
    """Whether one side says that nothing comes, and the other that the topic has stopped."""
    unexplained = Cause.SILENT, Cause.NO_MESSAGE, Cause.NO_CALL
    stale = any(each.state is State.STALE and each.cause in unexplained for each in said)
    return stale and any(each.state is State.STOPPED for each in said)


def test_recovering_slow_topic_loses_no_messages() -> None:
    """The rate is fine again, and the watch waits before it reports that."""
    slow = {"slow_since": NOW - 8.0, "expected_rate": 20.0, "shown_cause": Cause.SLOW}
    losing = verdict_on(SENDER, rate=10.0, lost_in_dds=80, **slow).text
    for rate in (17.1, 20.0, 20.3, 40.0):
        verdict = verdict_on(SENDER, rate=rate, **slow)
        assert (verdict.state, verdict.cause) == (State.SLOW, Cause.SLOW)
        assert f"{rate:.1f}" in verdict.text
        assert losing.partition(":")[2].split()[0] == "DDS"
        assert "DDS" not in verdict.text


def test_the_side_that_knows_why_is_heard() -> None:
    """The receiving side knows only that nothing comes; the sending side's publisher has stopped."""
    why = Verdict(State.STOPPED, Cause.PUBLISHER_GONE, "it died")
    verdict, from_sender = worse(why, Verdict(State.STALE, Cause.SILENT, "nothing for 15 s"))
    assert (verdict, from_sender) == (why, True)
    unheard = Verdict(State.WAITING, Cause.NO_PUBLISHER, "nobody")
    verdict, from_sender = worse(unheard, Verdict(State.STALE, Cause.SILENT, "nothing for 15 s"))
    assert (verdict, from_sender) == (Verdict(State.STALE, Cause.NO_PUBLISHER, "nobody"), True)


def test_own_words_stand_before_other_sides() -> None:
    here = CombinedVerdict(sends=False, peer_name="robot1")
    here.receive(VerdictRecord("slow", "slow", "2 Hz of 20"), NOW)
    assert here.shown(FINE).verdict.text == "robot1: 2 Hz of 20"
    assert here.shown(Verdict(State.DOWN, Cause.NO_PATH, "no UDP")).verdict.text == "no UDP"
    here.receive(None, NOW)
    assert here.shown(FINE).verdict == FINE


def test_duration_counts_on_at_other_side() -> None:
    """It is sent once, and needs no clock of the other side."""
    slow = Verdict(State.SLOW, Cause.SLOW, "slow, for {lasting}", NOW - 5.0)
    here = CombinedVerdict(sends=False, peer_name="robot1")
    here.receive(lasting(record_of(slow), slow, NOW), 100.0)
    assert here.shown(FINE).verdict.said(100.0) == "robot1: slow, for 5 s"
    assert here.shown(FINE).verdict.said(295.0) == "robot1: slow, for 3 min"


def test_since_when_it_is_so() -> None:
    """It counts from the beginning of the trouble, also if only the words or the reporting side change."""
    here = CombinedVerdict(sends=False, peer_name="robot1")
    assert here.since(FINE, 10.0) == here.since(FINE, 20.0) == 10.0
    slow = Verdict(State.SLOW, Cause.SLOW, "2 Hz of 20, for {lasting}", 25.0)
    assert here.since(slow, 30.0) == 25.0
    assert here.since(Verdict(State.SLOW, Cause.SLOW, "robot1: 3 Hz of 20"), 40.0) == 25.0
    assert here.since(Verdict(State.SLOW, Cause.LOSSY, "half is lost"), 50.0) == 50.0
    here.announce(FINE, 60.0)  # which happens every second, without a reader
    assert here.since(FINE, 70.0) == 60.0


@pytest.mark.parametrize("lasts", [float("nan"), float("inf"), -1.0, 1e300])
def test_a_time_that_cannot_be_is_not_believed(lasts: float) -> None:
    here = CombinedVerdict(sends=False, peer_name="robot1")
    here.receive(VerdictRecord("slow", "slow", "for {lasting}", lasts), NOW)
    assert here.shown(FINE).verdict.said(NOW) == "robot1: for 1 s"


def test_words_of_newer_peer_stand_as_given() -> None:
    here = CombinedVerdict(sends=True, peer_name="server")
    here.receive(VerdictRecord("haunted", "ghosts", "there are ghosts on the line"), NOW)
    shown = here.shown(FINE).verdict
    assert (shown.state, shown.cause, shown.text) == (State.SLOW, "ghosts", "server: there are ghosts on the line")


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.2, "1 s"),
        (9.9, "9 s"),
        (10, "10 s"),
        (39, "30 s"),
        (61, "1 min"),
        (3599, "59 min"),
        (9000, "2 h"),
        (6.3e7, "729 d"),
    ],
)
def test_durations_change_seldom(seconds: float, words: str) -> None:
    assert about(seconds) == words


@pytest.mark.parametrize("seconds", [10.0, 16.7, 17.3, 77.5, 98.3, 110.0, 3500.0, 9000.0, 200_000.0])
def test_reason_and_age_show_one_number(seconds: float) -> None:
    wall = 1.7e9 + 0.4
    said = Verdict(State.STOPPED, Cause.PUBLISHER_SILENT, LASTING, since=NOW - seconds).said(NOW, wall)
    assert formats.age_of(wall - seconds, wall) in (said.replace(" ", ""), said.replace(" min", "m"))


@pytest.mark.parametrize(
    ("nodes", "verb", "count"),
    [
        (["/a"], " has ", None),
        (["/a", "/a"], " has ", "2"),
        (["/a", "/b"], " have ", None),
        (["/a", "/a", "/b"], " have ", "3"),
    ],
)
def test_the_verb_agrees_with_the_names(nodes: list[str], verb: str, count: str | None) -> None:
    """One process may have several publishers, or several nodes one name."""
    endpoints = [endpoint(node)._replace(gid=bytes([number])) for number, node in enumerate(nodes)]
    found = verdict_on(SENDER, endpoints=endpoints, stopped_since=NOW - 3, stale_since=NOW - 3, expected_rate=10.0)
    assert (found.state, found.cause) == (State.STOPPED, Cause.PUBLISHER_SILENT)
    who = found.text.partition(": ")[2]
    assert verb in who
    counts = re.findall(r"\((\d+) ", who)
    assert counts == ([] if count is None else [count])


@pytest.mark.parametrize("datagrams", [1, 40])
@pytest.mark.parametrize("known", [{"full": FULL}, {"loss_of_full_link": True}, {"loss_unexplained": True}])
def test_no_remedy_makes_an_overload_worse(known: dict[str, Any], datagrams: int) -> None:
    text = verdict_on(SENDER, loss=LOST, datagrams=datagrams, **known).text
    assert USE_TCP not in text
    assert USE_TCP in verdict_on(SENDER, loss=LOST, datagrams=datagrams).text


def test_tcp_is_no_remedy_for_commands() -> None:
    """It would hold up messages that have to be young."""
    assert USE_TCP in verdict_on(SENDER, loss=LOST, datagrams=1).text
    assert USE_TCP not in verdict_on(SENDER, loss=LOST, datagrams=1, armed=True).text


@pytest.mark.parametrize("facts", [{"loss": Loss(2, 83, "queue full", 0.0, recovering=True)}, {"slow_since": 0.0}])
def test_what_recovers_begins_no_new_fault(facts: dict[str, Any]) -> None:
    """When a link has room again, a late topic's losses are over too, though the last ones were a moment ago."""
    facts |= {"rate": 19.0, "expected_rate": 20.0}
    assert verdict_on(SENDER, **facts) == FINE
    assert verdict_on(SENDER, **facts, shown_cause=Cause.LATE) == FINE
    cause = Cause.SLOW if "slow_since" in facts else Cause.QUEUE_FULL
    verdict = verdict_on(SENDER, **facts, shown_cause=cause)
    assert (verdict.state, verdict.cause) == (State.SLOW, cause)
    assert "%" not in verdict.text


_WHY_DISARMED = [*(each.text for each in Disarmed), *(each.value for each in Standstill)]


@pytest.mark.parametrize("why", _WHY_DISARMED)
@pytest.mark.parametrize("state", [State.DISARMED, State.DISARMING])
def test_disarmed_topic_has_its_text_on_one_line(why: str, state: State) -> None:
    can_be_armed = why != Disarmed.LINK_SLOW.text
    crossing = Crossing.DISARMING if state is State.DISARMING else Crossing.DISARMED
    if crossing is Crossing.DISARMING and not can_be_armed:
        return
    verdict = verdict_on(SENDER, topic="/cmd_vel", disarmed=why, crossing=crossing, can_be_armed=can_be_armed)
    assert verdict.state is state
    assert len(verdict.text) <= ON_ONE_LINE, verdict.text


@pytest.mark.parametrize("cause", [Cause.LINK_SLOW, Cause.CLOCK_UNKNOWN, Cause.PUBLISHER_STAMPS_OLD])
def test_expiring_messages_have_text_on_one_line(cause: Cause) -> None:
    verdict = expired_verdict(Expired(cause, 100, 100, 0.05, NOW))
    assert (verdict.state, verdict.cause) == (State.LATE, cause)
    assert len(verdict.text) <= ON_ONE_LINE, verdict.text


@pytest.mark.parametrize("how", [{"where": WAY}, {"where": QUEUE}, {}, {"was_full": True}, {"undecided": True}])
def test_late_messages_have_their_text_on_one_line(how: dict[str, Any]) -> None:
    late = Late(1.4, 0.2, **({"where": "", "full": None, "since": NOW} | how))
    verdict = late_verdict(late)
    assert verdict.cause is Cause.LATE
    assert len(verdict.text) <= ON_ONE_LINE, verdict.text


def test_an_audience_fits_into_a_report() -> None:
    """Names and types are other programs', and the other side ends a link for a text that is too long."""
    long = "x" * 255
    others = [endpoint(f"/{number}{long}", type_name=f"{long}/msg/{long}") for number in range(9)]
    found = audience(long, Qos(), [*others, endpoint("/deaf", LATCHED)], 0)
    assert len(found.deaf) == 4
    record = ReceivedReport(route=1, deaf=tuple(DeafRecord(each.node, each.cause, each.reason) for each in found.deaf))
    assert msgspec.json.decode(msgspec.json.encode(record), type=ReceivedReport) == record


@pytest.mark.parametrize(
    ("count", "nodes", "causes"), [(0, (), ["", "qos_incompatible"]), (1, ("/a",), ["qos_incompatible"])]
)
def test_dds_decides_whether_anybody_hears(count: int, nodes: tuple[str, ...], causes: list[str]) -> None:
    """A policy that is not compared, as a lease of liveliness, keeps a subscription from a publisher, too."""
    asks_for_more = endpoint("/b", LATCHED)
    found = audience(endpoint("/a").type_name, Qos(), [endpoint("/a"), asks_for_more], count)
    assert (found.count, found.nodes, [each.cause for each in found.deaf]) == (count, nodes, causes)
    assert found.is_settled is bool(count)
