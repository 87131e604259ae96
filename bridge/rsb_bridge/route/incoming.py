"""The receiving half of a topic's route: it counts, checks and publishes the peer's messages."""

from __future__ import annotations

from collections import Counter
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec
import zstandard

from rsb_bridge.cdr.checker import MalformedError, TooComplexError
from rsb_bridge.cdr.description import TypeClash, TypeVersion
from rsb_bridge.cdr.known_types import CLOCK
from rsb_bridge.channel.channel import Counts, ReceivingChannel
from rsb_bridge.model.calls import Refused
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.demands import full_type
from rsb_bridge.model.limits import OUTLIVE
from rsb_bridge.model.qos import AUTO_DEPTH, match_subscriptions, parts_of_lease
from rsb_bridge.model.reason import Reason
from rsb_bridge.model.snapshot import Ledger, Level, Stage, State
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_graph import agreed_type, type_hint
from rsb_bridge.ros.ros_interface import RosError, TopicSpec
from rsb_bridge.route.arming import without_history
from rsb_bridge.route.blocking_rules import stages_with_link
from rsb_bridge.route.catching_up import EVERY, LATE, CatchUp
from rsb_bridge.route.combined_verdict import lasting, record_of
from rsb_bridge.route.gates import NO_SAMPLE, GatedMessage, chained, compose_when_switched, incoming_gates, unleased
from rsb_bridge.route.latched import LatchedFullError, LatchedTopic
from rsb_bridge.route.ledger import CAUSES, reported_ledger
from rsb_bridge.route.lifecycle import RouteEvent, RoutePhase
from rsb_bridge.route.message_check import PUBLISHED_ASIDE, ExpandsTooMuchError, MessageCheck, Unpacker, malformed_text
from rsb_bridge.route.peeking import peeked
from rsb_bridge.route.rest_message import RestAfterArming, velocity_on
from rsb_bridge.route.source_publishers import SlowSubscriberError, SourcePublishers, bounded
from rsb_bridge.route.topic_route import TopicRoute
from rsb_bridge.route.topic_verdict import OF_RECEIVER, audience, no_subscriber
from rsb_bridge.wire.framing import HISTORY, LEASED, SOURCE_SHIFT, ZSTD, Message
from rsb_bridge.wire.headers import PUBLISHER_ID_LENGTH, HistoryHeader, split_history
from rsb_bridge.wire.messages import Describe, Propose, Publishers, Ready, Refuse
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_bridge.wire.records import DeafRecord, ReceivedReport, SentReport

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Collection, Iterator, Sequence

    from rsb_bridge.cdr.known_types import Velocity
    from rsb_bridge.context import Context
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.verdict import Verdict
    from rsb_bridge.ros.ros_interface import Endpoint
    from rsb_bridge.route.arming import Disarmed
    from rsb_bridge.route.blocking_rules import Rules
    from rsb_bridge.route.crossing import Crossing
    from rsb_bridge.route.gates import LastLook
    from rsb_bridge.route.idling import Signs
    from rsb_bridge.route.route import Owner
    from rsb_bridge.route.source_publishers import VolatileTopic

_INCOMPLETE_IN_A_ROW = 3
"""Messages given up incomplete since the last whole one. A round figure: nothing was measured. One may be bad luck."""
_ASKED_EVERY = 0.9
"""s until the graph is asked again who subscribes, where their number is the same: less than the second after which
`link.graph_watch` looks once more, when the graph has settled."""
_MATCHED_WITHIN = 2.0
"""s. A round figure: DDS matches a subscription that it lists within milliseconds."""
_ANNOUNCED_WITHIN = 0.25
"""Seconds in which other bridges hear an announcement, which is sent and read within 0.1 s. A round figure."""
_REPORTS_AFTER = 100
"""Messages after which an early report is sent: if this process is killed, the sender never learns whether the
unreported messages arrived."""
_PACKED = HISTORY | LEASED | ZSTD
"""Flags of messages whose payload is more than the content."""
_NO_GATES = (None, None, None)
_NO_HISTORY = HistoryHeader(bytes(PUBLISHER_ID_LENGTH), number=0, depth=AUTO_DEPTH)
"""For messages without a history header: they count as messages of one publisher."""
_LATENCIES = ("latency", "latency_p50", "latency_p99")


def _with_latencies(
    before: SentReport | ReceivedReport | None, report: ReceivedReport
) -> SentReport | ReceivedReport | None:
    """Return an earlier report with the latencies of a newer one, which are no news without new messages."""
    if not isinstance(before, ReceivedReport):
        return before
    return msgspec.structs.replace(before, **{name: getattr(report, name) for name in _LATENCIES})


class _NotPublishedError(Exception):
    """A message that arrived is not published, and no operator has to know. Its text is the cause in the ledger."""


_FAILURES: dict[type[Exception], tuple[str, EventCode]] = {
    ExpandsTooMuchError: ("expands too much", EventCode.ROUTE_EXPANDS_TOO_MUCH),
    MalformedError: ("malformed", EventCode.ROUTE_MALFORMED),
    TooComplexError: ("too complex", EventCode.ROUTE_TOO_COMPLEX),
    LatchedFullError: ("latched full", EventCode.ROUTE_LATCHED_FULL),
    SlowSubscriberError: ("slow subscriber", EventCode.ROUTE_SLOW_SUBSCRIBER),
    RosError: ("publish failed", EventCode.ROUTE_PUBLISH_FAILED),
    zstandard.ZstdError: ("publish failed", EventCode.ROUTE_PUBLISH_FAILED),
    ProtocolError: ("publish failed", EventCode.ROUTE_PUBLISH_FAILED),
}
"""Errors that prevent a publication, each with the cause in the ledger and the event's code."""
_CAUGHT: tuple[type[Exception], ...] = (_NotPublishedError, *_FAILURES)


def _failure_of(peer: Verdict) -> str:
    """Return the reason why the other side's subscription failed, or an empty string."""
    return peer.text if peer.cause == Cause.SUBSCRIBE_FAILED else ""


class IncomingRoute(TopicRoute[ReceivingChannel]):
    """Publishes here what the peer sends.

    It has more than 40 methods because 24 of them fill in hooks of `TopicRoute` and `Route`.

    Attributes:
        rest: follows the last message of an arming.
        offered: the QoS of the publishers here, or None if unknown.
        others: other publishers of the topic here, if a subscription does not match.
        report_now: the sender's last report on the present opening, or None.
        clocks: if it is a clock, the nodes and links that publish it here besides this link.
    """

    peer_report = SentReport
    outgoing: ClassVar[bool] = False
    rules: ClassVar[Rules[Any]] = OF_RECEIVER

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        self._catch_up = CatchUp()
        self._unpacker = Unpacker(peer.budget.expansion, context, self.deliver, self.request_reopen)
        self.outputs = SourcePublishers(self, self._unpacker)
        self.rest = RestAfterArming(self)
        self.check = MessageCheck(context, peer.budget.checks)
        self._choose_pace()
        compose_when_switched(self, self._compose_gates)
        self._received = 0
        self._report_at = _REPORTS_AFTER  # messages received
        self._delivered = 0
        self._dropped: Counter[str] = Counter()
        self._malformed = ""
        self._before: tuple[str, ReceivedReport] | None = None
        self._report: SentReport | None = None
        self.report_now: SentReport | None = None
        self._sender_ledger = Ledger()
        self.offered: Qos | None = None
        self._subscriber_qos: Qos | None = None
        self._unmatched_since: float | None = None  # s, since when DDS lists subscriptions and matches none
        self.others: Collection[Endpoint] = ()
        self.clocks: frozenset[str] = frozenset()
        self._asked_at = float("-inf")
        self._received_before = 0
        self._expired_before = 0
        self._hint = ("", "")
        self._alive = False  # a publisher on the sending side, by its liveliness lease
        self._asserts_again: asyncio.TimerHandle | None = None

    # --- setting up

    def open(self, route_id: int) -> None:
        """Begin a new opening, without a report of the sender yet."""
        self.report_now = None
        # Nobody here hears the type of the last one's publishers, and a participant can publish no second type.
        if self._hint[0] not in ("", self.type_name):
            self.outputs.close()
        super().open(route_id)

    def close(self, reason: str) -> None:
        """End the opening, and keep its counts: the sender gets them with the next opening, which counts from 0."""
        if self._unpacker.withdraw(wait=self.arming.held):
            self._received += 1
            self._delivered += 1
        if self._received:
            self._before = self.instance, self._received_report()
            self._received = self._delivered = 0
            self._report_at = _REPORTS_AFTER
            self._dropped.clear()
        self._unpacker.clear()
        self._alive = False
        self.outputs.set_alive(False)
        super().close(reason)

    def described(self, description: Describe) -> None:
        """Make the publishers for the messages that the sender describes, or refuse the route."""
        # Asked before the event, because the sender describes its messages again whenever it adds a source.
        first = self.life.phase is RoutePhase.ACCEPTED
        if not self.life.handle(RouteEvent.DESCRIBE):
            return
        if not self._agrees(description):
            return
        type_and_qos = (description.type, description.type_hash, description.qos)
        if (self.type_name, self.type_hash, self.qos) != type_and_qos:
            first = True
            self.outputs.close()
        elif first:
            # A new opening numbers its sources from 0. What late joiners get stays with its source.
            self.outputs.renumber(description.sources)
        # The sender leaves the history out, too; here nothing depends on its word.
        qos = without_history(description.qos) if self.arming.required else description.qos
        spec = TopicSpec(self.remote_topic, description.type, description.type_hash, bounded(qos))
        try:
            self.outputs.make(spec, description.sources)
            # Now, as a rest that does not fit the type must refuse the route instead of failing when it is needed.
            self.rest.prepare(spec)
        except (RosError, LatchedFullError) as error:
            self.outputs.close()  # a refused topic must not seem to have a publisher
            self._refuse_type(str(error))
            return
        self.type_name, self.type_hash, self.qos = type_and_qos
        self.offered = spec.qos
        self.settle_age()
        self.check.begin(description.type)
        newest: dict[bytes, int] = {}
        if first:
            newest = self.outputs.opened()
            self.log_other_end(description.type)
            self.log(Level.INFO, EventCode.ROUTE_CONNECTED, f"← {self.transport.name} connected ({description.type})")
        self.peer.send(Ready(route=self.id, sources=len(self.outputs), before=self._counted_before(), newest=newest))
        self.life.handle(RouteEvent.READY)
        self.judge_again()
        self.advance()

    def told_of_publishers(self, publishers: Publishers) -> None:
        """Take the publishers that the sending side has now."""
        self.outputs.present(publishers.present)
        began, self._alive = publishers.alive and not self._alive, publishers.alive
        self.outputs.set_alive(self._alive)
        # Other bridges of this domain first have to hear that these are no publishers of a node's.
        self._assert_liveliness(_ANNOUNCED_WITHIN if began else 0.0)

    def _assert_liveliness(self, after: float = 0.0) -> None:
        """Have subscriptions here see the publishers of the sending side alive as long as they are, `after` s."""
        if self._asserts_again is not None:
            self._asserts_again.cancel()
            self._asserts_again = None
        lease = self.qos.liveliness_lease_duration if self.qos is not None else 0.0
        if not self._alive or not lease:
            return
        if after:
            self._asserts_again = self.context.loop.call_later(after, self._assert_liveliness)
            return
        count = self.outputs.assert_liveliness() if self.crossing.flows else 1
        self._asserts_again = self.context.loop.call_later(parts_of_lease(lease, count), self._assert_liveliness)

    def _counted_before(self) -> ReceivedReport | None:
        """Return the counts of the last opening with messages, or None if it was with another process of the peer."""
        if self._before is None or self._before[0] != self.peer.instance:
            return None  # another one has openings of the same ids
        return self._before[1]

    def _agrees(self, description: Describe) -> bool:
        """Whether the described type may be published here; otherwise refuse it, now or once the reason is clear."""
        agreed = full_type(self.proposal.type)
        if agreed and description.type != agreed:  # arming may depend on the type
            self._refuse_type(TypeClash.NOT_AGREED(there=description.type, agreed=agreed))
            return False
        installed = self.context.ros.installed_hash(description.type)
        if not installed or installed == description.type_hash:
            return True
        opening = self.id

        def refuse(difference: str) -> None:
            # The answer may take seconds. By then the route may have another opening, with another type.
            if self.id == opening:
                hashes = TypeClash.HASHES(there=description.type_hash, here=installed)
                self._refuse_type(TypeClash.VERSIONS(type=description.type, difference=difference or hashes))

        self.peer.compare_types(opening, (TypeVersion(description.type, description.type_hash),), refuse)
        return False

    def _refuse_type(self, reason: str) -> None:
        # `refuse` ends the opening, and its id with it.
        route_id = self.id
        self.refuse(EventCode.ROUTE_TYPE_DIFFERS, Reason(reason))
        self.peer.send(Refuse(route=route_id, code="type_differs", reason=sanitize_text(reason)))

    def disarm(self, why: Disarmed, reason: str = "") -> None:
        """Close the publishers, and with them the messages that they hold for slow subscribers; then publish the rest.

        Every end of an arming passes here. Nothing that moves can follow the rest: `deliver` publishes nothing from now
        on, and a rest's own publisher is not theirs.
        """
        self._unpacker.withdraw(wait=True)
        self.outputs.close()
        super().disarm(why, reason)
        self.lapsed()

    def lapsed(self) -> None:
        """Publish the rest, as nothing passes any more, at least for now."""
        if self.rest.message is not None:
            self._unpacker.withdraw(wait=True)
            self.rest.message.begin()
            self.peer.report_soon(self)

    @property
    def velocity(self) -> Velocity | None:
        return velocity_on(self.context, self.remote_topic)

    def _advance(self) -> None:
        """Open the channel once there is a publisher, and look for subscribers."""
        if not self.outputs:
            # A sender without publishers takes the type of the subscriptions here.
            self._hint = type_hint(self.ends, self.remote_topic)
            return
        if self.life.accepted and self.channel is None:
            # While it is paused, too: the other side may not know yet, and frames without a channel hold up all others.
            self.peer.open_channel(self)
        matched, now = self.outputs.subscriber_count, self.context.now()
        if matched:
            self._unmatched_since = None
        if matched and matched == self.audience.count and now - self._asked_at < _ASKED_EVERY:
            return  # the same ones, most likely: to ask for them costs too much to do so at every change of the graph
        self._asked_at = now
        self.endpoints = self.ends.subscriptions(self.remote_topic)
        if not self.endpoints:
            self._unmatched_since = None
        elif not matched and self._unmatched_since is None:
            self._unmatched_since = now
        # The sender's publishers may have left, and an operator there may publish by hand.
        self._hint = agreed_type(self.endpoints)
        requested = [endpoint.qos for endpoint in self.endpoints]
        self._subscriber_qos = match_subscriptions(requested) if requested else None
        if self.offered is None:
            return
        self.audience = audience(self.type_name, self.offered, self.endpoints, matched)
        # Only then: it searches the graph, and only a clash needs the result.
        clash = any(each.cause == Cause.QOS_INCOMPATIBLE for each in self.audience.deaf)
        self.others = tuple(self.ends.publishers(self.remote_topic)) if clash else ()
        self.clocks = _further_clocks(self) if self.type_name == CLOCK else frozenset()

    def destroy(self) -> None:
        """End it for good, its publisher too."""
        # First: it disarms, which begins the rest. `rest.close` then lets that go on to its end.
        super().destroy()
        self.outputs.close()
        self.rest.close()
        self.check.end()

    def back(self) -> None:
        super().back()
        self._flows_since = self.context.now()  # what waited for the link is not late
        self.silence.rearm(self._flows_since)  # nor is its topic silent

    def set_check(self) -> None:
        self.check.set()

    # --- messages

    def _compose_gates(self) -> None:
        batch, arriving, leaving = incoming_gates(self)
        self._gates = chained(batch), chained(arriving), chained(leaving)

    def renew_tap(self) -> None:
        super().renew_tap()
        self._choose_pace()

    def _choose_pace(self) -> None:
        # Here, so that without a tap no message is asked for it.
        self._hand_on = self._publish if self.peek_slot.tap is None else self._publish_one_by_one

    def deliver(self, messages: Sequence[Message]) -> None:
        """Publish messages that arrived whole and authentic, or let them wait for later turns of the I/O loop."""
        if self._unpacker.holds:
            self._unpacker.wait(messages)
            return
        batch, began = self._gates[0], self.context.now()
        if batch is not None and (why := batch(NO_SAMPLE, began)) is not None:
            self._refuse(why, len(messages))
            return
        if not self.outputs.sinks:
            return
        now, offset = self.context.stamps.now(), self.peer.stamps.offset
        if offset is None or not LATE < (now - messages[0][1]) / 1e9 + offset < OUTLIVE.high or self._must_be_fresh:
            self._hand_on(messages, now, began)
            return
        allowed = self._catch_up.allowed(messages, began, max(self.meter.rate, self.meter.usual_rate or 0.0))
        self._hand_on(messages[:allowed], now, began)
        if later := messages[allowed:]:
            self._unpacker.pause(later, EVERY)

    @property
    def _must_be_fresh(self) -> bool:
        """Whether gates look at its messages, as at commands, or a latched topic's publishers keep them."""
        return self.is_latched or self._gates != _NO_GATES

    def _publish_one_by_one(self, messages: Sequence[Message], now: int, began: float) -> None:
        """Publish messages as `_publish`, of which the last of those that it gets is shown: here each."""
        for at, message in enumerate(messages):
            self._publish((message,), now, began)
            if self._unpacker.holds:
                self._unpacker.wait(messages[at + 1 :])
                return

    def _publish(self, messages: Sequence[Message], now: int, began: float) -> None:
        """Publish messages that came at `now` (ns of the clock of stamps) and `began` (s), as `deliver`."""
        (batch, arriving, leaving), sinks, sent = self._gates, self.outputs.sinks, now
        checker = self.check.checker
        # With a bounded number of lengths, a check takes next to no time, and nothing of the budget: one call less.
        check = None if checker is None else self.check.check if checker.loops else checker.check
        count, size, number, published = 0, 0, 0, b""
        # An iterator, so that `*following` below is the rest after a message that has to wait.
        following = iter(messages)
        for message in following:
            payload, stamp, flags = message
            if batch is not None:
                number, payload, flags = unleased(payload, flags)
            # Before the gates: what waits comes here again, and would take a second token of the rate.
            if flags & ZSTD and not self._unpacker.begin((payload, stamp, flags)):
                self._unpacker.wait((message, *following))
                break
            sample = NO_SAMPLE if arriving is leaving is None else GatedMessage(stamp, number)
            if arriving is not None and (why := arriving(sample, began)) is not None:
                self._unpacker.forget()
                self._refuse(why)
                continue
            self._received += 1
            # A peer may name any of 16 sources, also one that got no publisher here.
            if flags >> SOURCE_SHIFT >= len(sinks):
                self._drop(_NotPublishedError("unknown source"))
                continue
            sink = sinks[flags >> SOURCE_SHIFT]
            look = None if leaving is None else partial(leaving, sample, began)
            try:
                header, content = self._unpack(payload, flags) if flags & _PACKED else (_NO_HISTORY, payload)
                if check is not None:
                    check(content)
                if isinstance(sink, LatchedTopic):
                    self._publish_latched(sink, header, content, look, following)
                elif len(content) > PUBLISHED_ASIDE and self.purpose.in_graph:
                    self._publish_aside(sink, content, len(payload), GatedMessage(stamp, number), following)
                    continue
                elif (why := sink.publish(content, look)) is not None:
                    raise _NotPublishedError(CAUSES[why])
            except _CAUGHT as error:
                self._drop(error)
            else:
                count, size = count + 1, size + len(payload)
                published, sent = content, stamp  # the last one's are the batch's sample
        if count:
            self._published(count, size, published, (now - sent) / 1e9, began)
        if self._received >= self._report_at:
            self._report_at = self._received + _REPORTS_AFTER
            self.peer.report_soon(self)

    def _published(self, count: int, size: int, last: bytes, took: float, began: float) -> None:
        """Note messages that were published, of `size` bytes together.

        Args:
            took: s, by the clocks of both sides.
            began: s, when they arrived.
        """
        self._delivered += count
        if last and (rest := self.rest.message) is not None and self.arming.required and rest.moved(last, self.outputs):
            self.peer.report_soon(self)
        latency = None if (offset := self.peer.stamps.offset) is None else took + offset
        if latency is not None and latency <= began - self._flows_since:  # else it was kept from before
            self.latency.add(latency)
        if last and self.peek_slot.wanted:
            self._show(last, latency)
        self.count(count, size, began)

    def _show(self, content: bytes, latency: float | None) -> None:
        slot, now = self.peek_slot, self.context.wall_ns()
        if slot.tap is not None:
            slot.tap(content, now, now - int((latency or 0.0) * 1e9), b"", 0)
        if slot.is_awaited:
            clock = (self.peer.clock.offset, self.peer.clock.uncertainty)
            slot.put(peeked(self, content, now, latency=latency, clock=clock), self.context.now())

    def _refuse(self, why: Refused, messages: int = 1) -> None:
        """Count messages that arrived, and that a gate keeps back."""
        if self.idle:
            self.wake()
        self._received += messages
        self._dropped[CAUSES[why]] += messages
        if why is Refused.TOO_FAST:
            allowed = f"the {self.limit.here:g} Hz that this side allows"
            text = f"the other side sends more than {allowed}: the rest is left out"
            self.notices.message_error(EventCode.ROUTE_TOO_FAST, text)

    def _unpack(self, payload: bytes, flags: int) -> tuple[HistoryHeader, bytes]:
        """Return a message's history header and its content."""
        if flags & LEASED:  # on a route that needs no arming
            raise _NotPublishedError("disarmed")
        header, rest = split_history(payload) if flags & HISTORY else (_NO_HISTORY, payload)
        return header, self._unpacker.unpack(rest) if flags & ZSTD else rest

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
        self._received -= 1
        batch, _, leaving = self._gates
        look = None if batch is leaving is None else partial(self._last_look, sample)
        took, began = (self.context.stamps.now() - sample.stamp) / 1e9, self.context.now()
        shown = content if self.rest.message is not None or self.peek_slot.wanted else b""

        def then(why: Refused | RosError | None) -> None:
            self._received += 1
            if why is None:
                self._published(1, size, shown, took, began)
                return
            if isinstance(why, Refused):
                sink.unreserve()
            self._drop(why)

        # First, as a message that may not be published lets them go on at once. Too many of them end the opening.
        self._unpacker.wait(later)
        if self._unpacker.holds:
            self._unpacker.publish(publisher, content, look, then)

    def _last_look(self, sample: GatedMessage) -> Refused | None:
        """Return the reason why a message may not be published now that has passed all gates before."""
        (batch, _, leaving), now = self._gates, self.context.now()
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
        if not topic.publish(header, content, look, partial(self._not_published, self.id)):
            raise _NotPublishedError("already published")
        # Unpacked, they would take memory until a long message is published.
        if topic.is_busy:
            self._unpacker.wait(later)

    def _not_published(self, opening: int, why: Refused | RosError) -> None:
        """Note that a message counts as delivered in an opening, and is not published."""
        if self.id == opening:  # else its counts are closed
            self._delivered -= 1
            self._drop(why)

    def _drop(self, error: Refused | Exception) -> None:
        """Count a message that is not published, and tell operators why."""
        if self.idle:
            self.wake()
        if isinstance(error, Refused | _NotPublishedError):
            self._dropped[CAUSES[error] if isinstance(error, Refused) else str(error)] += 1
            return
        cause, code = next(found for kind, found in _FAILURES.items() if isinstance(error, kind))
        self._dropped[cause] += 1
        text = str(error)
        if isinstance(error, MalformedError):
            self._malformed = sanitize_text(text)
            text = malformed_text(self.type_name, self.peer.name, error)
        self.notices.message_error(code, text)

    @property
    def _came_here(self) -> int:
        return self._received

    @property
    def _passed(self) -> int:
        return self._received + self.meter.count

    def _judge_lateness(self, now: float, *, flows: bool, learns: bool) -> None:
        uncertainty = self.peer.stamps.uncertainty
        # What waited for the link is not late, nor what waits behind that.
        if uncertainty is None or not flows or self.judged.peer.cause == Cause.CATCHING_UP:
            self.lateness.reset()
        else:
            recent = self.latency.recent
            self.lateness.judge(recent, uncertainty, self.late_after, now, recent, learns=learns)

    def _signs(self) -> Signs:
        return *super()._signs(), self._report, self.audience, self.others, self.clocks

    def _next_change(self, now: float, crossing: Crossing) -> float:
        return now if self._sender_ledger.open else super()._next_change(now, crossing)

    @property
    def _is_polled(self) -> bool:
        # Histories of publishers that have gone are dropped, and nodes are asked for the description of a type.
        return super()._is_polled or self.is_latched or (bool(self.type_name) and self.check.checker is None)

    def _follow(self, now: float, crossing: Crossing) -> None:
        super()._follow(now, crossing)
        self.outputs.tick()
        if self.purpose.in_graph:  # else no node knows the type
            self.check.ask_subscribers(self.remote_topic, self.endpoints)
        expired = self.channel.counts().expired if self.channel is not None else 0
        if self._received != self._received_before:
            self._received_before, self._expired_before = self._received, expired
        elif expired - self._expired_before >= _INCOMPLETE_IN_A_ROW:
            self.notices.message_error(
                EventCode.ROUTE_INCOMPLETE,
                "no message arrives complete, because fragments are lost: use protocol: tcp, or smaller messages",
            )

    # --- the ledger

    def reported(self, report: SentReport) -> None:
        """Take the sender's ledger, which is right for both sides."""
        failed_before = _failure_of(self.judged.peer)
        self._report = report
        # Until the first report of an opening, the verdict is that this side waits for it.
        if self.report_now is None:
            self.judge_again()
        self.report_now = report
        self.wake()
        self.judged.receive(report.verdict, self.context.now())
        peer = self.judged.peer
        self.notices.set_loop(peer.text if peer.cause == Cause.LOOP else "")
        left_out = peer.cause == Cause.TYPE_CONFLICT and peer.state is not State.DOWN
        self.notices.set_warning(peer.text if left_out else "")
        failure = _failure_of(self.judged.peer)
        if failure and failure != failed_before:
            self.log(Level.ERROR, EventCode.ROUTE_SUBSCRIBE_FAILED, f"on the other side: {failure}")
        ledger = reported_ledger(report, self.context.wall())
        if ledger is None:
            self.notices.doubt(self.peer.instance, "the last plausible ones are shown")
        else:
            self._sender_ledger = ledger

    def ledger(self) -> Ledger:
        """Return the ledger of the sender's last report."""
        return self._sender_ledger

    def news(self) -> ReceivedReport | None:
        """Return the report to send to the peer now, or None if nothing has changed.

        While messages are in flight the same counts are sent again: the sender counts messages as lost that are not in
        a report after some time.
        """
        report = self._received_report()
        before, self._last_report = self._last_report, report
        awaits = self._sender_ledger.open and self.life.phase is RoutePhase.READY
        if report == _with_latencies(before, report) and not awaits:
            return None
        verdict = lasting(report.verdict, self.verdict(), self.context.now())
        return msgspec.structs.replace(report, verdict=verdict)

    def _received_report(self) -> ReceivedReport:
        counts = self.channel.counts() if self.channel is not None else Counts(newest=None)
        return ReceivedReport(
            route=self.id,
            received=self._received,
            delivered=self._delivered,
            expired=counts.expired,
            incomplete=counts.incomplete,
            newest=self._received + counts.lost if counts.newest is None else counts.newest,
            dropped=dict(self._dropped),
            subscribers=self.audience.count,
            subscriber_qos=self._subscriber_qos,
            type=self._hint[0],
            type_hash=self._hint[1],
            latency=self.latency.recent,
            latency_p50=self.latency.p50,
            latency_p99=self.latency.p99,
            jitter=self.latency.jitter,
            verdict=record_of(self.verdict()),
            nodes=self.audience.nodes,
            deaf=tuple(DeafRecord(each.node, each.cause, each.reason) for each in self.audience.deaf),
            came_before=self.came_before,
            malformed=self._malformed,
            velocity=self.velocity if self.arming.required else None,
        )

    # --- stages and verdict

    def stages(self) -> tuple[Stage, ...]:
        """Return the stages from the publisher to the subscriber, in order."""
        report, peer, known, kept = self.report_now, self.judged.peer, bool(self.type_name), self.has_kept
        if report is None or report.publishers:
            seen = Stage("publisher seen", None if report is None else True)
        else:
            seen = Stage("publisher seen", False, f"no publisher of {self.far_topic} on the other side")
        # A subscription that does not match is no obstacle to others that do.
        deaf = () if self.audience.count else self.audience.deaf
        clash = next((each.reason for each in deaf if each.cause == Cause.QOS_INCOMPATIBLE), "")
        if not clash and peer.cause == Cause.QOS_INCOMPATIBLE:
            clash = peer.text
        matches = Stage("QoS compatible", not clash if known else None, clash)
        failure = self.notices.loop or _failure_of(peer)
        takes = report is not None and report.subscribed
        subscribed = Stage("subscribed", False if failure else takes or None, failure)
        sent = Stage("sent", (report is not None and report.offered > 0) or kept or None)
        undelivered = "" if self._received else self.notices.undelivered
        received = Stage("received", self._received > 0 or kept or None, undelivered)
        published = Stage("published", self._delivered > 0 or kept or None)
        if self.audience.count:
            heard = Stage("subscriber seen", True)
        else:
            why = no_subscriber(self.local_topic, self.context.domain_id, self.audience.deaf)
            heard = Stage("subscriber seen", None, why)
        before = seen, Stage("type known", known or None, self.type_name or peer.text), matches, subscribed
        return stages_with_link(self, before, (sent, received, published, heard))

    @property
    def unmatched(self) -> bool:
        since = self._unmatched_since
        return since is not None and self.context.now() > since + _MATCHED_WITHIN

    @property
    def has_kept(self) -> bool:
        """Whether messages are kept here. The peer's verdict tells whether newer ones exist."""
        return self.outputs.has_kept

    @property
    def silence_counts(self) -> bool:
        """Whether silence counts while messages are in transit; otherwise the sending side judges."""
        return super().silence_counts and (self.silence.own or self._sender_ledger.open > 0)

    @property
    def present_type(self) -> TypeVersion:
        left = self._report is not None and not self._report.publishers
        return TypeVersion() if left else TypeVersion(self.type_name, self.type_hash)

    @property
    def publisher_nodes(self) -> tuple[str, ...]:
        return self._report.nodes if self._report else ()

    def end_qos(self) -> tuple[Qos | None, Qos | None]:
        return self._report.publisher_qos if self._report else None, self._subscriber_qos


def _further_clocks(route: IncomingRoute) -> frozenset[str]:
    """Return the nodes and the links that publish a route's clock here besides it."""
    nodes = {each.node for each in route.ends.publishers(route.remote_topic) if each.type_name == CLOCK}
    links = route.context.announcements.publishing_links(route.remote_topic, route.peer.name)
    return frozenset(nodes | {f"link {each}" for each in links})
