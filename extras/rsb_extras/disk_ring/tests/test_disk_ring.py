"""The ring on disk of bridges between two domains: what is in it, and what keeps a stretch."""

from __future__ import annotations

import threading
from functools import partial
from random import Random
from typing import TYPE_CHECKING, Any

import pytest
from tests.engine.arming_helpers import COMMANDS, is_set_up
from tests.support.bridge import carries, halves, happened, reloaded, route
from tests.support.domain import LATCHED, text
from tests.support.inside import inside
from tests.support.participants import KnownNode
from tests.support.waiting import eventually, holds
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.feature_api import Level
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.ros.ros_interface import TopicSpec
from rsb_bridge.route.sender import Sender
from rsb_extras.disk_ring.disk_ring import REASONS
from rsb_extras.disk_ring.keep_stretch import KeepStretch
from rsb_extras.disk_ring.ring_codes import RingCode, RingProblem
from rsb_extras.disk_ring.tests.ring_bed import metadata, texts, written_so_far
from rsb_extras.disk_ring.tests.ring_places import LOOKS_EVERY
from rsb_extras.recording import RecordLimits
from rsb_extras.recording.keep_last import KeepLast
from rsb_extras.recording.tests.recordings import read

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.consoles import Consoles
    from tests.support.domain import Domain
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine

ON = {"record": RecordLimits(disk=1.0, free=0.0, after=0.0)}


def wait_for(folder: Path, reason: str) -> Path:
    """Wait until a stretch is whole, and return its folder."""
    return eventually(lambda: next(iter(folder.glob(f"*-{reason}")), None))


def ring(folder: Path) -> list[Path]:
    return sorted(folder.parent.glob("ring/*/*.mcap"))


def in_ring(folder: Path, words: bytes) -> bool:
    """Whether a message with these words is on the disk."""
    return any(words in written_so_far(each) for each in ring(folder))


def test_note_keeps_what_passed(bridge: Bridge, robot: Domain, pc: Domain, folder: Path) -> None:
    pc.listener("/chat")
    chat = robot.publisher("/chat")
    server = bridge.server()
    client = bridge.client(Topic("/chat", "transmit"), features=ON)
    carries([chat], server, ["/chat"])
    sent = [f"message {number}" for number in range(20)]
    for each in sent:
        chat.publish(text(each))
    eventually(lambda: client.do(KeepLast(None)).result(60).messages == 20)  # all have passed
    answer = client.do(KeepStretch("it fell")).result(60)
    stretch = wait_for(folder, "note")
    assert answer.path == str(stretch)
    assert texts(stretch) == sent, "in memory and on disk"
    custom = metadata(stretch)["custom_data"]
    assert (custom["cause"], custom["note"]) == ("note", "it fell")
    eventually(lambda: happened(client, RingCode.KEPT))


def test_lost_link_keeps_a_stretch(bridge: Bridge, robot: Domain, pc: Domain, relay: Relay, folder: Path) -> None:
    chat = robot.publisher("/chat")
    pc.listener("/chat")
    server = bridge.server()
    client = bridge.client(Topic("/chat", "transmit"), features=ON)
    carries([chat], server, ["/chat"])
    chat.publish(text("the last word"))

    def has_passed() -> bool:
        try:
            return client.do(KeepLast(None)).result(60).messages == 1
        except EngineError:  # not yet
            return False

    eventually(has_passed)
    relay.refuse()
    relay.cut()
    stretch = wait_for(folder, "link")
    assert texts(stretch) == ["the last word"]
    assert metadata(stretch)["custom_data"]["subject"] == "robot1"


def by_operator(server: Engine) -> None:
    server.disarm(route(server, "/cmd").key).result(30)


def by_pause(server: Engine) -> None:
    server.pause(route(server, "/cmd").key, paused=True).result(30)


@pytest.mark.usefixtures("long_lease")
@pytest.mark.parametrize("disarm", [by_operator, by_pause])
def test_a_disarm_keeps_a_stretch_on_both_sides(
    disarm: Callable[[Engine], None], bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles, folder: Path
) -> None:
    """Of a topic that was armed: what moved the robot until then is in it, and nothing that came later."""
    motors, joystick = robot.listener("/cmd"), pc.publisher("/cmd")
    server, client = bridge.both(COMMANDS, features={"record": ON["record"]})
    eventually(lambda: is_set_up(server, client))
    holds(lambda: not [*folder.glob("*")], 0.5)
    consoles.arm(server)
    eventually(lambda: joystick.publish(text("go")) or "go" in motors.texts(100))
    disarm(server)
    joystick.publish(text("too late"))
    eventually(lambda: len([*folder.glob("*-disarm*")]) == 2)
    for each in folder.glob("*-disarm*"):
        assert set(texts(each, "/cmd")) == {"go"}
        custom = metadata(each)["custom_data"]
        assert (custom["cause"], custom["subject"]) == ("disarm", "/cmd")
        assert "disarmed" in custom["text"]


@pytest.mark.parametrize("code", map(EventCode, REASONS))
def test_events_keep_stretches(code: EventCode, bridge: Bridge, robot: Domain, folder: Path) -> None:
    client = bridge.client(
        Topic("/chat", "transmit"), features={"record": RecordLimits(disk=1.0, free=0.0, after=0.0, also=("/alone",))}
    )
    alone = robot.publisher("/alone")
    eventually(alone.get_subscription_count)
    alone.publish(text("word"))
    eventually(lambda: ring(folder))
    inside(client).context.events.add(Level.WARNING, code, "what happened", topic="/chat")
    stretch = wait_for(folder, REASONS[code])
    assert metadata(stretch)["custom_data"]["text"] == "what happened"


def test_no_publisher_pushes_out_another_of_a_latched_topic(bridge: Bridge, robot: Domain, folder: Path) -> None:
    """Neither in memory nor on disk, however much the other one publishes."""
    bridge.server()
    quiet, busy = (robot.publisher("/tf_static", qos=LATCHED) for _ in range(2))
    quiet.publish(text("quiet"))
    limits = RecordLimits(seconds=1.0, disk=0.04, free=0.0, after=0.0)
    client = bridge.client(Topic("/tf_static", "transmit"), features={"record": limits})
    chance = Random(1)

    def goes_on() -> bool:
        busy.publish(text(chance.randbytes(20_000).hex()))
        return len(ring(folder)) > 2  # each of more than a megabyte

    eventually(goes_on, what="three files")
    for file in ring(folder)[:-1]:
        assert texts(file, "/tf_static")[0] == "quiet"
    kept = partial(client.do, KeepLast(None))
    # Of older messages, 64 KiB stay.
    eventually(lambda: kept().result(60).messages <= 3, what="all is older than 1 s")
    assert [len(each.message.data) for each in read(kept().result(60).path)] == [len("quiet"), 40_000, 40_000]


def test_others_topics_are_in_it_if_the_session_says_so(bridge: Bridge, robot: Domain, folder: Path) -> None:
    limits = RecordLimits(disk=1.0, free=0.0, after=0.0, also=("/arm/**", "/left"))
    client = bridge.client(Topic("/chat", "transmit"), features={"record": limits})
    latched = robot.publisher("/arm/model", qos=LATCHED)
    latched.publish(text("model"))
    others = {name: robot.publisher(name) for name in ("/arm/joints", "/left", "/right")}
    eventually(lambda: all(others[name].get_subscription_count() for name in ("/arm/joints", "/left")))
    for name, publisher in others.items():
        publisher.publish(text(name))
    eventually(lambda: in_ring(folder, b"/arm/joints") and in_ring(folder, b"/left"))
    client.do(KeepStretch()).result(60)
    found = {(each.topic, each.message.data) for each in read_all(wait_for(folder, "note"))}
    assert found == {("/arm/model", "model"), ("/arm/joints", "/arm/joints"), ("/left", "/left")}
    assert not others["/right"].get_subscription_count()


def test_bridged_topics_are_in_it_also_without_a_link(
    bridge: Bridge, robot: Domain, pc: Domain, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    LOOKS_EVERY.set(monkeypatch, 1000.0)  # a link that comes or goes is seen at once: nothing is in it twice
    limits = RecordLimits(disk=1.0, free=0.0, after=0.0, also=("/chat",))
    pc.listener("/chat")
    chat = robot.publisher("/chat")
    server = bridge.server()
    bridge.client(Topic("/chat", "transmit"), features={"record": limits})
    carries([chat], server, ["/chat"])
    eventually(lambda: chat.get_subscription_count() == 1, what="the route's alone")
    server.stop()

    def is_recorded() -> bool:
        chat.publish(text("nobody hears it"))
        return in_ring(folder, b"nobody hears it")

    eventually(is_recorded)
    carries([chat], bridge.server(), ["/chat"])
    eventually(lambda: chat.get_subscription_count() == 1, what="the route's alone")


def read_all(stretch: Path) -> list[Any]:
    return [each for path in sorted(stretch.glob("*.mcap")) for each in read(path)]


def test_type_that_nobody_describes_is_in_it(bridge: Bridge, folder: Path) -> None:
    robot, pc = KnownNode(bridge.robot.id, "sends"), KnownNode(bridge.pc.id, "hears")
    for node in (robot, pc):
        node.start()
    try:
        spec = TopicSpec("/blob", "made_up_msgs/msg/Blob", f"RIHS01_{'5a' * 32}", Qos(depth=20))
        publisher, received = robot.advertise(spec, "robot"), list[bytes]()
        pc.subscribe(spec, lambda batch: received.extend(each.payload for each in batch), "pc")
        bridge.server()
        client = bridge.client(Topic("/blob", "transmit"), features=ON)

        def is_heard() -> bool:
            publisher.publish(b"\0\1\0\0\7")
            return bool(received)

        eventually(is_heard)
        eventually(lambda: in_ring(folder, b"\0\1\0\0\7"))
        client.do(KeepStretch()).result(60)
        (topic,) = metadata(wait_for(folder, "note"))["topics_with_message_count"]
        assert topic["topic_metadata"]["type"] == spec.type_name
    finally:
        for node in (robot, pc):
            node.stop()


def threads() -> int:
    return sum(each.name == "rsb-ring" for each in threading.enumerate())


def test_reload_switches_it(bridge: Bridge, robot: Domain, pc: Domain, folder: Path, tmp_path: Path) -> None:
    pc.listener("/chat")
    chat = robot.publisher("/chat")
    server = bridge.server()
    client = bridge.client(Topic("/chat", "transmit"))
    carries([chat], server, ["/chat"])
    assert not threads()
    with pytest.raises(EngineError, match=pattern(RingProblem.OFF)):
        client.do(KeepStretch()).result(60)
    for number, seconds in enumerate((0.0, 100.0)):
        limits = RecordLimits(disk=1.0, free=0.0, after=0.0, disk_seconds=seconds)
        reloaded(client, tmp_path / "client.yaml", features={"record": limits})
        chat.publish(text(f"word {number}"))
        eventually(lambda number=number: in_ring(folder, f"word {number}".encode()))
    reloaded(client, tmp_path / "client.yaml", features={})
    eventually(lambda: not threads())
    assert [each for path in ring(folder) for each in texts(path)] == ["word 0", "word 1"]
    (sender,) = halves(client, Sender)
    assert not sender.flow.peek_slot.wanted
