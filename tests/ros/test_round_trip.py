"""Messages of every common type, and of types that nobody here has, cross unchanged."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from rclpy.serialization import deserialize_message, serialize_message
from tests.ros.domains import DOMAIN
from tests.support import replaced
from tests.support.filled import filled
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.model.qos import Qos
from rsb_bridge.model.type_names import SHORT_NAMES, TypeNameProblem
from rsb_bridge.ros import raw_types, self_test
from rsb_bridge.ros.distribution import package_of
from rsb_bridge.ros.native import named_types, typesupport
from rsb_bridge.ros.native.typesupport import hash_of, installed_class
from rsb_bridge.ros.raw_types import UnusableType
from rsb_bridge.ros.ros_interface import RosError, RosProblem, TopicSpec
from rsb_bridge.ros.self_test import Shortfall

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rclpy.node import Node

    from rsb_bridge.model.wording import Wording
    from rsb_bridge.ros.node import RosNode

INSTALLED: dict[str, Any] = {name: found for name in SHORT_NAMES.values() if (found := installed_class(name))}
ODOMETRY = "nav_msgs/msg/Odometry"
MADE_UP_HASH = "RIHS01_" + "5a" * 32
STRING = "std_msgs/msg/String"
STRING_HASH = hash_of(INSTALLED[STRING])


def install(package: str) -> str:
    return UnusableType.REMEDY(package=package)


def test_every_common_type_crosses_both_ways(open_node: Callable[..., RosNode], rclpy_node: Node) -> None:
    ours = open_node()
    raw: dict[str, list[bytes]] = {name: [] for name in INSTALLED}
    crossed: dict[str, list[Any]] = {name: [] for name in INSTALLED}
    sources, targets, outgoing = {}, {}, {}
    for number, (name, message_class) in enumerate(INSTALLED.items()):
        sources[name] = rclpy_node.create_publisher(message_class, f"/in{number}", 10)
        targets[name] = rclpy_node.create_subscription(message_class, f"/out{number}", lambda _: None, 10)
        outgoing[name] = ours.advertise(TopicSpec(f"/out{number}", name, hash_of(message_class), Qos()), "link")

        def bridge(batch: Any, name: str = name) -> None:
            for taken in batch:
                raw[name].append(taken.payload)
                outgoing[name].publish(taken.payload)

        ours.subscribe(TopicSpec(f"/in{number}", name, hash_of(message_class), Qos()), bridge, "link")
    eventually(lambda: all(each.get_subscription_count() for each in sources.values()))
    eventually(lambda: all(each.subscriber_count for each in outgoing.values()))
    messages = {name: [message_class(), filled(message_class)] for name, message_class in INSTALLED.items()}
    payloads = {name: [serialize_message(message) for message in each] for name, each in messages.items()}
    for name, source in sources.items():
        for message in (*messages[name], *payloads[name]):
            source.publish(message)

    def all_crossed() -> bool:
        for name, target in targets.items():
            while taken := target.handle.take_message(INSTALLED[name], False):
                crossed[name].append(taken[0])
        return all(len(each) == 4 for each in crossed.values())

    eventually(all_crossed)
    assert len(INSTALLED) > 100
    # Only messages published as bytes are compared as bytes, because serializing leaves the padding undefined.
    assert {name: each[2:] for name, each in raw.items()} == payloads
    assert crossed == {name: each * 2 for name, each in messages.items()}


@pytest.mark.parametrize(
    ("type_name", "payload"),
    [
        ("tf2_msgs/msg/TFMessage", b"\x00\x01\x00\x00" + bytes(4)),
        ("made_up_msgs/msg/Blob", b"\x00\x01\x00\x00" + bytes(range(256)) * 400),
        ("made_up_msgs/action/Go_FeedbackMessage", b"\x00\x01\x00\x00" + bytes(17)),
    ],
    ids=["tf", "large", "action"],
)
def test_a_type_that_is_installed_nowhere_crosses(
    type_name: str, payload: bytes, open_node: Callable[..., RosNode]
) -> None:
    one, other = open_node(), open_node(name="other")
    received: dict[RosNode, list[bytes]] = {one: [], other: []}
    for near, far in ((one, other), (other, one)):

        def sink(batch: Any, node: RosNode = far) -> None:
            received[node].extend(taken.payload for taken in batch)

        far.subscribe(TopicSpec("/blob", type_name, MADE_UP_HASH, Qos()), sink, "link")
        publisher = near.advertise(TopicSpec("/blob", type_name, MADE_UP_HASH, Qos()), "link")
        eventually(lambda publisher=publisher: publisher.subscriber_count)
        publisher.publish(payload)
        eventually(lambda far=far: received[far])
    assert received == {one: [payload], other: [payload]}
    announced = one.publishers("/blob")
    assert [(each.type_name, each.type_hash) for each in announced] == [(type_name, MADE_UP_HASH)]


@pytest.fixture
def stock_relay() -> Iterator[None]:
    """Another process, stock rclpy: what it takes on /odom_in it says again on /odom_out."""
    with subprocess.Popen([sys.executable, str(Path(__file__).with_name("stock_relay.py")), str(DOMAIN)]) as process:
        yield
        process.terminate()
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()


@pytest.mark.usefixtures("stock_relay")
def test_bare_name_and_hash_match_real_type(open_node: Callable[..., RosNode], monkeypatch: pytest.MonkeyPatch) -> None:
    """The type is hidden from us, not from the other process; nav_msgs takes the part of a package that we lack."""
    odometry = INSTALLED[ODOMETRY]
    found = installed_class
    replaced.INSTALLED_CLASS.set(monkeypatch, lambda name: None if name == ODOMETRY else found(name))
    node = open_node()
    received: list[bytes] = []
    heard = TopicSpec("/odom_out", ODOMETRY, hash_of(odometry), Qos())
    node.subscribe(heard, lambda batch: received.extend(t.payload for t in batch), "link")
    publisher = node.advertise(heard._replace(topic="/odom_in"), "link")
    eventually(lambda: publisher.subscriber_count and node.publishers("/odom_out"))
    assert node.publishers("/odom_out")[0].type_hash == hash_of(odometry)
    messages = [odometry(), filled(odometry)]
    for message in messages:

        def crosses(message: Any = message) -> bool:
            publisher.publish(serialize_message(message))
            return any(deserialize_message(payload, odometry) == message for payload in received)

        eventually(crosses)  # the relay says nothing to a subscription that it does not know yet
    assert all(deserialize_message(payload, odometry) in messages for payload in received)


def test_made_type_is_asked_by_creating_thread_only(
    open_node: Callable[..., RosNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A Python callback on a thread of DDS's would fight it for the GIL."""
    asked_by = []

    def recording(prototype: Any) -> Callable[[Any], Any]:
        def wrap(function: Any) -> Any:
            if not callable(function):  # an address of the middleware's
                return prototype(function)

            def recorded(*arguments: Any) -> Any:
                asked_by.append(threading.get_ident())
                return function(*arguments)

            return prototype(recorded)

        return wrap

    replaced.FIND_TYPE.set(monkeypatch, recording(typesupport.FIND))
    replaced.GET_TYPE_HASH.set(monkeypatch, recording(typesupport.GET_HASH))
    replaced.NAMED_TYPES.set(monkeypatch, named_types.NamedTypes())
    one, other = open_node(), open_node(name="other")
    received: list[Any] = []
    one.subscribe(TopicSpec("/asked", "asked_msgs/msg/A", MADE_UP_HASH, Qos()), received.extend, "link")
    publisher = other.advertise(TopicSpec("/asked", "asked_msgs/msg/A", MADE_UP_HASH, Qos()), "link")
    eventually(lambda: publisher.subscriber_count)
    publisher.publish(bytes(8))
    eventually(lambda: received)
    publisher.close()
    one.stop()
    assert set(asked_by) == {threading.get_ident()}


def test_months_of_reconnects_with_other_types_make_none(
    open_node: Callable[..., RosNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each connection brings types that were never seen before; all that they leave is used again, and works."""
    types = named_types.NamedTypes()
    replaced.NAMED_TYPES.set(monkeypatch, types)
    here, there = open_node(), open_node(name="other")
    for connection in range(5):
        received: list[Any] = []
        names = [f"made_up_msgs/msg/C{connection}N{number}" for number in range(3)]
        specs = [TopicSpec(f"/t{number}", name, MADE_UP_HASH, Qos()) for number, name in enumerate(names)]
        ends: list[Any] = [here.advertise(each, "link") for each in specs]
        shared = specs[0]._replace(topic="/shares")
        shares = here.advertise(shared, "link")
        listens = there.subscribe(shared, received.extend, "link")
        eventually(lambda shares=shares: shares.subscriber_count)
        shares.publish(bytes(8))
        eventually(lambda received=received: received)
        assert types.used == len(names)
        for end in (*ends, *ends, shares, listens):
            end.close()
        eventually(lambda: not types.used)
    assert types.made == len(names)


def test_endpoint_that_cannot_be_made_keeps_no_type(
    open_node: Callable[..., RosNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    types = named_types.NamedTypes()
    replaced.NAMED_TYPES.set(monkeypatch, types)
    with pytest.raises(RosError, match=pattern(RosProblem.INVALID_NAME, name="/no topic")):
        open_node().advertise(TopicSpec("/no topic", "made_up_msgs/msg/A", MADE_UP_HASH, Qos()), "link")
    assert types.used == 0


@pytest.mark.parametrize(
    ("type_name", "type_hash", "code", "parameters"),
    [
        ("no_such_msgs/msg/Name", "", UnusableType.HASH_UNKNOWN, {"remedy": install(package_of("no_such_msgs"))}),
        ("no_such_msgs/msg/Name", "RIHS01_12", UnusableType.INVALID_HASH, {"type_hash": "RIHS01_12"}),
        ("nonsense", MADE_UP_HASH, TypeNameProblem.INVALID, {"name": "nonsense"}),
        (STRING, MADE_UP_HASH, UnusableType.ANOTHER_VERSION, {"here": STRING_HASH, "there": MADE_UP_HASH}),
    ],
)
def test_types_that_will_not_do(type_name: str, type_hash: str, code: Wording, parameters: dict[str, str]) -> None:
    with pytest.raises(RosError, match=pattern(code, **parameters)):
        raw_types.borrow_type(type_name, type_hash)


def test_another_middleware_needs_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for its name: no other middleware comes as a wheel."""
    name = "rmw_zenoh_cpp"
    replaced.MIDDLEWARE.set(monkeypatch, lambda: name)
    found = self_test.test()
    replaced.FINDINGS.set(monkeypatch, lambda: found)
    assert found.no_messages == Shortfall.ANOTHER_MIDDLEWARE(middleware=name)
    assert found.no_calls == Shortfall.NO_CALLS(middleware=name)
    needed = pattern(
        UnusableType.NOT_CARRIED, type_name="other_msgs/msg/Name", remedy=install(package_of("other_msgs"))
    )
    with pytest.raises(RosError, match=needed):
        raw_types.borrow_type("other_msgs/msg/Name", MADE_UP_HASH)
