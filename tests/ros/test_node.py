"""The guarantees of `RosNode` for the engine: no echo, no uncounted loss, fair turns, a clean end."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from rclpy.node import HIDDEN_NODE_PREFIX
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from tests.ros.domains import ANOTHER
from tests.support import constants
from tests.support.participants import KnownNode
from tests.support.resources import resources
from tests.support.waiting import eventually

from rsb_bridge.model.qos import PROFILES, Qos
from rsb_bridge.ros.node import RosNode
from rsb_bridge.ros.publication_numbers import PublicationNumbers, Untaken
from rsb_bridge.ros.ros_interface import NodeEnds, TopicSpec

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from rclpy.node import Node

STRING = "std_msgs/msg/String"
DEEP = Qos(depth=5000)


def strings(topic: str, qos: Qos = DEEP) -> TopicSpec:
    return TopicSpec(topic, STRING, "", qos)


def payload(text: str) -> bytes:
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + len(data).to_bytes(4, "little") + data


class Received:
    """A sink that keeps the payloads; it blocks while `hold` is clear."""

    def __init__(self) -> None:
        self.payloads: list[bytes] = []
        self.batches: list[int] = []
        self.stamps: list[int] = []
        self.gids: list[bytes] = []
        self.blocked = threading.Event()
        self.hold = threading.Event()
        self.hold.set()

    def __call__(self, batch: Any) -> None:
        holds = not self.hold.is_set()  # checked first: a reader of these payloads may clear it for the next
        self.payloads += [taken.payload for taken in batch]
        self.stamps += [taken.stamp for taken in batch]
        self.gids += [taken.gid for taken in batch]
        self.batches.append(len(batch))
        if holds:
            self.blocked.set()
            assert self.hold.wait(120)


@pytest.fixture
def start_one() -> None:
    """Start and stop a first node, which leaves Fast DDS's and the logger's own threads for good."""
    node = RosNode(ANOTHER, "first")
    node.start()
    node.stop()


def test_graph_shows_others_and_not_ourselves(open_node: Callable[..., RosNode], rclpy_node: Node) -> None:
    ours = open_node(name="robot-1 é")
    qos = Qos(
        "best_effort",
        "transient_local",
        deadline=0.5,
        lifespan=2.0,
        liveliness="manual_by_topic",
        liveliness_lease_duration=3.0,
    )
    ours.subscribe(strings("/ours_only"), Received(), "link")
    ours.subscribe(strings("/shared", PROFILES["sensor_data"]), Received(), "link")
    publisher = ours.advertise(strings("/shared", qos), "link")
    rclpy_node.create_publisher(String, "/shared", 1)
    other = open_node(name="other")
    advertised = other.advertise(strings("/theirs", qos), "link")
    [theirs] = eventually(lambda: ours.publishers("/theirs"))
    assert theirs.qos == msgspec.structs.replace(qos, depth=0)
    assert theirs.type_name == STRING
    assert theirs.type_hash == ours.installed_hash(STRING)
    assert theirs.gid == advertised.gid
    [stock] = eventually(lambda: [each for each in ours.publishers("/shared") if each.node])
    assert (stock.node, stock.qos) == ("/stock", Qos(depth=0))
    assert ours.subscriptions("/shared") == []
    assert publisher.subscriber_count == 0
    topics = eventually(lambda: found if "/theirs" in (found := ours.topics()) else None)
    assert topics["/theirs"] == topics["/shared"] == [STRING]
    assert "/ours_only" not in topics
    [seen] = eventually(lambda: [name for name in rclpy_node.get_node_names() if name.startswith("_rsb_robot_1__")])
    published = eventually(lambda: rclpy_node.get_publisher_names_and_types_by_node(seen, "/"))
    assert published == [("/shared", [STRING])]
    assert rclpy_node.get_service_names_and_types_by_node(seen, "/") == []


def test_nodes_and_what_they_use(open_node: Callable[..., RosNode], rclpy_node: Node) -> None:
    ours, other = open_node(), open_node()
    other.advertise(strings("/theirs"), "link")
    rclpy_node.create_subscription(String, "/heard", print, 10)
    eventually(lambda: {"/stock", f"/{other.node_name}"} <= set(ours.node_names()), what="both")
    assert f"/{ours.node_name}" not in ours.node_names()
    published = eventually(lambda: ours.ends_of(f"/{other.node_name}").publishes, what="its topic")
    assert published == {"/theirs": [STRING]}
    stock = eventually(lambda: found if "/heard" in (found := ours.ends_of("/stock")).hears else None, what="heard")
    assert stock.serves["/stock/get_parameters"] == ["rcl_interfaces/srv/GetParameters"]
    assert ours.ends_of("/nobody") == NodeEnds()


def test_visible_nodes_have_parameters(open_node: Callable[..., RosNode], rclpy_node: Node) -> None:
    """`ros2 param list` asks every node that is not hidden."""
    ours = open_node()
    names = eventually(lambda: found if ours.node_name in (found := rclpy_node.get_node_names()) else None)
    visible = [name for name in names if not name.startswith(HIDDEN_NODE_PREFIX)]
    assert visible
    assert all(AsyncParameterClient(rclpy_node, name).wait_for_services(10.0) for name in visible)


def test_two_bridges_of_one_name_are_two_nodes(open_node: Callable[..., RosNode]) -> None:
    one, other = open_node(), open_node()
    one.advertise(strings("/chat"), "link")
    assert len(eventually(lambda: other.publishers("/chat"))) == 1


def test_messages_of_same_origin_never_come_back(open_node: Callable[..., RosNode]) -> None:
    """A foreign publisher and one of another origin shout at once on the same topic: all of theirs, none of ours."""
    ours, foreign = open_node(), open_node(name="foreign")
    received = Received()
    ours.subscribe(strings("/chat"), received, ("link", 1))
    publishers = {
        "ours": ours.advertise(strings("/chat"), ("link", 1)),
        "other link": ours.advertise(strings("/chat"), ("link", 2)),
        "foreign": foreign.advertise(strings("/chat"), ("link", 1)),
    }
    eventually(lambda: ours.publishers("/chat"))
    eventually(lambda: publishers["foreign"].subscriber_count)

    def shout(name: str) -> None:
        for number in range(1500):
            publishers[name].publish(payload(f"{name} {number}"))

    shouting = [threading.Thread(target=shout, args=(name,)) for name in publishers]
    for thread in shouting:
        thread.start()
    for thread in shouting:
        thread.join()
    eventually(lambda: len(received.payloads) >= 3000)
    publishers["ours"].publish(payload("ours, after all"))
    publishers["ours"].close()
    publishers["foreign"].publish(payload("the last"))
    eventually(lambda: received.payloads[-1] == payload("the last"))
    for name in ("other link", "foreign"):
        said = [each for each in received.payloads if name.encode() in each]
        assert said == [payload(f"{name} {number}") for number in range(1500)]
    assert len(received.payloads) == 3001  # those, and the last


@pytest.mark.usefixtures("told")
def test_latched_history_reaches_each_new_subscription(open_node: Callable[..., RosNode], rclpy_node: Node) -> None:
    node = open_node()
    latched = rclpy_node.create_publisher(
        String, "/map", QoSProfile(depth=3, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    )
    for number in range(5):
        latched.publish(String(data=str(number)))
    for _ in range(2):
        received = Received()
        numbers = PublicationNumbers(time.monotonic)
        subscription = node.subscribe(
            strings("/map", Qos(durability="transient_local")), received, "link", numbers=numbers
        )
        eventually(lambda received=received: len(received.payloads) == 3)
        assert [each[8:9] for each in received.payloads] == [b"2", b"3", b"4"]
        assert numbers.counts[Untaken.LOST] == 0
        subscription.close()


def test_own_latched_message_never_reaches_later_subscription(open_node: Callable[..., RosNode]) -> None:
    node, other = open_node(), open_node(name="other")
    node.advertise(strings("/map", PROFILES["latched"]), "link").publish(payload("ours"))
    theirs = Received()
    other.subscribe(strings("/map", PROFILES["latched"]), theirs, "link")
    eventually(lambda: theirs.payloads)
    assert theirs.gids == [each.gid for each in other.publishers("/map")]
    received = Received()
    node.subscribe(strings("/map", PROFILES["latched"]), received, "link")
    other.advertise(strings("/map", PROFILES["latched"]), "link").publish(payload("theirs"))
    eventually(lambda: received.payloads)
    assert received.payloads == [payload("theirs")]


def test_losses_in_dds_are_counted_by_publisher(open_node: Callable[..., RosNode]) -> None:
    node, one, two = open_node(), open_node(name="one"), open_node(name="two")
    received = Received()
    numbers = PublicationNumbers(time.monotonic)
    node.subscribe(strings("/fast", Qos(depth=4)), received, "link", numbers=numbers)
    publishers = [each.advertise(strings("/fast"), "link") for each in (one, two)]
    for publisher in publishers:  # a gap is one only after the first message
        eventually(lambda publisher=publisher: publisher.subscriber_count)
        publisher.publish(payload("first"))
    eventually(lambda: len(received.payloads) == 2)
    received.hold.clear()
    publishers[0].publish(payload("block"))
    assert received.blocked.wait(60)
    for number in range(100):
        for publisher in publishers:
            publisher.publish(payload(str(number)))
    received.hold.set()
    eventually(lambda: received.payloads.count(payload("99")) == 2)
    assert len(received.payloads) == 3 + 4
    assert numbers.counts[Untaken.LOST] == 200 - 4


@pytest.mark.usefixtures("told")
def test_flood_on_one_topic_leaves_turns_to_another(open_node: Callable[..., RosNode]) -> None:
    node, other = open_node(), open_node(name="other")
    order: list[str] = []
    gate = Received()
    gate.hold.clear()
    node.subscribe(strings("/gate"), gate, "link")
    node.subscribe(strings("/flood"), lambda batch: order.extend(["flood"] * len(batch)), "link")
    node.subscribe(strings("/calm"), lambda _: order.append("calm"), "link")
    publishers = {name: other.advertise(strings(name), "link") for name in ("/gate", "/flood", "/calm")}
    for publisher in publishers.values():
        eventually(lambda publisher=publisher: publisher.subscriber_count)
    publishers["/gate"].publish(payload("stop here"))
    assert gate.blocked.wait(60)
    for number in range(2000):
        publishers["/flood"].publish(payload(str(number)))
    publishers["/calm"].publish(payload("me too"))
    gate.hold.set()
    eventually(lambda: len(order) == 2001)
    assert order.index("calm") <= 128


@pytest.mark.usefixtures("told")
def test_keep_all_keeps_all(open_node: Callable[..., RosNode]) -> None:
    node, other = open_node(), open_node(name="other")
    received = Received()
    received.hold.clear()
    numbers = PublicationNumbers(time.monotonic)
    node.subscribe(strings("/all", Qos(history="keep_all")), received, "link", numbers=numbers)
    publisher = other.advertise(strings("/all", Qos(history="keep_all")), "link")
    eventually(lambda: publisher.subscriber_count)
    for number in range(3000):
        publisher.publish(payload(str(number)))
    received.hold.set()
    eventually(lambda: len(received.payloads) == 3000)
    assert received.payloads == [payload(str(number)) for number in range(3000)]
    assert numbers.counts[Untaken.LOST] == 0
    assert max(received.batches) == 64


def test_slow_reader_does_not_hold_up_who_publishes(open_node: Callable[..., RosNode]) -> None:
    """A keep_all publisher of DDS's own kind would block 100 ms for each message past 5000, then refuse it."""
    node, other = open_node(), open_node(name="other")
    received = Received()
    received.hold.clear()
    node.subscribe(strings("/slow", Qos(history="keep_all")), received, "link")
    publisher = other.advertise(strings("/slow", Qos(history="keep_all")), "link")
    eventually(lambda: publisher.subscriber_count)
    publisher.publish(payload("block"))
    assert received.blocked.wait(60)
    started = time.monotonic()
    for number in range(11_000):
        publisher.publish(payload(str(number)))
    assert time.monotonic() - started < 120  # it would be ten minutes
    received.hold.set()


def test_stamps_are_this_machines_clock(open_node: Callable[..., RosNode]) -> None:
    node, other = open_node(), open_node(name="other")
    received = Received()
    node.subscribe(strings("/chat"), received, "link")
    publisher = other.advertise(strings("/chat"), "link")
    eventually(lambda: publisher.subscriber_count)
    before = time.time_ns()
    publisher.publish(payload("now"))
    eventually(lambda: received.stamps)
    assert before <= received.stamps[0] <= time.time_ns()


@pytest.mark.usefixtures("told")
def test_a_closed_subscription_is_silent(open_node: Callable[..., RosNode]) -> None:
    """`close` returns only once a sink that is being called has returned, and frees the endpoint."""
    node, other = open_node(), open_node(name="other")
    received = Received()
    received.hold.clear()
    subscription = node.subscribe(strings("/chat"), received, "link")
    publisher = other.advertise(strings("/chat"), "link")
    eventually(lambda: publisher.subscriber_count)
    publisher.publish(payload("1"))
    assert received.blocked.wait(60)
    closing = threading.Thread(target=subscription.close)
    closing.start()
    closing.join(0.05)
    assert closing.is_alive()
    received.hold.set()
    closing.join(60)
    publisher.publish(payload("2"))
    eventually(lambda: publisher.subscriber_count == 0)
    subscription.close()
    assert received.payloads == [payload("1")]


@pytest.mark.usefixtures("told")
def test_sink_may_close_its_subscription_and_stop_node(open_node: Callable[..., RosNode]) -> None:
    before = set(threading.enumerate())
    node = open_node()
    (thread,) = (each for each in set(threading.enumerate()) - before if each.name == "ros")
    other = open_node(name="other")
    called = []

    def sink(batch: Any) -> None:
        called.append(batch)
        subscription.close()
        node.stop()

    subscription = node.subscribe(strings("/chat"), sink, "link")
    publisher = other.advertise(strings("/chat"), "link")
    eventually(lambda: publisher.subscriber_count)
    publisher.publish(payload("1"))
    eventually(lambda: called and not thread.is_alive())
    assert len(called) == 1


@pytest.mark.usefixtures("told")
def test_sink_may_close_another_subscription_with_messages(open_node: Callable[..., RosNode]) -> None:
    node, other = open_node(), open_node(name="other")
    gate, closed, later = Received(), Received(), Received()
    gate.hold.clear()
    node.subscribe(strings("/gate"), gate, "link")
    node.subscribe(strings("/first"), lambda _: second.close(), "link")
    second = node.subscribe(strings("/second"), closed, "link")
    node.subscribe(strings("/third"), later, "link")
    publishers = [other.advertise(strings(name), "link") for name in ("/gate", "/first", "/second", "/third")]
    for publisher in publishers:
        eventually(lambda publisher=publisher: publisher.subscriber_count)
        publisher.publish(payload("1"))
        assert gate.blocked.wait(60)
    gate.hold.set()
    eventually(lambda: later.payloads)
    assert not closed.payloads


@pytest.mark.usefixtures("start_one")
def test_fifty_nodes_and_endpoints_leave_nothing_behind() -> None:
    before = resources()
    for _ in range(50):
        node = RosNode(ANOTHER, "robot1")
        node.start()
        node.subscribe(strings("/chat"), Received(), "link")
        node.subscribe(strings("/chat"), Received(), "link").close()
        node.advertise(strings("/chat"), "link")
        node.advertise(strings("/chat"), "link").close()
        node.stop()
        node.stop()
    # Fast DDS itself leaves a descriptor for each port in /dev/shm that a killed process has just left.
    eventually(lambda: (now := resources()).threads <= before.threads and now.descriptors < before.descriptors + 50)


@pytest.mark.usefixtures("start_one")
def test_stop_returns_within_second_though_sink_blocks() -> None:
    before = resources().threads
    node, other = KnownNode(ANOTHER, "robot1"), KnownNode(ANOTHER, "other")
    node.start()
    other.start()
    received = Received()
    received.hold.clear()
    node.subscribe(strings("/chat"), received, "link")
    publisher = other.advertise(strings("/chat"), "link")
    eventually(lambda: publisher.subscriber_count)
    publisher.publish(payload("1"))
    assert received.blocked.wait(60)
    started = time.monotonic()
    node.stop()
    assert time.monotonic() - started < 30  # the sink would block for ever
    received.hold.set()
    other.stop()
    eventually(lambda: resources().threads <= before)


def test_newcomers_losses_count_from_its_first_message(
    open_node: Callable[..., RosNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    """For an earlier publisher, nobody knows which messages the subscription should have had."""
    constants.DISCOVERED_WITHIN.set(monkeypatch, -1.0)
    node, other = open_node(), open_node(name="other")
    before = other.advertise(strings("/fast"), "link")
    for _ in range(50):
        before.publish(payload("too early"))
    eventually(lambda: node.publishers("/fast"))
    received = Received()
    numbers = PublicationNumbers(time.monotonic)
    node.subscribe(strings("/fast", Qos(depth=4)), received, "link", numbers=numbers)
    eventually(lambda: before.subscriber_count)
    received.hold.clear()
    before.publish(payload("block"))
    assert received.blocked.wait(60)
    newcomer = other.advertise(strings("/fast"), "link")
    eventually(lambda: newcomer.subscriber_count)
    for number in range(100):
        newcomer.publish(payload(str(number)))
    received.hold.set()
    eventually(lambda: received.payloads[-1] == payload("99"))
    assert len(received.payloads) == 1 + 4
    assert numbers.counts[Untaken.LOST] == 96


def test_what_no_subscription_took_is_counted_by_reason(open_node: Callable[..., RosNode]) -> None:
    node, other = open_node(), open_node(name="other")
    numbers = PublicationNumbers(time.monotonic)
    publisher = other.advertise(strings("/fast"), "link")

    def subscribed_after(count: int, gap: Untaken) -> None:
        """Publish so many messages for nobody, and one that is taken."""
        for _ in range(count):
            publisher.publish(payload("nobody hears it"))
        numbers.gap = gap
        received = Received()
        subscription = node.subscribe(strings("/fast"), received, "link", numbers=numbers)
        eventually(lambda: publisher.subscriber_count)
        publisher.publish(payload("heard"))
        eventually(lambda: received.payloads == [payload("heard")])
        subscription.close()
        eventually(lambda: not publisher.subscriber_count)

    eventually(lambda: node.publishers("/fast"))
    for count, gap in ((7, Untaken.UNSUBSCRIBED), (5, Untaken.MISSED), (3, Untaken.LOST), (2, Untaken.MISSED)):
        subscribed_after(count, gap)
    assert numbers.counts == {Untaken.UNSUBSCRIBED: 7, Untaken.MISSED: 7, Untaken.LOST: 3}


def test_a_history_that_begins_late_is_no_loss(
    open_node: Callable[..., RosNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.DISCOVERED_WITHIN.set(monkeypatch, -1.0)
    node, other = open_node(), open_node(name="other")
    received = Received()
    latched = Qos(durability="transient_local", history="keep_all")
    numbers = PublicationNumbers(time.monotonic)
    node.subscribe(strings("/map", latched), received, "link", numbers=numbers)
    newcomer = other.advertise(strings("/map", Qos(durability="transient_local", depth=2)), "link")
    for number in range(5):
        newcomer.publish(payload(str(number)))
    eventually(lambda: received.payloads[-1:] == [payload("4")])
    assert numbers.counts[Untaken.LOST] == 0


def own(node: RosNode) -> dict[tuple[str, Hashable], set[bytes]]:
    """Return the publishers that the node's own subscriptions take nothing of, by topic and origin."""
    return node._own


def test_nobody_waits_for_a_closed_publisher(open_node: Callable[..., RosNode]) -> None:
    publisher = open_node().advertise(strings("/closed", Qos()), "link")
    publisher.close()
    assert publisher.acknowledged


def test_closed_publishers_are_forgotten_in_time(open_node: Callable[..., RosNode]) -> None:
    node = open_node()
    for number in range(1100):
        node.advertise(strings(f"/closed_{number % 7}", Qos()), "link").close()
    assert sum(map(len, own(node).values())) == 1000


def test_topics_without_subscription_are_forgotten(open_node: Callable[..., RosNode]) -> None:
    node = open_node()
    for number in range(20):
        node.subscribe(strings(f"/gone{number}", Qos()), print, "link").close()
    publisher = node.advertise(strings("/stays", Qos()), "link")
    subscriptions = [node.subscribe(strings("/stays", Qos()), print, "link") for _ in range(2)]
    for each in subscriptions:
        each.close()
    assert dict(own(node)) == {("/stays", "link"): {publisher.gid}}
