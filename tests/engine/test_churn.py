"""Routes are paused, edited and removed while two threads send, and threads change at nearly every bytecode."""

from __future__ import annotations

import threading
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from tests.engine.churn_helpers import Publisher, Subscription
from tests.support import constants
from tests.support.bridge import happened
from tests.support.ports import free_port
from tests.support.waiting import eventually

from rsb_bridge.config.keys import write_key
from rsb_bridge.engine import Engine
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Client, Session, Topic
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import Endpoint, RawMessage, TopicSpec

_TYPE, _HASH, _GID = "std_msgs/msg/String", "RIHS01_" + "1" * 64, b"talker".ljust(16, b"\0")
_TOPICS = [f"/churn{number}" for number in range(4)]
_WITHIN = 180.0


class Ros(NoRos):
    """Has a talker on each topic, or a listener; what the bridge announces goes nowhere."""

    def __init__(self, instance_id: str, *, talks: bool) -> None:
        self.instance_id, self.node_name = instance_id, f"rsb_churn_{instance_id}"
        self.subscriptions_now: dict[str, Subscription] = {}
        self.taken: defaultdict[str, list[bytes]] = defaultdict(list)
        self._talks = talks
        self._made = 0

    def publishers(self, topic: str) -> list[Endpoint]:
        return [Endpoint("/talker", _TYPE, _HASH, Qos(), _GID)] if self._talks and topic in _TOPICS else []

    def subscribe(self, spec: TopicSpec, sink: Any, *_: Any, **__: Any) -> Any:
        made = Subscription(sink)
        if spec.topic in _TOPICS:
            self.subscriptions_now[spec.topic] = made
        return made

    def advertise(self, spec: TopicSpec, *_: Any) -> Any:
        self._made += 1
        return Publisher(b"%016d" % self._made, self.taken[spec.topic])


def talk(ros: Ros, topic: str, ends: threading.Event) -> None:
    number = 0
    while not ends.wait(0.001):
        subscription = ros.subscriptions_now[topic]
        with subscription.delivering:
            if subscription.closed:
                continue
            batch = []
            for _ in range(5):
                number += 1
                size = 400_000 if number % 500 == 0 else 100
                batch.append(RawMessage(number.to_bytes(8, "little") + bytes(size), number, _GID, number))
            subscription.sink(batch)


@pytest.mark.usefixtures("threads_change_often")
def test_no_message_is_reordered_doubled_or_uncounted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.EPOCH_BITS.set(monkeypatch, 8)  # new keys all the time
    write_key(tmp_path / "k.key")
    common: dict[str, Any] = {"server_ip": "127.0.0.1", "server_port": free_port(), "shutdown_topic": None}
    topics = [
        Topic(topic, "transmit", protocol="tcp" if number % 2 else "udp", qos=5000)
        for number, topic in enumerate(_TOPICS)
    ]
    here, there = Ros("00000001", talks=True), Ros("00000002", talks=False)
    server_session = Session(name="pc", role="server", domain_id=1, clients=(Client("robot", "k.key"),), **common)
    client_session = Session(
        name="robot", role="client", domain_id=2, key_file="k.key", topics=tuple(topics), **common
    )  # fmt: skip
    server = Engine(server_session, base=tmp_path, ros=there)
    client = Engine(client_session, base=tmp_path, ros=here)
    ends = threading.Event()
    threads = [threading.Thread(target=talk, args=(here, topic, ends)) for topic in _TOPICS]
    try:
        server.start()
        client.start()
        eventually(lambda: len(here.subscriptions_now) == len(_TOPICS), _WITHIN)
        for thread in threads:
            thread.start()
        for turn in range(24):
            topic = topics[turn % 4]
            (key,) = [route.key for route in client.snapshot().routes if route.topic == topic.topic]
            match turn % 3:
                case 0:
                    client.pause(key, True).result(_WITHIN)
                    client.pause(key, False).result(_WITHIN)
                case 1:
                    client.remove_topic(key).result(_WITHIN)
                    client.add_topic(topic).result(_WITHIN)
                case _:
                    other: Any = "udp" if turn % 2 else "tcp"
                    client.edit_topic(key, Topic(topic.topic, "transmit", protocol=other, qos=5000)).result(_WITHIN)
            before = len(there.taken[topic.topic])
            eventually(lambda: len(there.taken[topic.topic]) > before, _WITHIN, what="it flows again")  # noqa: B023
        ends.set()
        for thread in threads:
            thread.join(_WITHIN)
        eventually(lambda: not any(route.ledger.open for route in client.snapshot().routes), _WITHIN)
        for topic_name in _TOPICS:
            numbers = [int.from_bytes(payload[:8], "little") for payload in there.taken[topic_name]]
            assert numbers == sorted(set(numbers)), topic_name
        for route in client.snapshot().routes:
            ledger = route.ledger
            parts = ledger.delivered + ledger.throttled + ledger.expired + ledger.open + ledger.dropped_total
            assert ledger.offered == parts, ledger
        assert not any(happened(each, EventCode.ENGINE_ERROR) for each in (server, client))
    finally:
        ends.set()
        client.stop()
        server.stop()
