"""The gates that samples pass on their way: nothing old and nothing unarmed gets through (`Gate`).

The functions at the end list the gates of each way in the order in which they are asked, without those that are off.
What depends on a message's age or lease is asked twice: when a sample comes, before it costs anything, and right before
it is handed on, because unpacking, checks and requests to DDS take long.
"""

from __future__ import annotations

from functools import reduce
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeAlias, TypeVar

import msgspec

from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.calls import Refused
from rsb_bridge.wire.framing import LEASED
from rsb_bridge.wire.headers import LEASE_HEADER_LENGTH, CallFrame, frame_size, split_number

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.ros.ros_interface import Request
    from rsb_bridge.route.age import MessageAge
    from rsb_bridge.route.arming import Arming
    from rsb_bridge.route.lifecycle import PauseState
    from rsb_bridge.route.peer import CallBudget
    from rsb_bridge.route.rate_limit import AllowedRates
    from rsb_bridge.route.route import Route


S = TypeVar("S")
S_contra = TypeVar("S_contra", contravariant=True)


class Gated(Protocol):
    """A message or a call, as gates see it."""

    @property
    def stamp(self) -> int:
        """Time (ns) from which its age counts, by the clock of the side that took it from ROS."""
        ...

    @property
    def lease(self) -> int:
        """The lease's number from when it was taken from ROS, or 0 for none."""
        ...


class Gate(Protocol[S_contra]):
    """One reason not to pass."""

    def check(self, sample: S_contra, now: float, /) -> Refused | None:
        """Return the reason why a sample may not pass, or None.

        Args:
            now: s, when this turn of the I/O loop began. Gates before which a turn may stand still read the clock.
        """
        ...


Gates: TypeAlias = "tuple[Gate[Gated], ...]"
Check: TypeAlias = "Callable[[S, float], Refused | None]"
"""The `check` of a gate, or of several."""
LastLook: TypeAlias = "Callable[[], Refused | None]"
"""Returns the reason why a message may not be handed on, right before it would be, or None."""


def chained(gates: tuple[Gate[S], ...]) -> Check[S] | None:
    """Return one check for all, which returns the first reason not to pass, or None if no gate is on."""
    checks: list[Check[S]] = [gate.check for gate in gates]
    return reduce(_both, checks) if checks else None


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
        lease = self._arming.lease
        if lease is None or not self._arming.stands(now):
            return Refused.DISARMED
        return None if lease.alive else Refused.UNHEARD


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
        return None if self._rates.admits(self._topic, self._rate, now) else Refused.CALLS_A_SECOND


class CallRateGate:
    """Passes so many calls a second, and at once as many as come in one.

    Attributes:
        rate: Hz, or 0 for any.
    """

    def __init__(self, rate: float, now: float) -> None:
        self.rate = rate
        self._bucket = TokenBucket(max(1.0, rate), rate, now)

    def check(self, _: object, now: float) -> Refused | None:
        return None if self._bucket.take(1.0, now) else Refused.CALLS_A_SECOND


class Carries(Protocol):
    """A sender of calls, as far as gates know it."""

    @property
    def largest(self) -> int:
        """Bytes of the largest call that the transport carries."""
        ...


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


# --- from the channel to ROS


class GatedMessage(msgspec.Struct, gc=False):
    """A message of the other side's, as gates see it."""

    stamp: int
    lease: int


NO_SAMPLE = GatedMessage(0, 0)
"""For gates that are asked of no sample in particular."""


def unleased(payload: bytes, flags: int) -> tuple[int, bytes, int]:
    """Return the lease's number of a message, or 0 for none, and its payload and flags without it."""
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
    return IncomingGates(batch=hand_gates(route), arriving=(*leased, *slow), leaving=(*leased, *young))


# --- calls; those of lanes that stop or watch a robot are not `limited`


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
    return CallingGates((PauseGate(route.pausing), *hand_gates(route), *young, fits, *slow, budget), young)


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
    armed: Gates = (*hand_gates(route), LeaseGate(arming)) if arming.required else ()
    slow: Gates = (RateGate(route.peer.budget.rates, route.local_topic, rate),) if rate else ()
    return ProvidingGates((*young, PauseGate(route.pausing), *armed), (*young, *armed, *slow, budget))


# --- by hand


def hand_gates(route: Route) -> Gates:
    """Return the gates of what an operator of this side does here: neither a pause nor a rate holds that up."""
    return (ArmedGate(route.arming),) if route.arming.required else ()


def why_not_by_hand(route: Route, now: float) -> Refused | None:
    """Return the reason why an operator may do nothing by hand over a route at `now` (s), or None."""
    check = chained(hand_gates(route))
    return None if check is None else check(NO_SAMPLE, now)
