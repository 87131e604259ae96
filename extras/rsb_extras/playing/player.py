"""The player: publishes the messages of a recording when they are due."""

from __future__ import annotations

import struct
import time
from collections import Counter, deque
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.cdr.description import (
    NESTED,
    FieldType,
    MessageField,
    MessageType,
    TypeDescription,
    hash_of_text,
    text_of,
)
from rsb_bridge.feature_api import Qos, RosError, TopicSpec
from rsb_extras.playing.latched_room import LatchedRoom
from rsb_extras.playing.played_topics import CLOCK
from rsb_extras.playing.read_ahead import ReadAhead
from rsb_extras.recording.reading.stored_message import RecordingError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rsb_bridge.feature_api import Publisher
    from rsb_bridge.ros.node import RosNode
    from rsb_extras.playing.play_keys import PlayKeys
    from rsb_extras.playing.played_topics import PlayedPublishers
    from rsb_extras.recording.reading.open_recording import OpenRecording
    from rsb_extras.recording.reading.stored_message import StoredMessage

SECOND = 1_000_000_000
_LOOK_EVERY = 0.05  # s between two looks at the keys, while messages are always due
_TOLD_EVERY = 0.25  # s between two lines of state
_LATENESSES = 100_000  # the last ones, of which percentiles are told
_ACKNOWLEDGED_WITHIN = 10.0  # s. A round figure: on one machine 1 ms, for large messages on a busy one some s
_CLOCK_TYPE, _TIME_TYPE = "rosgraph_msgs/msg/Clock", "builtin_interfaces/msg/Time"
_INT32, _UINT32 = 6, 7
_CLOCK_DESCRIPTION = TypeDescription(
    MessageType(_CLOCK_TYPE, (MessageField("clock", FieldType(NESTED, 0, 0, _TIME_TYPE)),)),
    (
        MessageType(
            _TIME_TYPE,
            (
                MessageField("sec", FieldType(_INT32, 0, 0, "")),
                MessageField("nanosec", FieldType(_UINT32, 0, 0, "")),
            ),
        ),
    ),
)


def clock_message(time_ns: int) -> bytes:
    """Return a serialized rosgraph_msgs/msg/Clock."""
    seconds, rest = divmod(time_ns, SECOND)
    return b"\0\1\0\0" + struct.pack("<iI", max(-(1 << 31), min(seconds, (1 << 31) - 1)), rest)


class PlaySpan(NamedTuple):
    """What is played of a recording, and how fast.

    Attributes:
        begin, end: ns since the epoch.
        clock: Hz of /clock, or 0 for none.
    """

    begin: int
    end: int
    rate: float = 1.0
    loop: bool = False
    clock: float = 0.0


class PlayState(NamedTuple):
    """The state of a player: its place (ns since the epoch), what it has published, and who listens."""

    position: int
    is_paused: bool
    messages: int
    subscriptions: int


class Player:
    """Plays a recording once, or again and again.

    Attributes:
        messages: number of those that were published.
        failed: number of those that DDS refused, by topic and reason.
        late: s by which the last messages were published too late.
        error: why the rest of the recording was not played, or empty.
        room: for messages that late joiners get.
    """

    def __init__(
        self,
        recording: OpenRecording,
        node: RosNode,
        publishers: PlayedPublishers,
        span: PlaySpan,
        *,
        is_paused: bool,
    ) -> None:
        self.messages = 0
        self.failed: Counter[tuple[str, str]] = Counter()
        self.late: deque[float] = deque(maxlen=_LATENESSES)
        self.error = ""
        self.room = LatchedRoom()
        self._recording = recording
        self._publishers = publishers
        self._span = span
        self._is_paused = is_paused
        self._clock = _clock_publisher(node) if span.clock else None
        self._ahead = ReadAhead(iter(()))
        self._at, self._since = span.begin, 0.0  # the place in the recording, and when it was there (monotonic, s)
        self._clock_at = 0.0
        self._taken = 0  # messages of the recording, played or not

    def play(self, keys: PlayKeys, tell: Callable[[PlayState], None]) -> None:
        """Play, until the end or a key.

        Args:
            tell: is called several times a second.
        """
        try:
            self._go_to(self._span.begin)
            looked = told = 0.0
            before: int | None = None  # messages that were taken before the present round
            while True:
                now = time.monotonic()
                if now - told >= _TOLD_EVERY:
                    told = now
                    tell(self._state(now))
                wait = self._do_due(now)
                if wait is None:
                    # A round without messages would take no time, and the keys none of it.
                    if not self._span.loop or self._span.begin == self._span.end or self._taken == before:
                        return
                    before = self._taken
                    self._go_to(self._span.begin)
                elif wait > 0 or now - looked >= _LOOK_EVERY:
                    looked = now
                    for key in keys.wait(min(wait, told + _TOLD_EVERY - now)):
                        if key == "end":
                            return
                        self._press(key)
        finally:
            self._ahead.close()

    def settle(self) -> None:
        """Wait until reliable subscriptions have all messages, for some time at most."""
        deadline = time.monotonic() + _ACKNOWLEDGED_WITHIN
        while time.monotonic() < deadline and not all(each.publisher.acknowledged for each in self._publishers.all):
            time.sleep(0.01)

    def _do_due(self, now: float) -> float | None:
        """Publish what is due, and return the seconds until more is, or None at the end."""
        if self._is_paused:
            return _TOLD_EVERY
        if self._clock is not None and now >= self._clock_at:
            self._clock_at = max(self._clock_at + 1 / self._span.clock, now)
            self._tell_clock(self._position(now))
        message = self._ahead.peek(_LOOK_EVERY)
        if message is None:
            if not self._ahead.is_over:
                return 0.0
            self.error = self._ahead.error
            return None
        due = self._since + (message.time - self._at) / SECOND / self._span.rate
        if due > (now := time.monotonic()):
            return min(due, self._clock_at) - now if self._clock is not None else due - now
        self._publish(self._take())
        self.late.append(time.monotonic() - due)
        return 0.0

    def _take(self) -> StoredMessage:
        self._taken += 1
        return self._ahead.take()

    def _publish(self, message: StoredMessage) -> None:
        played = self._publishers.of(message.channel)
        if played is None:
            return
        try:
            if not self.room.take(played, message):
                return
            played.publisher.publish(bytes(message.content))
            self.messages += 1
        except RosError as error:
            self.failed[message.channel.topic, str(error)] += 1

    def _press(self, key: str) -> None:
        now = time.monotonic()
        if key == "pause":
            self._at, self._since, self._is_paused = self._position(now), now, not self._is_paused
            self._clock_at = now
        elif key == "step":
            if self._is_paused and (message := self._ahead.peek(1.0)) is not None:
                self._at = message.time
                self._publish(self._take())
                self._tell_clock(message.time)
        else:
            to = self._position(now) + int(key) * SECOND
            self._go_to(max(self._span.begin, min(to, self._span.end)))

    def _go_to(self, at: int) -> None:
        """Go on from a time (ns) in the recording, after what late joiners had got by then."""
        self._ahead.close()
        self.room.seek()
        for message in self._latched_before(at):
            self._publish(message)
        topics, end = self._publishers.topics, self._span.end + 1
        self._ahead = ReadAhead(self._recording.messages(topics=topics, begin=at, end=end))
        self._ahead.peek(_TOLD_EVERY)  # before the time begins to run
        self._at, self._since = at, time.monotonic()
        self._clock_at = self._since

    def _latched_before(self, at: int) -> list[StoredMessage]:
        """Return the messages that late joiners would get at a time, in their order."""
        if not self._publishers.latched:
            return []
        return self.room.newest(self._undamaged(self._publishers.latched, at), self._publishers)

    def _undamaged(self, topics: set[str], end: int) -> Iterator[StoredMessage]:
        with suppress(RecordingError):  # the damage is met again, and told, where it is played
            yield from self._recording.messages(topics=topics, end=end)

    def _position(self, now: float) -> int:
        passed = 0.0 if self._is_paused else (now - self._since) * self._span.rate
        return min(self._at + round(passed * SECOND), self._span.end)

    def _state(self, now: float) -> PlayState:
        everywhere = [each.publisher for each in self._publishers.all] + [each for each in (self._clock,) if each]
        subscriptions = sum(each.subscriber_count for each in everywhere)
        return PlayState(self._position(now), self._is_paused, self.messages, subscriptions)

    def _tell_clock(self, at: int) -> None:
        if self._clock is not None:
            self._clock.publish(clock_message(at))


def _clock_publisher(node: RosNode) -> Publisher:
    qos = Qos(reliability="best_effort", depth=1)  # as rclcpp subscribes
    return node.advertise(TopicSpec(CLOCK, _CLOCK_TYPE, hash_of_text(text_of(_CLOCK_DESCRIPTION)), qos), "play")
