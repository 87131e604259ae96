"""The receiving half of a route: open, count, publish."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, ClassVar

import msgspec
import zstandard

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import KEPT_DEPTH, LATCHED_DEPTH
from rsb_bridge.model.qos import incompatible, match_subscriptions
from rsb_bridge.model.snapshot import Ledger, Level, Stage
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.ros.api import Publisher, RosError
from rsb_bridge.ros.graph import type_hint
from rsb_bridge.route.latched import LATCHED_LIMIT, Latched
from rsb_bridge.route.ledger import reported_ledger
from rsb_bridge.route.route import Peer, Route
from rsb_bridge.wire.framing import MESSAGE_LIMIT, ZSTD, Message
from rsb_bridge.wire.messages import Describe, Propose, Ready, Refuse
from rsb_bridge.wire.records import ReceivedReport, SentReport

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.channel.channel import ReceivingChannel
    from rsb_bridge.context import Context
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.session import Topic

EXPANSION_AT_ONCE = 4 * MESSAGE_LIMIT
EXPANSION_A_SECOND = 256 << 20
"""Bytes that a link's compressed messages may have more here than on the wire: 64 MiB of zeros come as 2 kB, and to
unpack and publish them keeps the thread of all links busy for 60 ms."""
_INCOMPLETE_IN_A_ROW = 3


class _ExpansionError(Exception):
    """A peer's compressed messages would keep this side too busy."""


class IncomingRoute(Route):
    """Publishes here what the peer sends."""

    outgoing: ClassVar[bool] = False
    channel: ReceivingChannel | None

    def __init__(self, context: Context, peer: Peer, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        super().__init__(context, peer, spec, proposal, proposed_here=proposed_here)
        self._publisher: Publisher | None = None
        self._latched: Latched | None = None
        self._decompressor = zstandard.ZstdDecompressor()
        self._received = 0
        self._delivered = 0
        self._dropped: Counter[str] = Counter()
        self._before: tuple[str, ReceivedReport] | None = None
        self._report: SentReport | None = None
        self._sender_ledger = Ledger()
        self._subscriber_qos: Qos | None = None
        self._clash = ""
        self._subscribers = 0
        self._received_before = 0
        self._expired_before = 0
        self._hint = ("", "")

    # --- setting up

    def close(self, reason: str) -> None:
        """End the opening. The next one is counted anew, as the sender does, who is told then what came of this one."""
        if self._received:
            self._before = self.instance, self.received_report()
            self._received = self._delivered = 0
            self._dropped.clear()
        super().close(reason)

    def described(self, description: Describe) -> None:
        """The sender says what it will send: have a publisher for it, or say why not."""
        if clash := self._type_clash(description):
            self._refuse_type(clash)
            return
        if self._publisher is None or self._current() != (description.type, description.type_hash, description.qos):
            self._close_publisher()
            qos = _bounded(description.qos)
            try:
                self._publisher = self.context.ros.advertise(
                    self.remote_topic,
                    description.type,
                    description.type_hash,
                    qos,
                    origin=self.peer.name,
                )
            except RosError as error:
                self._refuse_type(str(error))
                return
            if qos.durability == "transient_local":
                self._latched = Latched(self.peer.latched, qos.depth)
            self.type_name, self.type_hash, self.qos = description.type, description.type_hash, description.qos
        self.log(Level.INFO, EventCode.ROUTE_CONNECTED, f"← {self.transport.name} connected ({description.type})")
        self.peer.send(Ready(route=self.id, before=self._counted_before()))
        self.advance()

    def _counted_before(self) -> ReceivedReport | None:
        """What was counted in the last opening in which anything came, if that was with this same process."""
        if self._before is None or self._before[0] != self.peer.instance:
            return None  # another one has openings of the same ids
        return self._before[1]

    def _current(self) -> tuple[object, ...]:
        return (self.type_name, self.type_hash, self.qos)

    def _type_clash(self, description: Describe) -> str:
        installed = self.context.ros.installed_hash(description.type)
        if installed and installed != description.type_hash:
            return (
                f"{description.type} differs between the two sides ({description.type_hash} there, {installed} here): "
                "install the same version on both"
            )
        return ""

    def _refuse_type(self, reason: str) -> None:
        route_id = self.id
        self.refuse(EventCode.ROUTE_TYPE_DIFFERS, reason)
        self.peer.send(Refuse(route=route_id, code="type_differs", reason=sanitize_text(reason)))

    def advance(self) -> None:
        """Make the path once there is a publisher, and look who listens."""
        if self._publisher is None:
            self._hint = type_hint(self.context.ros, self.remote_topic)
            return
        if self.accepted and not self.paused and self.channel is None:
            self.peer.open_channel(self)
        before, self._subscribers = self._subscribers, self._publisher.subscriber_count
        if self._subscribers and self._subscribers == before and self._subscriber_qos is not None:
            return  # the same ones, most likely: to ask for them costs too much to do so at every change of the graph
        self._clash = ""
        requested = [endpoint.qos for endpoint in self.context.ros.subscriptions(self.remote_topic)]
        self._subscriber_qos = match_subscriptions(requested) if requested else None
        if not self._subscribers and self.qos is not None:
            self._clash = next((clash for qos in requested if (clash := incompatible(self.qos, qos))), "")

    def destroy(self) -> None:
        """End it for good, its publisher too."""
        super().destroy()
        self._close_publisher()

    def _close_publisher(self) -> None:
        if self._publisher is not None:
            self._publisher.close()
            self._publisher = None
        if self._latched is not None:
            self._latched.clear()
            self._latched = None

    # --- messages

    def deliver(self, messages: Iterable[Message]) -> None:
        """Publish messages that arrived whole and authentic."""
        publisher = self._publisher
        if publisher is None:
            return
        now = self.context.wall_ns()
        count = size = 0
        stamp = now
        for payload, stamp, flags in messages:  # noqa: B007 — the last one's stamp is the batch's latency sample
            self._received += 1
            try:
                content = self._decompress(payload) if flags & ZSTD else payload
                if self._latched is not None and not self._latched.keep(len(content)):
                    self._dropped["latched full"] += 1
                    self._say(
                        EventCode.ROUTE_LATCHED_FULL,
                        f"this link's latched topics keep more than {LATCHED_LIMIT:,} bytes: give it a smaller depth",
                    )
                    continue
                publisher.publish(content)
            except _ExpansionError as error:
                self._dropped["expands too much"] += 1
                self._say(EventCode.ROUTE_EXPANDS_TOO_MUCH, str(error))
            except (RosError, zstandard.ZstdError) as error:
                self._dropped["publish failed"] += 1
                self._say(EventCode.ROUTE_PUBLISH_FAILED, str(error))
            else:
                count += 1
                size += len(payload)
        self._delivered += count
        if count:
            if (offset := self.peer.clock_offset) is not None:
                self.latency.add((now - stamp) / 1e9 + offset)
            self.count(count, size)

    def tick(self) -> None:
        super().tick()
        counts = self.channel.counts() if self.channel is not None else None
        expired = counts.expired if counts else 0
        if self._received != self._received_before:
            self._received_before, self._expired_before = self._received, expired
        elif expired - self._expired_before >= _INCOMPLETE_IN_A_ROW:
            self._say(
                EventCode.ROUTE_INCOMPLETE,
                "none of its messages comes whole: too large for UDP on this network: use protocol: tcp",
            )

    def _decompress(self, payload: bytes) -> bytes:
        size = zstandard.frame_content_size(payload)
        if not 0 <= size <= MESSAGE_LIMIT:
            raise zstandard.ZstdError(f"a compressed message claims {size:,} bytes")
        if not self.peer.expansion.take(size - len(payload), self.context.now()):
            raise _ExpansionError(
                f"this link's compressed messages grow by more than {EXPANSION_A_SECOND:,} bytes a second here: "
                "send less, or without compression"
            )
        return self._decompressor.decompress(payload)

    def _say(self, code: EventCode, text: str) -> None:
        if text != self.last_error:
            self.last_error = text
            self.log(Level.ERROR, code, text)

    # --- the ledger

    def reported(self, report: SentReport) -> None:
        """The sender's ledger, which counts for both sides."""
        failed_before = self._failure()
        self._report = report
        self.problem = report.problem
        failure = self._failure()
        if failure and failure != failed_before:
            self.log(Level.ERROR, EventCode.ROUTE_SUBSCRIBE_FAILED, f"on the other side: {failure}")
        ledger = reported_ledger(report)
        if ledger is None:
            self.doubt("the last that could be are shown")
        else:
            self._sender_ledger = ledger

    def ledger(self) -> Ledger:
        """As the sender last said."""
        return self._sender_ledger

    def received_report(self) -> ReceivedReport:
        """What the sender is told of the present opening."""
        counts = self.channel.counts() if self.channel is not None else None
        return ReceivedReport(
            route=self.id,
            received=self._received,
            delivered=self._delivered,
            expired=counts.expired if counts else 0,
            incomplete=counts.incomplete if counts else 0,
            newest=counts.newest if counts else self._received,
            dropped=dict(self._dropped),
            subscribers=self._subscribers,
            subscriber_qos=self._subscriber_qos,
            type=self._hint[0],
            type_hash=self._hint[1],
            latency_p50=self.latency.p50,
            latency_p99=self.latency.p99,
            jitter=self.latency.jitter,
        )

    def _failure(self) -> str:
        report = self._report
        failed = report is not None and report.publishers and not report.subscribed and self._publisher is not None
        return self.problem if failed else ""

    def _end_qos(self) -> tuple[Qos | None, Qos | None]:
        return self._report.publisher_qos if self._report else None, self._subscriber_qos

    def _stages(self) -> tuple[Stage, ...]:
        """From the publisher there to the subscriber here."""
        report = self._report
        known = bool(self.type_name)
        publishers = report.publishers if report else 0
        return (
            Stage(
                "publisher seen",
                publishers > 0 if report else None,
                "" if publishers or not report else f"no publisher of {self.topic} on the other side",
            ),
            Stage("type known", known or None, self.type_name if known else self.problem),
            Stage("QoS compatible", not self._clash if known else None, self._clash),
            Stage(
                "subscribed",
                False if self._failure() else (report is not None and report.subscribed) or None,
                self.problem,
            ),
            self.link_stage(),
            Stage("peer accepted", False if self.refusal else self.accepted or None, self.refusal),
            Stage("sent", (report is not None and report.offered > 0) or None),
            Stage("received", self._received > 0 or None, "" if self._received else self.last_error),
            Stage("published", self._delivered > 0 or None),
            Stage(
                "subscriber seen",
                self._subscribers > 0 or None,
                ""
                if self._subscribers
                else f"nobody subscribes to {self.remote_topic} in domain {self.context.domain_id}",
            ),
        )


def _bounded(qos: Qos) -> Qos:
    """What a publisher here keeps for late joiners and slow readers, whatever the peer asks for."""
    if qos.durability != "transient_local":
        return qos if qos.depth <= KEPT_DEPTH else msgspec.structs.replace(qos, depth=KEPT_DEPTH)
    depth = LATCHED_DEPTH if qos.history == "keep_all" else min(max(qos.depth, 1), LATCHED_DEPTH)
    return msgspec.structs.replace(qos, history="keep_last", depth=depth)
