"""The receiving half of a topic's route: it counts, checks and publishes the peer's messages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import msgspec

from rsb_bridge.cdr.description import TypeClash, TypeVersion
from rsb_bridge.channel.channel import Counts, ReceivingChannel
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.demands import full_type
from rsb_bridge.model.qos import parts_of_lease
from rsb_bridge.model.reason import Reason
from rsb_bridge.model.snapshot import Level, State
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.distribution import package_of
from rsb_bridge.ros.ros_interface import EndPlace, RosError, TopicSpec
from rsb_bridge.route.arming import without_history
from rsb_bridge.route.combined_verdict import lasting, record_of
from rsb_bridge.route.half import Carried
from rsb_bridge.route.idling import STEADY_FOR
from rsb_bridge.route.incoming_path import REPORTS_AFTER, IncomingPath
from rsb_bridge.route.latched import LatchedFullError
from rsb_bridge.route.lazy import LazyReceiver
from rsb_bridge.route.ledger import reported_ledger
from rsb_bridge.route.lifecycle import RouteEvent, RoutePhase
from rsb_bridge.route.listeners import Listeners
from rsb_bridge.route.message_check import MessageCheck
from rsb_bridge.route.rest_message import RestAfterArming
from rsb_bridge.route.source_publishers import bounded
from rsb_bridge.route.topic_facts import ReceiverFacts, failure_of
from rsb_bridge.route.topic_flow import TopicFlow
from rsb_bridge.route.topic_verdict import OF_RECEIVER
from rsb_bridge.wire.messages import Describe, Publishers, Ready, Refuse
from rsb_bridge.wire.records import DeafRecord, ReceivedCounts, ReceivedReport, SentCounts, SentReport

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Sequence

    from rsb_bridge.route.crossing import Crossing
    from rsb_bridge.route.half import Rules
    from rsb_bridge.route.idling import Signs
    from rsb_bridge.route.route import Route

_INCOMPLETE_IN_A_ROW = 3
"""Messages given up incomplete since the last whole one. A round figure: nothing was measured. One may be bad luck."""
_ANNOUNCED_WITHIN = 0.25
"""Seconds in which other bridges hear an announcement, which is sent and read within 0.1 s. A round figure."""


class Receiver:
    """Publishes here what the peer sends.

    Attributes:
        path: the path of the messages, with the counts of the present opening.
        rest: follows the last message of an arming.
    """

    peer_report: ClassVar[Any] = SentCounts, SentReport
    outgoing: ClassVar[bool] = False
    duplex: ClassVar[bool] = False
    rules: ClassVar[Rules[Any]] = OF_RECEIVER

    def __init__(self, route: Route) -> None:
        self.route = route
        self.carried: Carried[ReceivingChannel] = Carried()
        self.flow = TopicFlow(route, self.carried)
        # The last ones of the present opening.
        self._last_counts: tuple[object, ...] = ()
        self._last_report: ReceivedReport | None = None
        self._reported: tuple[object, ...] = ()  # the contents of that, which take less time to compare
        self.rest = RestAfterArming(self.flow)
        self.check = MessageCheck(route.context, route.peer.budget.checks)
        self.path = IncomingPath(self.flow, self.rest, self.check)
        self.outputs = self.path.outputs
        self.deliver, self.restart_measuring = self.path.deliver, self.flow.restart_measuring
        self._before: tuple[str, ReceivedCounts] | None = None
        self._resends = 0  # as the last `Publishers` said, for the next process of the sending side
        self.listeners = Listeners(self.flow, self.outputs)
        self.lazy = LazyReceiver(route, self.flow, self.outputs)
        self._setbacks: tuple[object, ...] = ()  # at the last tick
        self._missing: tuple[object, ...] = ()  # of a channel's counts, by the last report
        self._percentiles_due = 0.0  # s, from when on reports have them if nobody looks
        self._received_before = 0
        self._expired_before = 0
        self._alive = False  # a publisher on the sending side, by its liveliness lease
        self._asserts_again: asyncio.TimerHandle | None = None
        self.facts = ReceiverFacts(self.flow, self.path, self.listeners)

    # --- setting up

    def open(self) -> None:
        """Begin a new opening, without a report of the sender yet."""
        self.facts.report_now = None
        # Nobody here hears the type of the last one's publishers, and a participant can publish no second type.
        if self.listeners.hint[0] not in ("", self.carried.type_name):
            self.outputs.close()
        self._forget_reports()
        self.flow.full_at = None

    def close(self, reason: str) -> None:
        """End the opening, and keep its counts: the sender gets them with the next opening, which counts from 0."""
        if self.path.unpacker.withdraw(wait=self.route.arming.held):
            self.path.received += 1
            self.path.delivered += 1
        if self.path.received:
            self._before = self.route.instance, self._counts()
            self.path.received = self.path.delivered = 0
            self.path.report_at = REPORTS_AFTER
            self.path.dropped.clear()
        self.path.forget_transforms()
        self.path.unpacker.clear()
        self._alive = False
        self.lazy.end()
        self.outputs.set_alive(False)
        self.flow.drivers.there = ()

    def described(self, description: Describe) -> None:
        """Make the publishers for the messages that the sender describes, or refuse the route."""
        # Asked before the event, because the sender describes its messages again whenever it adds a source.
        first = self.route.life.phase is RoutePhase.ACCEPTED
        if not self.route.life.handle(RouteEvent.DESCRIBE):
            return
        if not self._agrees(description):
            return
        type_and_qos = (description.type, description.type_hash, description.qos)
        if (self.carried.type_name, self.carried.type_hash, self.flow.qos) != type_and_qos:
            first = True
            self.outputs.close()
        elif first:
            # A new opening numbers its sources from 0. What late joiners get stays with its source.
            self.outputs.renumber(description.sources)
        if not self.outputs:
            self.route.context.place(self.route, description.nodes)
        # The sender leaves the history out, too; here nothing depends on its word.
        qos = without_history(description.qos) if self.route.arming.required else description.qos
        spec = TopicSpec(self.route.remote_topic, description.type, description.type_hash, bounded(qos))
        try:
            self.outputs.make(spec, description.sources)
            # Now, as a rest that does not fit the type must refuse the route instead of failing when it is needed.
            self.rest.prepare(spec)
        except (RosError, LatchedFullError) as error:
            self.outputs.close()  # a refused topic must not seem to have a publisher
            self._refuse_type(str(error))
            return
        if self.carried.type_name not in ("", description.type):
            self.listeners.type_before = self.carried.type_name
        self.flow.knows(*type_and_qos)
        self.listeners.offered = spec.qos
        self.route.settle_age()
        self.check.begin(description.type)
        if first and self.route.purpose.in_graph:
            self.path.choose_transforms(opens=True)
        newest: dict[bytes, int] = {}
        if first:
            newest = self.outputs.opened()
            self.flow.end.log_other(description.type)
            text = f"← {self.route.transport.name} connected ({description.type})"
            self.route.log(Level.INFO, EventCode.ROUTE_CONNECTED, text)
        ready = Ready(
            route=self.route.id,
            sources=len(self.outputs),
            before=self._counted_before(),
            newest=newest,
            resends=self._resends,
        )
        self.route.peer.send(ready)
        self.route.life.handle(RouteEvent.READY)
        self.route.judge_again()
        self.route.advance()

    def told_of_publishers(self, publishers: Publishers) -> None:
        """Take the publishers that the sending side has now."""
        self.outputs.present(publishers.present)
        self._resends = publishers.resends
        began, self._alive = publishers.alive and not self._alive, publishers.alive
        self.outputs.set_alive(self._alive)
        # Other bridges of this domain first have to hear that these are no publishers of a node's.
        self._assert_liveliness(_ANNOUNCED_WITHIN if began else 0.0)

    def _assert_liveliness(self, after: float = 0.0) -> None:
        """Have subscriptions here see the sending side's publishers alive as long as they are, from in `after` s on."""
        if self._asserts_again is not None:
            self._asserts_again.cancel()
            self._asserts_again = None
        lease = self.flow.qos.liveliness_lease_duration if self.flow.qos is not None else 0.0
        if not self._alive or not lease:
            return
        if after:
            self._asserts_again = self.route.context.loop.call_later(after, self._assert_liveliness)
            return
        count = self.outputs.assert_liveliness() if self.route.crossing.flows else 1
        self._asserts_again = self.route.context.loop.call_later(parts_of_lease(lease, count), self._assert_liveliness)

    def _counted_before(self) -> ReceivedCounts | None:
        """Return the counts of the last opening with messages, or None if it was with another process of the peer."""
        if self._before is None or self._before[0] != self.route.peer.instance:
            return None  # another one has openings of the same ids
        return self._before[1]

    def _agrees(self, description: Describe) -> bool:
        """Whether the described type may be published here; otherwise refuse it, now or once the reason is clear."""
        agreed = full_type(self.route.proposal.type)
        if agreed and description.type != agreed:  # arming may depend on the type
            self._refuse_type(TypeClash.NOT_AGREED(there=description.type, agreed=agreed))
            return False
        installed = self.route.context.ros.installed_hash(description.type)
        if description.keyed and not installed:
            package = package_of(description.type.partition("/")[0])
            self._refuse_type(TypeClash.KEYED(type=description.type, package=package))
            return False
        if not installed or installed == description.type_hash:
            return True
        opening = self.route.id

        def refuse(difference: str) -> None:
            # The answer may take seconds. By then the route may have another opening, with another type.
            if self.route.id == opening:
                hashes = TypeClash.HASHES(there=description.type_hash, here=installed)
                self._refuse_type(TypeClash.VERSIONS(type=description.type, difference=difference or hashes))

        self.route.peer.compare_types(opening, (TypeVersion(description.type, description.type_hash),), refuse)
        return False

    def _refuse_type(self, reason: str) -> None:
        # `refuse` ends the opening, and its id with it.
        route_id = self.route.id
        self.route.refuse(EventCode.ROUTE_TYPE_DIFFERS, Reason(reason))
        self.route.peer.send(Refuse(route=route_id, code="type_differs", reason=sanitize_text(reason)))

    @property
    def places(self) -> Sequence[EndPlace]:
        return (EndPlace("publisher", self.route.remote_topic, self.route.peer.name),)

    def move(self) -> bool:
        if self.outputs.needs_sender and not (self.route.id and self.route.peer.linked):
            return False  # nobody would repeat what late joiners get
        try:
            repeated = not self.outputs.move()
        except (RosError, LatchedFullError) as error:
            self.route.notices.message_error(EventCode.ROUTE_PUBLISH_FAILED, str(error))
            return True
        if repeated:
            self.outputs.close()
            text = "its publisher belongs to another node now: what is latched is sent again"
            self.route.request_reopen(EventCode.ROUTE_MOVED, text, Level.INFO)
        return True

    def disarm(self) -> None:
        """Close the publishers, and with them the messages that they hold for slow subscribers.

        Every end of an arming passes here, and `lapse`, which publishes the stop message, follows. Nothing that moves
        can come after that: `deliver` publishes nothing from now on, and the stop message has a publisher of its own.
        """
        self.path.unpacker.withdraw(wait=True)
        self.outputs.close()

    def lapse(self) -> None:
        """Publish the stop message."""
        if self.rest.message is not None:
            self.path.unpacker.withdraw(wait=True)
            self.rest.message.begin()
            self.route.peer.report_soon(self.route)

    def proceed(self) -> None:
        """Open the channel once there is a publisher, and look for subscribers."""
        if not self.outputs:
            self.listeners.look_without_publisher()
        else:
            if self.route.life.accepted and self.carried.channel is None:
                # While it is paused, too: the other side may not know yet, and frames without a channel hold up all
                # others.
                self.route.peer.open_channel(self.route)
            self.listeners.look()
            self.lazy.tell()
        self._look_for_publishers()

    def _look_for_publishers(self) -> None:
        report = self.facts.report_now
        self.listeners.look_for_publishers(sends=bool(self.outputs) if report is None else report.publishers > 0)

    @property
    def rests(self) -> bool:
        return self.lazy.rests

    def destroy(self) -> None:
        """Close its publishers. The end of the opening has begun the rest; `rest.close` lets that go on to its end."""
        self.outputs.close()
        self.rest.close()
        self.check.end()
        self.path.forget_transforms()

    def resume(self) -> None:
        self._forget_reports()
        self.flow.flows_since = self.route.context.now()  # what waited for the link is not late
        self.flow.silence.rearm(self.flow.flows_since)  # nor is its topic silent

    def measure(self, now: float, crossing: Crossing, *, learns: bool) -> None:
        self.flow.latency.tick(now)
        if self.facts.report_now is not None:
            self.route.meter.publishers = self.facts.report_now.publishers
        if self.listeners.further:  # whether other links' messages may come changes without the graph
            self.flow.drivers.look(self.listeners.further)
        self._judge_lateness(now, flows=crossing.flows, learns=learns)
        self.route.age.update(self.path.received, now)
        if not learns and self.route.link_full is not None:  # in this order: on a full link, nothing is learned
            self.flow.full_at = now
        if self.route.age.only_newest or self.flow.left_out.is_on:
            self.flow.left_out.judge(self.facts.ledger, now)

        self._setbacks = self._present_setbacks()

    def _present_setbacks(self) -> tuple[object, ...]:
        """Return values of which some change with each message that arrives and is not published, or not whole."""
        path = self.path
        return *path.dropped.values(), path.malformed, self._missing

    def goes_on(self, now: float) -> bool:
        latency = self.flow.latency.newest or 0.0
        return self._present_setbacks() == self._setbacks and self.flow.goes_on(now, latency)

    def configure(self) -> None:
        self.flow.set_stale_after()
        self.check.set()
        self.choose_transforms()

    def choose_transforms(self) -> None:
        """Ask features anew what changes the messages of the present opening."""
        if self.route.life.phase is RoutePhase.READY and self.route.purpose.in_graph:
            self.path.choose_transforms(opens=False)

    def suspend(self) -> None:
        """Nothing waits here."""

    def flush(self) -> None:
        """Nothing is sent here."""

    # --- messages

    @property
    def passed(self) -> int:
        return self.path.received + self.route.meter.count

    def _judge_lateness(self, now: float, *, flows: bool, learns: bool) -> None:
        uncertainty = self.route.peer.stamps.uncertainty
        # What waited for the link is not late, nor what waits behind that.
        if uncertainty is None or not flows or self.route.judged.peer.cause == Cause.CATCHING_UP:
            self.flow.lateness.reset()
        else:
            recent = self.flow.latency.recent
            self.flow.lateness.judge(recent, uncertainty, self.flow.late_after, now, recent, learns=learns)

    def signs(self) -> Signs:
        listeners = self.listeners
        audience, report = self.flow.audience, self.facts.report
        drivers = self.flow.drivers.here
        after, published = self.flow.silence.watch.after, listeners.published
        return after, report, audience, listeners.others, listeners.clocks, drivers, published

    def next_change(self, now: float, crossing: Crossing) -> float:
        if self.facts.ledger.open:
            return now
        counts = self.facts.silence_counts
        return self.flow.next_change(now, awaited=crossing.flows, counts=counts, polled=self._is_polled)

    @property
    def _is_polled(self) -> bool:
        # Histories of publishers that have gone are dropped, nodes are asked for the description of a type, a similar
        # topic may appear, and a subscription may get no name.
        asks_for_type, listeners = bool(self.carried.type_name) and self.check.checker is None, self.listeners
        awaits = listeners.awaits_name or listeners.lacks_match
        return self.flow.is_latched or asks_for_type or self.facts.is_unpublished or awaits

    def is_well(self, now: float) -> bool:
        return self.flow.is_well(now) and not self.listeners.unmatched

    def is_calm(self, now: float) -> bool:
        return not self._is_polled and self.flow.is_calm(now)

    def act(self, now: float, crossing: Crossing) -> None:
        self.flow.act(now, awaited=crossing.flows)
        self.outputs.tick()
        if self.listeners.lacks_match:  # DDS may match them later, which changes nothing in the graph
            self.listeners.look()
        if self.facts.is_unpublished:
            self._look_for_publishers()
        if self.route.purpose.in_graph:  # else no node knows the type
            self.check.ask_subscribers(self.route.remote_topic, self.carried.endpoints)
        expired = self.carried.channel.counts().expired if self.carried.channel is not None else 0
        if self.path.received != self._received_before:
            self._received_before, self._expired_before = self.path.received, expired
        elif expired - self._expired_before >= _INCOMPLETE_IN_A_ROW:
            self.route.notices.message_error(
                EventCode.ROUTE_INCOMPLETE,
                "no message arrives complete, because fragments are lost: use protocol: tcp, or smaller messages",
            )

    # --- the ledger

    def reported(self, report: SentCounts | SentReport) -> None:
        """Take what the peer knows of the present opening."""
        if isinstance(report, SentCounts):
            self._counted(report)
            return
        failed_before = failure_of(self.route.judged.peer)
        # Until the first report of an opening, the verdict is that this side waits for it.
        if self.facts.report_now is None:
            self.route.judge_again()
        self.facts.report = self.facts.report_now = report
        self.flow.drivers.told(report.drivers)
        self.route.wake()
        self.route.judged.receive(report.verdict, self.route.context.now())
        self.lazy.told()
        peer = self.route.judged.peer
        self.route.notices.set_loop(peer.text if peer.cause == Cause.LOOP else "")
        left_out = peer.cause == Cause.TYPE_CONFLICT and peer.state is not State.DOWN
        self.route.notices.set_warning(peer.text if left_out else "")
        failure = failure_of(self.route.judged.peer)
        if failure and failure != failed_before:
            self.route.log(Level.ERROR, EventCode.ROUTE_SUBSCRIBE_FAILED, f"on the other side: {failure}")

    def _counted(self, counts: SentCounts) -> None:
        """Take the sender's ledger, which is right for both sides."""
        if not self.route.idling.is_steady(self.route.context.now()):
            self.route.wake()
        ledger = reported_ledger(counts, self.route.context.wall())
        if ledger is None:
            self.route.notices.doubt(self.route.peer.instance, "the last plausible ones are shown")
        else:
            self.facts.ledger = ledger

    def news(self) -> Sequence[ReceivedCounts | ReceivedReport]:
        news: list[ReceivedCounts | ReceivedReport] = []
        counts = self._counts()
        before = self._last_counts
        # Latencies are no news without new messages.
        self._last_counts = (
            counts.received, counts.delivered, counts.newest, counts.dropped, counts.expired, counts.incomplete,
            counts.velocity,
        )  # fmt: skip
        # While messages are in flight the same counts are sent again: the sender counts as lost what is in no report
        # after some time.
        if self._last_counts != before or (self.facts.ledger.open and self.route.life.phase is RoutePhase.READY):
            news.append(counts)
        if not self.route.idling.goes_on_now and (report := self._report()) is not None:
            news.append(report)
        return news

    def _counts(self) -> ReceivedCounts:
        counts = self.carried.channel.counts() if self.carried.channel is not None else Counts(newest=None)
        self._missing = counts[1:]
        path, latency, now = self.path, self.flow.latency, self.route.context.now()
        p50 = p99 = jitter = None
        # To sort the samples takes a while, and while nobody looks, figures may be as old.
        if now >= self._percentiles_due or self.route.peer.is_looked_at:
            self._percentiles_due = now + STEADY_FOR
            (p50, p99), jitter = latency.percentiles(), latency.jitter
        return ReceivedCounts(
            route=self.route.id,
            received=path.received,
            delivered=path.delivered,
            newest=path.received + counts.lost if counts.newest is None else counts.newest,
            latency=latency.recent,
            latency_p50=p50,
            latency_p99=p99,
            jitter=jitter,
            dropped=dict(path.dropped),
            expired=counts.expired,
            incomplete=counts.incomplete,
            velocity=self.facts.velocity if self.route.arming.required else None,
        )

    def _report(self) -> ReceivedReport | None:
        """Return what the peer does not know beside the figures, or None if it knows all."""
        verdict, audience, listeners = self.route.verdict(for_peer=True), self.flow.audience, self.listeners
        wanted, drivers, came_before = self.lazy.wanted, self.flow.drivers, self.facts.came_before
        contents = (
            self.route.id, verdict, audience, wanted, listeners.subscriber_qos, listeners.hint, listeners.published,
            came_before, self.path.malformed, drivers.here,
        )  # fmt: skip
        if contents == self._reported and self._last_report is not None:
            return None
        self._reported = contents
        report = ReceivedReport(
            route=self.route.id,
            subscribers=audience.count,
            wanted=wanted,
            subscriber_qos=listeners.subscriber_qos,
            type=listeners.hint[0],
            type_hash=listeners.hint[1],
            verdict=record_of(verdict),
            nodes=audience.nodes,
            publishers=listeners.published.nodes,
            published_as=listeners.published.near,
            deaf=tuple(DeafRecord(each.node, each.cause, each.reason) for each in audience.deaf),
            came_before=came_before,
            malformed=self.path.malformed,
            drivers=drivers.records,
        )
        if report == self._last_report:
            return None
        self._last_report = report
        return msgspec.structs.replace(report, verdict=lasting(report.verdict, verdict, self.route.context.now()))

    def _forget_reports(self) -> None:
        self._last_counts, self._last_report = (), None
