"""Limits of a peer that measures, and of one with arbitrary answers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

from tests.support.virtual_time import virtual_loop

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import TopicSpec
from rsb_extras.bench.benchmark import BENCH, BenchmarkStep
from rsb_extras.bench.link_bench import BenchAnswer
from rsb_extras.bench.tests import bench_places
from rsb_extras.bench.tests.peer_s_share_helpers import PEER, Here

if TYPE_CHECKING:
    import pytest

    from rsb_bridge.route.route import Route

UP, DOWN = BENCH.route_name("tcp", "transmit"), BENCH.route_name("tcp", "receive")


def publish(drain: Any, messages: int, size: int = 100) -> None:
    for _ in range(messages):
        drain.publish(bytes(size))


def test_peer_that_counts_anew_keeps_to_its_leave() -> None:
    here = Here()
    drain = here.open(UP)
    publish(drain, 500)
    here.ask(reset=True)
    here.second()
    assert "100 messages a second" in here.denied[0]


def test_peer_that_reopens_topic_keeps_to_its_leave() -> None:
    here = Here()
    for _ in range(6):
        drain = here.open(UP)
        publish(drain, 10, 20_000)
        drain.close()
        del here.routes[UP]
        here.open(UP)
        here.second()
    assert "1 MB" in here.denied[0]


def test_the_rate_is_of_all_topics_together() -> None:
    here = Here()
    for drain in [here.open(BENCH.route_name("tcp", str(number))) for number in range(5)]:
        publish(drain, 90)
    here.second()
    assert "100 messages a second" in here.denied[0]


def test_peer_is_not_charged_for_what_was_asked() -> None:
    here = Here()
    drain = here.open(DOWN)
    here.own.add(drain)
    publish(drain, 500, 20_000)
    here.second()
    assert not here.denied
    drain.close()
    here.second()
    assert not here.own


def test_one_run_at_a_time_whatever_the_topics() -> None:
    here = Here()
    sources = []
    for topic in (DOWN, BENCH.route_name("udp", "receive")):
        here.routes[topic] = SimpleNamespace(local_topic=topic, purpose=BENCH, proposed_here=False)
        sources.append(here.ends.subscribe(TopicSpec(topic, "", "", Qos()), lambda _: None, PEER))
    try:
        cast("Any", sources[1]).start(100, 10.0, 50)
        assert "still being sent" in here.ask(size=100, rate=10.0, count=5).problem
    finally:
        for source in sources:
            source.close()


def test_growing_count_of_peer_is_not_awaited_forever(monkeypatch: pytest.MonkeyPatch) -> None:
    here, received = Here(), 0

    async def ask(*_: object, **__: Any) -> BenchAnswer:
        nonlocal received
        received += 1
        here.time = loop.time()
        assert here.time < 60.0
        return BenchAnswer(1, received=received)

    bench_places.ASK_PEER.set(monkeypatch, ask)
    order = BenchmarkStep("run", PEER, "tcp", "transmit", 100, 100_000.0, 1_000_000)
    with virtual_loop() as loop:
        settled = here.bench._settled_there(cast("Route", None), 1, order)
        assert loop.run_until_complete(settled).received == received


def test_message_beyond_limit_is_refused() -> None:
    here = Here()
    drain = here.open(UP)
    publish(drain, 10, 100_000)
    assert not here.denied
    publish(drain, 1, 1)
    assert here.denied
    assert (drain.messages, drain.bytes) == (10, 1_000_000)
    here.time += 3600.0
    publish(here.open(UP), 1, 900_000)
    assert not here.bench.refusal(UP)
