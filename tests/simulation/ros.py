"""A ROS domain without ROS: publishers and subscriptions, as far as a bridge can tell them from DDS's.

What an engine sees of it is in `tests.simulation.node`.

- Endpoints find each other a moment after they are made, and until then messages do not reach.
- A publisher that is transient_local keeps its last `depth` messages for subscriptions that come later.
- A subscription keeps `depth` messages until they are taken; when more come, the oldest are lost.
- Messages are taken in batches, a moment after they came, on the loop instead of a thread.
- The endpoints of a process that was killed are seen for up to 40 s more.
"""

from __future__ import annotations

import contextvars
import itertools
from collections import defaultdict, deque
from typing import TYPE_CHECKING

import msgspec
from tests.simulation.services import Client, Server, Services, Taker

from rsb_bridge.model.qos import Qos, incompatible
from rsb_bridge.ros.publication_numbers import PublicationNumbers
from rsb_bridge.ros.ros_interface import Liveliness, RawMessage

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable
    from random import Random

    from tests.simulation.loop import SimulatedLoop
    from tests.simulation.node import Node

    from rsb_bridge.model.calls import Fields
    from rsb_bridge.ros.ros_interface import OnFailure, Sink

STRING = "std_msgs/msg/String"
_DISCOVERY = (0.001, 0.05)
_TAKING = (0.0001, 0.002)
_LEASE = (10.0, 40.0)
"""s, between which a process that has died is still seen."""
_KEEP_ALL = 5000
_OF_NOBODY = contextvars.Context()


def hash_of(type_name: str, version: int = 0) -> str:
    number = version
    for letter in type_name:
        number = number * 131 + ord(letter)
    return f"RIHS01_{number % (1 << 256):064x}"


class Domain:
    """One ROS domain.

    Attributes:
        taking: s, between which messages wait until they are taken: more where the ROS thread is busy.
        installed: hash by type name, of the types that nodes here were built with.
        written: what makes a message of a type from its fields, for the types that engines here write themselves.
        numbers: whether messages carry their publisher's numbers, which some middleware does not give.
    """

    def __init__(self, loop: SimulatedLoop, random: Random, wall_ns: Callable[[], int]) -> None:
        self.loop = loop
        self.random = random
        self.wall_ns = wall_ns
        self.taking = _TAKING
        self.installed = {STRING: hash_of(STRING)}
        self.written: dict[str, Callable[[Fields], bytes]] = {}
        self.numbers = True
        self._gids = itertools.count(1)
        self._writers: defaultdict[str, list[Writer]] = defaultdict(list)
        self._readers: defaultdict[str, list[Reader]] = defaultdict(list)
        self._watchers: dict[Node, Callable[[], None]] = {}
        self._telling = False
        self.services = Services(self)

    def new_gid(self) -> bytes:
        return next(self._gids).to_bytes(16, "big")

    def topics(self) -> dict[str, set[str]]:
        found: dict[str, set[str]] = {}
        for writer in (each for writers in self._writers.values() for each in writers):
            found.setdefault(writer.topic, set()).add(writer.type_name)
        for reader in (each for readers in self._readers.values() for each in readers):
            found.setdefault(reader.topic, set()).add(reader.type_name)
        return found

    def writers(self, topic: str) -> list[Writer]:
        return self._writers.get(topic, [])

    def readers(self, topic: str) -> list[Reader]:
        return self._readers.get(topic, [])

    def add_writer(self, writer: Writer) -> None:
        self._writers[writer.topic].append(writer)
        self.changed()
        for reader in self.readers(writer.topic):
            self._match_soon(writer, reader)

    def add_reader(self, reader: Reader) -> None:
        self._readers[reader.topic].append(reader)
        self.changed()
        for writer in self.writers(reader.topic):
            self._match_soon(writer, reader)

    def remove_writer(self, writer: Writer) -> None:
        if writer in self.writers(writer.topic):
            self._writers[writer.topic].remove(writer)
            self.changed()

    def remove_reader(self, reader: Reader) -> None:
        if reader in self.readers(reader.topic):
            self._readers[reader.topic].remove(reader)
            self.changed()
            for writer in self.writers(reader.topic):
                writer.matched.pop(reader, None)

    def watch(self, node: Node, on_change: Callable[[], None]) -> None:
        """Call a node when endpoints come or go, once for several changes of a moment."""
        self._watchers[node] = on_change

    def unwatch(self, node: Node) -> None:
        self._watchers.pop(node, None)

    def changed(self) -> None:
        """Call the nodes soon, because the graph has changed."""
        if self._watchers and not self._telling:
            self._telling = True
            self.loop.call_later(self.random.uniform(*_DISCOVERY), self._tell, context=_OF_NOBODY)

    def _tell(self) -> None:
        self._telling = False
        for on_change in tuple(self._watchers.values()):
            on_change()

    def forget_later(self, end: Writer | Reader | Server | Client) -> None:
        """Drop an endpoint whose process has died, once its lease is over."""
        self.loop.call_later(self.random.uniform(*_LEASE), self.forget, end, context=_OF_NOBODY)

    def forget(self, end: Writer | Reader | Server | Client) -> None:
        if isinstance(end, Writer):
            self.remove_writer(end)
        elif isinstance(end, Reader):
            self.remove_reader(end)
        else:
            self.services.remove(end)

    def _match_soon(self, writer: Writer, reader: Reader) -> None:
        if (writer.type_name, writer.type_hash) == (reader.type_name, reader.type_hash):
            self.loop.call_later(self.random.uniform(*_DISCOVERY), self._match, writer, reader, context=_OF_NOBODY)

    def _match(self, writer: Writer, reader: Reader) -> None:
        if writer.closed or reader.closed or incompatible(writer.qos, reader.qos):
            return
        writer.matched[reader] = None
        if reader.qos.durability == "transient_local":
            for sample in writer.kept:
                reader.hear(writer, sample)


class Writer:
    """A publisher of any node's: `rsb_bridge.ros.ros_interface.Publisher`.

    Attributes:
        kept: its messages for subscriptions that come later.
    """

    def __init__(
        self, domain: Domain, node: str, topic: str, type_name: str, type_hash: str, qos: Qos, origin: Hashable = None
    ) -> None:
        self.gid = domain.new_gid()
        self.node = node
        self.topic = topic
        self.type_name = type_name
        self.type_hash = type_hash
        self.qos = qos
        self.seen_qos = msgspec.structs.replace(qos, depth=0)
        self.origin = (node, origin)
        self.matched: dict[Reader, None] = {}
        latched = qos.durability == "transient_local"
        depth = _KEEP_ALL if qos.history == "keep_all" else qos.depth
        self.refuses = False
        self.kept: deque[RawMessage] = deque(maxlen=depth if latched else 0)
        self.published = 0
        self.closed = False
        self.on_publish: Callable[[bytes], None] | None = None
        self._domain = domain
        domain.add_writer(self)

    def assert_liveliness(self) -> None:
        pass

    def publish(self, payload: bytes) -> None:
        if self.closed:
            return
        self.published += 1
        now = self._domain.wall_ns()
        sample = RawMessage(payload, now, self.gid, self.published if self._domain.numbers else 0, source=now)
        self.kept.append(sample)
        if self.on_publish is not None:
            self.on_publish(payload)
        for reader in self.matched:
            if not reader.closed:
                reader.hear(self, sample)

    @property
    def subscriber_count(self) -> int:
        return sum(reader.node != self.node for reader in self.matched)

    @property
    def acknowledged(self) -> bool:
        return True

    def close(self, *, killed: bool = False) -> None:
        if self.closed:
            return
        self.closed = True
        if killed:
            self._domain.forget_later(self)
        else:
            self.matched.clear()
            self._domain.remove_writer(self)


class Reader(Taker[RawMessage]):
    """A subscription of any node's: `rsb_bridge.ros.ros_interface.Subscription`.

    Attributes:
        on_take: told of each batch, before the sink.
    """

    def __init__(
        self,
        domain: Domain,
        node: str,
        topic: str,
        type_name: str,
        type_hash: str,
        qos: Qos,
        sink: Sink,
        origin: Hashable = None,
        on_failure: OnFailure | None = None,
        numbers: PublicationNumbers | None = None,
    ) -> None:
        super().__init__(domain, node, topic, type_name, type_hash, sink, on_failure)
        self.topic = topic
        self.qos = qos
        self.seen_qos = msgspec.structs.replace(qos, depth=0)
        self.numbers = numbers or PublicationNumbers(domain.loop.time)
        latched = qos.durability == "transient_local"
        self.numbers.begin(None if latched else frozenset(each.gid for each in domain.writers(topic)))
        self.matched = 1
        self.refuses = False
        self.liveliness = Liveliness(alive=1)
        self.taken = 0
        self.on_take: Callable[[list[RawMessage]], None] | None = None
        self.origin = (node, origin)
        self._depth = _KEEP_ALL if qos.history == "keep_all" else max(1, qos.depth)
        domain.add_reader(self)

    def hear(self, writer: Writer, sample: RawMessage) -> None:
        if writer.origin == self.origin:
            return
        if len(self._pending) >= self._depth:
            self._pending.popleft()
        self.put(sample)

    def _count(self, batch: list[RawMessage]) -> None:
        """Follow the numbers, as `rsb_bridge.ros.topic_endpoints.Reader` does."""
        numbers, newest = self.numbers, self.numbers.newest
        for message in batch:
            previous = newest.get(message.gid)
            if previous is None:
                previous = numbers.first(message.gid, message.number)
            if message.number > previous + 1:
                numbers.lose(message.number - previous - 1)
            newest[message.gid] = message.number

    def go_on(self) -> None:
        """Take again what has come meanwhile, soon."""
        self.stalled = False
        if self._pending:
            self._drain_soon()

    def _take(self, batch: list[RawMessage]) -> None:
        now = self._domain.wall_ns()  # a process that was frozen receives then what arrived meanwhile
        batch = [each._replace(stamp=now) for each in batch]
        self._count(batch)
        self.taken += len(batch)
        if self.on_take is not None:
            self.on_take(batch)
        self._sink(batch)
