"""An image and its camera_info at a limited rate: by a common beat, or by one pattern, each pair crosses whole."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String
from tests.support.bridge import carries, outgoing, route, settled
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from rclpy.publisher import Publisher
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain, Listener

RATE = 50.0
PAIRS = 150
EVERY = 0.004  # s


def stamps_of(listener: Listener) -> list[int]:
    stamps = (deserialize_message(each, listener._kind).header.stamp for each in listener.payloads)
    return [each.sec * 10**9 + each.nanosec for each in stamps]


def publish(number: int, *publishers: Publisher) -> None:
    """Publish one message of each, with one stamp."""
    for publisher in publishers:
        message = publisher.msg_type()
        message.header.stamp.sec, message.header.stamp.nanosec = 1_700_000_000 + number // 250, number % 250 * 4_000_000
        publisher.publish(message)


@pytest.mark.parametrize(
    "topics",
    [
        (
            Topic("/camera/image", "transmit", max_rate=RATE, beat="camera"),
            Topic("/camera/camera_info", "transmit", max_rate=RATE, beat="camera"),
        ),
        (Topic("/camera/*", "transmit", max_rate=RATE),),
    ],
    ids=["entries", "pattern"],
)
def test_pairs_cross_whole_though_one_begins_later(
    topics: tuple[Topic, ...], bridge: Bridge, robot: Domain, pc: Domain
) -> None:
    images, infos = pc.listener("/camera/image", Image), pc.listener("/camera/camera_info", CameraInfo)
    image, info = robot.publisher("/camera/image", Image), robot.publisher("/camera/camera_info", CameraInfo)
    server, client = bridge.both(*topics)
    carries([image, info], server, ["/camera/image", "/camera/camera_info"])
    first = 40
    for number in range(first):
        publish(number, image)
        time.sleep(EVERY)
    number = first
    while outgoing(client, "/camera/camera_info").facts.ledger.delivered < PAIRS:
        publish(number, *((image, info) if number % 2 else (info, image)))
        number += 1
        time.sleep(EVERY)
    for topic in ("/camera/image", "/camera/camera_info"):
        settled(client, topic, number if topic == "/camera/image" else number - first)
        assert route(client, topic).ledger.throttled > 0
    since = 1_700_000_000 * 10**9 + first * 4_000_000
    eventually(lambda: [each for each in stamps_of(images) if each >= since] == stamps_of(infos))
    assert len(stamps_of(infos)) >= PAIRS


def test_type_without_stamp_goes_by_its_own_limit(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    topics = [Topic(each, "transmit", max_rate=RATE, beat="words") for each in ("/one", "/two", "/three")]
    listeners = [pc.listener(each.topic) for each in topics]
    publishers = [robot.publisher(each.topic) for each in topics]
    server, _ = bridge.both(*topics)
    carries(publishers, server, ["/one", "/two", "/three"])
    deadline = time.monotonic() + 60
    while not all(len(each.payloads) > 3 for each in listeners):  # the same words: neither follows the other
        assert time.monotonic() < deadline
        for publisher in publishers:
            publisher.publish(String(data="same words"))
        time.sleep(EVERY)
