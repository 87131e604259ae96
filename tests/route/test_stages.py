"""The stages of a topic's path, as each half knows them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeVar

import pytest
from tests.support.offline import FakePeer, half_of

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.reason import Reason
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause, Verdict
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.sender import Sender
from rsb_bridge.wire.records import ReceivedReport, SentCounts, SentReport, VerdictRecord

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.model.snapshot import Stage

NAMES = (
    "publisher seen", "type known", "QoS compatible", "subscribed", "link up", "peer accepted", "sent", "received",
    "published", "subscriber seen",
)  # fmt: skip
"""Scripts read these names in JSON."""
HALVES = pytest.mark.parametrize("kind", [Sender, Receiver])


TopicHalf = TypeVar("TopicHalf", bound=Sender | Receiver)


def opened(kind: type[TopicHalf], context: Context, peer: FakePeer | None = None) -> TopicHalf:
    half = half_of(kind, context, Topic("/chat", "transmit"), peer)
    half.route.open(1)
    return half


def stages_of(half: Sender | Receiver) -> dict[str, Stage]:
    stages = {each.name: each for each in half.facts.stages()}
    assert tuple(stages) == NAMES
    return stages


@HALVES
def test_without_link_only_that_is_known(kind: type[Sender | Receiver], make_context: Callable[..., Context]) -> None:
    peer = FakePeer()
    peer.linked = False
    peer.down_reason = "no route to host"
    known = {
        name: each for name, each in stages_of(opened(kind, make_context(), peer)).items() if each.done is not None
    }
    assert {name: (each.done, each.detail) for name, each in known.items()} == {"link up": (False, "no route to host")}


@HALVES
@pytest.mark.parametrize(("state", "done"), [(State.WAITING, None), (State.DOWN, False)])
def test_link_without_a_path(
    kind: type[Sender | Receiver], state: State, done: bool | None, make_context: Callable[..., Context]
) -> None:
    half = opened(kind, make_context())
    channel: Any = SimpleNamespace(ready=True, trouble=lambda: Verdict(state, Cause.NO_PATH, "stuck"))
    half.carried.channel = channel
    link = stages_of(half)["link up"]
    assert (link.done, link.detail) == (done, "stuck")


@HALVES
def test_acceptance_and_refusal(kind: type[Sender | Receiver], make_context: Callable[..., Context]) -> None:
    half = opened(kind, make_context())
    assert stages_of(half)["peer accepted"].done is None
    half.route.on_accepted()
    assert stages_of(half)["peer accepted"].done is True
    half.route.refuse(EventCode.ROUTE_REFUSED, Reason("denied"))
    accepted = stages_of(half)["peer accepted"]
    assert (accepted.done, accepted.detail) == (False, "denied")


@HALVES
def test_loop_prevents_the_subscription(kind: type[Sender | Receiver], make_context: Callable[..., Context]) -> None:
    half = opened(kind, make_context())
    half.route.notices.loop = "round"
    subscribed = stages_of(half)["subscribed"]
    assert (subscribed.done, subscribed.detail) == (False, "round")


@HALVES
def test_qos_is_unknown_without_a_type(kind: type[Sender | Receiver], make_context: Callable[..., Context]) -> None:
    stages = stages_of(opened(kind, make_context()))
    assert (stages["type known"].done, stages["QoS compatible"].done) == (None, None)


def test_sender_knows_what_receiver_has_reported(make_context: Callable[..., Context]) -> None:
    half = opened(Sender, make_context())
    half.route.on_accepted()
    assert stages_of(half)["publisher seen"].done is False
    assert stages_of(half)["subscriber seen"].detail == ""
    half.reported(ReceivedReport(route=1))
    assert "/chat there" in stages_of(half)["subscriber seen"].detail
    half.reported(ReceivedReport(route=1, subscribers=2))
    assert stages_of(half)["subscriber seen"].done is True


def test_receiver_knows_what_sender_has_reported(make_context: Callable[..., Context]) -> None:
    half = opened(Receiver, make_context())
    assert stages_of(half)["publisher seen"].done is None
    half.reported(SentReport(route=1, publishers=0))
    assert stages_of(half)["publisher seen"].done is False
    nobody = "no publisher of /chat in domain 3; did you mean /chatter?"
    half.reported(SentReport(route=1, verdict=VerdictRecord("waiting", Cause.SIMILAR_NAME, nobody)))
    assert stages_of(half)["publisher seen"].detail == nobody
    half.reported(SentReport(route=1, publishers=1, subscribed=True))
    half.reported(SentCounts(route=1, offered=3, in_flight=3))
    stages = stages_of(half)
    done = {name for name, each in stages.items() if each.done}
    assert {"publisher seen", "subscribed", "sent"} <= done
    assert "received" not in done
