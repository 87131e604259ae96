"""The messages that pass a bridge, each made once for all that record them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

from rsb_bridge.cdr.description import DescriptionError
from rsb_bridge.feature_api import Qos, Receiver, Sender, TopicSpec
from rsb_extras.recording.mcap_file import RecordedTopic
from rsb_extras.recording.message_definition import message_definition
from rsb_extras.recording.message_ring import RingMessage

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.feature_api import Bridge, Context, Tap

    Taker: TypeAlias = Callable[[RingMessage], None]

_PUBLISHERS = 4096
"""Publishers whose newest number is remembered. A round figure; after that, a message may be kept twice."""


class PassingMessages:
    """Gives each message of all present and coming routes to those that record. Without one, no route has a tap."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._takers: tuple[Taker, ...] = ()
        self._numbers: dict[bytes, int] = {}
        self._renew_taps: Callable[[], None] = lambda: None

    def of(self, bridge: Bridge) -> PassingMessages:
        """Have the taps of this bridge's routes follow."""

        def renew_taps() -> None:
            for link in bridge.role.links():
                for route in link.routes.values():
                    if isinstance(route.half, Sender | Receiver):
                        route.half.flow.renew_tap()

        self._renew_taps = renew_taps
        return self

    def give(self, take: Taker) -> None:
        """Give each message to `take` from now on."""
        self._set((*self._takers, take))

    def end(self, take: Taker) -> None:
        self._set(tuple(each for each in self._takers if each != take))

    def _set(self, takers: tuple[Taker, ...]) -> None:
        had, self._takers = bool(self._takers), takers
        if had != bool(takers):
            self._numbers.clear()
            self._context.tap_of = self.tap if takers else lambda _, __: None
            self._renew_taps()

    def tap(self, name: str, source: Any) -> Tap:
        """Return what takes the messages of a topic, as `rsb_bridge.context.Context.tap_of`."""
        now, is_own = self._context.now, self._context.announcements.is_own
        topic = TopicSpec(name, "", "", Qos())

        def tap(content: bytes, time: int, published: int, publisher: bytes, number: int) -> None:
            nonlocal topic
            # What comes from ROS may have come over another link, where it is recorded already.
            if publisher and (is_own(publisher) or self.is_known(publisher, number or published)):
                return
            if topic.type_hash != source.type_hash or topic.qos is not source.qos:
                topic = TopicSpec(name, source.type_name, source.type_hash, source.qos or Qos())
            message = RingMessage(now(), topic, content, time, published, number, publisher)
            for take in self._takers:
                take(message)

        return tap

    def is_known(self, publisher: bytes, number: int) -> bool:
        """Whether a message has come already: over another link, or again to a new subscription. Notes it if not.

        Args:
            publisher: its id in the middleware.
            number: grows with each of its messages.
        """
        if self._numbers.get(publisher, 0) >= number:
            return True
        if len(self._numbers) >= _PUBLISHERS and publisher not in self._numbers:
            self._numbers.clear()
        self._numbers[publisher] = number
        return False


def passing_messages(bridge: Bridge) -> PassingMessages:
    """Return the messages that pass a bridge."""
    return bridge.context.shared(PassingMessages).of(bridge)


async def recorded_topic(context: Context, topic: TopicSpec) -> RecordedTopic:
    """Return what a file says of a topic. Its description is empty if nobody describes its type, or it has no file."""
    text = await context.descriptions.find(topic.type_name, topic.type_hash, topic.topic) or ""
    try:
        message_definition(text)
    except DescriptionError:
        text = ""
    return RecordedTopic(topic.topic, topic.type_name, topic.type_hash, text, topic.qos)
