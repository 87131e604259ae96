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
- a full queue and a lost link: no rule keeps these messages back.
- pause, arming and loops of a message that `LastLater` sends: `sending.OutgoingPath` asks them once more.
- a message with a lease's number on a route that needs no arming: `incoming.IncomingRoute` drops it as it unpacks it.
- what an operator publishes by hand: the feature `driving` asks `why_not_by_hand` of all routes of the topic
  together, then whether it is about to be disarmed, who holds it, whether the robot would stop by itself, the limits of
  its velocity, and last the command's ticket.
"""

from __future__ import annotations

from functools import reduce
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias, TypeVar

import msgspec

from rsb_bridge.cdr.known_types import DRIVING_TYPES
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
    from rsb_bridge.route.history_depth import Sample
    from rsb_bridge.route.ledger import RouteLedger
    from rsb_bridge.route.lifecycle import PauseState
    from rsb_bridge.route.loop_filter import LoopFilter
    from rsb_bridge.route.peer import CallBudget
    from rsb_bridge.route.rate_limit import AllowedRates, LastLater, Throttle
    from rsb_bridge.route.route import Route
    from rsb_bridge.route.topic_route import TopicRoute
    from rsb_bridge.wire.framing import Message


S = TypeVar("S")
S_contra = TypeVar("S_contra", contravariant=True)


class Gated(Protocol):
    """A message or a call, as gates see it."""

    @property
    def stamp(self) -> int:
        """Time (ns) from which its age counts, by the clock of the side that took it from ROS."""

    @property
    def lease(self) -> int:
        """The lease's number from when it was taken from ROS, or 0 for none."""


class Gate(Protocol[S_contra]):
    """One reason not to pass."""

    def check(self, sample: S_contra, now: float, /) -> Refused | None:
        """Return the reason why a sample may not pass, or None.

        Args:
            now: s, when this turn of the I/O loop began. Gates before which a turn may stand still read the clock.
        """


Gates: TypeAlias = "tuple[Gate[Gated], ...]"
Check: TypeAlias = "Callable[[S, float], Refused | None]"
"""The `check` of a gate, or of several."""
Sift: TypeAlias = "Callable[[Sequence[S]], Sequence[S]]"
"""The `passing` of a sieve, or of several."""
LastLook: TypeAlias = "Callable[[], Refused | None]"
"""Returns the reason why a message may not be handed on, right before it would be, or None."""


def chained(gates: tuple[Gate[S], ...]) -> Check[S] | None:
    """Return one check for all, which returns the first reason not to pass, or None if no gate is on."""
    return reduce(_both, [gate.check for gate in gates]) if gates else None


def _both(first: Check[S], second: Check[S]) -> Check[S]:
    # The usual two in a loop would take 100 ns more a message.
    return lambda sample, now: first(sample, now) or second(sample, now)


class PauseGate:
    """Passes calls while no operator has paused them. The pause of a topic ends its subscription instead."""

    def __init__(self, pausing: PauseState) -> None:
        self._pausing = pausing

    def check(self, _: object, __: float) -> Refused | None:
        return Refused.PAUSED if self._pausing.paused else None


class ArmedGate:
    """Passes everything while operators want it to pass, and the two sides hear each other."""

    def __init__(self, arming: Arming) -> None:
        self._arming = arming

    def check(self, _: object, now: float) -> Refused | None:
        crossing = self._arming.crossing(now)
        if crossing is Crossing.YES:
            return None
        # A caller learns that arming again does not help: the two sides do not hear each other.
        return Refused.UNHEARD if crossing is Crossing.UNHEARD else Refused.DISARMED


class LeaseGate:
    """Passes what the other side took from ROS in this arming, at most a second ago."""

    def __init__(self, arming: Arming) -> None:
        self._arming = arming

    def check(self, sample: Gated, _: float) -> Refused | None:
        number, arming = sample.lease, self._arming
        if number >= arming.first and arming.lease is not None and arming.lease.passes(number):
            return None
        return Refused.DISARMED


class YoungGate:
    """Passes what is young enough on the side that took it from ROS."""

    def __init__(self, age: MessageAge) -> None:
        self._age = age

    def check(self, sample: Gated, _: float) -> Refused | None:
        return None if self._age.is_young(sample.stamp) else Refused.TOO_OLD


class AgeGate:
    """Passes what is young enough on the side that gives it to ROS, and counts the rest by its cause."""

    def __init__(self, age: MessageAge) -> None:
        self._age = age

    def check(self, sample: Gated, _: float) -> Refused | None:
        if (why := self._age.why_old(sample.stamp)) is None:
            return None
        self._age.expired(why, 1)
        return Refused.TOO_OLD


class RateGate:
    """Passes as many of one topic's messages a second as this side allows."""

    def __init__(self, rates: AllowedRates, topic: str, rate: float) -> None:
        self._rates = rates
        self._topic = topic
        self._rate = rate

    def check(self, _: object, now: float) -> Refused | None:
        return None if self._rates.admits(self._topic, self._rate, now) else Refused.TOO_FAST


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


class Carries(Protocol):
    """A sender of calls, as far as gates know it."""

    @property
    def largest(self) -> int:
        """Bytes of the largest call that the transport carries."""


class SizeGate:
    """Passes requests that the transport carries."""

    def __init__(self, outbox: Carries) -> None:
        self._outbox = outbox

    def check(self, request: Request, _: float) -> Refused | None:
        return Refused.TOO_LARGE if len(request.payload) > self._outbox.largest else None


class BudgetGate:
    """Passes calls within their link's budget, in which each one that passes has its place until it ends."""

    def __init__(self, budget: CallBudget) -> None:
        self._budget = budget

    def check(self, call: Request | CallFrame, now: float) -> Refused | None:
        return self._budget.take(frame_size(call.content if isinstance(call, CallFrame) else call.payload), now)


def compose_when_switched(route: Route, compose: Callable[[], None]) -> None:
    """Have a route's gates composed now, and again whenever one may have to be switched on or off."""
    route.arming.switched = route.age.switched = route.limit.switched = compose
    compose()


# --- from ROS to the channel


class Sieve(Protocol[S]):
    """A gate for messages that come together. A call of `Gate.check` for each would take as long as sending them."""

    def passing(self, batch: Sequence[S], /) -> Sequence[S]:
        """Return the messages that pass, and count the others in the ledger."""


def sifting(first: Sieve[S], *others: Sieve[S]) -> Sift[S]:
    """Return one sieve's `passing` for all, one after the other."""
    sift: Sift[S] = first.passing
    return reduce(_then, (sieve.passing for sieve in others), sift)


def _then(first: Sift[S], second: Sift[S]) -> Sift[S]:
    return lambda batch: second(first(batch))


class FreshSieve:
    """Passes what is young enough as it comes from ROS, by its publisher's stamps."""

    def __init__(self, age: MessageAge, ledger: RouteLedger) -> None:
        self._age = age
        self._ledger = ledger

    def passing(self, batch: Sequence[RawMessage]) -> Sequence[RawMessage]:
        fresh = self._age.fresh(batch)
        if expired := len(batch) - len(fresh):
            self._ledger.offered += expired
            self._ledger.expired += expired
        return fresh


class LoopSieve:
    """Passes what does not go in a loop. The loop filter holds messages whose source is not known yet."""

    def __init__(self, loops: LoopFilter, route: Route, ledger: RouteLedger) -> None:
        self._loops = loops
        self._route = route
        self._ledger = ledger

    def passing(self, batch: Sequence[RawMessage]) -> Sequence[RawMessage]:
        sources = self._loops.table.flags
        # Nearly always all sources are known: then the batch passes as it is, without a copy.
        for message in batch:
            if message.gid not in sources:
                return self._admitted(batch)
        return batch

    def _admitted(self, batch: Sequence[RawMessage]) -> Sequence[RawMessage]:
        admitted, unseen = self._loops.admit(batch)
        if unseen:
            self._route.advance()  # finds their publishers, and may change the sources of the others
            sources = self._loops.table.flags
            sent = [message for message in admitted if message.gid in sources]
            # `advance` may have ended the opening: then the messages would not loop, but are lost with it.
            self._ledger.lose("would loop" if self._route.id else "link lost", len(admitted) - len(sent))
            admitted = sent
        self._ledger.lose("queue full", self._loops.give_up())
        return admitted


class ThrottleSieve:
    """Passes as many of a volatile topic's messages a second as both sides want.

    Args:
        later: has the last of what may move a robot pass after all.
    """

    def __init__(self, throttle: Throttle, ledger: RouteLedger, route: Route, later: LastLater) -> None:
        self._throttle = throttle
        self._ledger = ledger
        self._route = route
        self._later = later

    def passing(self, batch: Sequence[RawMessage]) -> Sequence[RawMessage]:
        passed = [message for message in batch if self._throttle.passes(message.stamp)]
        left_out = len(batch) - len(passed)
        if self._route.type_name in DRIVING_TYPES or self._route.arming.required:
            last = None if passed and passed[-1] is batch[-1] else batch[-1]
            left_out += self._later.follow(last) - (last is not None)
        self._ledger.throttled += left_out
        return passed


class KeptAgeSieve:
    """Passes a latched topic's messages that are still young enough. Some have waited, as in their history."""

    def __init__(self, age: MessageAge, ledger: RouteLedger) -> None:
        self._age = age
        self._ledger = ledger

    def passing(self, samples: Sequence[Sample]) -> Sequence[Sample]:
        oldest = self._age.oldest
        for _, message, _ in samples:
            if message.stamp < oldest:
                return self._young(samples, oldest)
        return samples

    def _young(self, samples: Sequence[Sample], oldest: int) -> Sequence[Sample]:
        for each in samples:
            if each.message.stamp < oldest:
                self._age.expired(Cause.PUBLISHER_STAMPS_OLD if each.replayed else Cause.LINK_SLOW, 1)
                self._ledger.expired += 1
        return [each for each in samples if each.message.stamp >= oldest]


class KeptLoopSieve:
    """Passes a latched topic's messages of which it has not turned out, while they waited, that they would loop."""

    def __init__(self, loops: LoopFilter, ledger: RouteLedger) -> None:
        self._loops = loops
        self._ledger = ledger

    def passing(self, samples: Sequence[Sample]) -> Sequence[Sample]:
        sources = self._loops.table.flags
        for _, message, _ in samples:
            if message.gid not in sources:
                passed = [each for each in samples if each.message.gid in sources]
                self._ledger.drop("would loop", len(samples) - len(passed))
                return passed
        return samples


class CarriesMessages(Carries, Protocol):
    """A sender of messages, as far as gates know it."""

    def too_large(self, size: int, /) -> None:
        """Count a message of so many bytes that does not pass."""


class SizeSieve:
    """Passes what the transport carries."""

    def __init__(self, outbox: CarriesMessages) -> None:
        self._outbox = outbox

    def passing(self, messages: Sequence[Message]) -> Sequence[Message]:
        return [each for each in messages if self._fits(len(each[0]))]

    def _fits(self, size: int) -> bool:
        if size <= self._outbox.largest:
            return True
        self._outbox.too_large(size)
        return False


class YoungSieve:
    """Passes what is still young enough when the channel has room for it."""

    def __init__(self, age: MessageAge, ledger: RouteLedger) -> None:
        self._age = age
        self._ledger = ledger

    def passing(self, messages: Sequence[Message]) -> Sequence[Message]:
        young = self._age.young(messages)
        if len(young) < len(messages):
            self._ledger.expired += len(messages) - len(young)
        return young


class SendingGates(NamedTuple):
    """The gates of a topic's sending half, in the order in which they are asked.

    Attributes:
        batch: asked once of messages that come together from ROS.
        arriving: asked of these when they have the stamps for the other side.
        sourced: asked of a volatile topic's messages when the loop filter has found their source.
        kept: asked of a latched topic's messages when its histories release them.
        packed: asked of the compressed messages if they are too long together.
        leaving: asked right before the channel gets them, maybe after a wait in the queue.
    """

    batch: Gates
    arriving: tuple[Sieve[RawMessage], ...]
    sourced: tuple[Sieve[RawMessage], ...]
    kept: tuple[Sieve[Sample], ...]
    packed: tuple[Sieve[Message], ...]
    leaving: tuple[Sieve[Message], ...]


def sending_gates(
    route: TopicRoute[Any],
    ledger: RouteLedger,
    throttle: Throttle,
    later: LastLater,
    loops: LoopFilter,
    outbox: CarriesMessages,
) -> SendingGates:
    """Return the gates of messages from ROS to the channel."""
    age, ages = route.age, route.age.is_on
    # A latched topic's messages wait in its histories; their age is asked when they leave these (`KeptAgeSieve`).
    fresh = (FreshSieve(age, ledger),) if ages and not route.is_latched else ()
    return SendingGates(
        batch=armed_gates(route),
        arriving=(*fresh, LoopSieve(loops, route, ledger)),
        sourced=(ThrottleSieve(throttle, ledger, route, later),) if throttle.is_on else (),
        kept=(*((KeptAgeSieve(age, ledger),) if ages else ()), KeptLoopSieve(loops, ledger)),
        packed=(SizeSieve(outbox),),
        leaving=(YoungSieve(age, ledger),) if ages else (),
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
    """The gates of a topic's receiving half.

    Attributes:
        batch: asked once of messages that arrive together, for nothing in them counts.
        arriving: asked of each one before it is unpacked and checked.
        leaving: asked right before DDS gets it.
    """

    batch: Gates
    arriving: Gates
    leaving: Gates


def incoming_gates(route: Route) -> IncomingGates:
    """Return the gates of messages from the channel to ROS."""
    arming, rate = route.arming, route.limit.here
    leased: Gates = (LeaseGate(arming),) if arming.required else ()
    young: Gates = (AgeGate(route.age),) if route.age.is_on else ()
    slow: Gates = (RateGate(route.peer.budget.rates, route.local_topic, rate),) if rate else ()
    # The rate comes last, so that messages which the lease refuses take no token.
    return IncomingGates(batch=armed_gates(route), arriving=(*leased, *slow), leaving=(*leased, *young))


# --- calls; lanes that stop or watch a robot are not `limited`


class CallingGates(NamedTuple):
    """The gates of the callers' half.

    Attributes:
        arriving: asked of each request from ROS.
        leaving: asked right before the channel gets it.
    """

    arriving: tuple[Gate[Request], ...]
    leaving: Gates


def calling_gates(route: Route, outbox: Carries, rate: CallRateGate, *, limited: bool) -> CallingGates:
    """Return the gates of calls from ROS to the channel."""
    fits, budget = SizeGate(outbox), BudgetGate(route.peer.budget.asked)
    if not limited:
        return CallingGates((fits, budget), ())
    young: Gates = (YoungGate(route.age),) if route.age.is_on else ()
    slow: Gates = (rate,) if rate.rate else ()
    # Rate and budget come last: a call that is refused before takes no token, and no place.
    return CallingGates((PauseGate(route.pausing), *armed_gates(route), *young, fits, *slow, budget), young)


class ProvidingGates(NamedTuple):
    """The gates of the providing half. Between them, contents are checked.

    Attributes:
        arriving: asked of each call that comes.
        leaving: asked right before ROS gets it.
    """

    arriving: Gates
    leaving: tuple[Gate[CallFrame], ...]


def providing_gates(route: Route, *, limited: bool) -> ProvidingGates:
    """Return the gates of calls from the channel to ROS."""
    arming, rate, budget = route.arming, route.limit.here, BudgetGate(route.peer.budget.provided)
    if not limited:
        return ProvidingGates((), (budget,))
    young: Gates = (AgeGate(route.age),) if route.age.is_on else ()
    armed: Gates = (*armed_gates(route), LeaseGate(arming)) if arming.required else ()
    slow: Gates = (RateGate(route.peer.budget.rates, route.local_topic, rate),) if rate else ()
    # As on the callers' side, only a call that nothing else refuses takes a token and a place.
    return ProvidingGates((*young, PauseGate(route.pausing), *armed), (*young, *armed, *slow, budget))


# --- by hand; neither a pause nor a rate holds that up


def armed_gates(route: Route) -> Gates:
    """Return the gate of a route that must be armed. The other lists begin with it, and by hand there is no further."""
    return (ArmedGate(route.arming),) if route.arming.required else ()


def why_not_by_hand(route: Route, now: float) -> Refused | None:
    """Return the reason why an operator may do nothing by hand over a route at `now` (s), or None."""
    check = chained(armed_gates(route))
    return None if check is None else check(NO_SAMPLE, now)
