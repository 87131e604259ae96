"""Pictures and messages of a recording at a time in it, drawn by the process that draws those of topics."""

from __future__ import annotations

import asyncio
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.cdr.description import hash_of_text, text_of
from rsb_bridge.ros.native.rosidl_descriptions import installed_description
from rsb_extras.pictures.drawing import VIEWS, is_map
from rsb_extras.pictures.topic_view import FRAMES, KEPT_BYTES, KEPT_MESSAGES
from rsb_extras.pictures.worker import TakenSample, Task
from rsb_extras.recording.reading.defined_types import DefinitionError, defined_type, rosidl_description
from rsb_extras.recording.reading.recorded_qos import played_qos

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from rsb_extras.pictures.picture import Picture, Wish
    from rsb_extras.pictures.renderer import Renderer
    from rsb_extras.recording.reading.open_recording import OpenRecording
    from rsb_extras.recording.reading.stored_message import StoredChannel, StoredMessage

SECOND = 1_000_000_000
_LOOKS_BACK = (1, 10, 100, 1000, None)
"""s before a time in which its newest message is looked for; at last in all of it. Round figures."""
_TRANSFORMS = 10.0  # s of /tf before a time, as tf2 keeps them
_ONLY_NEWEST = {VIEWS["sensor_msgs/msg/Image"], VIEWS["sensor_msgs/msg/PointCloud2"]}
"""Views that show one message, of types of which some seconds take long to read."""


class Moment(NamedTuple):
    """What a recording has of a topic at a time.

    Attributes:
        message: the newest one then, or None before the first one.
        picture: of all until then.
    """

    message: StoredMessage | None
    picture: Picture


def described_type(channel: StoredChannel) -> tuple[str, str] | None:
    """Return the description of a channel's type and its hash, as it is recorded or installed, or None."""
    encoding, text = channel.definition
    if encoding == "ros2msg":
        try:
            found = text_of(rosidl_description(defined_type(channel.type_name, text.decode())))
        except (DefinitionError, UnicodeDecodeError):
            pass
        else:
            return found, hash_of_text(found)
    try:
        installed = installed_description(channel.type_name)
    except (ImportError, ValueError):
        return None
    if installed is None or channel.type_hash not in ("", hash_of_text(installed)):
        return None
    return installed, hash_of_text(installed)


class RecordedPictures:
    """Looks at one topic of a recording, at one time after the other.

    A later time goes on from the one before, with all messages between; an earlier one, or another topic, begins anew.
    """

    def __init__(self, recording: OpenRecording, renderer: Renderer) -> None:
        self._recording = recording
        self._renderer = renderer
        self._view = renderer.next_view()
        self._topic = ""
        self._wish: Wish | None = None
        self._until: int | None = None  # ns; messages before were drawn
        self._seen = 0
        self._newest: StoredMessage | None = None
        self._types: dict[int, tuple[StoredChannel, tuple[str, str] | None]] = {}
        self._latched = {each.topic for each in recording.channels if played_qos(each.profiles).latched}

    async def at(self, topic: str, time: int, wish: Wish) -> Moment:
        """Return what a topic shows at a time (ns).

        Raises:
            RecordingError: the recording cannot be read there.
        """
        goes_on = self._goes_on(topic, time, wish)
        if not goes_on:
            self._renderer.forget(self._view)
            self._view = self._renderer.next_view()
            self._seen, self._newest, self._until = 0, None, None  # if the recording cannot be read, nothing goes on
        frames = self._frames(topic, wish)
        begin = self._until if goes_on else None
        samples, asked = await asyncio.to_thread(partial(self._samples, topic, frames, begin, time, wish))
        self._topic, self._wish, self._until = topic, wish, time + 1
        self._seen += asked
        type_name = self._recording.summary.topics[topic][0]
        descriptions = {name: (name, *found) for name, found in self._described(samples)}
        readable = tuple(each for each in samples if each.type_name in descriptions)
        size = 0 if self._newest is None else len(self._newest.content)
        task = Task(self._view, type_name, wish, readable, self._seen, size, tuple(descriptions.values()), time)
        return Moment(self._newest, await self._renderer.draw(task))

    def type_of(self, channel: StoredChannel) -> tuple[str, str] | None:
        """Return the description of a channel's type and its hash, or None if nobody describes it."""
        known = self._types.get(id(channel))
        if known is None:
            known = self._types[id(channel)] = channel, described_type(channel)
        return known[1]

    def next_time(self, topic: str, time: int, *, back: bool) -> int | None:
        """Return the time of a topic's next message, or of the one before, or None if there is none."""
        if not back:
            found = next(self._recording.messages(topics={topic}, begin=time + 1), None)
            return None if found is None else found.time
        before = self._newest_before({topic}, time)
        return None if before is None else before.time

    def _goes_on(self, topic: str, time: int, wish: Wish) -> bool:
        return (
            self._until is not None
            and topic == self._topic
            and self._wish is not None
            and wish.how == self._wish.how
            and self._until <= time + 1 <= self._until + round(wish.seconds * SECOND)
        )

    def _frames(self, topic: str, wish: Wish) -> set[str]:
        """Return the topics of transforms that a map needs."""
        type_name = self._recording.summary.topics[topic][0]
        shows_map = wish.how == "map" or (not wish.how and is_map(type_name))
        known = self._recording.summary.topics
        return {each for each in FRAMES if each in known and each != topic} if shows_map else set()

    def _samples(
        self, topic: str, frames: Collection[str], begin: int | None, time: int, wish: Wish
    ) -> tuple[list[TakenSample], int]:
        """Return the messages to draw, those of transforms first, and how many of the topic itself there were."""
        end = time + 1
        helping: list[StoredMessage] = []
        for frame in frames:
            since = None if frame in self._latched else time - round(_TRANSFORMS * SECOND)
            since = since if begin is None else begin
            helping += _newest(self._recording.messages(topics={frame}, begin=since, end=end))[0]
        own: list[StoredMessage] = []
        count = 0
        if begin is not None or wish.how or VIEWS.get(self._recording.summary.topics[topic][0]) not in _ONLY_NEWEST:
            since = time - round(wish.seconds * SECOND) if begin is None else begin
            own, count = _newest(self._recording.messages(topics={topic}, begin=since, end=end))
        if not own and self._newest is None and (before := self._newest_before({topic}, end)) is not None:
            own, count = [before], 1
        if own:
            self._newest = own[-1]
        return [*(_sample(each, is_asked=False) for each in helping), *(_sample(each) for each in own)], count

    def _newest_before(self, topics: set[str], end: int) -> StoredMessage | None:
        for seconds in _LOOKS_BACK:
            begin = None if seconds is None else end - seconds * SECOND
            found = deque(self._recording.messages(topics=topics, begin=begin, end=end), 1)
            if found:
                return found[0]._replace(content=memoryview(bytes(found[0].content)))
        return None

    def _described(self, samples: Collection[TakenSample]) -> Iterator[tuple[str, tuple[str, str]]]:
        names = {each.type_name for each in samples}
        for channel in self._recording.channels:
            if channel.type_name in names and (found := self.type_of(channel)) is not None:
                yield channel.type_name, found


def _newest(messages: Iterator[StoredMessage]) -> tuple[list[StoredMessage], int]:
    """Return the newest messages within the limits of a view, and how many there were."""
    kept: deque[StoredMessage] = deque()
    count = size = 0
    for message in messages:
        count += 1
        # A view would hold the whole chunk.
        kept.append(message._replace(content=memoryview(bytes(message.content))))
        size += len(message.content)
        while len(kept) > 1 and (size > KEPT_BYTES or len(kept) > KEPT_MESSAGES):
            size -= len(kept.popleft().content)
    return [*kept], count


def _sample(message: StoredMessage, *, is_asked: bool = True) -> TakenSample:
    channel = message.channel
    content = bytes(message.content)
    return TakenSample(channel.topic, channel.type_name, content, message.time, channel.publisher, is_asked)
