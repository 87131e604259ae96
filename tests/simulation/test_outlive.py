"""Worlds whose links outlive their connections: nothing stays wrong, and calls end only as they should."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING
from unittest.mock import Mock, patch

import msgspec
import pytest
from tests.simulation.beds import until
from tests.simulation.conditions import ACTIONS, CALLS, KEEPING, LIVELY, STILL, STORM
from tests.simulation.episodes import connections_forgotten, data_connections_break, delayed, path_is_cut, tunnelled
from tests.simulation.world import Violation, World
from tests.support.long import long
from tests.support.replaced import ENCODER

from rsb_bridge.link.association import MOST_BYTES, Association
from rsb_bridge.link.client_channels import ClientChannels
from rsb_bridge.link.client_end import ClientEnd
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.wire.codec import encode
from rsb_bridge.wire.messages import Neighbours

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from tests.simulation.beds import Yard
    from tests.simulation.conditions import Conditions

_SEEDS = (1, 2)
_BUSY = replace(CALLS, faults=10.0, commands=60.0)


@pytest.mark.parametrize("seed", [*_SEEDS, *long(*range(3, 12))])
@pytest.mark.parametrize("conditions", [LIVELY, STORM, _BUSY, ACTIONS, KEEPING], ids=lambda each: each.name)
def test_nothing_stays_wrong(conditions: Conditions, seed: int) -> None:
    world = World(seed, replace(conditions, outlive=conditions.outlive or 60.0, moves=conditions.faults, nights=0.0))
    with patch.object(Association, "resume", autospec=True, side_effect=Association.resume) as resumed:
        try:
            world.play(1800)
        except Violation as violation:
            pytest.fail(str(violation), pytrace=False)
    assert resumed.called or seed not in _SEEDS, "no link went on with its session"


@pytest.mark.parametrize("seed", [*_SEEDS, *long(*range(3, 12))])
def test_link_moves_from_connections_that_carry_nothing(seed: int) -> None:
    """Only the old ones carry nothing: another one is up before either side gives the link up."""
    world = World(seed, replace(LIVELY, outlive=60.0, nights=0.0, faults=0.0, commands=0.0))
    with (
        patch.object(Association, "resume", autospec=True, side_effect=Association.resume) as resumed,
        patch.object(Association, "suspend", autospec=True, side_effect=Association.suspend) as suspended,
    ):
        try:
            world.play(900, connections_forgotten(world))
        except Violation as violation:
            pytest.fail(str(violation), pytrace=False)
    assert resumed.call_count > 40
    assert not suspended.called


@pytest.mark.parametrize(
    "course",
    [lambda world: tunnelled(world, 300.0, 2_000.0, 60.0), lambda world: delayed(world, 300.0, 1.5)],
    ids=["tunnel of 2 kB/s", "round trip of 3 s"],
)
def test_link_stays_on_a_thin_or_slow_path(course: Callable[[World], Coroutine[None, None, None]]) -> None:
    """Its connection is doubted when the path gets so, at most, and not each second."""
    world = World(1, replace(STILL, outlive=60.0, topics=(2,)))
    with (
        patch.object(ClientEnd, "_connect", autospec=True, side_effect=ClientEnd._connect) as attempts,
        patch.object(Association, "resume", autospec=True, side_effect=Association.resume) as resumed,
    ):
        try:
            world.play(420.0, course(world))
        except Violation as violation:
            pytest.fail(str(violation), pytrace=False)
    assert attempts.call_count <= 4
    assert resumed.call_count <= 4


@pytest.mark.bed(Topic("/chat", "transmit", protocol="udp"), outlive=60.0)
async def test_connection_lost_as_datagrams_pass(yard: Yard) -> None:
    """Its routes resume on the next one, once, with that one's keys and sockets."""
    yard.publish("/chat")
    await until(lambda: "/chat" in yard.routes() and yard.routes()["/chat"].connected, 30.0)
    opening, lost = yard.routes()["/chat"].id, 0

    def found(channels: ClientChannels) -> None:
        nonlocal lost
        find(channels)
        if lost < 2:
            lost += 1
            channels.control.abort("reset")

    find = ClientChannels.udp_ready
    with patch.object(ClientChannels, "udp_ready", found):
        yard.link().channels.control.abort("reset")
        await until(lambda: lost == 2 and yard.link().linked, 30.0)
    await asyncio.sleep(20.0)  # a socket that hears nothing is in trouble by then
    assert EventCode.ENGINE_ERROR not in yard.codes()
    for on_server in (False, True):
        (route,) = yard.routes(on_server=on_server).values()
        channel = route.half.carried.channel
        assert channel is not None
        assert channel.trouble() is None
    assert yard.routes()["/chat"].id == opening


@pytest.mark.parametrize("seed", [1, *long(2, 3, 4)])
@pytest.mark.parametrize("break_them", [data_connections_break, path_is_cut])
def test_kept_topics_outlive_connections(
    break_them: Callable[[World, int], Coroutine[None, None, None]], seed: int
) -> None:
    """Nothing that was in transit, or came meanwhile, is lost; the control connection stays, or is cut off, too."""
    world = World(seed, replace(STILL, outlive=60.0, topics=(0,)))
    (robot,) = world.robots
    topics = Topic("/up", "transmit", qos=10, keep=60.0), Topic("/down", "receive", qos=10, keep=60.0)
    robot.host.session = msgspec.structs.replace(robot.host.session, topics=topics)
    for topic, size in zip(topics, (100, 20_000), strict=True):
        flow = world.add_topic_flow(robot, topic, world.random("kept"))
        flow.size, flow.period = size, 0.05

    sent: dict[str, int] = {}
    heard: dict[str, int] = {}

    async def course() -> None:
        await asyncio.sleep(30.0)
        for flow in robot.topic_flows:
            flow.vanish()
        await asyncio.sleep(3.0)
        for flow in robot.topic_flows:
            heard[str(flow)] = -flow.heard
            flow.appear()
        await break_them(world, 4)
        for flow in robot.topic_flows:
            flow.vanish()
        await asyncio.sleep(5.0)
        for flow in robot.topic_flows:
            heard[str(flow)] += flow.heard
            sent[str(flow)] = flow.sent

    with patch.object(Association, "suspend", autospec=True, side_effect=Association.suspend) as suspended:
        try:
            world.play(180.0, course())
        except Violation as violation:
            pytest.fail(str(violation), pytrace=False)
    assert suspended.called is (break_them is path_is_cut)
    for name, count in sent.items():
        assert count > 1000
        assert count - 1 <= heard[name] <= count  # DDS may not know the writer yet when it publishes its first


@pytest.mark.bed(Topic("/chat", "transmit"), outlive=60.0)
async def test_control_message_is_encoded_once(yard: Yard) -> None:
    """It is sent, and kept for the next connection."""
    link, message = yard.link(), Neighbours(bridges=("x",))
    assert link.association is not None
    encoder = Mock(wraps=ENCODER.value)
    with ENCODER.during(encoder):
        link.send(message)
    encoder.encode.assert_called_once_with(message)


@pytest.mark.bed(Topic("/chat", "transmit"), outlive=60.0)
async def test_peer_that_handles_nothing_ends_link(yard: Yard) -> None:
    """It reads all that comes, and acknowledges none of it."""
    yard.publish("/chat")
    link = yard.link()
    assert link.association is not None
    before, long, sent = link.association.id, Neighbours(bridges=("x" * 250,) * 64), 0
    with patch.object(Association, "acknowledge", lambda *_: None):
        while link.linked and sent < 2 * MOST_BYTES:
            link.send(long)
            sent += len(encode(long))
            await asyncio.sleep(0.02)
    assert 0.9 * MOST_BYTES < sent < 1.1 * MOST_BYTES
    await until(lambda: link.linked, 30.0)
    assert link.association.id != before
    assert EventCode.ENGINE_ERROR not in yard.codes()


@pytest.mark.bed(Topic("/chat", "transmit"), outlive=60.0)
async def test_peer_that_denies_proposal_it_used(yard: Yard) -> None:
    """It resumes, and says that it has handled nothing: another association begins, without an error of this side's."""
    yard.publish("/chat")
    await until(lambda: "/chat" in yard.routes() and yard.routes()["/chat"].connected, 30.0)
    link, far = yard.link(), yard.link(on_server=True)
    assert link.association is not None
    assert far.association is not None
    before, handled = link.association.id, far.association.handled
    with patch.object(Association, "acknowledge", lambda *_: None):
        link.table.openings.propose(yard.routes()["/chat"])
        await until(lambda: yard.routes()["/chat"].connected, 30.0)
        await asyncio.sleep(1.0)
        far.association.handled = handled
        link.channels.control.abort("reset")
    await until(lambda: link.linked and link.association is not None and link.association.id != before, 60.0)
    assert EventCode.ENGINE_ERROR not in yard.codes()
