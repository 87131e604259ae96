"""One topic in one direction over one link: what both halves of a route share.

The sending half is `rsb_bridge.route.outgoing`, the receiving half `rsb_bridge.route.incoming`. `advance` does whatever
can be done next and may be called at any time, so nothing depends on the order in which ROS, the peer and the sockets
become ready.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, ClassVar, Protocol

import msgspec

from rsb_bridge.model.backoff import Backoff
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Ledger, Level, RouteSnapshot, Stage
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.verdict import FINE
from rsb_bridge.route.both_sides import BothSides
from rsb_bridge.route.channel_losses import ChannelLosses
from rsb_bridge.route.lifecycle import Event, Lifecycle
from rsb_bridge.route.notices import Notices
from rsb_bridge.route.pause import PauseState
from rsb_bridge.route.peeking import PeekSlot
from rsb_bridge.route.peer import Peer
from rsb_bridge.route.verdict import Facts, judge
from rsb_bridge.telemetry.meters import LatencyMeter, RateMeter, StaleWatch
from rsb_bridge.wire.messages import Close, Propose

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from rsb_bridge.channel.channel import DataChannel
    from rsb_bridge.context import Context
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.verdict import Verdict
    from rsb_bridge.ros.api import Endpoint
    from rsb_bridge.wire.framing import Message
    from rsb_bridge.wire.records import ReceivedReport, SentReport

_FIRST_PAUSE, _LONGEST_PAUSE = 1.0, 10.0
_PROPOSED_WITHIN = 3.0
LINK_STAGE = "link up"


class Owner(Peer, Protocol):
    """The link that a route belongs to."""

    def open_channel(self, route: Route) -> None:
        """Begin to open `route.channel`. For streams, a server waits for the client's instead."""
        ...


class Route:
    """A route's half on this side. Lives across reconnects; `id` is that of the present opening.

    Attributes:
        key: names it in commands.
        spec: what was asked for, as the client sees it.
        topic: its name on the sending side.
        remote_topic: its name on the receiving side.
        from_client: whether the client sends.
        proposed_here: whether this side opens it anew after a reconnect.
        id: route id on the present connection; 0: not open.
        instance: of the peer's process that its present or last opening is with.
        life: what the two sides have agreed on so far.
        closed_ids: of its last incarnations on the present connection, the oldest first.
        closed_at: s, when its last opening ended; 0: it had none.
        peek_slot: takes the next message for whoever looks at the topic.
        endpoints: others' publishers of the topic on the sending side, their subscriptions on the receiving side.
        losses: of the channels that carried it.
        own_verdict: what this side made of it at the last tick.
        judged: what both sides make of it.
    """

    outgoing: ClassVar[bool]

    def __init__(self, context: Context, peer: Owner, spec: Topic, proposal: Propose, *, proposed_here: bool) -> None:
        self.context = context
        self.peer = peer
        self.spec = spec
        self.proposal = proposal
        self.topic = proposal.topic
        self.remote_topic = proposal.remote_topic
        self.from_client = proposal.from_client
        self.transport = context.transports[proposal.transport]
        self.proposed_here = proposed_here
        self.key = route_key(peer.name, proposal)
        self.id = 0
        self.instance = ""
        self.life = Lifecycle()
        self.opened_at = 0.0
        self.closed_ids: deque[int] = deque()
        self.closed_at = 0.0
        self.retry_at = 0.0
        self._backoff = Backoff(_FIRST_PAUSE, _LONGEST_PAUSE)
        self.notices = Notices(self.log)
        self.pausing = PauseState(peer.revisions, paused=proposal.paused, is_client=peer.is_client)
        self.channel: DataChannel | None = None
        self.type_name = ""
        self.type_hash = ""
        self.qos: Qos | None = None
        self.endpoints: Sequence[Endpoint] = ()
        self.losses = ChannelLosses()
        self.own_verdict = FINE
        self.judged = BothSides(sends=self.outgoing, peer_name="server" if peer.is_client else peer.name)
        self.meter = RateMeter(context.now())
        self.latency = LatencyMeter()
        self.stale = StaleWatch(0.0, 0, context.now())
        self.set_stale_after()
        self.peek_slot = PeekSlot()
        self.release_port: Callable[[], None] | None = None
        self._told_report: SentReport | ReceivedReport | None = None  # the last one of the present opening

    # --- what the halves do differently

    def on_accepted(self) -> None:
        """Both sides want the route."""
        if self.life.take(Event.ACCEPT):
            self.advance()

    def advance(self) -> None:
        """Do what can be done next."""
        raise NotImplementedError

    def flush(self) -> None:
        """The path takes more again. A receiving half sends nothing."""

    def deliver(self, messages: Iterable[Message]) -> None:
        """Messages came, whole and authentic. A sending half gets none: the peer does not even have its key."""

    def ledger(self) -> Ledger:
        """Where the messages went."""
        raise NotImplementedError

    def stages(self) -> tuple[Stage, ...]:
        """The steps of a message's way; without a link, nothing is known of the others."""
        steps = self._stages()
        if self.peer.linked:
            return steps
        return tuple(step if step.name == LINK_STAGE else Stage(step.name, None) for step in steps)

    def _stages(self) -> tuple[Stage, ...]:
        raise NotImplementedError

    def _end_qos(self) -> tuple[Qos | None, Qos | None]:
        """What the publishers at the beginning offer, and what the subscriptions at the end ask for."""
        raise NotImplementedError

    def _end_nodes(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The nodes that publish the topic at the beginning, and those that subscribe to it at the end."""
        raise NotImplementedError

    def set_peer_topic(self, topic: str) -> None:
        """The peer says what the topic is called on its side."""
        if self.outgoing:
            self.remote_topic = topic
        else:
            self.topic = topic

    @property
    def local_topic(self) -> str:
        """Its name on this side."""
        return self.topic if self.outgoing else self.remote_topic

    # --- opening and closing

    @property
    def accepted(self) -> bool:
        """Whether both sides want it."""
        return self.life.accepted

    @property
    def refusal(self) -> str:
        """Why it was refused; empty: it was not."""
        return self.life.refusal

    def open(self, route_id: int) -> None:
        """Begin a new opening on the present connection."""
        self.id = route_id
        self.instance = self.peer.instance
        self.opened_at = self.context.now()
        self._told_report = None
        self.life.take(Event.OPEN)
        self.judged.take(None, self.context.now())
        self.stale.rearm(self.context.now())

    def close(self, reason: str) -> None:
        """End the present opening; what it keeps across openings stays."""
        if self.channel is not None:
            path, self.channel = self.channel, None
            path.close(reason)
        if self.release_port is not None:
            self.release_port()
            self.release_port = None
        self.peer.closed(self.id)
        self.id = 0
        self.notices.closed()
        self.judged.take(None, self.context.now())
        self.life.take(Event.CLOSE)
        self.closed_at = self.context.now()

    def destroy(self) -> None:
        """End it for good: endpoints too."""
        self.close("removed")
        self.losses.forget_report()

    def refuse(self, code: EventCode, reason: str) -> None:
        """The route can't be; it is tried again later if it was proposed here."""
        self.notices.error(code, reason)
        self._end(reason)

    def _end(self, reason: str) -> None:
        """End the present opening for a reason that is shown; it is opened again later if it was proposed here."""
        self.close(reason)
        self.life.take(Event.REFUSE, reason)
        self.retry_at = self.context.now() + self._backoff.next()

    def awaited_until(self, linked_at: float) -> float:
        """Until when (s) the other side will have asked for the route anew, if it still wants it."""
        if self.closed_at > linked_at:
            return self.closed_at + _LONGEST_PAUSE + _PROPOSED_WITHIN
        return linked_at + _PROPOSED_WITHIN

    def channel_lost(self, reason: str) -> None:
        """What carried the route broke: open it again. It is reported as an error once the link has outlived it."""
        if self.id:
            text, connection = f"data connection: {reason}", self.peer.connections
            self._end_on_both_sides(text)

            def report() -> None:
                if self.peer.linked and self.peer.connections == connection:
                    self.notices.error(EventCode.ROUTE_CHANNEL_LOST, text)

            self.losses.add(reason, self.context.loop, report)

    def request_reopen(self, code: EventCode, reason: str, level: Level = Level.WARNING) -> None:
        """Close the route on both sides; its proposer opens it again, which as a rule is all that it needs."""
        if self.id:
            self.notices.error(code, reason, level)
            self._end_on_both_sides(reason)

    def _end_on_both_sides(self, reason: str) -> None:
        route_id = self.id
        self._end(reason)
        self.peer.send(Close(route=route_id, reason=sanitize_text(reason)))

    @property
    def paused(self) -> bool:
        """Whether it carries no messages, as an operator of either side wants."""
        return self.pausing.paused

    def pause(self, paused: bool) -> None:
        """An operator of this side stops or resumes carrying messages; the route stays set up."""
        was = self.paused
        self.pausing.change(paused=paused)
        self._paused(was)

    def pause_from_peer(self, paused: bool, revision: int, *, known: bool = True) -> None:
        """The peer tells its state of the pause.

        Args:
            paused: its state.
            revision: of its state.
            known: whether this side's revisions are about the peer's present process; else its state counts as it is.
        """
        was = self.paused
        if known:
            self.pausing.merge(paused=paused, revision=revision)
        else:
            self.pausing.adopt(paused=paused, revision=revision)
        self._paused(was)

    def _paused(self, was: bool) -> None:
        paused = self.paused
        if paused != was:
            self.spec = msgspec.structs.replace(self.spec, paused=paused)
            self.stale.rearm(self.context.now())
            code = EventCode.ROUTE_PAUSED if paused else EventCode.ROUTE_RESUMED
            self.log(Level.INFO, code, "paused" if paused else "resumed")
        self.advance()

    def amend(self, spec: Topic, proposal: Propose) -> None:
        """Go on with other limits; counts, endpoints and what is under way stay."""
        changes = limits_changed(self.proposal, proposal)
        self.spec, self.proposal = spec, proposal
        self.set_stale_after()
        if changes:
            self.log(Level.INFO, EventCode.ROUTE_AMENDED, changes)

    def set_stale_after(self) -> None:
        """Watch for silence as the topic's entry and the session say now."""
        session, own = self.context.session, self.spec.stale_after
        self.stale.after = session.stale_after if own is None else own
        self.stale.times = session.stale_warnings
        self.never_stale = own is None

    # --- time

    def tick(self) -> None:
        """Once a second: histories, stale warnings, and what has turned for the worse."""
        now = self.context.now()
        self.meter.tick(now)
        self.latency.tick()
        flowing = self.flowing
        if flowing:  # that both sides accept it says little: what it is refused for may be found out later
            self._backoff.reset()
        if flowing and not self.is_latched:
            if number := self.stale.check(now):
                text = f"nothing for {self.stale.after * number:g} s (warning {number} of {self.stale.times})"
                if number == self.stale.times:
                    text += "; no more will be said until data returns"
                self.log(Level.WARNING, EventCode.ROUTE_STALE, text)
        else:
            self.stale.rearm(now)
        self.own_verdict = self.verdict()
        if said := self.judged.announce(self.own_verdict, now):
            self.log(said.level, said.code, said.text, cause=said.cause)

    def count(self, messages: int, size: int) -> None:
        """Note that messages passed."""
        self.notices.flowing()
        now = self.context.now()
        self.meter.add(messages, size, now)
        quiet = self.stale.seen(now)
        if quiet is not None:
            self.log(Level.INFO, EventCode.ROUTE_DATA_AGAIN, f"reinitialized: data again after {quiet:.0f} s")

    # --- how it is

    def link_stage(self) -> Stage:
        """Whether the peer is there, and what carries this route gets through."""
        trouble = self.trouble()
        return Stage(LINK_STAGE, self.peer.linked and not trouble, trouble or self.peer.down_reason)

    def accepted_stage(self) -> Stage:
        """Whether both sides want the route."""
        return Stage("peer accepted", False if self.refusal else self.accepted or None, self.refusal)

    def trouble(self) -> str:
        """Why what carries it does not get through; empty: it does."""
        return self.channel.trouble() if self.channel is not None else ""

    @property
    def is_latched(self) -> bool:
        """A latched topic is not stale when silent, unless its session entry says after how long it is."""
        return self.never_stale and self.qos is not None and self.qos.latched

    @property
    def connected(self) -> bool:
        """Whether there is a way for messages; those that are under way when the route is paused still go it."""
        return self.accepted and self.channel is not None and self.channel.ready

    @property
    def flowing(self) -> bool:
        """Whether messages could cross now."""
        return self.connected and not self.paused and not self.notices.loop

    # --- what is made of it

    def facts(self) -> Facts:
        """What this half knows."""
        raise NotImplementedError

    def verdict(self) -> Verdict:
        """What this side makes of the route."""
        return judge(self.facts())

    def snapshot(self) -> RouteSnapshot:
        """The route as it is now."""
        now = self.context.now()
        verdict, from_peer = self.judged.shown(self.verdict())
        publisher_qos, subscriber_qos = self._end_qos()
        publishers, subscribers = self._end_nodes()
        return RouteSnapshot(
            key=self.key,
            link=self.peer.name,
            topic=self.local_topic,
            remote_topic=self.remote_topic if self.outgoing else self.topic,
            outgoing=self.outgoing,
            spec=self.spec,
            state=verdict.state,
            reason=verdict.said(now),
            type_name=self.type_name,
            type_hash=self.type_hash,
            qos=self.qos,
            publisher_qos=publisher_qos,
            subscriber_qos=subscriber_qos,
            transport=self.transport.name,
            port=self.proposal.port or self.peer.shared_port(),
            stages=self.stages(),
            ledger=self.ledger(),
            rate=self.meter.rate,
            expected_rate=self._expected_rate(),
            bytes_per_second=self.meter.bytes_per_second,
            bytes_total=self.meter.bytes,
            latency_p50=self.latency.p50,
            latency_p99=self.latency.p99,
            latency_uncertainty=self.peer.clock_uncertainty,
            jitter=self.latency.jitter,
            age=None if self.meter.last is None else now - self.meter.last,
            history=tuple(self.meter.history),
            last_error=self.notices.last_error,
            cause=verdict.cause,
            from_peer=from_peer,
            publishers=publishers,
            subscribers=subscribers,
        )

    def _expected_rate(self) -> float | None:
        rate, limit = self.spec.expected_rate or self.meter.usual_rate, self.proposal.max_rate
        return min(rate, limit) if rate and limit else rate

    def log(self, level: Level, code: EventCode, text: str, *, cause: str = "") -> None:
        """Add an event about this route."""
        topic = self.local_topic
        self.context.log(level, code, f"{topic}: {text}", link=self.peer.name, topic=topic, cause=cause)


def limits_changed(old: Propose, new: Propose) -> str:
    """What differs between the limits of two proposals, for an operator."""
    limits = (
        ("max_rate", old.max_rate or None, new.max_rate or None, " Hz"),
        ("expected_rate", old.expected_rate or None, new.expected_rate or None, " Hz"),
        ("stale_after", old.stale_after, new.stale_after, " s"),
    )
    return ", ".join(
        f"{name} {_figure(before, unit)} → {_figure(after, unit)}"
        for name, before, after, unit in limits
        if before != after
    )


def _figure(value: float | None, unit: str) -> str:
    return "none" if value is None else f"{value:g}{unit}"


def route_key(link: str, proposal: Propose) -> str:
    """What identifies a route on both sides: the link, the direction and the topic's name on the sending side."""
    return f"{link} {'→' if proposal.from_client else '←'} {proposal.topic}"
