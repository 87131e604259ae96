"""The gates of messages and calls: nothing old and nothing unarmed gets through (`Gate`, `Sieve`).

Each direction has a function that lists its gates in the order in which they are asked, except for gates that are off:
`sending_gates`, `incoming_gates`, `calling_gates`, `providing_gates`, `armed_gates`. They ask ages and leases twice:
when a sample comes, before it costs anything, and right before it is handed on, because queues, unpacking, checks and
requests to DDS take long.

These are no gates:

- the check of contents (`message_check`), which follows the first gates and precedes the last ones. It stops at the
  wrong field, and operators read the field's name: so it raises an error with that text, as unpacking does. A gate
  around it would make the way of a received message 8 % longer (of 16 that come together, 0.49 µs each).
- `rate_limit.LatestLater`, the rate limit of a latched topic: it sends the newest message later instead of dropping it.
- `rate_limit.LastLater`, which does so with the last message before a silence, of a topic that moves a robot.
- `driver_sieve`, which only counts, after the loop filter: it is on for what may move a robot.
- a full queue and a lost link: no rule keeps these messages back.
- pause, arming and loops of a message that `LastLater` sends: `sending.OutgoingPath` asks them once more.
- a message with a lease's number on a route that needs no arming: `incoming_path.IncomingPath` drops it when it
  unpacks it.
- what an operator publishes by hand: the feature `driving` asks `why_not_by_hand` of all routes of the topic
  together, then whether it is about to be disarmed, who holds it, whether the robot would stop by itself, the limits of
  its velocity, and last the command's ticket.
"""

from __future__ import annotations

from functools import reduce
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeAlias, TypeVar

import msgspec

from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.calls import Refused
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.wire.framing import LEASED
from rsb_bridge.wire.headers import LEASE_HEADER_LENGTH, CallFrame, frame_size, split_number

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.ros.ros_interface import RawMessage, Request
    from rsb_bridge.route.age import MessageAge
    from rsb_bridge.route.arming import Arming
    from rsb_bridge.route.beat import TopicInBeat
    from rsb_bridge.route.drivers import Drivers
    from rsb_bridge.route.history_depth import Sample
    from rsb_bridge.route.ledger import RouteLedger
    from rsb_bridge.route.lifecycle import PauseState
    from rsb_bridge.route.loop_filter import LoopFilter
    from rsb_bridge.route.peer_budget import CallBudget
    from rsb_bridge.route.rate_limit import AllowedRates, LastLater, Throttle
    from rsb_bridge.route.route import Route
    from rsb_bridge.route.topic_flow import TopicFlow
    from rsb_bridge.wire.framing import Message


S = TypeVar("S")


class Gated(Protocol):
    """A message or a call, as gates see it."""

    @property
    def stamp(self) -> int:
        """Time (ns) from which its age counts, by the clock of the side that took it from ROS."""

    @property
    def lease(self) -> int:
        """The lease's number from when it was taken from ROS, or 0 for none."""


Gate: TypeAlias = "Callable[[S, float], Refused | None]"
"""One reason not to pass, or a chain of them: returns the reason why a sample may not pass, or None.

It also gets `now` (s), when this turn of the I/O loop began. Gates before which a turn may stand still read the clock.
"""
Gates: TypeAlias = "tuple[Gate[Gated], ...]"
Sieve: TypeAlias = "Callable[[Sequence[S]], Sequence[S]]"
"""A gate for messages that come together, or a chain of them: returns those that pass, and counts the others in the
ledger. To ask a gate for each message would take as long as sending them."""
LastLook: TypeAlias = "Callable[[], Refused | None]"
"""Returns the reason why a message may not be handed on, right before it would be, or None."""


def chained(gates: tuple[Gate[S], ...]) -> Gate[S] | None:
    """Return one gate for all, which returns the first reason not to pass, or None if no gate is on."""
    return reduce(_both, gates) if gates else None


def _both(first: Gate[S], second: Gate[S]) -> Gate[S]:
    # The usual two in a loop would take 100 ns more a message.
    return lambda sample, now: first(sample, now) or second(sample, now)


def pause_gate(pausing: PauseState) -> Gate[object]:
    """Pass calls while no operator has paused them. The pause of a topic ends its subscription instead."""
    return lambda _, __: Refused.PAUSED if pausing.paused else None


def armed_gate(arming: Arming) -> Gate[object]:
    """Pass everything while operators want it to pass, and the two sides hear each other."""

    def gate(_: object, now: float) -> Refused | None:
        crossing = arming.crossing(now)
        if crossing is Crossing.YES:
            return None
        # A caller learns that arming again does not help: the two sides do not hear each other.
        return Refused.UNHEARD if crossing is Crossing.UNHEARD else Refused.DISARMED

    return gate


def lease_gate(arming: Arming) -> Gate[Gated]:
    """Pass what the other side took from ROS in this arming, at most a second ago."""

    def gate(sample: Gated, _: float) -> Refused | None:
        number = sample.lease
        if number >= arming.first and arming.lease is not None and arming.lease.passes(number):
            return None
        return Refused.DISARMED

    return gate


def young_gate(age: MessageAge) -> Gate[Gated]:
    """Pass what is young enough on the side that took it from ROS."""
    return lambda sample, _: None if age.is_young(sample.stamp) else Refused.TOO_OLD


def age_gate(age: MessageAge) -> Gate[Gated]:
    """Pass what is young enough on the side that gives it to ROS, and count the rest by its cause."""

    def gate(sample: Gated, _: float) -> Refused | None:
        if (why := age.why_old(sample.stamp)) is None:
            return None
        age.expired(why, 1)
        return Refused.TOO_OLD

    return gate


def rate_gate(rates: AllowedRates, topic: str, rate: float) -> Gate[object]:
    """Pass as many of one topic's messages a second as this side allows."""
    return lambda _, now: None if rates.admits(topic, rate, now) else Refused.TOO_FAST


class CallRateGate:
    """Passes so many calls a second, and at once as many as come in one.

    Attributes:
        rate: Hz, or 0 for any.
    """

    def __init__(self, rate: float, now: float) -> None:
        self.rate = rate
        # A bucket that holds less than one token never gives any.
        self._bucket = TokenBucket(max(1.0, rate), rate, now)

    def check(self, _: object, now: float) -> Refused | None:
        return None if self._bucket.take(1.0, now) else Refused.TOO_FAST


def size_gate(largest: int) -> Gate[Request]:
    """Pass requests of at most `largest` bytes, which the transport carries."""
    return lambda request, _: Refused.TOO_LARGE if len(request.payload) > largest else None


def budget_gate(budget: CallBudget) -> Gate[Request | CallFrame]:
    """Pass calls within their link's budget, in which each one that passes has its place until it ends."""

    def gate(call: Request | CallFrame, now: float) -> Refused | None:
        return budget.take(frame_size(call.content if isinstance(call, CallFrame) else call.payload), now)

    return gate


def compose_when_switched(route: Route, compose: Callable[[], None]) -> None:
    """Have a route's gates composed now, and again whenever one may have to be switched on or off."""
    route.arming.switched = route.age.switched = route.limit.switched = compose
    compose()


# --- from ROS to the channel


def sifting(first: Sieve[S], *others: Sieve[S]) -> Sieve[S]:
    """Return one sieve for all, one after the other."""
    return reduce(_then, others, first)


def _then(first: Sieve[S], second: Sieve[S]) -> Sieve[S]:
    return lambda batch: second(first(batch))


def fresh_sieve(flow: TopicFlow, ledger: RouteLedger) -> Sieve[RawMessage]:
    """Pass what is young enough as it comes from ROS, by its publisher's stamps."""
    age, silence, now = flow.route.age, flow.silence, flow.route.context.now

    def sieve(batch: Sequence[RawMessage]) -> Sequence[RawMessage]:
        fresh = age.fresh(batch)
        if expired := len(batch) - len(fresh):
            ledger.offered += expired
            ledger.expired += expired
            silence.seen(now())  # whoever publishes what is too old has not stopped
        return fresh

    return sieve


def loop_sieve(loops: LoopFilter, route: Route, ledger: RouteLedger) -> Sieve[RawMessage]:
    """Pass what does not go in a loop. The loop filter holds messages whose source is not known yet."""

    def admitted(batch: Sequence[RawMessage]) -> Sequence[RawMessage]:
        passed, unseen = loops.admit(batch)
        if unseen:
            route.advance()  # finds their publishers, and may change the sources of the others
            sources = loops.table.flags
            sent = [message for message in passed if message.gid in sources]
            # `advance` may have ended the opening: then the messages would not loop, but are lost with it.
            ledger.lose("would loop" if route.id else "link lost", len(passed) - len(sent))
            passed = sent
        ledger.lose("queue full", loops.give_up())
        return passed

    def sieve(batch: Sequence[RawMessage]) -> Sequence[RawMessage]:
        sources = loops.table.flags
        # Nearly always all sources are known: then the batch passes as it is, without a copy.
        for message in batch:
            if message.gid not in sources:
                return admitted(batch)
        return batch

    return sieve


def driver_sieve(drivers: Drivers) -> Sieve[RawMessage]:
    """Pass everything, and count the messages of each driver."""

    def sieve(batch: Sequence[RawMessage]) -> Sequence[RawMessage]:
        drivers.count(batch)
        return batch

    return sieve


def throttle_sieve(
    throttle: Throttle, ledger: RouteLedger, flow: TopicFlow, later: LastLater, beat: TopicInBeat | None
) -> Sieve[RawMessage]:
    """Pass as many of a volatile topic's messages a second as both sides want, those that its beat chooses."""

    def sieve(batch: Sequence[RawMessage]) -> Sequence[RawMessage]:
        if beat is None:
            passed = [message for message in batch if throttle.passes(message.stamp)]
        else:
            passed = [message for message in batch if beat.passes(message)]
        left_out = len(batch) - len(passed)
        if flow.carried.may_move or flow.route.arming.required:
            last = None if passed and passed[-1] is batch[-1] else batch[-1]
            left_out += later.follow(last) - (last is not None)
        ledger.throttled += left_out
        return passed

    return sieve


def kept_age_sieve(age: MessageAge, ledger: RouteLedger) -> Sieve[Sample]:
    """Pass a latched topic's messages that are still young enough. Some have waited, as in their history."""

    def sieve(samples: Sequence[Sample]) -> Sequence[Sample]:
        oldest = age.oldest
        old = [each for each in samples if each.message.stamp < oldest]
        if not old:
            return samples
        ledger.expired += len(old)
        for each in old:
            age.expired(Cause.PUBLISHER_STAMPS_OLD if each.replayed else Cause.LINK_SLOW, 1)
        return [each for each in samples if each.message.stamp >= oldest]

    return sieve


def kept_loop_sieve(loops: LoopFilter, ledger: RouteLedger) -> Sieve[Sample]:
    """Pass a latched topic's messages of which it has not turned out, while they waited, that they would loop."""

    def sieve(samples: Sequence[Sample]) -> Sequence[Sample]:
        sources = loops.table.flags
        for _, message, _ in samples:
            if message.gid not in sources:
                passed = [each for each in samples if each.message.gid in sources]
                ledger.drop("would loop", len(samples) - len(passed))
                return passed
        return samples

    return sieve


def young_sieve(age: MessageAge, ledger: RouteLedger) -> Sieve[Message]:
    """Pass what is still young enough when the channel has room for it."""

    def sieve(messages: Sequence[Message]) -> Sequence[Message]:
        young = age.young(messages)
        ledger.expired += len(messages) - len(young)
        return young

    return sieve


class SendingGates(NamedTuple):
    """The gates of a topic's sending half, in the order in which they are asked."""

    batch: Gates  # once of messages that come together from ROS
    arriving: tuple[Sieve[RawMessage], ...]  # of these when they have the stamps for the other side
    sourced: tuple[Sieve[RawMessage], ...]  # of a volatile topic's when the loop filter has found their source
    kept: tuple[Sieve[Sample], ...]  # of a latched topic's when its histories release them
    packed: tuple[Sieve[Message], ...]  # of the compressed messages if they are too long together
    leaving: tuple[Sieve[Message], ...]  # right before the channel gets them, maybe after a wait in the queue


def sending_gates(
    flow: TopicFlow,
    ledger: RouteLedger,
    throttle: Throttle,
    later: LastLater,
    loops: LoopFilter,
    fitting: Sieve[Message],
    beat: TopicInBeat | None = None,
) -> SendingGates:
    """Return the gates of messages from ROS to the channel.

    Args:
        beat: chooses for the throttle, or None if that goes by itself.
        later: has the last of what may move a robot pass after all.
        fitting: passes what the transport carries.
    """
    route = flow.route
    age, ages = route.age, route.age.is_on
    # A latched topic's messages wait in its histories; their age is asked when they leave these (`kept_age_sieve`).
    fresh = (fresh_sieve(flow, ledger),) if ages and not flow.is_latched else ()
    driven = (driver_sieve(flow.drivers),) if flow.drivers.are_watched else ()
    return SendingGates(
        batch=armed_gates(route),
        arriving=(*fresh, loop_sieve(loops, route, ledger), *driven),
        sourced=(throttle_sieve(throttle, ledger, flow, later, beat),) if throttle.is_on else (),
        kept=(*((kept_age_sieve(age, ledger),) if ages else ()), kept_loop_sieve(loops, ledger)),
        packed=(fitting,),
        leaving=(young_sieve(age, ledger),) if ages else (),
    )


# --- from the channel to ROS


class GatedMessage(msgspec.Struct, gc=False):
    """A message of the other side's, as gates see it."""

    stamp: int
    lease: int


NO_SAMPLE = GatedMessage(0, 0)
"""For gates that are asked of no sample in particular."""


def unleased(payload: bytes, flags: int) -> tuple[int, bytes, int]:
    """Return the lease's number of a message, or 0 for none, and its payload and flags without it."""
    # A message that is too short for the header keeps its flag and gets 0, which is no lease's number: gates drop it.
    if not flags & LEASED or len(payload) < LEASE_HEADER_LENGTH:
        return 0, payload, flags
    return *split_number(payload), flags & ~LEASED


class IncomingGates(NamedTuple):
    """The gates of a topic's receiving half."""

    batch: Gates  # asked once of messages that arrive together, for nothing in them counts
    arriving: Gates  # of each one before it is unpacked and checked
    leaving: Gates  # right before DDS gets it


def incoming_gates(route: Route) -> IncomingGates:
    """Return the gates of messages from the channel to ROS."""
    arming, rate = route.arming, route.limit.here
    leased: Gates = (lease_gate(arming),) if arming.required else ()
    young: Gates = (age_gate(route.age),) if route.age.is_on else ()
    slow: Gates = (rate_gate(route.peer.budget.rates, route.local_topic, rate),) if rate else ()
    # The rate comes last, so that messages which the lease refuses take no token.
    return IncomingGates(batch=armed_gates(route), arriving=(*leased, *slow), leaving=(*leased, *young))


# --- calls; lanes that stop or watch a robot are not `limited`


class CallingGates(NamedTuple):
    """The gates of the callers' half."""

    arriving: tuple[Gate[Request], ...]  # asked of each request from ROS
    leaving: Gates  # right before the channel gets it


def calling_gates(route: Route, largest: int, rate: CallRateGate, *, limited: bool) -> CallingGates:
    """Return the gates of calls from ROS to the channel."""
    fits, budget = size_gate(largest), budget_gate(route.peer.budget.asked)
    if not limited:
        return CallingGates((fits, budget), ())
    young: Gates = (young_gate(route.age),) if route.age.is_on else ()
    slow: Gates = (rate.check,) if rate.rate else ()
    # Rate and budget come last: a call that is refused before takes no token, and no place.
    return CallingGates((pause_gate(route.pausing), *armed_gates(route), *young, fits, *slow, budget), young)


class ProvidingGates(NamedTuple):
    """The gates of the providing half. Between them, contents are checked."""

    arriving: Gates  # asked of each call that comes
    leaving: tuple[Gate[CallFrame], ...]  # right before ROS gets it


def providing_gates(route: Route, *, limited: bool) -> ProvidingGates:
    """Return the gates of calls from the channel to ROS."""
    arming, rate, budget = route.arming, route.limit.here, budget_gate(route.peer.budget.provided)
    if not limited:
        return ProvidingGates((), (budget,))
    young: Gates = (age_gate(route.age),) if route.age.is_on else ()
    armed: Gates = (*armed_gates(route), lease_gate(arming)) if arming.required else ()
    slow: Gates = (rate_gate(route.peer.budget.rates, route.local_topic, rate),) if rate else ()
    # As on the callers' side, only a call that nothing else refuses takes a token and a place.
    return ProvidingGates((*young, pause_gate(route.pausing), *armed), (*young, *armed, *slow, budget))


# --- by hand; neither a pause nor a rate holds that up


def armed_gates(route: Route) -> Gates:
    """Return the gate of a route that must be armed. The other lists begin with it, and by hand there is no further."""
    return (armed_gate(route.arming),) if route.arming.required else ()


def why_not_by_hand(route: Route, now: float) -> Refused | None:
    """Return the reason why an operator may do nothing by hand over a route at `now` (s), or None."""
    check = chained(armed_gates(route))
    return None if check is None else check(NO_SAMPLE, now)
