"""The path of outgoing messages: its gates are on it while they are on, and the ledger counts every message."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.route.gates_helpers import armed
from tests.route.loop_filter_helpers import FIRST, World, world

from rsb_bridge.cdr.known_types import DRIVING_TYPES
from rsb_bridge.model.motion import LATEST
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import RawMessage
from rsb_bridge.route.arming import Disarmed
from rsb_bridge.route.lease import LeaseHalf
from rsb_bridge.route.ledger import REPLACED
from rsb_bridge.route.route import Route
from rsb_bridge.route.sending import USE_TCP, remedy_for_size
from rsb_bridge.transport.registry import default_transports
from rsb_bridge.wire.framing import CONTENT_LIMIT
from rsb_bridge.wire.messages import Propose

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.route.sending import Outbox

__all__ = ["world"]
BEST_EFFORT = Qos(reliability="best_effort")
FLOAT, TRAJECTORY = "std_msgs/msg/Float64", "trajectory_msgs/msg/JointTrajectory"
SECOND = 10**9


def publish(world: World, count: int, rate: int = 100, size: int = 100) -> int:
    before, now = len(world.sent), world.context.stamps.now()
    for number in range(count):
        world.path.offer([RawMessage(bytes(size), now + number * SECOND // rate, FIRST)])
    return len(world.sent) - before


def outbox(world: World) -> Outbox:
    return world.path._outbox


def limited(world: World) -> None:
    world.sender.route.limit.set_max_rate(10.0)


def unlimited(world: World) -> None:
    world.sender.route.limit.set_max_rate(0.0)


def test_rate_limit_is_on_path_while_set(world: World) -> None:
    path, ledger = world.path, world.ledger
    assert not path.gates.sourced
    publish(world, 10)
    limited(world)
    assert len(path.gates.sourced) == 1
    sent = publish(world, 50)
    assert 0 < sent < 10
    assert ledger.throttled == 50 - sent
    assert world.path.traffic.offered == 10 + sent  # a topic asks the link for no more than its own limit
    unlimited(world)
    assert not path.gates.sourced
    assert publish(world, 10) == 10
    assert ledger.offered == 70 == ledger.sent_now + ledger.throttled


@pytest.mark.parametrize("count", range(1, 8))  # so that the last one comes anywhere between two beats
@pytest.mark.parametrize(
    ("type_name", "arm", "passes"),
    [*((each, False, True) for each in sorted(DRIVING_TYPES)), (FLOAT, True, True), (FLOAT, False, False)],
)
def test_last_message_of_what_may_move_robot_passes(
    type_name: str, arm: bool, passes: bool, count: int, world: World
) -> None:
    """It may be the stop; it comes a beat later, and only if nothing follows it."""
    world.sender.flow.knows(type_name, world.sender.carried.type_hash, world.sender.flow.qos)
    if arm:
        armed(world.sender.route.arming, world.context)
    limited(world)
    for number in range(count):
        world.path.offer([RawMessage(b"message %d" % number, world.context.stamps.now(), FIRST, lease=1)])
        world.wait(0.02)
    world.wait(0.2)
    heard = [int(each.rpartition(b" ")[2]) for each in world.sent]
    assert heard[-1] == count - 1 if passes else heard == [0, 5][: len(heard)]
    assert heard == sorted(set(heard))
    assert len(heard) <= 2 + passes
    ledger = world.sender.facts.ledger
    assert (ledger.offered, ledger.throttled) == (count, count - len(heard))


@pytest.mark.parametrize("ends", [Route.disarm, Route.close])
def test_waiting_messages_do_not_outlive_arming(ends: Callable[..., None], world: World) -> None:
    armed(world.sender.route.arming, world.context)
    limited(world)
    for payload in (b"moves", b"turns"):
        world.path.offer([RawMessage(payload, world.context.stamps.now(), FIRST, lease=1)])
    ends(world.sender.route, Disarmed.OPERATOR)
    world.sender.route.open(2)
    world.sender.route.on_accepted()
    world.peer.answer(world.sender)
    armed(world.sender.route.arming, world.context)
    world.wait(0.5)
    assert [each[4:] for each in world.sent] == [b"moves"]
    assert world.sender.facts.ledger.open == 0


def test_age_is_asked_again_when_message_leaves_queue(world: World) -> None:
    ledger = world.ledger
    world.sender.route.age.settle((0.5,), armed=False)
    world.peer.channel.congested = True
    assert publish(world, 2) == 0
    world.wait(1.0)
    world.peer.channel.congested = False
    world.sender.route.flush()
    assert (ledger.offered, ledger.sent_now, ledger.expired) == (2, 0, 2)


@pytest.mark.parametrize(("type_name", "kept"), [("geometry_msgs/msg/Twist", 1), ("std_msgs/msg/String", 3)])
def test_of_velocities_that_waited_only_newest_is_sent(type_name: str, kept: int, world: World) -> None:
    world.sender.route.arming.demand(required=True, deadman=0.0)
    world.sender.flow.knows(type_name, world.sender.carried.type_hash, world.sender.flow.qos)
    world.peer.channel.congested = True
    for number in range(3):
        world.path.receive([RawMessage(bytes(number), world.context.stamps.now(), FIRST)])
    world.peer.channel.congested = False
    world.sender.route.flush()
    assert (world.ledger.sent_now, world.ledger.dropped["queue full"]) == (kept, 3 - kept)
    assert len(world.sent[-1]) == 4 + 2  # the number of the lease, and the newest message


@pytest.mark.parametrize("arm", [False, True])
@pytest.mark.parametrize("world", [{}, {"qos": 20}], indirect=True)
def test_of_commands_that_waited_only_newest_is_sent(arm: bool, world: World) -> None:
    world.sender.flow.knows(TRAJECTORY, world.sender.carried.type_hash, world.sender.flow.qos)
    if arm:
        armed(world.sender.route.arming, world.context)
    world.sender.route.settle_age()
    world.peer.channel.congested = True
    assert publish(world, 5) == 0
    world.peer.channel.congested = False
    world.sender.route.flush()
    assert (world.ledger.sent_now, world.ledger.dropped) == (1, {REPLACED: 4})


def test_commands_that_come_at_once_all_pass(world: World) -> None:
    """None of them has waited, though they are more than one turn takes."""
    world.sender.flow.knows(TRAJECTORY, world.sender.carried.type_hash, world.sender.flow.qos)
    world.sender.route.settle_age()
    stamp = world.context.stamps.now()
    world.path.offer([RawMessage(b"%d" % number, stamp, FIRST) for number in range(50)])
    assert world.sent == [b"%d" % number for number in range(50)]


def test_command_that_waited_too_long_is_not_sent(world: World) -> None:
    world.sender.flow.knows(TRAJECTORY, world.sender.carried.type_hash, world.sender.flow.qos)
    world.sender.route.settle_age()
    world.peer.channel.congested = True
    publish(world, 1)
    world.wait(LATEST + 0.1)
    world.peer.channel.congested = False
    world.sender.route.flush()
    assert (world.ledger.sent_now, world.ledger.expired) == (0, 1)


def test_later_messages_are_lost_with_link(world: World) -> None:
    """It may be older than what arms the next opening."""
    ledger = world.ledger
    world.graph.sink([RawMessage(b"late", 0, FIRST)])
    world.sender.route.close("over")
    world.wait(0.1)
    assert (ledger.offered, ledger.dropped["link lost"]) == (1, 1)
    assert not world.sent


def test_uncarriable_messages_ask_nothing_of_link(world: World) -> None:
    path, ledger = world.path, world.ledger
    outbox(world).largest = 50
    path.offer([RawMessage(bytes(size), 1, FIRST) for size in (10, 60, 20, 70)])
    assert world.sent == [bytes(10), bytes(20)]
    assert (ledger.offered, ledger.dropped["too large"], world.path.traffic.offered) == (4, 2, 2)
    path.offer([RawMessage(bytes(60), 1, FIRST)])
    assert (ledger.offered, ledger.dropped["too large"], world.path.traffic.offered) == (5, 3, 2)


@pytest.mark.parametrize("world", [{"compression": "zstd"}], indirect=True)
def test_message_is_not_too_large_for_receiver_alone(world: World) -> None:
    """Compressed it would pass here, and the receiver would not unpack it."""
    path, ledger = world.path, world.ledger
    path.offer([RawMessage(bytes(CONTENT_LIMIT + 1), 1, FIRST)])
    assert not world.sent
    assert ledger.dropped["too large"] == 1


@pytest.mark.parametrize("world", [{"compression": "zstd"}], indirect=True)
def test_what_crosses_counts_after_compression(world: World) -> None:
    world.path.offer([RawMessage(bytes(100_000_000), 1, FIRST)])
    (sent,) = world.sent
    assert len(sent) < 20_000
    assert not world.ledger.dropped


@pytest.mark.parametrize(
    ("protocol", "compression", "remedy"),
    [("udp", "none", USE_TCP), ("tcp", "none", "set compression: zstd"), ("tcp", "zstd", "publish smaller ones")],
)
def test_the_remedy_for_too_large_messages(protocol: Any, compression: Any, remedy: str) -> None:
    proposal = Propose(route=1, topic="/map", remote_topic="/map", from_client=True, compression=compression)
    assert remedy_for_size(default_transports()[protocol], proposal) == remedy


def test_a_message_without_a_channel_is_lost(world: World) -> None:
    world.sender.carried.channel = None
    assert publish(world, 3) == 0
    assert world.ledger.dropped["link lost"] == 3


@pytest.mark.parametrize("world", [{"qos": 2}], indirect=True)
@pytest.mark.parametrize(
    ("in_doubt", "still", "quiet", "cause"),
    [(True, 0.0, 0.0, "outage"), (False, 0.4, 0.4, "outage"), (False, 0.4, 0.1, "queue full")],
)
def test_drops_of_silent_link_count_as_outage(
    in_doubt: bool, still: float, quiet: float, cause: str, world: World
) -> None:
    """Also in a gap that is over before the connection is doubted."""
    world.peer.channel.congested = True
    publish(world, 3)
    world.peer.channel.stood_still = still
    world.peer.keepalive = SimpleNamespace(in_doubt=in_doubt, quiet=quiet)
    publish(world, 5)
    assert Counter(world.ledger.dropped) == Counter(["queue full", *[cause] * 5])
    assert world.sender.facts.ledger.waiting == 2


def test_nothing_that_is_disarmed_is_shown_to_operators(world: World) -> None:
    world.sender.route.arming.lease = LeaseHalf(world.context.clock.steady, world.context.ros.turns, lambda: None)
    world.sender.route.arming.demand(required=True, deadman=0.0)
    world.sender.flow.peek_slot.wanted = True
    assert publish(world, 1) == 0
    assert world.sender.flow.peek_slot.wanted


@pytest.mark.parametrize("world", [{"keep": 60.0, "qos": 2}], indirect=True)
def test_messages_of_several_publishers_come_together(world: World) -> None:
    """Each publisher's own newest ones wait."""
    other = b"other" + FIRST[5:]
    world.graph.nodes[other] = "/other"
    world.comes(other, b"hello")
    world.peer.channel.congested = True
    stamp = world.context.stamps.now()
    world.path.receive([RawMessage(b"quiet", stamp, FIRST)])
    world.wait(61.0)
    world.path.receive([RawMessage(b"%d" % number, stamp, other if number else FIRST) for number in range(5)])
    world.wait(61.0)
    world.path.resume()
    world.peer.channel.congested = False
    world.sender.route.flush()
    assert world.sent == [b"hello", b"quiet", b"0", b"3", b"4"]
    assert world.ledger.dropped == {"outage": 2}
