"""Messages of publishers that are not known yet are held, and nothing asks again and again whose they are."""

from __future__ import annotations

import pytest
from tests.route.loop_filter_helpers import FIRST, SCAN, SECOND, TYPE, TYPE_HASH, World, world
from tests.support.reports import told_words

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.hops import hop
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.reason import EndCode, Reason
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.announcements import Origin
from rsb_bridge.ros.ros_interface import Endpoint
from rsb_bridge.route.loop_filter import Publication, SourceTable
from rsb_bridge.wire.framing import SOURCE_SHIFT
from rsb_bridge.wire.messages import Describe, Ready

__all__ = ["world"]


def test_new_publisher_is_looked_up_by_first_message(world: World) -> None:
    world.graph.nodes[SECOND] = "/other"
    asked = world.graph.asked
    world.comes(SECOND, b"1")
    world.comes(SECOND, b"2")
    assert world.sent == [b"1", b"2"]
    assert world.graph.asked == asked + 1


def test_messages_without_node_wait_in_order(world: World) -> None:
    """The graph is asked once for all of them, and again when it has changed."""
    world.graph.nodes[SECOND] = ""
    asked = world.graph.asked
    for number in range(100):
        world.comes(SECOND, b"%d" % number)
        world.comes(FIRST, b"x")
        world.wait(0.02)
    assert world.sent == 100 * [b"x"]
    assert world.graph.asked == asked + 1
    world.graph.nodes[SECOND] = "/other"
    world.sender.route.advance()  # as the graph watch does at each change
    world.comes(SECOND, b"100")
    assert world.sent[100:] == [b"%d" % number for number in range(101)]


def test_unexplained_publisher_is_awaited_without_polling(world: World) -> None:
    world.graph.nodes[SECOND] = ""
    world.sender.route.advance()
    world.comes(SECOND, b"1", b"2")
    asked = world.graph.asked
    world.wait(2.9)
    assert (world.sent, world.graph.asked) == ([], asked)
    world.wait(0.2)
    assert (world.sent, world.graph.asked) == ([b"1", b"2"], asked + 1)
    world.wait(600.0)
    assert world.graph.asked == asked + 1


@pytest.mark.parametrize("since", [3.453, 62.349, 62.48])
def test_wait_for_publisher_ends_when_it_says(since: float) -> None:
    """Sums of these times are rounded: a difference may be smaller than the wait when the moment has come."""
    table, publication = SourceTable(), Publication(SECOND, "bridge", None)
    table.update([publication], "hop", frozenset(), frozenset(), since)
    assert table.unexplained
    table.update([publication], "hop", frozenset(), frozenset(), table.explained_by)
    assert not table.unexplained


def test_messages_of_other_source_await_peers_publisher(world: World) -> None:
    announcements = world.context.announcements
    via = (hop("rsb_elsewhere_1", SCAN),)
    second = Endpoint(f"/{world.graph.node_name}", TYPE, TYPE_HASH, Qos(), SECOND)
    announcements.announce(SCAN, "another link", second, Origin(via))
    world.comes(SECOND, b"1")
    world.comes(FIRST, b"x")
    assert world.sent == [b"x"]
    described = [each for each in world.peer.sent if isinstance(each, Describe)][-1]
    assert [source.via for source in described.sources] == [
        (hop(world.graph.node_name, SCAN),),
        (*via, hop(world.graph.node_name, SCAN)),
    ]
    world.peer.answer(world.sender)
    assert world.peer.channel.sent[1:] == [(b"1", 1 << SOURCE_SHIFT)]


def test_messages_without_peers_publisher_are_left_out(world: World) -> None:
    announcements = world.context.announcements
    second = Endpoint(f"/{world.graph.node_name}", TYPE, TYPE_HASH, Qos(), SECOND)
    announcements.announce(SCAN, "another link", second, Origin((hop("rsb_elsewhere_1", SCAN),)))
    world.comes(SECOND, b"1")
    world.sender.peer_ready(Ready(route=1, sources=1))
    assert world.sent == []
    assert "left out" in world.sender.route.snapshot().stages[0].detail


def test_excess_held_messages_are_lost_and_counted(world: World) -> None:
    world.graph.nodes[SECOND] = ""
    for _ in range(12):
        world.comes(SECOND, *(1000 * [b"x"]))
    ledger = world.sender.facts.ledger
    assert (ledger.offered, ledger.dropped) == (2000, {"queue full": 2000})
    world.comes(SECOND, *(40 * [bytes(1 << 20)]))
    assert world.held <= 32
    world.sender.route.close("link lost")
    ledger = world.sender.facts.ledger
    assert ledger.offered == sum(ledger.dropped.values()) == 12_040


def test_large_first_message_survives_lookup(world: World) -> None:
    world.graph.nodes[SECOND] = ""
    world.comes(SECOND, bytes(8 << 20), b"small")
    assert (world.held, world.sender.facts.ledger.dropped) == (2, {})


def test_held_messages_do_not_outlive_a_pause(world: World) -> None:
    """A goal that is an hour old is sent to nobody."""
    world.graph.nodes[SECOND] = ""
    world.comes(SECOND, b"old goal")
    world.sender.route.pausing.change(paused=True)
    world.wait(3600.0)
    world.sender.route.pausing.change(paused=False)
    world.wait(10.0)
    ledger = world.sender.facts.ledger
    assert (world.sent, ledger.offered, ledger.dropped) == ([], 1, {"paused": 1})


def test_awaited_publisher_is_no_failure_elsewhere(world: World) -> None:
    """It takes seconds at most, and heals by itself."""
    world.graph.nodes = {SECOND: ""}
    world.sender.route.close("closed")
    world.sender.route.open(3)
    world.sender.route.on_accepted()
    world.sender.route.tick()
    assert "announce" in world.sender.route.snapshot().reason
    report = told_words(world.sender)
    assert report.verdict is not None
    assert (report.verdict.state, report.verdict.cause) == (State.WAITING, Cause.NO_MESSAGE)


def test_a_loop_that_comes_again_is_said_again(world: World) -> None:
    for _ in range(2):
        world.sender.route.notices.set_loop("messages would loop")
        world.sender.route.notices.set_loop("")
    codes = [event.code for event in world.context.events.after(0)]
    assert codes.count(EventCode.ROUTE_LOOP) == codes.count(EventCode.ROUTE_LOOP_GONE) == 2


def test_a_removed_route_says_nothing_of_its_channel(world: World) -> None:
    world.sender.route.channel_lost(Reason("reset", EndCode.BROKE))
    world.sender.route.destroy()
    world.wait(10.0)
    assert EventCode.ROUTE_CHANNEL_LOST not in [event.code for event in world.context.events.after(0)]


def test_distant_publisher_does_not_reopen_route_forever(world: World) -> None:
    """Anybody in the domain can announce so many hops."""
    announcements = world.context.announcements
    world.graph.nodes = {}
    world.sender.route.close("closed")
    hops = tuple(hop(f"rsb_{number}_1", SCAN) for number in range(16))
    far = Endpoint(f"/{world.graph.node_name}", TYPE, TYPE_HASH, Qos(), SECOND)
    announcements.announce(SCAN, "another link", far, Origin(hops))
    openings = 0
    for _ in range(300):
        if not world.sender.route.id and world.loop.time() >= world.sender.route.reopening.retry_at:
            openings += 1
            world.sender.route.open(2 * openings + 1)
            world.sender.route.on_accepted()
        world.sender.route.advance()
        world.wait(1.0)
    assert openings == 1
