"""A stand-in for a robot's ROS graph, so that one process can be many robots: `StandIn`, driven by a `Metronome`.

There is no DDS in it. The engine above it is the real one: what the stand-in "publishes" is throttled, sealed and sent
like any other message, and what the link brings is counted.
"""

from __future__ import annotations

import heapq
import itertools
import secrets
import threading
import time
from random import Random
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.cdr.known_types import (
    BATTERY_STATE,
    BATTERY_STATE_HASH,
    STRING,
    STRING_HASH,
    battery_state,
    stamped_string,
)
from rsb_bridge.feature_api import Endpoint, Qos, RawMessage
from rsb_bridge.ros.discovery import Discovery
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import Liveliness

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

    from rsb_bridge.feature_api import TopicSpec
    from rsb_bridge.ros.publication_numbers import PublicationNumbers
    from rsb_bridge.ros.ros_interface import OnFailure, Sink


_GID_LENGTH = 16
_FLOOD_AT_ONCE = 16
"""Messages of a batch of a flood. A round figure below `ros_interface.BATCH`."""
_QOS = Qos()
_HASHES = {STRING: STRING_HASH, BATTERY_STATE: BATTERY_STATE_HASH}
_BATTERY_LASTS, _CHARGED_AT = 900.0, 0.1
"""s from a full battery to the charge at which it is changed for another."""


class Talk(msgspec.Struct, frozen=True):
    """A topic that a node of the stand-in publishes.

    Attributes:
        rate: Hz, or 0 for as fast as the bridge takes them.
        size: bytes of each message, if it is a String.
        type: ``std_msgs/msg/String``, or ``sensor_msgs/msg/BatteryState``.
    """

    topic: str
    rate: float
    size: int
    type: str = STRING


class StandIn(NoRos):
    """A graph of one node that publishes and subscribes; `rsb_bridge.ros.ros_interface.RosInterface`.

    Args:
        hears: topics that it subscribes to.

    Attributes:
        published: messages that the node has published, by topic.
        received: messages that the bridge has published for the node, by topic.
        muted: topics that the node has stopped publishing, though its publisher stays.
    """

    def __init__(self, name: str, talks: Sequence[Talk], hears: Sequence[str] = ()) -> None:
        self.instance_id = secrets.token_hex(4)
        self.node_name = f"_rsb_{name}_{self.instance_id}"
        self.shortfalls: tuple[str, ...] = ()
        self.discovery = Discovery({})
        self.talks = tuple(talks)
        self.published = dict.fromkeys((each.topic for each in talks), 0)
        self.received = dict.fromkeys(hears, 0)
        self.muted: set[str] = set()
        self._node = f"/{name}"
        self._types = dict.fromkeys(hears, STRING) | {each.topic: each.type for each in talks}
        self._began = time.monotonic() - _BATTERY_LASTS * Random(name).random()  # noqa: S311 -- no secret
        self._hears = frozenset(hears)
        self._gids = {each.topic: secrets.token_bytes(_GID_LENGTH) for each in talks}
        self._readers: dict[str, list[_Reader]] = {}

    def publish(self, topic: str, size: int, count: int = 1) -> None:
        """Publish messages at once; always called by the same thread for a topic."""
        if topic in self.muted:
            return
        first = self.published[topic] + 1
        self.published[topic] += count
        readers = self._readers.get(topic, ())
        if readers:
            gid, stamp = self._gids[topic], time.time_ns()
            make = self._battery if self._types[topic] == BATTERY_STATE else stamped_string
            batch = [RawMessage(make(size), stamp, gid, first + each) for each in range(count)]
            # A sink may close its reader, which then leaves the list.
            for reader in tuple(readers):
                reader.receive(batch)

    def _battery(self, _: int) -> bytes:
        """Return the state of a battery that falls; each robot's has begun at another time."""
        used = (time.monotonic() - self._began) % _BATTERY_LASTS / _BATTERY_LASTS
        return battery_state(1.0 - used * (1.0 - _CHARGED_AT))

    # --- the engine's side

    def stop(self) -> None:
        self._readers.clear()

    def topics(self) -> dict[str, list[str]]:
        return {topic: [type_name] for topic, type_name in self._types.items()}

    def publishers(self, topic: str) -> list[Endpoint]:
        return [self._endpoint(topic, self._gids[topic])] if topic in self._gids else []

    def subscriptions(self, topic: str) -> list[Endpoint]:
        return [self._endpoint(topic, b"")] if topic in self._hears else []

    def _endpoint(self, topic: str, gid: bytes) -> Endpoint:
        type_name = self._types[topic]
        return Endpoint(self._node, type_name, _HASHES[type_name], _QOS, gid)

    def installed_hash(self, type_name: str) -> str | None:
        return _HASHES.get(type_name)

    def installed_description(self, type_name: str) -> str | None:
        try:
            from rsb_bridge.ros.native.rosidl_descriptions import installed_description  # noqa: PLC0415 (needs ROS)

            return installed_description(type_name) if type_name in _HASHES else None
        except (ImportError, ValueError):  # a bench without ROS does without
            return None

    def subscribe(
        self,
        spec: TopicSpec,
        sink: Sink,
        origin: Hashable,
        on_failure: OnFailure | None = None,
        numbers: PublicationNumbers | None = None,
        **_: object,
    ) -> _Reader:
        readers = self._readers.setdefault(spec.topic, [])
        reader = _Reader(sink, readers)
        readers.append(reader)
        return reader

    def advertise(self, spec: TopicSpec, origin: Hashable) -> _Writer:
        return _Writer(spec.topic, self.received)


class _Reader:
    """The bridge's subscription to a topic of the stand-in."""

    liveliness = Liveliness(alive=1)
    matched = 1
    refuses = False

    def __init__(self, sink: Sink, among: list[_Reader]) -> None:
        self._sink: Sink | None = sink
        self._among = among

    def receive(self, batch: Sequence[RawMessage]) -> None:
        if (sink := self._sink) is not None:
            sink(batch)

    def close(self) -> None:
        self._sink = None
        if self in self._among:
            self._among.remove(self)


class _Writer:
    """The bridge's publisher in the stand-in."""

    acknowledged = True
    refuses = False

    def __init__(self, topic: str, received: dict[str, int]) -> None:
        self.gid = secrets.token_bytes(_GID_LENGTH)
        self.subscriber_count = int(topic in received)
        self._topic = topic
        self._received = received

    def assert_liveliness(self) -> None:
        """Do nothing: its subscriptions have no lease."""

    def publish(self, payload: bytes) -> None:
        if self.subscriber_count:
            self._received[self._topic] += 1

    def close(self) -> None:
        """Do nothing: the stand-in holds no resources."""


class Metronome:
    """Has stand-ins publish at their rates, on a thread of its own; what is as fast as it can has one each.

    Args:
        random: shifts each topic within its period, so that robots are not in step.
    """

    def __init__(self, random: Random) -> None:
        self._random = random
        self._due: list[tuple[float, int, StandIn, Talk]] = []
        self._numbers = itertools.count()
        self._changed = threading.Condition()
        self._stops = False
        self._threads = [threading.Thread(target=self._run, name="rsb-metronome", daemon=True)]
        self._threads[0].start()

    def add(self, ros: StandIn) -> None:
        """Have one more stand-in publish."""
        for talk in ros.talks:
            if talk.rate:
                due = time.monotonic() + self._random.random() / talk.rate
                with self._changed:
                    # Without numbers, two stand-ins that are due at the same time would be compared.
                    heapq.heappush(self._due, (due, next(self._numbers), ros, talk))
                    self._changed.notify()
            else:
                self.flood(ros, talk)

    def flood(self, ros: StandIn, talk: Talk) -> None:
        """Have a topic published as fast as the bridge takes it."""
        flooding = threading.Thread(target=self._flood, args=(ros, talk), name="rsb-flood", daemon=True)
        self._threads.append(flooding)
        flooding.start()

    def stop(self) -> None:
        """Publish no more."""
        with self._changed:
            self._stops = True
            self._changed.notify()
        for thread in self._threads:
            thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._stops and (not self._due or self._due[0][0] > time.monotonic()):
                    self._changed.wait(self._due[0][0] - time.monotonic() if self._due else None)
                if self._stops:
                    return
                due, number, ros, talk = self._due[0]
                # Where the machine does not keep up, periods are left out instead of made up for.
                again = max(due + 1 / talk.rate, time.monotonic())
                heapq.heapreplace(self._due, (again, number, ros, talk))
            ros.publish(talk.topic, talk.size)

    def _flood(self, ros: StandIn, talk: Talk) -> None:
        while not self._stops:
            ros.publish(talk.topic, talk.size, _FLOOD_AT_ONCE)
            time.sleep(0)  # others may have the GIL, which a loop without waiting keeps for 5 ms a time
