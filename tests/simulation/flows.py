"""Topics with a publisher at one end and a subscription at the other, and what was counted at both: the outside truth.

Each message carries which flow it belongs to, which life of the publisher sent it, and its number. So whatever comes
out at the other end can be checked by itself, whatever the bridge says of it.
"""

from __future__ import annotations

import contextvars
import struct
from collections import Counter, OrderedDict
from typing import TYPE_CHECKING, NamedTuple

from tests.simulation.ros import Reader, Writer, hash_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from random import Random

    from tests.simulation.ros import Domain

    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.session import Topic
    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.route.outgoing import OutgoingRoute

_HEAD = struct.Struct("<4sIII")
_CDR = b"\0\1\0\0"
_REMEMBERED = 4096
LATE = 2.5
"""s: a message of this age is late by the default of `late_after`, whatever the clocks' uncertainty."""
CLOCKS = 0.005
"""s that true time and the clocks of stamps may differ by, beside what the engines know of."""
_OF_NOBODY = contextvars.Context()


class Label(NamedTuple):
    """What a message carries.

    Attributes:
        flow: its number.
        life: of its publisher, from 1.
        number: in that life, from 1.
    """

    flow: int
    life: int
    number: int


def label_of(payload: bytes) -> Label | None:
    """The label of a message; None: it is no flow's."""
    if len(payload) < _HEAD.size or payload[:4] != _CDR:
        return None
    return Label(*_HEAD.unpack_from(payload)[1:])


class Account:
    """What a route's sending half did, as seen from outside.

    Attributes:
        offered: messages that it took.
        published: of those, how many the other side's engine has published.
        unreported: how many of these the sender may never learn of, because whoever published them is gone.
        removed: how many of these the sender may hold for lost, because the receiving half was removed.
        forgotten: whether whoever published for it was ever gone.
        last_offered: s, when it took the last one.
    """

    __slots__ = ("forgotten", "last_offered", "offered", "published", "removed", "unreported")

    def __init__(self) -> None:
        self.offered = 0
        self.published = 0
        self.unreported = 0
        self.removed = 0
        self.forgotten = False
        self.last_offered = 0.0

    def forget(self, route: OutgoingRoute, *, removed: bool = False) -> None:
        """Whoever published for that route is gone, and has reported what the route knows.

        Args:
            route: the sending half.
            removed: whether the receiving half was removed, and its process goes on.
        """
        self.forgotten = True
        self.unreported = self.published - route.ledger().delivered
        if removed:
            self.removed = self.unreported


class Flow:
    """One topic that is to be bridged.

    Attributes:
        number: of the flow.
        topic: as the client's session has it.
        robot: the client's name.
        source: where it is published.
        sink: where somebody listens.
        source_topic: its name there.
        sink_topic: its name there.
        qos: what its publisher offers.
        period: s from one message to the next, on average.
        size: bytes of a message, on average.
        life: of the publisher, from 1; 0: there never was one.
        changed: s, when something was last done to its ends.
        sent: by the present publisher.
        troubles: what goes on that may keep it from flowing.
        last_sent: s, when the last message was published.
        last_heard: s, when the last message came out.
        heard: messages that came out.
        oldest: s, the age of the oldest of them when it came out.
        newest: number of the newest message that came out, by life of the publisher.
        fresh_within: s from when a message is published until it comes out at the latest, if it does.
        max_age: s that a message may be old when the other side's engine publishes it, by true time.
        late: messages that came out late, one after the other, as many as there are until now.
        late_since: s, when the first of them came out.
        taken: by which sending half of a route each of the last messages was taken.
    """

    def __init__(
        self,
        number: int,
        topic: Topic,
        robot: str,
        ends: tuple[Domain, Domain],
        names: tuple[str, str],
        *,
        random: Random,
        qos: Qos,
        period: float,
        size: int,
        on_wrong: Callable[[str], None],
    ) -> None:
        self.number = number
        self.topic = topic
        self.robot = robot
        self.source, self.sink = ends
        self.source_topic, self.sink_topic = names
        self.qos = qos
        self.period = period
        self.size = size
        self.type_name = f"flow{number}_msgs/msg/Sample"
        for domain in ends:
            domain.installed[self.type_name] = hash_of(self.type_name)
        self.life = 0
        self.sent = 0
        self.troubles: Counter[str] = Counter()
        self.last_sent = 0.0
        self.last_heard = 0.0
        self.heard = 0
        self.newest: dict[int, int] = {}
        self.fresh_within = float("inf")
        self.max_age = float("inf")
        self.oldest = 0.0
        self.late = 0
        self.late_since = 0.0
        self._published_at: OrderedDict[Label, float] = OrderedDict()
        self.taken: OrderedDict[Label, Account] = OrderedDict()
        self.writer: Writer | None = None
        self.reader: Reader | None = None
        self.changed = 0.0
        self._random = random
        self._loop = self.source.loop
        self._on_wrong = on_wrong
        self._seen: OrderedDict[Label, None] = OrderedDict()

    def __str__(self) -> str:
        way = "→" if self.topic.direction == "transmit" else "←"
        return f"{self.robot} {way} {self.source_topic}"

    @property
    def ordered(self) -> bool:
        """Whether its messages may neither overtake each other nor come twice."""
        return self.topic.protocol != "udp"

    @property
    def latched(self) -> bool:
        """Whether late joiners get what was published last."""
        return self.qos.durability == "transient_local"

    # --- the nodes at its ends

    def appear(self) -> None:
        """A new publisher is there, and publishes."""
        if self.writer is None:
            self.life += 1
            self.sent = 0
            self.changed = self._loop.time()
            self.writer = Writer(
                self.source, f"/app{self.number}", self.source_topic, self.type_name, hash_of(self.type_name), self.qos
            )
            self._loop.call_later(
                0.1 if self.latched else self._random.uniform(0.0, self.period),
                self._beat,
                self.life,
                context=_OF_NOBODY,
            )

    def vanish(self) -> None:
        """The publisher is gone."""
        writer, self.writer = self.writer, None
        if writer is not None:
            writer.close()

    def listen(self) -> None:
        """Somebody subscribes at the other end, anew."""
        self.deafen()
        type_hash = self.sink.installed[self.type_name]
        self.reader = Reader(
            self.sink, f"/ear{self.number}", self.sink_topic, self.type_name, type_hash, self.qos, self._heard
        )

    def deafen(self) -> None:
        """Nobody subscribes any more."""
        reader, self.reader = self.reader, None
        if reader is not None:
            reader.close()
        self.newest.clear()
        self._seen.clear()

    def update_sink(self, version: int) -> None:
        """Another version of the type is installed where the messages come out."""
        self.deafen()
        self.sink.installed[self.type_name] = hash_of(self.type_name, version)
        self.listen()

    def publish(self) -> None:
        """Send one message."""
        if self.writer is not None:
            self.sent += 1
            self.last_sent = self._loop.time()
            self._published_at[Label(self.number, self.life, self.sent)] = self.last_sent
            if len(self._published_at) > _REMEMBERED:
                self._published_at.popitem(last=False)
            padding = self._random.randrange(2 * self.size)
            self.writer.publish(_HEAD.pack(_CDR, self.number, self.life, self.sent) + bytes(padding))

    def made_at(self, payload: bytes) -> float | None:
        """Return when (s) a message was published by its node, or None if that was too long ago to know."""
        label = label_of(payload)
        return None if label is None else self._published_at.get(label)

    def _beat(self, life: int) -> None:
        if self.writer is None or self.life != life:
            return
        self.publish()
        self._loop.call_later(self.period * self._random.uniform(0.5, 1.5), self._beat, life, context=_OF_NOBODY)

    def _heard(self, batch: Sequence[RawMessage]) -> None:
        self.heard += len(batch)
        self.last_heard = self._loop.time()
        for message in batch:
            label = label_of(message.payload)
            if label is None or label.flow != self.number:
                self._on_wrong(f"{self}: a message of something else came out: {message.payload[:24]!r}")
                continue
            if label in self._seen and not self.latched:
                self._on_wrong(f"{self}: {label} came out twice")
            newest = self.newest.get(label.life, 0)
            if self.ordered and not self.latched and label.number <= newest:
                self._on_wrong(f"{self}: {label} came out after {newest}")
            self._check_age(label)
            self.newest[label.life] = max(newest, label.number)
            self._seen[label] = None
            if len(self._seen) > _REMEMBERED:
                self._seen.popitem(last=False)

    def _check_age(self, label: Label) -> None:
        published_at = self._published_at.get(label)
        if published_at is None:
            return
        age = self._loop.time() - published_at
        self.oldest = max(self.oldest, age)
        if age < LATE:
            self.late = 0
            return
        if not self.late:
            self.late_since = self._loop.time()
        self.late += 1
        if age > self.fresh_within:
            self._on_wrong(f"{self}: {label} came out {age:.1f} s after it was published")

    # --- what the bridge does, as the domains at both ends see it

    def took(self, account: Account, batch: Sequence[RawMessage]) -> None:
        """A route's sending half took messages."""
        account.offered += len(batch)
        account.last_offered = self._loop.time()
        for message in batch:
            label = label_of(message.payload)
            if label is not None:
                self.taken[label] = account
        while len(self.taken) > _REMEMBERED:
            self.taken.popitem(last=False)

    def published(self, payload: bytes) -> Account | None:
        """The other side's engine published a message; whose count it belongs to."""
        label = label_of(payload)
        account = self.taken.get(label) if label is not None else None
        if account is not None:
            account.published += 1
        published_at = self._published_at.get(label) if label is not None else None
        if published_at is not None and self._loop.time() - published_at > self.max_age + CLOCKS:
            age = self._loop.time() - published_at
            self._on_wrong(f"{self}: {label} was published when it was {age:.3f} s old, more than {self.max_age:g} s")
        return account
