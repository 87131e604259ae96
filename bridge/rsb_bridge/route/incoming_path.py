"""The path of one route's messages from its channel to ROS."""

from __future__ import annotations

import math
from collections import Counter
from functools import partial
from typing import TYPE_CHECKING

import zstandard

from rsb_bridge.cdr.checker import MalformedError, TooComplexError
from rsb_bridge.model.calls import Refused
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import OUTLIVE
from rsb_bridge.model.qos import AUTO_DEPTH
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.catching_up import EVERY, LATE, LIVE_WITHIN, CatchUp
from rsb_bridge.route.gates import NO_SAMPLE, GatedMessage, chained, compose_when_switched, incoming_gates, unleased
from rsb_bridge.route.latched import LatchedFullError, LatchedTopic
from rsb_bridge.route.ledger import CAUSES
from rsb_bridge.route.message_check import PUBLISHED_ASIDE, ExpandsTooMuchError, MessageCheck, Unpacker, malformed_text
from rsb_bridge.route.message_transform import TransformError, changed
from rsb_bridge.route.peeking import peeked
from rsb_bridge.route.source_publishers import SlowSubscriberError, SourcePublishers
from rsb_bridge.wire.framing import HISTORY, LEASED, SOURCE_SHIFT, ZSTD, Message
from rsb_bridge.wire.headers import PUBLISHER_ID_LENGTH, HistoryHeader, split_history
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterator, Sequence

    from rsb_bridge.route.gates import LastLook
    from rsb_bridge.route.message_transform import FindTransforms, Transforms
    from rsb_bridge.route.rest_message import RestAfterArming
    from rsb_bridge.route.source_publishers import VolatileTopic
    from rsb_bridge.route.topic_flow import TopicFlow

REPORTS_AFTER = 100
"""Messages after which an early report is sent: if this process is killed, the sender never learns whether the
unreported messages arrived."""
_PACKED = HISTORY | LEASED | ZSTD
"""Flags of messages whose payload is more than the content."""
_CHANGED_OTHERWISE = "its messages are changed in another way from now on"
_NO_GATES = (None, None, None)
_NO_HISTORY = HistoryHeader(bytes(PUBLISHER_ID_LENGTH), number=0, depth=AUTO_DEPTH)
"""For messages without a history header: they count as messages of one publisher."""


class _NotPublishedError(Exception):
    """A message that arrived is not published, and no operator has to know. Its text is the cause in the ledger."""


_FAILURES: dict[type[Exception], tuple[str, EventCode]] = {
    ExpandsTooMuchError: ("expands too much", EventCode.ROUTE_EXPANDS_TOO_MUCH),
    MalformedError: ("malformed", EventCode.ROUTE_MALFORMED),
    TooComplexError: ("too complex", EventCode.ROUTE_TOO_COMPLEX),
    TransformError: ("not changed", EventCode.ROUTE_NOT_CHANGED),
    LatchedFullError: ("latched full", EventCode.ROUTE_LATCHED_FULL),
    SlowSubscriberError: ("slow subscriber", EventCode.ROUTE_SLOW_SUBSCRIBER),
    RosError: ("publish failed", EventCode.ROUTE_PUBLISH_FAILED),
    zstandard.ZstdError: ("publish failed", EventCode.ROUTE_PUBLISH_FAILED),
    ProtocolError: ("publish failed", EventCode.ROUTE_PUBLISH_FAILED),
}
"""Errors that prevent a publication, each with the cause in the ledger and the event's code."""
_CAUGHT: tuple[type[Exception], ...] = (_NotPublishedError, *_FAILURES)


class IncomingPath:
    """The path of one route's messages from its channel to ROS, and the counts of the present opening.

    Attributes:
        outputs: the publishers here.
        unpacker: unpacks compressed messages; later ones wait behind one that is not unpacked yet.
        received, delivered, dropped: messages of the present opening, the last ones by cause.
        transforms: change each message.
        malformed: the field of the last malformed message, and what is wrong with it, or an empty string.
        report_at: messages received at which an early report is sent.
    """

    def __init__(self, flow: TopicFlow, rest: RestAfterArming, check: MessageCheck) -> None:
        self.route, self.carried, self.flow = flow.route, flow.carried, flow
        self._rest, self.check = rest, check
        route = flow.route
        self._catch_up = CatchUp()
        self.unpacker = Unpacker(route.peer.budget.expansion, route.context, self.deliver, route.request_reopen)
        self.outputs = SourcePublishers(route, self.unpacker)
        flow.tap_changed = self.choose_publish
        self.choose_publish()
        compose_when_switched(route, self._compose_gates)
        self.received = 0
        self.report_at = REPORTS_AFTER
        self.delivered = 0
        self.dropped: Counter[str] = Counter()
        self.malformed = ""
        self.transforms: Transforms = ()
        self._transforms_asked: asyncio.Task[None] | None = None
        self._awaits_transforms = False

    def choose_transforms(self, *, opens: bool) -> None:
        """Ask features what changes the messages; until they answer, these stay as before, or wait in a new opening."""
        waits = opens or self._awaits_transforms
        self.forget_transforms()
        find = None if self.route.peer.transforms is None else self.route.peer.transforms(self.route)
        if find is not None or self.transforms:
            self._awaits_transforms = waits
            self._transforms_asked = self.route.context.loop.create_task(self._find_transforms(find))
        elif waits:
            self.unpacker.go_on()

    def forget_transforms(self) -> None:
        """Await no answer any more: the opening has ended, or they are asked again."""
        self._awaits_transforms = False
        if self._transforms_asked is not None:
            self._transforms_asked.cancel()
            self._transforms_asked = None

    async def _find_transforms(self, find: FindTransforms | None) -> None:
        found = () if find is None else await find()
        self._transforms_asked = None
        self._use_transforms(found)
        if self._awaits_transforms:
            self._awaits_transforms = False
            self.unpacker.go_on()

    def _use_transforms(self, found: Transforms) -> None:
        if found == self.transforms:
            return
        self.transforms = found
        self.route.judge_again()
        # What DDS keeps for late joiners was changed otherwise, and what was kept back does not come again by itself.
        if self.flow.is_latched and (self.received or self.outputs.has_kept):
            self.outputs.close()
            self.route.request_reopen(EventCode.ROUTE_CHANGED_OTHERWISE, _CHANGED_OTHERWISE, Level.INFO)

    def deliver(self, messages: Sequence[Message]) -> None:
        """Publish messages that arrived whole and authentic, or let them wait for later turns of the I/O loop."""
        if self.unpacker.holds or self._awaits_transforms:
            self.unpacker.wait(messages)
            return
        batch, began = self._gates[0], self.route.context.now()
        if batch is not None and (why := batch(NO_SAMPLE, began)) is not None:
            self.refuse(why, len(messages))
            return
        if not self.outputs.sinks:
            return
        now, offset = self.route.context.stamps.now(), self.route.peer.stamps.offset
        if offset is None or not LATE < (now - messages[0][1]) / 1e9 + offset < OUTLIVE.high or self._must_be_fresh:
            self._hand_on(messages, now, began)
            return
        rate = max(self.route.meter.rate, self.route.meter.usual_rate or 0.0)
        allowed = self._catch_up.allowed(messages, began, rate, math.inf if self.flow.is_whole else LIVE_WITHIN)
        self._hand_on(messages[:allowed], now, began)
        if later := messages[allowed:]:
            self.unpacker.pause(later, EVERY)

    @property
    def _must_be_fresh(self) -> bool:
        """Whether gates look at its messages, as at commands, or a latched topic's publishers keep them."""
        return self.flow.is_latched or self._gates != _NO_GATES

    def _publish_one_by_one(self, messages: Sequence[Message], now: int, began: float) -> None:
        """Publish messages for a tap: `_publish` shows only the last of those that it gets, and a tap must see each.

        If one has to wait, as `_publish` may find, those behind it queue up.
        """
        for at, message in enumerate(messages):
            self._publish((message,), now, began)
            if self.unpacker.holds:
                self.unpacker.wait(messages[at + 1 :])
                return

    def _publish(self, messages: Sequence[Message], now: int, began: float) -> None:
        """Publish messages that came at `now` (ns of the clock of stamps) and `began` (s), as `deliver`."""
        (batch, arriving, leaving), sinks, sent = self._gates, self.outputs.sinks, now
        checker = self.check.checker
        # With a bounded number of lengths, a check takes next to no time, and nothing of the budget: one call less.
        check = None if checker is None else self.check.check if checker.loops else checker.check
        transforms = self.transforms
        count, size, number, published = 0, 0, 0, b""
        # An iterator, so that `*following` below is the rest after a message that has to wait.
        following = iter(messages)
        for message in following:
            payload, stamp, flags = message
            if batch is not None:
                number, payload, flags = unleased(payload, flags)
            # Before the gates: what waits comes here again, and would take a second token of the rate.
            if flags & ZSTD and not self.unpacker.begin((payload, stamp, flags)):
                self.unpacker.wait((message, *following))
                break
            sample = NO_SAMPLE if arriving is leaving is None else GatedMessage(stamp, number)
            if arriving is not None and (why := arriving(sample, began)) is not None:
                self.unpacker.forget()
                self.refuse(why)
                continue
            self.received += 1
            # A peer may name any of 16 sources, also one that got no publisher here.
            if flags >> SOURCE_SHIFT >= len(sinks):
                self.drop(_NotPublishedError("unknown source"))
                continue
            sink = sinks[flags >> SOURCE_SHIFT]
            look = None if leaving is None else partial(leaving, sample, began)
            try:
                header, content = self._unpack(payload, flags) if flags & _PACKED else (_NO_HISTORY, payload)
                if check is not None:
                    check(content)
                if transforms:
                    content = changed(content, transforms)
                if isinstance(sink, LatchedTopic):
                    self._publish_latched(sink, header, content, look, following)
                elif len(content) > PUBLISHED_ASIDE and self.route.purpose.in_graph:
                    self._publish_aside(sink, content, len(payload), GatedMessage(stamp, number), following)
                    continue
                elif (why := sink.publish(content, look)) is not None:
                    raise _NotPublishedError(CAUSES[why])
            except _CAUGHT as error:
                self.drop(error)
            else:
                count, size = count + 1, size + len(payload)
                published, sent = content, stamp  # the last one's are the batch's sample
        if count:
            self._published(count, size, published, (now - sent) / 1e9, began)
        if self.received >= self.report_at:
            self.report_at = self.received + REPORTS_AFTER
            self.route.peer.report_soon(self.route)

    def _published(self, count: int, size: int, last: bytes, took: float, began: float) -> None:
        """Note messages that were published, of `size` bytes together.

        Args:
            took: s, by the clocks of both sides.
            began: s, when they arrived.
        """
        self.delivered += count
        if (
            last
            and (rest := self._rest.message) is not None
            and self.route.arming.required
            and rest.moved(last, self.outputs)
        ):
            self.route.peer.report_soon(self.route)
        latency = None if (offset := self.route.peer.stamps.offset) is None else took + offset
        if latency is not None and latency <= began - self.flow.flows_since:  # else it was kept from before
            self.flow.latency.add(latency)
        if last and self.flow.peek_slot.wanted:
            self._show(last, latency)
        self.flow.count(count, size, began)

    def _show(self, content: bytes, latency: float | None) -> None:
        slot, now = self.flow.peek_slot, self.route.context.wall_ns()
        if slot.tap is not None:
            slot.tap(content, now, now - int((latency or 0.0) * 1e9), b"", 0)
        if slot.is_awaited:
            clock = self.route.peer.clock
            offset = 0.0 if any(each.corrects_stamps for each in self.transforms) else clock.offset
            shown = peeked(self.flow, content, now, latency=latency, clock=(offset, clock.uncertainty))
            slot.put(shown, self.route.context.now())

    def refuse(self, why: Refused, messages: int = 1) -> None:
        """Count messages that arrived, and that a gate keeps back."""
        if self.route.idle:
            self.route.wake()
        self.received += messages
        self.dropped[CAUSES[why]] += messages
        if why is Refused.TOO_FAST:
            allowed = f"the {self.route.limit.here:g} Hz that this side allows"
            text = f"the other side sends more than {allowed}: the rest is left out"
            self.route.notices.message_error(EventCode.ROUTE_TOO_FAST, text)

    def _unpack(self, payload: bytes, flags: int) -> tuple[HistoryHeader, bytes]:
        """Return a message's history header and its content."""
        if flags & LEASED:  # on a route that needs no arming
            raise _NotPublishedError("disarmed")
        header, rest = split_history(payload) if flags & HISTORY else (_NO_HISTORY, payload)
        return header, self.unpacker.unpack(rest) if flags & ZSTD else rest

    def _publish_aside(
        self,
        sink: VolatileTopic,
        content: bytes,
        size: int,
        sample: GatedMessage,
        later: Iterator[Message],
    ) -> None:
        """Publish a long message on another thread; it counts, and later ones follow, once that is done.

        Args:
            size: bytes of its payload.
        """
        publisher = sink.reserve(content)
        self.received -= 1
        batch, _, leaving = self._gates
        look = None if batch is leaving is None else partial(self._last_look, sample)
        took, began = (self.route.context.stamps.now() - sample.stamp) / 1e9, self.route.context.now()
        shown = content if self._rest.message is not None or self.flow.peek_slot.wanted else b""

        def then(why: Refused | RosError | None) -> None:
            self.received += 1
            if why is None:
                self._published(1, size, shown, took, began)
                return
            if isinstance(why, Refused):
                sink.unreserve()
            self.drop(why)

        # First, as a message that may not be published lets them go on at once. Too many of them end the opening.
        self.unpacker.wait(later)
        if self.unpacker.holds:
            self.unpacker.publish(publisher, content, look, then)

    def _last_look(self, sample: GatedMessage) -> Refused | None:
        """Return the reason why a message may not be published now that has passed all gates before."""
        (batch, _, leaving), now = self._gates, self.route.context.now()
        why = None if batch is None else batch(sample, now)
        return leaving(sample, now) if why is None and leaving is not None else why

    def _publish_latched(
        self,
        topic: LatchedTopic,
        header: HistoryHeader,
        content: bytes,
        look: LastLook | None,
        later: Iterator[Message],
    ) -> None:
        if look is not None and (why := look()) is not None:
            raise _NotPublishedError(CAUSES[why])
        if not topic.publish(header, content, look, partial(self._not_published, self.route.id)):
            raise _NotPublishedError("already published")
        # Unpacked, they would take memory until a long message is published.
        if topic.is_busy:
            self.unpacker.wait(later)

    def _not_published(self, opening: int, why: Refused | RosError) -> None:
        """Note that a message counts as delivered in an opening, and is not published."""
        if self.route.id == opening:  # else its counts are closed
            self.delivered -= 1
            self.drop(why)

    def drop(self, error: Refused | Exception) -> None:
        """Count a message that is not published, and tell operators why."""
        if self.route.idle:
            self.route.wake()
        if isinstance(error, Refused | _NotPublishedError):
            self.dropped[CAUSES[error] if isinstance(error, Refused) else str(error)] += 1
            return
        cause, code = next(found for kind, found in _FAILURES.items() if isinstance(error, kind))
        self.dropped[cause] += 1
        text = str(error)
        if isinstance(error, MalformedError):
            self.malformed = sanitize_text(text)
            text = malformed_text(self.carried.type_name, self.route.peer.name, error)
        self.route.notices.message_error(code, text)

    def _compose_gates(self) -> None:
        batch, arriving, leaving = incoming_gates(self.route)
        self._gates = chained(batch), chained(arriving), chained(leaving)

    def choose_publish(self) -> None:
        """Publish each message by itself while there is a tap: chosen here, so that no message is asked for one."""
        self._hand_on = self._publish if self.flow.peek_slot.tap is None else self._publish_one_by_one
