"""A latched topic from its publishers to late joiners on the far side, on virtual time and with a made-up DDS."""

from __future__ import annotations

import asyncio
from collections import defaultdict, deque
from dataclasses import dataclass, field
from itertools import count
from random import Random
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import msgspec
import pytest
from tests.support.offline import FakePeer
from tests.support.virtual_time import VirtualClock, VirtualLoop, virtual_loop

from rsb_bridge.context import Context
from rsb_bridge.model.calls import Refused
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Session
from rsb_bridge.ros.discovery import Discovery
from rsb_bridge.ros.ros_interface import RawMessage, RosError, TopicSpec
from rsb_bridge.ros.ros_thread import RosToLoopQueue
from rsb_bridge.route.latched import PUBLISHER_COST, LatchedFullError, LatchedTopic
from rsb_bridge.route.source_publishers import bounded
from rsb_bridge.route.topic_subscription import TopicSubscription
from rsb_bridge.telemetry.event_log import EventLog
from rsb_bridge.telemetry.meters import RateMeter
from rsb_bridge.transport.registry import default_transports
from rsb_bridge.wire.framing import Budget
from rsb_bridge.wire.headers import HistoryHeader, publisher_id

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.ros.ros_interface import Sink
    from rsb_bridge.route.history_depth import Sample
    from rsb_bridge.route.sending import OutgoingPath

LATCHED = Qos(durability="transient_local", depth=0)


@dataclass
class Writer:
    gid: bytes
    depth: int
    newest: int = 0
    history: deque[int] = field(default_factory=deque)
    published: dict[int, int] = field(default_factory=dict)
    """When each message was published, in ns."""
    answers: bool = True
    """Whether a new reader gets its history: not once its process was killed or stopped."""


class NearDds:
    """The sending side's DDS: histories come first, and each reader hears each writer in order, a little late."""

    node_name = "_rsb_robot1_0123abcd"
    shortfalls: tuple[str, ...] = ()
    discovery = Discovery({})

    def __init__(self, loop: VirtualLoop, random: Random, lifespan: float) -> None:
        self.loop = loop
        self.random = random
        self.lifespan = lifespan
        self.writers: dict[bytes, Writer] = {}
        self.readers: list[NearReader] = []
        self.subscribed = 0
        self.ahead = 0.0  # s, of the publishers' clock
        self.refuses = False  # whether it makes no further subscription
        self.overwrites = False  # whether it is too slow to hand over a history before it is overwritten
        self._numbers = count()

    def installed_hash(self, _: str) -> str:
        return ""

    def survives_foreign_keys(self, _: str) -> bool:
        return True

    def subscribe(self, *arguments: Any, **_: Any) -> NearReader:
        if self.refuses:
            raise RosError("too many subscriptions")
        self.subscribed += 1
        reader = NearReader(self, arguments[1])
        self.readers.append(reader)
        for writer in self.writers.values():
            reader.match(writer)
        return reader

    def now_ns(self) -> int:
        return int((1 + self.loop.time()) * 1e9)

    def new_writer(self, depth: int) -> Writer:
        writer = Writer(publisher_id(b"writer %d" % next(self._numbers)), depth)
        self.writers[writer.gid] = writer
        for reader in self.readers:
            reader.match(writer)
        return writer

    def publish(self, writer: Writer) -> None:
        writer.newest += 1
        writer.history.append(writer.newest)
        writer.published[writer.newest] = self.now_ns() + int(self.ahead * 1e9)
        while len(writer.history) > writer.depth:
            writer.history.popleft()
        if self.lifespan:
            self.loop.call_later(self.lifespan, self._expire, writer, writer.newest)
        for reader in self.readers:
            reader.hear(writer)

    def _expire(self, writer: Writer, number: int) -> None:
        if writer.history and writer.history[0] == number:
            writer.history.popleft()


class NearReader:
    alive = True
    matched = 1

    def __init__(self, dds: NearDds, sink: Sink) -> None:
        self._dds = dds
        self._sink = sink
        self._matched: set[bytes] = set()
        self._waiting: dict[bytes, deque[int]] = {}

    def match(self, writer: Writer) -> None:
        self._dds.loop.call_later(self._dds.random.uniform(0, 0.05), self._discovered, writer)

    def _discovered(self, writer: Writer) -> None:
        if not writer.answers:
            self._dds.loop.call_later(0.1, self._discovered, writer)
            return
        self._matched.add(writer.gid)
        self._waiting[writer.gid] = deque(list(writer.history)[-1:] if self._dds.overwrites else writer.history)
        self._hand_over_soon(writer)

    def hear(self, writer: Writer) -> None:
        if writer.gid in self._matched:
            self._waiting[writer.gid].append(writer.newest)
            self._hand_over_soon(writer)

    def _hand_over_soon(self, writer: Writer) -> None:
        self._dds.loop.call_later(self._dds.random.uniform(0, 0.01), self._hand_over, writer)

    def _hand_over(self, writer: Writer) -> None:
        waiting = self._waiting[writer.gid]
        if waiting and self in self._dds.readers:
            now, published = self._dds.now_ns(), writer.published
            self._sink([RawMessage(b"%d" % at, now, writer.gid, at, 0, published[at]) for at in waiting])
            waiting.clear()

    def close(self) -> None:
        if self in self._dds.readers:
            self._dds.readers.remove(self)


class FarDds:
    """The receiving side's DDS: publishers that keep what their depth says, and one subscriber from the beginning."""

    def __init__(self, loop: VirtualLoop, lifespan: float = 0.0) -> None:
        self.loop = loop
        self.lifespan = lifespan
        self.discovery: Callable[[], float] = lambda: 0.1  # s until the subscriber knows a new publisher
        self.asks_after = 0.0  # s until a publisher that overwrites nothing asks for acknowledgements
        self.open: list[FarPublisher] = []
        self.heard: list[bytes] = []
        self.first_heard = 0.0
        self.made = 0

    def advertise(self, depth: int) -> FarPublisher:
        self.made += 1
        publisher = FarPublisher(self, depth)
        self.open.append(publisher)
        return publisher

    def late_joiner(self) -> list[bytes]:
        return sorted(content for publisher in self.open for content in publisher.kept)

    def histories(self) -> dict[bytes, list[list[int]]]:
        """Return the numbers that each publisher here keeps, by the writer on the other side."""
        found = defaultdict[bytes, list[list[int]]](list)
        for publisher in self.open:
            split = [content.rpartition(b" ") for content in publisher.kept]
            if split:
                found[split[0][0]].append([int(number) for _, _, number in split])
        return found


class FarPublisher:
    """A publisher that knows the subscriber at once, and that the subscriber knows later."""

    gid = b""
    subscriber_count = 1
    refuses = False

    def __init__(self, dds: FarDds, depth: int) -> None:
        self._dds = dds
        self._known_at = dds.loop.time() + dds.discovery()
        dds.loop.call_at(self._known_at, self._deliver)
        self.kept: deque[bytes] = deque(maxlen=depth)
        self._unheard: deque[bytes] = deque(maxlen=depth)
        self._published_at = 0.0

    @property
    def acknowledged(self) -> bool:
        asked = len(self.kept) == self.kept.maxlen or self._dds.loop.time() - self._published_at >= self._dds.asks_after
        return asked and not self._unheard

    def assert_liveliness(self) -> None:
        pass

    def publish(self, content: bytes) -> None:
        assert self in self._dds.open
        self._published_at = self._dds.loop.time()
        self.kept.append(content)
        if self._dds.lifespan:
            self._dds.loop.call_later(self._dds.lifespan, self._expire, content)
        self._unheard.append(content)
        if self._dds.loop.time() >= self._known_at:
            self._deliver()

    def _deliver(self) -> None:
        if self._unheard and self in self._dds.open:
            self._dds.first_heard = self._dds.first_heard or self._dds.loop.time()
            self._dds.heard += self._unheard
            self._unheard.clear()

    def _expire(self, content: bytes) -> None:
        if self.kept and self.kept[0] == content:
            self.kept.popleft()

    def close(self) -> None:
        self._dds.open.remove(self)


class End:
    """What the sending side's part of a route knows of it; in a set, too."""

    def __init__(self, **parts: Any) -> None:
        self.__dict__ |= parts


class Route:
    """The route between the two: a link that may be cut, and processes that may be restarted."""

    def __init__(self, near: NearDds, far: FarDds, context: Context) -> None:
        self.meter = RateMeter(0.0)
        self.near, self.far, self.context = near, far, context
        self.mute: set[bytes] = set()
        self.budget = Budget(1 << 30)
        self.offered = self.sent = self.held = 0
        self.resends = 0  # as the far side remembers it
        self.paused = False
        self.topic = self.make_topic()
        self.subscription = self.make_subscription()
        self.open()

    def make_topic(self) -> LatchedTopic:
        depth = bounded(msgspec.structs.replace(LATCHED, lifespan=self.near.lifespan)).depth
        return LatchedTopic(self.context.loop, self.far.advertise, self.budget, depth)

    def make_subscription(self) -> TopicSubscription:
        route: Any = End(
            context=self.context,
            ends=self.context.ros,
            peer=FakePeer(),
            meter=self.meter,
            arming=SimpleNamespace(required=False),
            proposal=SimpleNamespace(qos=None, express=False),
            log=lambda *_: pytest.fail("the subscription did not fail"),
        )
        loop_filter: Any = SimpleNamespace(alive_left_out=lambda qos: 0)
        return TopicSubscription(route, cast("OutgoingPath", self), loop_filter, self.tell)

    def open(self) -> None:
        qos = msgspec.structs.replace(LATCHED, lifespan=self.near.lifespan)
        subject = TopicSpec("/latched", "std_msgs/msg/String", "", qos)
        self.topic.opened()
        self.subscription.begin(subject, known=self.topic.newest(), resends=self.resends)
        self.tell()
        if not self.paused:
            self.subscription.subscribe(missed=False)

    def pause(self, paused: bool) -> None:
        if paused == self.paused:
            return
        self.paused = paused
        if paused:
            self.subscription.unsubscribe()
        else:
            self.subscription.subscribe(missed=False)

    def offer(self, batch: Sequence[RawMessage]) -> None:
        assert self.subscription.histories is not None
        self.offered += self.subscription.histories.receive(batch).new

    def emit(self, samples: Sequence[Sample]) -> None:
        for header, message, _ in samples:
            self.sent += 1
            content = b"%s %s" % (message.gid.rstrip(b"\0"), message.payload)
            assert self.topic.publish(header, content), (header, content)

    def too_late(self, _: Sequence[RawMessage]) -> None:
        pytest.fail("nothing is in flight when an opening ends")

    def cut(self) -> None:
        self.held += self.subscription.close()
        self.open()

    def restart_near(self) -> None:
        self.held += self.subscription.close()
        self.subscription = self.make_subscription()
        self.open()

    def restart_far(self) -> None:
        self.held += self.subscription.close()
        self.topic.close()
        assert not self.far.open
        assert self.budget.held == 0
        self.far.heard.clear()
        self.resends = 0
        self.topic = self.make_topic()
        self.open()

    def tell(self) -> None:
        assert self.subscription.histories is not None
        self.topic.present(self.subscription.histories.present(set(self.near.writers), self.mute))
        self.resends = self.subscription.histories.resends

    def second(self) -> None:
        assert self.subscription.histories is not None
        self.subscription.tick()
        self.tell()
        self.topic.tick()


class World:
    def __init__(self, loop: VirtualLoop, seed: int, lifespan: float = 0.0) -> None:
        self.loop = loop
        self.random = Random(seed)
        self.near, self.far = NearDds(loop, self.random, lifespan), FarDds(loop, lifespan)
        clock = VirtualClock(loop)
        session = Session(name="robot1", role="client", server_ip="127.0.0.1", server_port=1)
        context = Context(
            session,
            0,
            self.near,  # type: ignore[arg-type]
            EventLog(clock),
            RosToLoopQueue(loop),
            loop,
            clock,
            self.random,
            default_transports(),
        )
        self.route = Route(self.near, self.far, context)

    def wait(self, seconds: float) -> None:
        end = self.loop.time() + seconds
        while self.loop.time() < end:
            self.loop.run_until_complete(asyncio.sleep(min(1.0, end - self.loop.time())))
            self.route.second()

    def near_late_joiner(self) -> list[bytes]:
        return sorted(
            b"%s %d" % (writer.gid.rstrip(b"\0"), number)
            for writer in self.near.writers.values()
            if writer.answers
            for number in writer.history
        )


def histories_match(world: World) -> bool:
    """Whether late joiners hear the same on both sides, in the same order.

    Of a writer that has begun to drop messages, and keeps more than one, the far side may keep older ones, too.
    """
    far = world.far.histories()
    near = {each.gid.rstrip(b"\0"): each for each in world.near.writers.values() if each.answers and each.history}
    for name, writer in near.items():
        kept, history = far.get(name, []), list(writer.history)
        if writer.depth == 1 or writer.newest <= writer.depth:
            if kept != [history]:
                return False
        elif sorted(number for each in kept for number in each)[-len(history) :] != history:
            return False
    return near.keys() == far.keys()


@pytest.mark.parametrize(
    ("kills", "pauses", "seed"),
    [
        *((kills, 0, seed) for kills in (0, 2) for seed in range(16)),
        *((0, 0, seed) for seed in (39, 42, 62, 134, 350, 557)),
        *((2, 0, seed) for seed in (64, 106, 117)),
        *((0, 2, seed) for seed in (6, 9, 64, 112, 137, 163, 285, 286)),
        *((2, 2, seed) for seed in (25, 43, 100)),
    ],
)
def test_late_joiners_get_the_same_on_both_sides(kills: int, pauses: int, seed: int) -> None:
    """For all depths and orders of events, at rest both sides keep the same, in one publisher each.

    Nothing is heard twice but the newest message once a node has been killed.
    """
    with virtual_loop() as loop:
        world = World(loop, seed)
        random = world.random
        for _ in range(60):
            writers = list(world.near.writers.values())
            events = {
                "publish": 8,
                "burst": 2,
                "writer": 3,
                "gone": 1,
                "killed": kills,
                "cut": 1,
                "near": 1,
                "far": 1,
                "wait": 6,
                "rest": 3,
                "pause": pauses,
            }
            match random.choices([*events], [*events.values()])[0]:
                case "publish" if writers:
                    world.near.publish(random.choice(writers))
                case "burst" if writers:
                    writer = random.choice(writers)
                    for _ in range(random.randint(2, 15)):
                        world.near.publish(writer)
                case "writer":
                    world.near.new_writer(random.choice([1, 1, 1, 2, 3, 5, 10, 15]))
                case "gone" if writers:
                    del world.near.writers[random.choice(writers).gid]
                case "killed" if writers:
                    killed = random.choice(writers)
                    killed.answers = False
                    world.loop.call_later(20.0, world.near.writers.pop, killed.gid, None)
                case "cut":
                    world.route.cut()
                case "near":
                    world.route.restart_near()
                case "far":
                    world.route.restart_far()
                case "wait":
                    world.wait(random.expovariate(5))
                case "pause":
                    world.route.pause(not world.route.paused)
                case "rest":
                    world.route.pause(False)
                    world.wait(25)
                    assert histories_match(world)
        world.route.pause(False)
        world.wait(25)
        assert histories_match(world)
        assert kills or len(set(world.far.heard)) == len(world.far.heard)
        route = world.route
        assert route.offered == route.sent + route.held
        route.held += route.subscription.close()
        route.topic.close()
        assert route.budget.held == 0
        assert not loop.errors
        assert not world.near.readers


def test_live_subscriber_misses_nothing_while_depths_are_learned() -> None:
    with virtual_loop() as loop:
        world = World(loop, 1)
        world.wait(1)
        writer = world.near.new_writer(7)
        world.wait(1)
        for _ in range(30):
            world.near.publish(writer)
            world.wait(0.3)
        assert world.far.heard == [b"writer 0 %d" % number for number in range(1, 31)]
        assert world.near.subscribed <= 2 + 8
        assert len(world.far.open) <= 7


@pytest.mark.parametrize("depth", [1, 10, 100])
@pytest.mark.parametrize("rate", [2, 25])
def test_a_live_subscriber_hears_all_over_cuts(rate: int, depth: int) -> None:
    """On a busy machine it discovers a publisher after seconds, when DDS has overwritten the first messages."""
    with virtual_loop() as loop:
        world = World(loop, depth)
        world.far.discovery = lambda: world.random.uniform(0.5, 4.0)
        writer = world.near.new_writer(depth)
        for _ in range(6):
            for _ in range(8 * rate):
                world.near.publish(writer)
                world.wait(1 / rate)
            world.route.cut()
        sent = world.route.sent
        world.wait(60)
        assert len(world.far.heard) == sent
        assert world.far.heard == sorted(world.far.heard, key=lambda content: int(content.rpartition(b" ")[2]))
        assert set(world.near_late_joiner()) <= set(world.far.late_joiner())


def test_a_cut_finds_no_depth_again() -> None:
    with virtual_loop() as loop:
        world = World(loop, 1)
        writer = world.near.new_writer(3)
        for _ in range(5):
            world.near.publish(writer)
        world.wait(5)
        subscribed, made = world.near.subscribed, world.far.made
        for _ in range(3):
            world.route.cut()
            for _ in range(5):
                world.near.publish(writer)
                world.wait(0.2)
        assert world.near.subscribed == subscribed + 3
        assert world.far.made <= made + 1
        assert world.far.late_joiner() == world.near_late_joiner()


def test_late_joiner_hears_no_publisher_that_has_ended() -> None:
    """An e-stop that a node released before it ended: the next one has pressed it, and nobody may hear otherwise."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        ends, presses = world.near.new_writer(1), world.near.new_writer(1)
        for writer in (ends, presses):
            world.near.publish(writer)
            world.wait(2.0)
        del world.near.writers[ends.gid]
        world.wait(3.0)
        assert world.far.late_joiner() == [b"writer 1 1"]


class KilledBeside:
    """A node that has released an e-stop and was killed, its successor that has pressed it, and one beside them."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.beside, self.killed = world.near.new_writer(1), world.near.new_writer(1)
        for writer in (self.beside, self.killed):
            world.near.publish(writer)
            world.wait(2.0)
        self.killed.answers = False
        self.successor = world.near.new_writer(1)
        world.near.publish(self.successor)


def test_newest_is_heard_last_after_kill() -> None:
    """DDS lists the killed publisher all the time."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        KilledBeside(world)
        world.wait(4.0)
        assert world.far.late_joiner() == [b"writer 0 1", b"writer 1 1", b"writer 2 1"]
        world.wait(6.0)
        assert world.far.late_joiner() == world.near_late_joiner() == [b"writer 0 1", b"writer 2 1"]
        # A late joiner may have heard them in another order before.
        assert world.far.heard == [b"writer 0 1", b"writer 1 1", b"writer 2 1", b"writer 2 1"]
        world.wait(20.0)
        assert len(world.far.heard) == 4


def test_publisher_without_history_is_not_taken_for_killed() -> None:
    """A transient one of Cyclone DDS, which gives a subscription of ROS what it publishes from then on."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        world.route.mute.add(publisher_id(b"writer 1"))
        KilledBeside(world)
        world.wait(20.0)
        assert world.far.late_joiner() == [b"writer 0 1", b"writer 1 1", b"writer 2 1"]
        assert len(world.far.heard) == 3


def test_cut_after_kill_sends_nothing_again() -> None:
    with virtual_loop() as loop:
        world = World(loop, 1)
        nodes = KilledBeside(world)
        world.wait(10.0)
        heard = list(world.far.heard)
        for _ in range(2):
            world.route.cut()
            world.wait(2.0)
            assert world.far.heard == heard
            assert world.far.late_joiner() == world.near_late_joiner() == [b"writer 0 1", b"writer 2 1"]
        del world.near.writers[nodes.successor.gid]
        world.wait(3.0)
        assert world.far.late_joiner() == world.near_late_joiner() == [b"writer 0 1"]


@pytest.mark.parametrize("pauses", [False, True])
def test_newest_stays_until_it_can_be_sent_again(pauses: bool) -> None:
    """The further subscription is refused, or the route is paused once the killed publisher is withdrawn."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        nodes = KilledBeside(world)
        world.wait(7.0)
        assert world.far.late_joiner() == world.near_late_joiner() == [b"writer 0 1", b"writer 2 1"]
        if pauses:
            world.route.subscription.unsubscribe()
        world.near.refuses = True
        world.wait(10.0)
        assert world.far.late_joiner() == world.near_late_joiner()
        assert len(world.far.heard) == 3
        world.near.refuses = False
        if pauses:
            world.route.subscription.subscribe(missed=False)
        world.wait(10.0)
        assert world.far.late_joiner() == world.near_late_joiner()
        assert world.far.heard[3:] == [b"writer 2 1"]
        nodes.killed.answers = True
        world.wait(3.0)
        assert world.far.late_joiner() == world.near_late_joiner()


@pytest.mark.parametrize("after", [0.2, 2.0, 4.0, 5.5, 6.5, 8.0])
def test_newest_is_sent_again_after_a_cut(after: float) -> None:
    """Before the killed publisher is asked, before it is judged, and before the peer has closed its history."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        KilledBeside(world)
        world.wait(after)
        world.route.cut()
        world.wait(12.0)
        assert world.far.late_joiner() == world.near_late_joiner() == [b"writer 0 1", b"writer 2 1"]
        assert world.far.heard == [b"writer 0 1", b"writer 1 1", b"writer 2 1", b"writer 2 1"]


@pytest.mark.parametrize("after", [6.5, 7.0, 8.0])
@pytest.mark.parametrize("side", ["near", "far"])
def test_newest_is_sent_again_after_a_restart(side: str, after: float) -> None:
    """It was withdrawn less than 3 s ago. The near side's new process does not see the killed publisher."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        nodes = KilledBeside(world)
        world.wait(after)
        assert world.far.late_joiner() == [b"writer 0 1", b"writer 2 1"]
        if side == "near":
            del world.near.writers[nodes.killed.gid]
            world.route.restart_near()
        else:
            world.route.restart_far()
        world.wait(15.0)
        assert world.far.late_joiner() == world.near_late_joiner() == [b"writer 0 1", b"writer 2 1"]
        assert world.far.heard[-1] == b"writer 2 1"
        assert world.far.heard.count(b"writer 2 1") == 2


@pytest.mark.parametrize("resends", [1, 2, 17])
def test_new_process_sends_nothing_that_was_sent_again(resends: int) -> None:
    """The peer knows the newest message under an id that the former process made."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        nodes = KilledBeside(world)
        for _ in range(resends - 1):
            world.wait(12.0)
            nodes.killed = world.near.new_writer(1)
            world.near.publish(nodes.killed)
            world.wait(1.0)
            nodes.killed.answers = False
            world.near.publish(world.near.new_writer(1))
            world.wait(1.0)
            world.near.publish(nodes.successor)
        world.wait(12.0)
        assert world.far.heard.count(b"writer 2 %d" % resends) == 2
        heard = list(world.far.heard)
        for _ in range(2):
            world.route.restart_near()
            world.wait(12.0)
            assert world.far.heard == heard
            assert world.far.late_joiner() == world.near_late_joiner()


def test_message_that_never_comes_is_not_waited_for_forever() -> None:
    """The far side remembers one that no publisher has any more, and another publisher has never published."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        world.near.new_writer(1)
        world.near.publish(world.near.new_writer(1))
        world.wait(2.0)
        world.route.resends = 2**63 - 1
        world.route.restart_near()
        world.wait(8.0)
        assert world.route.resends == 2**63 - 1
        world.wait(30.0)
        assert world.route.resends == 0
        assert world.far.late_joiner() == world.near_late_joiner() == [b"writer 1 1"]


def test_killed_before_a_restart_is_withdrawn_too() -> None:
    with virtual_loop() as loop:
        world = World(loop, 1)
        KilledBeside(world)
        world.wait(2.0)
        world.route.restart_near()
        world.wait(12.0)
        assert world.far.late_joiner() == world.near_late_joiner() == [b"writer 0 1", b"writer 2 1"]
        assert world.far.heard[-1] == b"writer 2 1"


def test_message_after_kill_is_not_sent_again() -> None:
    with virtual_loop() as loop:
        world = World(loop, 1)
        nodes = KilledBeside(world)
        world.wait(7.0)
        world.near.publish(nodes.successor)
        world.wait(10.0)
        assert world.far.late_joiner() == world.near_late_joiner() == [b"writer 0 1", b"writer 2 2"]
        assert world.far.heard[2:] == [b"writer 2 1", b"writer 2 2"]


def test_stopped_publisher_that_goes_on_is_heard_again() -> None:
    with virtual_loop() as loop:
        world = World(loop, 1)
        nodes = KilledBeside(world)
        world.wait(10.0)
        assert b"writer 1 1" not in world.far.late_joiner()
        nodes.killed.answers = True
        world.wait(3.0)
        world.near.publish(nodes.killed)
        world.wait(3.0)
        assert world.far.late_joiner() == world.near_late_joiner() == [b"writer 0 1", b"writer 1 2", b"writer 2 1"]


def test_killed_publisher_leaves_no_subscription() -> None:
    with virtual_loop() as loop:
        world = World(loop, 1)
        nodes = KilledBeside(world)
        world.wait(10.0)
        assert len(world.near.readers) == 2
        del world.near.writers[nodes.killed.gid]
        world.wait(3.0)
        assert len(world.near.readers) == 1
        assert world.far.late_joiner() == world.near_late_joiner()


@pytest.mark.parametrize("after", [0.5, 4.0, 10.0])
def test_pause_after_kill_leaves_no_subscription(after: float) -> None:
    """Before the killed publisher is asked, before it is judged, and while it is silent."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        nodes = KilledBeside(world)
        world.wait(after)
        world.route.subscription.unsubscribe()
        assert not world.near.readers
        world.wait(10.0)
        assert not world.near.readers
        world.route.subscription.subscribe(missed=False)
        world.wait(10.0)
        assert world.far.late_joiner() == world.near_late_joiner() == [b"writer 0 1", b"writer 2 1"]
        nodes.killed.answers = True
        world.wait(3.0)
        world.near.publish(nodes.killed)
        world.wait(15.0)
        assert world.far.late_joiner() == world.near_late_joiner()
        assert len(world.near.readers) == 1


def test_living_publishers_are_not_sent_again() -> None:
    """Nodes that start one after the other, each asking for the others."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        for _ in range(10):
            world.near.publish(world.near.new_writer(1))
            world.wait(1.5)
        world.wait(10.0)
        assert len(world.far.heard) == 10
        assert len(world.near.readers) == 1
        assert world.near.subscribed <= 1 + 10


def test_new_sender_may_not_know_its_publishers_yet() -> None:
    with virtual_loop() as loop:
        far = FarDds(loop)
        topic = LatchedTopic(loop, far.advertise, Budget(1 << 30), 1)
        publisher = publisher_id(b"writer")
        topic.present({publisher: 1})
        assert topic.publish(HistoryHeader(publisher, 1, 1), b"1")
        topic.opened()
        topic.present({})
        loop.run_until_complete(asyncio.sleep(5.0))
        topic.tick()
        assert far.late_joiner() == [b"1"]
        topic.present({publisher: 1})
        topic.present({})
        topic.tick()
        loop.run_until_complete(asyncio.sleep(1.0))
        topic.tick()
        assert far.late_joiner() == []
        topic.close()


def test_stopped_subscriber_delays_others_ten_seconds_only() -> None:
    with virtual_loop() as loop:
        far = FarDds(loop)
        far.discovery = lambda: 1e9
        topic = LatchedTopic(loop, far.advertise, Budget(1 << 30), 1)
        for number in range(1, 100):
            assert topic.publish(HistoryHeader(publisher_id(b"writer"), number, 1), b"%d" % number)
        loop.run_until_complete(asyncio.sleep(11.0))
        assert far.late_joiner() == [b"99"]
        topic.close()


def test_retired_publishers_give_way_to_new_ones() -> None:
    """A subscriber that acknowledges nothing leaves them open; their memory counts."""
    with virtual_loop() as loop:
        far = FarDds(loop)
        far.discovery = lambda: 1e9
        budget = Budget(4 * PUBLISHER_COST)
        topic = LatchedTopic(loop, far.advertise, budget, 1)
        for depth in range(1, 20):
            assert topic.publish(HistoryHeader(publisher_id(b"writer"), depth, depth), b"x")
            topic.present({publisher_id(b"writer"): 1})
            loop.run_until_complete(asyncio.sleep(11.0))
        assert len(far.open) <= 3
        topic.close()
        assert budget.held == 0


def test_a_deep_history_costs_few_probes_and_publishers() -> None:
    """It is kept whole; while its depth is unknown some older messages may be kept too."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        writer = world.near.new_writer(300)
        for _ in range(1000):
            world.near.publish(writer)
            world.wait(0.05)
        world.wait(20)
        assert world.near.subscribed <= 30
        assert world.far.made <= 24
        assert set(world.near_late_joiner()) <= set(world.far.late_joiner())
        assert len(world.far.late_joiner()) <= 600
        world.route.restart_far()
        world.wait(20)
        assert world.near_late_joiner() == world.far.late_joiner()


def test_a_busy_publisher_is_measured_too() -> None:
    """At 200 Hz a probe cannot catch it at rest, so the depth may be off by what is published meanwhile."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        world.wait(1)
        writer = world.near.new_writer(10)
        for _ in range(2000):
            world.near.publish(writer)
            world.wait(0.005)
        world.wait(5)
        assert set(world.near_late_joiner()) <= set(world.far.late_joiner())
        assert len(world.far.late_joiner()) <= 40
        assert len(world.far.heard) == 2000


@pytest.mark.parametrize("seconds", [0.3, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("rate", [50, 100])
@pytest.mark.parametrize("depth", [1, 3])
def test_a_burst_leaves_what_its_publisher_keeps(depth: int, rate: int, seconds: float) -> None:
    with virtual_loop() as loop:
        world = World(loop, depth)
        world.wait(1)
        writer = world.near.new_writer(depth)
        world.wait(0.1)
        for _ in range(int(rate * seconds)):
            world.near.publish(writer)
            world.wait(1 / rate)
        world.wait(5)
        assert set(world.near_late_joiner()) <= set(world.far.late_joiner())
        assert len(world.far.late_joiner()) <= depth + 1


def test_a_clock_ahead_makes_no_history_shallow() -> None:
    """By its times, a part of the history seems to be published while it is handed over."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        world.near.ahead = 0.2
        world.wait(1)
        writer = world.near.new_writer(10)
        for _ in range(100):
            world.near.publish(writer)
            world.wait(1 / 50)
        world.wait(5)
        assert set(world.near_late_joiner()) <= set(world.far.late_joiner())


def test_overwritten_history_is_not_taken_for_short() -> None:
    """DDS does so at 5 kHz at times."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        world.wait(1)
        writer = world.near.new_writer(1000)
        world.near.overwrites = True
        for _ in range(7_000):
            world.near.publish(writer)
            world.wait(1 / 5000)
        world.wait(5)
        assert world.near_late_joiner() == world.far.late_joiner()


@pytest.mark.parametrize(
    ("rate", "publishers", "lifespan"),
    [(0.1, 1, 0.0), (1, 25, 10.0), (10, 1, 10.0), (25, 25, 0.0), (50, 1, 0.0), (200, 25, 10.0), (5000, 1, 0.0)],
)
def test_live_messages_cross_at_once_at_any_rate(rate: float, publishers: int, lifespan: float) -> None:
    """All arrive in order, none waits for its publisher to pause, and late joiners get all that is kept."""
    with virtual_loop() as loop:
        world = World(loop, 1, lifespan)
        world.wait(1)
        writers = [world.near.new_writer(1000) for _ in range(publishers)]
        world.wait(0.1)
        began, behind = loop.time(), 0
        count = max(4 * publishers, min(2000, int(12 * rate)))
        for at in range(count):
            world.near.publish(writers[at % publishers])
            world.wait(1 / rate)
            behind = max(behind, at + 1 - len(world.far.heard))
        assert world.far.first_heard - began < 0.5
        world.wait(0.5)
        heard = defaultdict[bytes, list[int]](list)
        for content in world.far.heard:
            name, _, number = content.rpartition(b" ")
            heard[name].append(int(number))
        assert heard == {each.gid.rstrip(b"\0"): list(range(1, each.newest + 1)) for each in writers}
        assert behind <= 1 + rate * 0.5
        assert set(world.near_late_joiner()) <= set(world.far.late_joiner())
        assert world.route.offered == world.route.sent == count


@pytest.mark.parametrize("rate", [10, 50, 200])
@pytest.mark.parametrize("depth", [5, 20, 100])
def test_beginning_is_heard_in_order(rate: int, depth: int) -> None:
    """The subscriber starts with its publisher: it takes seconds to discover the first publishers here."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        world.far.asks_after = 0.1
        world.far.discovery = lambda: max(0.1, 4.0 - loop.time())
        world.wait(1)
        writer = world.near.new_writer(depth)
        world.wait(0.1)
        for _ in range(8 * rate):
            world.near.publish(writer)
            world.wait(1 / rate)
        world.wait(2)
        heard = [int(content.rpartition(b" ")[2]) for content in world.far.heard]
        assert heard == list(range(1, 8 * rate + 1))
        assert world.far.late_joiner() == world.near_late_joiner()


@pytest.mark.parametrize("rate", [25, 200])
def test_late_acknowledgements_hold_message_up_half_second(rate: int) -> None:
    """DDS asks for them every 3 s, until a publisher overwrites what it has published."""
    with virtual_loop() as loop:
        world = World(loop, 1)
        world.far.asks_after = 3.0
        world.wait(1)
        writer, behind = world.near.new_writer(1000), 0
        world.wait(0.1)
        for at in range(5 * rate):
            world.near.publish(writer)
            world.wait(1 / rate)
            behind = max(behind, at + 1 - len(world.far.heard))
        assert behind <= 1 + 0.6 * rate
        world.wait(1)
        assert len(world.far.heard) == 5 * rate


def test_lifespan_does_not_hide_kept_message() -> None:
    """The peer forgets what has expired; a publisher that keeps less than that is found out while it is young."""
    with virtual_loop() as loop:
        world = World(loop, 1, lifespan=30.0)
        world.wait(1)
        writer = world.near.new_writer(1)
        world.wait(0.1)
        for _ in range(10):
            world.near.publish(writer)
            world.wait(0.5)
        assert world.far.late_joiner() == world.near_late_joiner()


def test_an_expired_history_is_no_shallow_one() -> None:
    with virtual_loop() as loop:
        world = World(loop, 1, lifespan=1.0)
        world.wait(1)
        writer = world.near.new_writer(100)
        for _ in range(8):
            world.near.publish(writer)
            world.wait(3)
        for _ in range(40):
            world.near.publish(writer)
            world.wait(0.01)
        assert len(world.near_late_joiner()) == 40
        assert set(world.near_late_joiner()) <= set(world.far.late_joiner())


def test_publishers_and_bytes_are_bounded() -> None:
    with virtual_loop() as loop:
        far = FarDds(loop)
        budget = Budget(3 * PUBLISHER_COST + 1000)
        topic = LatchedTopic(loop, far.advertise, budget, 1)
        for number in range(3):
            assert topic.publish(HistoryHeader(b"%016d" % number, 1, 1), b"x")
        with pytest.raises(LatchedFullError):
            topic.publish(HistoryHeader(b"%016d" % 3, 1, 1), b"x")
        with pytest.raises(LatchedFullError):
            topic.publish(HistoryHeader(b"%016d" % 0, 2, 1), b"x" * 1000)
        assert len(far.open) == 3
        topic.close()
        assert budget.held == 0
        assert not far.open


def test_topic_stays_despite_oversized_first_message() -> None:
    with virtual_loop() as loop:
        far = FarDds(loop)
        topic = LatchedTopic(loop, far.advertise, Budget(PUBLISHER_COST + 100), 1)
        with pytest.raises(LatchedFullError):
            topic.publish(HistoryHeader(publisher_id(b"writer"), 1, 5), b"x")
        for _ in range(3):
            loop.run_until_complete(asyncio.sleep(1.0))
            topic.tick()
        assert len(far.open) == 1


def test_messages_that_waited_do_not_overrun_a_subscriber() -> None:
    """A new depth needs a new publisher, which nobody has discovered yet: messages wait meanwhile."""
    count, depth = 2500, 500
    with virtual_loop() as loop:
        far = FarDds(loop)
        topic = LatchedTopic(loop, far.advertise, Budget(1 << 30), 1)
        loop.run_until_complete(asyncio.sleep(1.0))
        for number in range(1, count + 1):
            assert topic.publish(HistoryHeader(publisher_id(b"writer"), number, 1000), b"%d" % number)
        heard = [0]
        while heard[-1] < count and loop.time() < 10.0:
            loop.run_until_complete(asyncio.sleep(0.001))
            heard.append(len(far.heard))
        topic.close()
    assert far.heard == [b"%d" % number for number in range(1, count + 1)]
    assert max(after - before for before, after in zip(heard, heard[20:], strict=False)) <= depth  # in 20 ms
    assert len(heard) < 500  # ms


@pytest.mark.parametrize("depths", [(2, 2), (5, 2)], ids=["one publisher", "depth found since"])
def test_moved_topic_publishes_what_is_kept_once_more(depths: tuple[int, int]) -> None:
    """And nothing that was never published, nor what its publisher on the sending side keeps no longer."""
    with virtual_loop() as loop:
        far, budget = FarDds(loop), Budget(1 << 30)
        topic = LatchedTopic(loop, far.advertise, budget, depths[0], repeats=True)
        writer = publisher_id(b"writer")
        for number in range(1, 5):
            look = None if number != 2 else lambda: Refused.DISARMED
            assert topic.publish(HistoryHeader(writer, number, depths[0]), b"%d" % number, look)
            loop.run_until_complete(asyncio.sleep(0.2))
        topic.present({writer: depths[1]})
        loop.run_until_complete(asyncio.sleep(1.0))
        former, heard, held = [*far.open], [*far.heard], budget.held
        assert topic.move()
        assert topic.needs_sender  # until all is published
        for _ in range(3):
            loop.run_until_complete(asyncio.sleep(1.0))
            topic.tick()
        assert not topic.needs_sender
        assert not {*former} & {*far.open}
        assert far.heard[len(heard) :] == far.late_joiner()
        assert set(far.late_joiner()) == ({b"3", b"4"} if depths[0] == 2 else {b"1", b"3", b"4"})
        assert budget.held == held
        assert not topic.publish(HistoryHeader(writer, 4, 2), b"4")
        topic.close()
        assert budget.held == 0


def test_topic_that_cannot_move_stays() -> None:
    with virtual_loop() as loop:
        far, budget = FarDds(loop), Budget(PUBLISHER_COST + 10_000)
        topic = LatchedTopic(loop, far.advertise, budget, 1, repeats=True)
        assert topic.publish(HistoryHeader(publisher_id(b"writer"), 1, 1), b"x")
        held = budget.held
        with pytest.raises(LatchedFullError):
            topic.move()
        assert budget.held == held
        assert far.late_joiner() == [b"x"]


def test_topic_that_keeps_no_content_needs_its_sender_to_move() -> None:
    with virtual_loop() as loop:
        far = FarDds(loop)
        topic = LatchedTopic(loop, far.advertise, Budget(1 << 30), 1)
        assert topic.move()
        assert topic.publish(HistoryHeader(publisher_id(b"writer"), 1, 1), b"x")
        assert topic.needs_sender
        assert not topic.move()
        assert far.made == 2
