"""Our own messages can carry everything in the graph, which any DDS program may have put there."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import pytest
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, ReliabilityPolicy
from tests.ros.domains import ANOTHER
from tests.support import replaced

from rsb_bridge.model.qos import Qos, clamp_qos, match_publishers, match_subscriptions
from rsb_bridge.ros.native.rcl_conversions import endpoint_of
from rsb_bridge.ros.participant import Participant
from rsb_bridge.wire.codec import decode, encode, pack_topics, topic_entries
from rsb_bridge.wire.messages import Describe, Report
from rsb_bridge.wire.records import ReceivedReport, SentReport, Source, TopicEntry

STRING = "std_msgs/msg/String"


def endpoint_info(**changes: Any) -> dict[str, Any]:
    profile = {
        "reliability": ReliabilityPolicy.RELIABLE,
        "durability": DurabilityPolicy.VOLATILE,
        "history": HistoryPolicy.KEEP_LAST,
        "deadline": Duration(nanoseconds=2**63 - 1),
        "lifespan": Duration(nanoseconds=2**63 - 1),
        "liveliness": LivelinessPolicy.AUTOMATIC,
        "liveliness_lease_duration": Duration(nanoseconds=2**63 - 1),
    }
    info = {
        "node_name": "node",
        "node_namespace": "/",
        "topic_type": STRING,
        "topic_type_hash": {"version": 1, "value": bytes(32)},
        "endpoint_gid": list(range(16)),
        "qos_profile": profile | {key: value for key, value in changes.items() if key in profile},
    }
    return info | {key: value for key, value in changes.items() if key not in profile}


@pytest.mark.parametrize(
    ("announced", "clamped"),
    [
        (Qos(), Qos()),
        (Qos(deadline=0.5e-3, lifespan=1e-9), Qos(deadline=0.001, lifespan=0.001)),
        (Qos(deadline=-1.0, lifespan=nan), Qos()),
        (Qos(deadline=inf, lifespan=1e9), Qos(lifespan=1e9)),
        (Qos(depth=2**70, deadline=2.0), Qos(depth=100_000, deadline=2.0)),
        (Qos(depth=-5), Qos(depth=0)),
        (Qos(liveliness_lease_duration=1e-9), Qos(liveliness_lease_duration=0.001)),
    ],
)
def test_qos_is_clamped_to_what_every_message_takes(announced: Qos, clamped: Qos) -> None:
    assert clamp_qos(announced) == clamped
    for qos in (clamp_qos(announced), match_publishers([clamped] * 2), match_subscriptions([clamped] * 2)):
        sent, received = SentReport(route=1, publisher_qos=qos), ReceivedReport(route=1, subscriber_qos=qos)
        for message in (
            Describe(route=1, type=STRING, type_hash="", qos=qos, sources=(Source(("rsb_a/x",)),)),
            Report(sent=(sent,), received=(received,)),
        ):
            assert decode(encode(message)) == message
        entry = TopicEntry("/chat", STRING, "", qos, 1, 1)
        assert [each for each, _ in topic_entries(pack_topics([entry]))] == [entry]


@pytest.mark.parametrize("nanoseconds", [1, 500_000, 2**63 - 2])
def test_an_endpoint_comes_clamped(nanoseconds: int) -> None:
    found = endpoint_of(endpoint_info(deadline=Duration(nanoseconds=nanoseconds), lifespan=Duration(nanoseconds=1)))
    assert found.qos == clamp_qos(found.qos)
    assert found.qos.lifespan == 0.001


def test_type_that_no_ros_program_would_name_so() -> None:
    assert (
        endpoint_of(endpoint_info(topic_type="evil\x1b[2J/msg/X")).type_name == "evil\N{REPLACEMENT CHARACTER}[2J/msg/X"
    )
    assert len(endpoint_of(endpoint_info(topic_type="x" * 1000)).type_name) == 255


def test_topics_beyond_ros_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    participant = Participant(ANOTHER, "reader")
    graph = [("/fine", ["x" * 300]), ("/_hidden/too", [STRING]), ("/" + "x" * 255, [STRING])]
    graph += [(name, [STRING]) for name in ("/e\x1b[2J", "/a b", "/7", "no_slash", "")]
    replaced.PARTICIPANT_ASK.set(monkeypatch, lambda *_: graph)
    assert participant.topics() == {"/fine": ["x" * 255], "/_hidden/too": [STRING]}
    participant.leave()
