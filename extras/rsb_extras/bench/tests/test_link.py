"""Measuring the link of two engines, neither of which has a ROS domain: what crosses joins no topic."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, TypeVar

import pytest
import zstandard
from tests.support import replaced
from tests.support.frames import write_frame
from tests.support.inside import inside
from tests.support.rogue import Rogue
from tests.support.waiting import eventually

from rsb_bridge.api import EngineError
from rsb_bridge.config.keys import read_key, write_key
from rsb_bridge.link.extension import LinkError
from rsb_bridge.model.session import Client, Session
from rsb_bridge.model.snapshot import State
from rsb_bridge.wire.framing import MORE, ZSTD
from rsb_extras.bench import LIMITS, BenchmarkLimits
from rsb_extras.bench.benchmark import BENCH, ENDED_BY_PEER, Bench, BenchmarkStep
from rsb_extras.bench.link_bench import REOPENED, LinkBench
from rsb_extras.bench.tests import bench_places
from rsb_extras.bench.tests.link_helpers import LEAVE, WITHIN, Pair, linked, pair

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine
    from pathlib import Path

    from rsb_bridge.engine import Engine
    from rsb_bridge.engine.bridge import Bridge
    from rsb_extras.bench.link_bench import BenchAnswer

__all__ = ["linked", "pair"]

T = TypeVar("T")


def on_bridge(engine: Engine, ask: Callable[[Bridge], Coroutine[None, None, T]]) -> T:
    bridge = inside(engine)
    assert bridge is not None
    return asyncio.run_coroutine_threadsafe(ask(bridge), bridge.context.loop).result(WITHIN)


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a run wait for its last message: a process that stands still for 0.7 s would end it before."""
    bench_places.BENCH_QUIET.set(monkeypatch, 30.0)
    bench_places.BENCH_LATE.set(monkeypatch, 30.0)


@pytest.mark.usefixtures("patient")
def test_messages_cross_both_ways_and_are_counted(pair: Callable[..., Pair]) -> None:
    """One after another, while the topics of all are still there: the ways do not close a loop."""
    both = pair(to_client=LEAVE)
    for direction in ("transmit", "receive", "transmit"):
        for transport in ("tcp", "udp"):
            found = both.run(both.client, transport=transport, direction=direction)
            assert (found.sent, found.received) == (40, 40), (transport, direction)
            assert 0.0 < found.p50 + (found.uncertainty or 0.0) <= found.p99 + (found.uncertainty or 0.0)
            assert found.p50 <= found.p99 <= found.p999
            assert found.sending.sent_bytes > 40 * 2500
            assert found.most_rate == LEAVE.max_rate
            assert found.usage.memory > 0


@pytest.mark.parametrize("first_heard", ["the proposal", "the run"])
def test_run_with_reopened_topic_has_no_figures(
    first_heard: str, pair: Callable[..., Pair], monkeypatch: pytest.MonkeyPatch
) -> None:
    """For example where the link is lost, and back soon: the other side has counted from 0 since.

    The run may go on before the other side has heard of the new opening.
    """
    both = pair(to_client=LEAVE)
    both.run(both.client)
    step = BenchmarkStep("run", "", "tcp", "transmit", 2500, 50.0, 1000)  # it ends long before
    running = both.client.do(Bench(step))

    async def open_anew(bridge: Bridge) -> bool:
        (link,) = bridge.role.links()
        (route,) = link.routes.values()
        source = bridge.context.internal[BENCH.name].sources[route.local_topic, link.name]
        if not source.busy or source.sent < 20:
            return False
        if first_heard == "the run":

            async def wait_for_run(*_: object) -> None:
                while not running.done():  # noqa: ASYNC110 -- a thread's state
                    await asyncio.sleep(0.01)

            replaced.PREPARE_PORT.set(monkeypatch, wait_for_run)
        link.table.openings.propose(route)
        return True

    eventually(lambda: on_bridge(both.client, open_anew), WITHIN)
    with pytest.raises(EngineError, match=REOPENED):
        running.result(WITHIN)


def test_both_sides_do_not_measure_at_once(pair: Callable[..., Pair], monkeypatch: pytest.MonkeyPatch) -> None:
    bench_places.BENCH_IDLE.set(monkeypatch, 600.0)  # the second one may begin late
    both = pair(to_client=LEAVE, to_server=LEAVE)
    both.run(both.client)
    assert "measuring the link" in both.refused(both.server)


@pytest.mark.usefixtures("patient")
def test_a_server_measures_its_client_with_leave(pair: Callable[..., Pair]) -> None:
    both = pair(to_server=LEAVE)
    assert both.run(both.server, link="robot1").received == 40
    assert "bench/tcp/transmit" in both.topics()


@pytest.mark.usefixtures("patient")
def test_clients_that_measure_at_once_have_own_figures(tmp_path: Path, linked: Callable[..., list[Engine]]) -> None:
    """Their routes have one name on the server."""
    keys = {name: f"{name}.key" for name in ("robot1", "robot2")}
    for key in keys.values():
        write_key(tmp_path / key)
    entries = tuple(Client(*each, features={LIMITS.name: LEAVE}) for each in keys.items())
    server = Session(name="pc", role="server", server_ip="", clients=entries)
    sides = [Session(name=name, role="client", server_ip="", key_file=key) for name, key in keys.items()]
    _, *clients = linked(server, *sides)
    for direction in ("transmit", "receive"):
        orders = [BenchmarkStep("run", "", "tcp", direction, 2500, rate, 60) for rate in (50.0, 30.0)]
        under_way = [engine.do(Bench(order)) for engine, order in zip(clients, orders, strict=True)]
        found = [each.result(WITHIN) for each in under_way]
        assert [(each.sent, each.received) for each in found] == [(60, 60)] * 2


def test_a_session_does_not_keep_the_topics(pair: Callable[..., Pair]) -> None:
    """They are removed when the one that measures ends, or is not heard of any more."""
    both = pair(to_client=LEAVE)
    before = both.client.session
    for ends in (True, False):
        both.run(both.client)
        assert both.topics()
        assert both.client.session == before
        if ends:
            both.client.do(Bench(BenchmarkStep("end"))).result(WITHIN)
        eventually(lambda: not both.topics(), WITHIN)


def test_the_peer_s_operator_can_stop_it(pair: Callable[..., Pair]) -> None:
    both = pair(to_client=LEAVE)
    both.run(both.client)
    running = both.client.do(Bench(BenchmarkStep("run", "", "tcp", "transmit", 2500, 50.0, 1000)))
    key = eventually(lambda: next((route.key for route in both.server.snapshot().routes), None), WITHIN)
    both.server.remove_topic(key).result(WITHIN)
    with pytest.raises(EngineError) as stopped:
        running.result(WITHIN)
    assert str(stopped.value).startswith(ENDED_BY_PEER)
    assert both.refused(both.client).startswith(ENDED_BY_PEER), "it does not just begin again"
    assert not both.server.snapshot().routes


@pytest.mark.parametrize("direction", ["transmit", "receive"])
def test_more_bytes_than_the_leave_has_are_refused(pair: Callable[..., Pair], direction: str) -> None:
    both = pair(to_client=BenchmarkLimits(megabytes=1.0))
    both.run(both.client, direction=direction)

    def refused() -> bool:
        try:
            both.run(both.client, direction=direction, size=50_000, rate=50.0, count=60)
        except EngineError as error:  # perhaps only that the run before is still crossing
            return "bench.megabytes" in str(error)
        return False

    eventually(refused, WITHIN)  # what arrives is looked at once a second
    assert "bench.megabytes" in both.refused(both.client, direction=direction, transport="udp", size=50_000)


def test_higher_rate_than_leave_has_is_not_made(pair: Callable[..., Pair]) -> None:
    both = pair(to_client=BenchmarkLimits(max_rate=50.0))
    for direction in ("transmit", "receive"):
        assert "50 messages a second" in both.refused(both.client, direction=direction, rate=60.0)


def test_who_sends_faster_all_same_is_cut_off(pair: Callable[..., Pair]) -> None:
    both = pair(to_client=BenchmarkLimits(max_rate=100.0))
    both.run(both.client, rate=50.0, count=5)
    internal = inside(both.client).context.internal[BENCH.name]
    source = internal.sources["bench/tcp/transmit", "robot1"]
    source.start(100, 1000.0, 5000)
    eventually(lambda: not both.server.snapshot().routes, WITHIN)


def test_peer_orders_runs_on_its_own_topic_only(pair: Callable[..., Pair]) -> None:
    both = pair(to_client=LEAVE)
    both.run(both.client)

    async def ask(bridge: Bridge) -> BenchAnswer:
        (link,) = bridge.role.links()
        (route,) = link.routes.values()
        return await link.extensions.find(LinkBench)._ask(route, route.id, size=100, rate=10.0, count=5)

    with pytest.raises(LinkError):
        on_bridge(both.server, ask)


def test_what_cannot_be_ordered(pair: Callable[..., Pair]) -> None:
    both = pair(to_client=LEAVE)
    large, slow = {"size": 1 << 30}, {"rate": 1.0, "count": 1000}
    for wrong in ({"size": 1}, large, {"count": 0}, {"rate": 0.0}, slow, {"link": "x"}):
        assert both.refused(both.client, **wrong)
        assert not both.topics()


MEGABYTE = 1_000_000


def let_in(server: Engine) -> tuple[int, int, int]:
    """Return the bytes of a measuring peer: as received, unpacked, and of incomplete messages."""

    async def ask(bridge: Bridge) -> tuple[int, int, int]:
        (link,) = bridge.role.links()
        budget = link.extensions.find(LinkBench)._budget
        return budget._wire, budget._payload, link.budget.unfinished.held

    return on_bridge(server, ask)


def measures(server: Engine) -> bool:
    """Whether the link has a topic; a snapshot may be older than the topic."""

    async def ask(bridge: Bridge) -> bool:
        (link,) = bridge.role.links()
        return bool(link.routes)

    return on_bridge(server, ask)


def storm(rogue: Rogue, transport: str, what: str, size: int) -> int:
    """Send 20 MB on a topic that measures, as fast as the server takes them; the bytes that went out."""
    route = rogue.internal(BENCH, (transport, "transmit"), transport)
    messages, sent = 20 * MEGABYTE // size, 0
    content = zstandard.ZstdCompressor(1).compress(bytes(MEGABYTE)) if what == "compressed" else bytes(size)
    try:
        if transport == "udp":
            rogue.probe()
            writer = rogue.datagrams(route)
            for _ in range(messages):
                for datagram in writer.write(content, 0, 0, 1400):
                    rogue.udp.send(datagram)
                    sent += len(datagram)
            return sent
        stream, frames = rogue.stream(route)
        for _ in range(messages):
            flags = ZSTD if what == "compressed" else MORE if what == "chunks" else 0
            stream.sendall(frame := write_frame(frames, content, 0, flags))
            sent += len(frame)
    except OSError:
        pass
    return sent


@pytest.mark.parametrize(
    ("transport", "what", "size"),
    [
        ("tcp", "small", 100),
        ("tcp", "whole", 500_000),
        ("tcp", "one", 20 * MEGABYTE),
        ("tcp", "chunks", 100_000),
        ("tcp", "compressed", 50_000),
        ("udp", "small", 1_000),
        ("udp", "large", 300_000),
    ],
)
def test_no_byte_beyond_the_limit_is_taken(
    pair: Callable[..., Pair], tmp_path: Path, transport: str, what: str, size: int
) -> None:
    """Over several connections, since the leave is for an hour."""
    both = pair(to_client=BenchmarkLimits(megabytes=1.0, max_rate=1e6))
    both.client.stop()
    port = both.server.session.server_port
    refused = 0
    for _ in range(3):
        eventually(lambda: not any(link.state is State.OK for link in both.server.snapshot().links), WITHIN)
        with Rogue(port, read_key(tmp_path / "k.key").secret) as rogue:
            try:
                storm(rogue, transport, what, size)
            except AssertionError:  # it may not propose the topic any more
                refused += 1
            if what != "one":  # the length of a frame ends its stream before a byte counts
                eventually(lambda: not measures(both.server), WITHIN)
            wire, payload, unfinished = let_in(both.server)
            assert max(wire, payload) <= MEGABYTE
            assert unfinished <= MEGABYTE
    if what == "one":
        assert payload == 0, "no stream takes a frame that is as long"
    else:
        assert refused >= 1
