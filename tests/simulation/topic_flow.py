"""Topics of a world: a publisher at the near end, and a listener at the far end.

Each message carries its flow, the run of the publisher that sent it, and its number in that run.
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from typing import TYPE_CHECKING, Any, NamedTuple

from tests.simulation.flow import CDR, Flow, bound
from tests.simulation.ros import Reader, Writer, hash_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.route.sender import Sender

_HEAD = struct.Struct("<4sIII")
LATE = 2.5
"""s: a message of this age is late by the default of `late_after`, for any uncertainty of the clocks."""
CLOCKS = 0.005
"""s by which true time and the stamps' clocks may differ, in addition to the engines' own estimate."""


class Label(NamedTuple):
    flow: int
    life: int
    number: int


def label_of(payload: bytes) -> Label | None:
    if len(payload) < _HEAD.size or payload[:4] != CDR:
        return None
    return Label(*_HEAD.unpack_from(payload)[1:])


class Account:
    """Counts of a route's sending half, from outside.

    Attributes:
        newest: the highest number of each publisher that it took from ROS: all up to it are accounted for.
        offered: messages that it took from ROS for the first time.
        published: how many of these the other side's engine has published.
        unreported: how many of these the sender may never learn of, because their publisher's process is gone.
        removed: how many of these the sender may hold for lost, because the receiving half was removed.
        forgotten: whether the publishing process was ever gone.
    """

    __slots__ = ("forgotten", "last_offered", "newest", "offered", "published", "removed", "unreported")

    def __init__(self) -> None:
        self.offered = 0
        self.newest: dict[bytes, int] = {}
        self.published = 0
        self.unreported = 0
        self.removed = 0
        self.forgotten = False
        self.last_offered = 0.0

    def forget(self, sender: Sender, *, removed: bool = False) -> None:
        """Note that the process that published for that sender is gone; the sender's ledger has its last report.

        Args:
            removed: whether the receiving half was removed, and its process goes on.
        """
        self.forgotten = True
        self.unreported = self.published - sender.facts.ledger.delivered
        if removed:
            self.removed = self.unreported


class TopicFlow(Flow):
    """A topic, with its publisher and its listener.

    Attributes:
        life: number of the present publisher, from 1, or 0 before the first.
        oldest: s, the greatest age of a message on arrival.
        fresh_within: s, the greatest age on arrival that is allowed.
        max_age: s, the greatest age that is allowed when the receiving engine publishes, by true time.
        late: late messages in a row, up to now.
        late_since: s, when the first of these arrived.
        taken: the account of the route that took each of the last messages.
    """

    def __init__(self, *args: Any, qos: Qos, size: int, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.qos = qos
        self.size = size
        self.type_name = f"flow{self.number}_msgs/msg/Sample"
        for domain in (self.near, self.far):
            domain.installed[self.type_name] = hash_of(self.type_name)
        self.life = 0
        self.sent = 0
        self.last_sent = 0.0
        self.last_heard = 0.0
        self.heard = 0
        self.newest: dict[int, int] = {}
        self.fresh_within = float("inf")
        self.max_age = float("inf")
        self.oldest = 0.0
        self.late = 0
        self.late_since = 0.0
        self.taken: OrderedDict[Label, Account] = OrderedDict()
        self.writer: Writer | None = None
        self.reader: Reader | None = None
        self._published_at: OrderedDict[Label, float] = OrderedDict()
        self._seen: OrderedDict[Label, None] = OrderedDict()
        self._openings: OrderedDict[Label, tuple[Account, float]] = OrderedDict()
        """Of the routes that took them: an account, and when (s) the opening began."""
        self._newest_out: dict[int, int] = {}  # of the messages that came out of the bridge

    def __str__(self) -> str:
        way = "→" if self.topic.direction == "transmit" else "←"
        return f"{self.robot} {way} {self.near_name}"

    @property
    def ordered(self) -> bool:
        """Whether its messages may neither overtake each other nor come twice."""
        return self.topic.protocol != "udp" or (self.qos.reliability == "reliable" and not self.topic.arm)

    @property
    def latched(self) -> bool:
        return self.qos.durability == "transient_local"

    # --- the nodes at its ends

    def appear(self) -> None:
        if self.writer is None:
            self.life += 1
            self.sent = 0
            self.changed = self._loop.time()
            self.writer = Writer(
                self.near, f"/app{self.number}", self.near_name, self.type_name, hash_of(self.type_name), self.qos
            )
            first = 0.1 if self.latched else self._random.uniform(0.0, self.period)
            self._later(first, self._beat, self.life)

    def vanish(self) -> None:
        writer, self.writer = self.writer, None
        if writer is not None:
            writer.close()

    def listen(self) -> None:
        self.deafen()
        type_hash = self.far.installed[self.type_name]
        self.reader = Reader(
            self.far, f"/listener{self.number}", self.far_name, self.type_name, type_hash, self.qos, self._heard
        )

    def deafen(self) -> None:
        reader, self.reader = self.reader, None
        if reader is not None:
            reader.close()
        self.newest.clear()
        self._seen.clear()

    def update_listener(self, version: int) -> None:
        self.deafen()
        self.far.installed[self.type_name] = hash_of(self.type_name, version)
        self.listen()

    def publish(self) -> None:
        if self.writer is not None:
            self.sent += 1
            self.last_sent = self._loop.time()
            self._published_at[Label(self.number, self.life, self.sent)] = self.last_sent
            bound(self._published_at)
            padding = self._random.randrange(2 * self.size)
            self.writer.publish(_HEAD.pack(CDR, self.number, self.life, self.sent) + bytes(padding))

    def made_at(self, payload: bytes) -> float | None:
        """Return when (s) a message was published by its node, or None if that was too long ago to know."""
        label = label_of(payload)
        return None if label is None else self._published_at.get(label)

    def _beat(self, life: int) -> None:
        if self.writer is None or self.life != life:
            return
        self.publish()
        self._soon_again(self._beat, life)

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
            bound(self._seen)

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

    def took(self, account: Account, opened_at: float, batch: Sequence[RawMessage]) -> None:
        for message in batch:
            newest = account.newest.get(message.gid, 0)
            account.offered += message.number > newest
            account.newest[message.gid] = max(newest, message.number)
        account.last_offered = self._loop.time()
        for message in batch:
            label = label_of(message.payload)
            if label is not None:
                self.taken[label] = account
                self._openings[label] = account, opened_at
        bound(self.taken)
        bound(self._openings)

    def published(self, payload: bytes) -> Account | None:
        """The other side's engine published a message; whose count it belongs to."""
        label = label_of(payload)
        account = self.taken.get(label) if label is not None else None
        if account is not None:
            account.published += 1
        if label is not None:
            self._check_kept(label)
        published_at = self._published_at.get(label) if label is not None else None
        if published_at is not None and self._loop.time() - published_at > self.max_age + CLOCKS:
            age = self._loop.time() - published_at
            self._on_wrong(f"{self}: {label} was published when it was {age:.3f} s old, more than {self.max_age:g} s")
        return account

    def _check_kept(self, label: Label) -> None:
        """Check that no message before this one is missing that the same opening took and promised to keep."""
        newest = self._newest_out.get(label.life, 0)
        self._newest_out[label.life] = max(newest, label.number)
        if self.topic.kept is None or self.latched:
            return
        opening, kept_since = self._openings.get(label), self._loop.time() - self.topic.kept.seconds
        for number in range(newest + 1, label.number):
            missing = label._replace(number=number)
            taken = opening is not None and self._openings.get(missing) == opening
            if taken and self._published_at.get(missing, 0.0) > kept_since:
                self._on_wrong(f"{self}: {missing} was to be kept, and {label} came out instead")
