"""The subscription of a route that sends: its depth, its failures, and the histories of a latched topic."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.cdr.known_types import CLOCK
from rsb_bridge.model.budgets import Backoff
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import LATCHED_DEPTH
from rsb_bridge.model.qos import auto_depth, parts_of_lease
from rsb_bridge.model.snapshot import Level
from rsb_bridge.ros.lasting_subscription import LastingSubscription
from rsb_bridge.ros.publication_numbers import PublicationNumbers, Untaken
from rsb_bridge.ros.ros_interface import BATCH, RosError
from rsb_bridge.route.combined_verdict import named
from rsb_bridge.route.history_depth import Histories, KnownPublishers, note_taken
from rsb_bridge.route.lease import Marker
from rsb_bridge.route.peer_budget import TypeUse
from rsb_bridge.route.route import promised_keep

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Collection, Mapping, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import Endpoint, OnFailure, RawMessage, Subscription, TopicSpec
    from rsb_bridge.route.loop_filter import LoopFilter
    from rsb_bridge.route.route import Route
    from rsb_bridge.route.sending import OutgoingPath


# Round figures.
_LOOKS_EVERY = 1.0  # s, at most, between two looks at who is alive
_ASKED_ANEW = 10.0, 60.0  # s: most until DDS is first asked again who is alive, least between later questions
_SHALLOW = 8  # messages that are kept: fewer could be overwritten before a turn that waits (`ros.turn_pacing`)
_UNHEARD_FOR, _HEARD_FURTHER = 5.0, 2.0
"""s for which a publisher is not heard until a further subscription listens, and after that has heard it."""
_ASKS_FOR, _ASKS_AGAIN = 30.0, 300.0
"""s for which a further subscription listens, and after which it does again. Round figures."""
_BEST_EFFORT = "subscribed as best_effort, which hears it; what is lost stays lost"
_MATCHED_WITHIN = 2  # ticks: DDS matches a publisher that it lists within milliseconds


class KeyedRoutes(set["Route"]):
    """The routes whose subscription has to end as soon as a publisher with a key of another DDS comes.

    Such a publisher's messages may end the process.
    """

    def __init__(self, _: Context) -> None:
        super().__init__()


class TopicSubscription:
    """A route's subscription, begun again with each opening. It hands all messages to `OutgoingPath`, on the I/O loop.

    With ``qos: auto`` the depth on a volatile topic follows the topic's rate, and its `keep`. On a latched topic
    messages come with what their publishers keep for late joiners, and none that the peer has.

    Args:
        path: gets the messages; after `close` it drops messages that are still in the ROS queue.
        found: called after the histories know more depths, or `alive` has changed.

    Attributes:
        spec: the present opening's topic, with the QoS that publishers offer or an operator wants; or None before.
        histories: of a latched topic's publishers, or None for a volatile topic.
        numbers: over all openings.
    """

    def __init__(
        self,
        route: Route,
        path: OutgoingPath,
        loop_filter: LoopFilter,
        found: Callable[[], None],
    ) -> None:
        self.spec: TopicSpec | None = None
        self.histories: Histories | None = None
        self.numbers = PublicationNumbers(route.context.loop.time)
        self._liveliness: _Liveliness | None = None
        self._context = context = route.context
        self._route = route
        self._path = path
        self._loop_filter = loop_filter
        self._type = TypeUse(context.ros, route.peer.budget.types)
        self._found = found
        self._is_automatic = route.proposal.qos is None  # depths are chosen here
        self._receiver = _Receiver(path.offer)
        self._subscription: LastingSubscription | None = None
        self._depth = 0
        self._remembered = KnownPublishers()  # of a latched topic
        self._has_begun = False
        self._keyed = context.shared(KeyedRoutes)
        self._lost_seen = 0
        self._unmatched_ticks = 0
        self._reliability = _Reliability(route, self._unreliable)

    # --- the subscription

    def begin(self, spec: TopicSpec, known: Mapping[bytes, int], resends: int = 0) -> None:
        """Begin an opening. Subscribe to nothing yet.

        Args:
            known: for each publisher of a latched topic, the number of the newest message that the peer has.
            resends: of `KnownPublishers`, as the peer remembers it of an earlier process of this side.
        """
        if not self._has_begun:
            self._has_begun, self._remembered.resends = True, resends
        self.spec = spec
        self._reliability = _Reliability(self._route, self._unreliable)
        # A new one: what is still queued for the former one is of an earlier opening, and so are the losses until now.
        self._receiver = _Receiver(self._path.offer)
        self._lost_seen = self._lost
        if spec.qos.latched:
            kept = LATCHED_DEPTH if spec.qos.history == "keep_all" else max(1, spec.qos.depth)
            self.histories = Histories(
                self._context.loop,
                self._probe,
                self._path.emit,
                self._found,
                self._path.offer,
                depth=0 if self._is_automatic else kept,
                lifespan=spec.qos.lifespan,
                known=known,
                remembered=self._remembered,
            )

    def subscribe(self, *, missed: bool) -> None:
        """Begin to take messages.

        Args:
            missed: whether those published since the last subscription should have been taken.

        Raises:
            RosError: the topic cannot be subscribed to.
        """
        assert self.spec is not None
        self._type.begin(self.spec.type_name, self.spec.type_hash)
        self.numbers.gap = Untaken.MISSED if missed else Untaken.UNSUBSCRIBED
        if not self._context.ros.survives_foreign_keys(self.spec.type_name):
            self._keyed.add(self._route)
        self._subscription = LastingSubscription(self._context.loop, self._subscribe, self._changed)
        if self.spec.qos.liveliness_lease_duration:
            self._liveliness = _Liveliness(self._route, self.spec, self._subscription, self._loop_filter, self._found)

    def unsubscribe(self) -> None:
        """Take no more messages for now. May be called twice."""
        if self._liveliness is not None:
            self._liveliness.close()
            self._liveliness = None
        self._reliability.ask_no_further()
        if self._subscription is not None:
            self._keyed.discard(self._route)
            self._subscription.close()
            self._subscription = None
        if self.histories is not None:
            self.histories.unsubscribed()
        self._type.end()

    def renew(self) -> None:
        """Subscribe anew, if it is subscribed; what is published meanwhile is left out on purpose."""
        if self.receives and self._subscription is not None:
            self.numbers.gap = Untaken.UNSUBSCRIBED
            self._subscription.renew()

    def move(self) -> None:
        """Subscribe again at once, by another node; what is published until DDS has matched it counts as left out."""
        if self.receives and self._subscription is not None:
            self.numbers.gap = Untaken.UNSUBSCRIBED
            self._subscription.reopen()

    def close(self) -> int:
        """End the opening, drop the messages that the histories hold, and return their number."""
        self._receiver.offer = self._path.too_late  # they may be older than what arms the next opening
        held = 0
        if self.histories is not None:
            self._receiver.offer = self._latched_too_late
            held = self.histories.close()
        self.spec = self.histories = None
        self.unsubscribe()
        return held

    def _latched_too_late(self, batch: Sequence[RawMessage]) -> None:
        for message in batch:  # the next opening's subscription brings them again
            note_taken(self._remembered.taken, message)
        self._path.too_late(batch)

    @property
    def active(self) -> bool:
        """Whether it is subscribed, or about to be again after a failure."""
        return self._subscription is not None

    @property
    def receives(self) -> bool:
        """Whether it is subscribed and has not failed."""
        return self._subscription is not None and not self._subscription.failure

    @property
    def alive(self) -> bool:
        """Whether a publisher is alive, by the lease of its liveliness; False without a lease."""
        return self._liveliness is not None and self._liveliness.alive

    @property
    def failure(self) -> str:
        """The reason why no messages are taken now, for an operator, or an empty string."""
        return self._subscription.failure if self._subscription is not None else ""

    @property
    def _lost(self) -> int:
        return self.numbers.counts[Untaken.LOST]

    @property
    def is_unmatched(self) -> bool:
        """Whether DDS has matched no publisher for a while: a listed one then differs in what the list lacks."""
        return self.receives and self._unmatched_ticks > _MATCHED_WITHIN

    @property
    def refuses(self) -> bool:
        """Whether DDS has refused a publisher for a policy that the graph does not show."""
        return self.is_unmatched and self._subscription is not None and self._subscription.refuses

    @property
    def awaits_match(self) -> bool:
        """Whether DDS had matched no publisher at the last tick."""
        return self._unmatched_ticks > 0

    @property
    def is_settled(self) -> bool:
        """Whether it waits for no publisher to be heard."""
        return not self._reliability.awaits

    def tick(self, publishers: Sequence[Endpoint] = ()) -> None:
        """Subscribe again if that brings what DDS has lost, or does not give. Called once a second.

        Args:
            publishers: the topic's present ones.
        """
        if self._subscription is None:
            return
        self._unmatched_ticks = 0 if self._subscription.matched else self._unmatched_ticks + 1
        if self.receives and self.spec is not None:
            self._reliability.look(self.spec, publishers, self.numbers.newest)
        if self._lost == self._lost_seen:
            return
        self._lost_seen = self._lost
        before, depth = self._depth, self._qos().depth
        # Only then: a new subscription of a volatile topic misses what is published until DDS has matched it.
        if self._is_deepened and depth >= 2 * before:
            text = f"DDS lost messages: the subscription gets a depth of {depth:,} instead of {before:,}"
            self._route.log(Level.INFO, EventCode.ROUTE_DEEPENED, text)
            self._subscription.reopen()

    @property
    def _is_deepened(self) -> bool:
        """Whether the depth is chosen here: neither an operator has, nor are all messages kept anyway."""
        qos = self.spec.qos if self.spec is not None else None
        return self._is_automatic and qos is not None and not qos.latched and qos.history != "keep_all"

    def _unreliable(self) -> None:
        """Subscribe again, as it has turned out whether a publisher is reliable in name only."""
        if self._subscription is not None:
            self._subscription.reopen()

    def _qos(self) -> Qos:
        assert self.spec is not None
        qos, meter = self._reliability.asked(self.spec.qos), self._route.meter
        if qos.latched:
            return msgspec.structs.replace(qos, history="keep_all")  # each publisher keeps what it keeps
        if not self._is_deepened:
            return qos
        rate = meter.usual_rate or meter.rate or self._route.spec.expected_rate or None
        # A bridge that stood still gets all at once, and what it promised to keep must not be lost then.
        keep = promised_keep(self._route)
        size = meter.bytes / meter.count if meter.count else 0.0
        return msgspec.structs.replace(qos, depth=auto_depth(qos.reliability, rate, size, keep))

    def _subscribe(self, on_failure: OnFailure | None) -> Subscription:
        if self.histories is not None:
            self.histories.resubscribed()
        return self._subscribe_for(self._receiver, on_failure, self.numbers)

    def _subscribe_for(
        self, receiver: _Receiver, on_failure: OnFailure | None, numbers: PublicationNumbers | None = None
    ) -> Subscription:
        assert self.spec is not None
        spec = self.spec._replace(qos=self._qos())
        express = self._is_express(spec)
        self._depth = spec.qos.depth
        put = partial(self._context.ros_queue.put, receiver, express=express)
        sink: Callable[[Sequence[RawMessage]], None] = put
        arming = self._route.arming
        if arming.required and arming.lease is not None:
            marked = Marker(arming.lease, self._context.ros.turns, BATCH).marked

            def put_marked(batch: Sequence[RawMessage]) -> None:
                put(marked(batch))

            sink = put_marked
        # What this node publishes for the same peer is left out.
        return self._route.ends.subscribe(spec, sink, self._route.peer.name, on_failure, numbers, express=express)

    def _is_express(self, spec: TopicSpec) -> bool:
        """Whether messages are taken as they come: also where few are kept until then, or others' clocks follow."""
        shallow = spec.qos.history == "keep_last" and 0 < spec.qos.depth < _SHALLOW
        return shallow or self._route.proposal.express or self._route.arming.required or spec.type_name == CLOCK

    def _changed(self) -> None:
        self._route.wake()
        if self.failure:
            self._route.notices.record(self.failure)
            self._route.log(Level.ERROR, EventCode.ROUTE_SUBSCRIBE_FAILED, self.failure)
        else:
            text = f"subscribed again ({self.spec.type_name if self.spec is not None else ''})"
            self._route.log(Level.INFO, EventCode.ROUTE_CONNECTED, text)

    def _probe(self, take: Callable[[Sequence[RawMessage]], None]) -> Subscription:
        if self._subscription is None:
            raise RosError("the topic is not subscribed to")
        return self._subscribe_for(_Receiver(take), None)


class _FurtherSubscription:
    """A second subscription to a route's topic for a while, which shows what the first one cannot.

    Attributes:
        open: the subscription, or None.
    """

    def __init__(self, route: Route) -> None:
        self._route = route
        self.open: Subscription | None = None

    def begin(self, spec: TopicSpec, sink: Callable[[Sequence[RawMessage]], None], **policies: str) -> None:
        """Subscribe to the newest message, with some policies of its own, in place of the one before; DDS may refuse.

        Args:
            sink: as of `RosInterface.subscribe`.
        """
        self.end()
        qos = msgspec.structs.replace(spec.qos, history="keep_last", depth=1, **policies)
        with suppress(RosError):
            self.open = self._route.ends.subscribe(spec._replace(qos=qos), sink, self._route.peer.name)

    def end(self) -> None:
        """Close it. May be called twice."""
        if self.open is not None:
            self.open.close()
            self.open = None


class _Liveliness:
    """Looks several times in a lease whether a publisher is alive.

    If DDS has not judged all publishers, and calls none alive, it is asked by a further subscription, and again by a
    new one, until it has: it may have missed what they asserted while it made the first (`ros_interface.Liveliness`).
    """

    def __init__(
        self,
        route: Route,
        spec: TopicSpec,
        first: LastingSubscription,
        loop_filter: LoopFilter,
        changed: Callable[[], None],
    ) -> None:
        """Begin to look, in the next turn of the loop.

        Args:
            first: the route's subscription.
            changed: called after `alive` has changed.
        """
        self.alive = False
        self._loop = loop = route.context.loop
        self._route = route
        self._spec = spec
        self._first = first
        self._loop_filter = loop_filter
        self._changed = changed
        lease, (soonest, latest) = spec.qos.liveliness_lease_duration, _ASKED_ANEW
        self._looks_every = min(parts_of_lease(lease), _LOOKS_EVERY)
        self._asks_after = Backoff(min(lease, soonest), max(lease, latest))
        self._asks_at = loop.time() + self._asks_after.next()
        self._further = _FurtherSubscription(route)
        self._looks_again: asyncio.Handle = loop.call_soon(self._look)

    def _look(self) -> None:
        self._looks_again = self._loop.call_later(self._looks_every, self._look)
        alive = self._is_alive(self._loop_filter.alive_left_out(self._spec.qos))
        if alive != self.alive:
            self.alive = alive
            self._changed()

    def _is_alive(self, left_out: int) -> bool:
        alive, unjudged = self._first.liveliness
        if alive > left_out or not unjudged:
            self._further.end()
            self._asks_after.reset()
            return alive > left_out
        if self._further.open is not None:
            alive, unjudged = self._further.open.liveliness
            if alive > left_out or not unjudged:
                return alive > left_out
        if (now := self._loop.time()) >= self._asks_at:
            self._asks_at = now + self._asks_after.next()
            self._further.begin(self._spec, lambda _: None)
        return False

    def close(self) -> None:
        self._looks_again.cancel()
        self._further.end()


class _Reliability:
    """Finds publishers that are announced as reliable and repeat nothing: only best-effort subscriptions hear them.

    RustDDS without a policy is such a one (0.15.1): a reliable subscription that is made after its first message is
    matched, waits for what it has missed, and gets nothing for ever. Beside one that is unheard, a best-effort
    subscription shows whether it publishes.
    """

    def __init__(self, route: Route, changed: Callable[[], None]) -> None:
        """Trust all publishers.

        Args:
            changed: called after the answer of `asked` has changed.
        """
        self._route = route
        self._changed = changed
        self._unheard_since: dict[bytes, float] = {}  # s, by publisher
        self._asks_at, self._asks_until = float("-inf"), 0.0  # s, of a further subscription
        self._further = _FurtherSubscription(route)
        self._heard_further: dict[bytes, float] = {}  # s, when the further subscription first heard a publisher
        self._found = b""

    def asked(self, qos: Qos) -> Qos:
        """Return the QoS to ask for where a topic has this one."""
        return msgspec.structs.replace(qos, reliability="best_effort") if self._found else qos

    @property
    def awaits(self) -> bool:
        """Whether it waits for a publisher to be heard, or to go."""
        return bool(self._unheard_since or self._found)

    def look(self, spec: TopicSpec, publishers: Sequence[Endpoint], heard: Collection[bytes]) -> None:
        """Judge the publishers. Called once a second.

        Args:
            heard: those that the reliable subscription has heard.
        """
        doubtful = {each.gid: each for each in publishers if each.may_not_repeat}
        if not (doubtful or self.awaits):  # nearly always
            return
        now = self._route.context.loop.time()
        if self._found:
            if self._found not in doubtful:  # it has gone
                self._found = b""
                self._changed()
            return
        # The history of a latched topic comes to reliable subscriptions only.
        can_lack = spec.qos.reliability == "reliable" and not spec.qos.latched
        unheard = {*doubtful} - {*heard} if can_lack else set()
        if unheard - {*self._unheard_since}:
            self._asks_at = float("-inf")
        self._unheard_since = {gid: self._unheard_since.get(gid, now) for gid in unheard}
        if not any(now - since >= _UNHEARD_FOR for since in self._unheard_since.values()):
            self.ask_no_further()
            return
        if self._further.open is None:
            if now < self._asks_at:
                return
            self._asks_until = now + _ASKS_FOR
            self._ask(spec)
        elif now >= self._asks_until:  # one that is silent; of the others, all comes twice meanwhile
            self._asks_at = now + _ASKS_AGAIN
            self.ask_no_further()
        for gid in unheard:
            if now - self._heard_further.get(gid, now) >= _HEARD_FURTHER:
                self._found = gid
                self.ask_no_further()
                text = f"{named([doubtful[gid].node])} repeats nothing, though it publishes as reliable: {_BEST_EFFORT}"
                self._route.log(Level.WARNING, EventCode.ROUTE_UNRELIABLE, text)
                self._changed()
                return

    def ask_no_further(self) -> None:
        """Close the further subscription. May be called twice."""
        self._heard_further = {}
        self._further.end()

    def _ask(self, spec: TopicSpec) -> None:
        context, heard = self._route.context, self._heard_further

        def hear(batch: Sequence[RawMessage]) -> None:
            for each in batch:
                heard.setdefault(each.gid, context.loop.time())
            self._route.wake()  # an idle route is not looked at

        self._further.begin(spec, partial(context.ros_queue.put, _Receiver(hear)), reliability="best_effort")


class _Receiver:
    """A receiver of the ROS queue that may change the function that gets the messages."""

    def __init__(self, offer: Callable[[Sequence[RawMessage]], None]) -> None:
        self.offer = offer
