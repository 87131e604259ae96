"""The calls of callers here, from when they are asked until they are answered or given up.

A call goes through `AskedCalls.asked` (from ROS) and the outbox to the channel. What the other side says of it comes to
`receive`, which answers the caller, or ends the call in `_end_refused`.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.wording import Wording
from rsb_bridge.ros.ros_interface import Request, RosError
from rsb_bridge.route.calls.call_frames import APART, CallsOutbox, Spacing, from_wrong_side
from rsb_bridge.route.calls.calls_flow import CallsKind
from rsb_bridge.route.calls.calls_ledger import refused_as
from rsb_bridge.route.calls.manual_call import CallError, ManualCall
from rsb_bridge.route.calls.pending_calls import PendingCall, PendingCalls
from rsb_bridge.route.gates import CallRateGate, calling_gates, chained, compose_when_switched
from rsb_bridge.wire.headers import CallFrame, What, frame_size
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rsb_bridge.ros.ros_interface import ServiceServer
    from rsb_bridge.route.calls.calls_flow import CallsFlow
    from rsb_bridge.route.calls.lane_types import LaneTypes
    from rsb_bridge.wire.records import CallsReport

_TIMER_LATE = 0.002
"""s. Spaces answers of 100 Hz, too: of those 5 ms apart, the slack of messages lets ten come at once."""
_CAUGHT_UP_IN = 0.1
"""Part of the timeout in which answers of any gap come about: later calls wait behind them. A round figure."""


@dataclass(slots=True)
class CallerCall(PendingCall):
    """A call of a caller on this side.

    Attributes:
        server: took it, or is an operator's `ManualCall`.
        caller: names the request in `server.answer`.
        request: of an action's call, or empty.
    """

    server: ServiceServer | ManualCall
    caller: bytes
    request: bytes = b""


class CallerCalls(PendingCalls[CallerCall]):
    """Calls that wait for answers of the other side, numbered as they are sent.

    Attributes:
        last: number of the newest one.
        before: number of the newest one of earlier openings: those up to it wait to be sent again.
    """

    last = before = 0

    def begin(self, call: CallerCall, timeout: float | None) -> int:
        """Number a call, which expires after `timeout` s, or never if that is None."""
        self.last += 1
        self.add(self.last, call, timeout)
        return self.last

    def begin_again(self, number: int, timeout: float | None) -> int:
        """Give a call of an earlier opening a number of the present one, and its whole timeout."""
        call = self._calls.pop(number)  # it keeps its place in the budget
        call.expires = False
        return self.begin(call, timeout)

    def end_by(self, frame: CallFrame) -> CallerCall | None:
        """End the call that a frame is about, and return it, or None if it has ended before.

        Raises:
            ProtocolError: it was never made, or not on that lane.
        """
        call = self.get(frame.call)
        if call is None and not 0 < frame.call <= self.last:
            raise ProtocolError(f"an answer to call {frame.call}, which was never made")
        if frame.call <= self.before:  # its opening is about to end
            return None
        if call is not None and call.lane != frame.lane:
            raise ProtocolError(f"call {frame.call} is answered on lane {frame.lane}, not {call.lane}")
        return self.end(frame.call)


class CallerKind(CallsKind[CallerCall]):
    """What calls do here by their kind besides passing on: nothing for a service.

    Goals (`action_goals`) and parameters (`node_parameters`) replace methods.
    """

    def begins(self, call: CallerCall, payload: bytes) -> None:
        """Note a caller's call that is about to be sent."""

    def repeats(self, call: CallerCall) -> bool:
        """Return whether a call may be sent again after its opening has ended: it does no harm twice."""
        return False

    def refused(self, lane: int, server: ServiceServer | ManualCall, caller: bytes, request: bytes) -> None:
        """Handle a request that did not reach its server, and will not."""

    def answered(self, call: CallerCall, frame: CallFrame) -> None:
        """Read an answer that its caller gets next."""

    def unanswered(self, call: CallerCall) -> None:
        """Note a call that gets no answer."""

    def publishes(self, frame: CallFrame) -> bool:
        """Read a message, and return whether subscribers here get it."""
        return True


class LandedText(Wording):
    """The progress of a call without an answer on the other side."""

    GIVEN = "it was given to DDS there, so the node may have acted on it"
    UNREPORTED = "not reported whether it was given to DDS there: the node may have acted on it"


def _landed(number: int, report: CallsReport | None) -> str:
    """Return how far a call without an answer got, as the other side has reported it, once a second."""
    given = report is not None and number <= report.given
    return (LandedText.GIVEN if given else LandedText.UNREPORTED)()


class AskedCalls:
    """The calls of callers on this side.

    Args:
        kind: the class of what they do besides, by their kind.

    Attributes:
        pending: those that wait for answers.
        outbox: their frames, until the channel takes them.
        kind: follows them.
        lost: those that may be asked again, and whose server has gone since the last tick.
    """

    def __init__(self, flow: CallsFlow, types: LaneTypes, kind: type[CallerKind]) -> None:
        route = flow.route
        self._flow, self._route, self._types = flow, route, types
        self.outbox = CallsOutbox(flow, self._leaves)
        self.pending = CallerCalls(route.context.loop, route.peer.budget.asked, self._expired, self.outbox.forget)
        self.kind = kind(flow, self.pending)
        self.lost: list[CallerCall] = []
        self._spacing = Spacing(_TIMER_LATE)
        self._newest = 0.0  # s, latest time at which a held-up answer would have come without the way
        self._rate = CallRateGate(0.0, route.context.now())
        compose_when_switched(route, self._compose_gates)

    def _compose_gates(self) -> None:
        route = self._route
        if self._rate.rate != route.limit.rate:
            self._rate = CallRateGate(route.limit.rate, route.context.now())
        gates = [calling_gates(route, self.outbox.largest, self._rate, limited=limited) for limited in (False, True)]
        self._arriving = [chained(each.arriving) for each in gates]
        self._leaving = [chained(each.leaving) for each in gates]

    @property
    def lanes(self) -> set[int]:
        """The lanes on which callers wait for answers."""
        return {call.lane for _, call in self.pending.items()}

    # --- from ROS to the channel

    def asked(self, lane: int, server: ServiceServer, requests: Sequence[Request]) -> None:
        """Send callers' requests, or refuse them."""
        flow, age = self._flow, self._route.age
        limited = flow.members[lane].limited
        with_age, check = age.is_on and limited, self._arriving[limited]
        for request in map(age.aged, requests) if with_age else requests:
            payload, now = request.payload, self._route.context.now()
            flow.asked(len(payload))
            size = frame_size(payload)
            if check is not None and (why := check(request, now)) is not None:
                flow.failures.refused(why)
                self.kind.refused(lane, server, request.caller, payload)
                continue
            call = CallerCall(lane, size, now, server, request.caller)
            self.kind.begins(call, payload)
            self._begin(call, payload, request.lease, request.stamp if with_age else 0)
        self.outbox.flush()

    def ask_next(self, servers: Mapping[int, ServiceServer]) -> None:
        """Ask the next server what one that has gone did not answer; called once a second.

        Callers cannot see that another one is there: the bridge's own endpoint stays.
        """
        lost, self.lost = self.lost, []
        for call in lost:
            if (server := servers.get(call.lane)) is not None:
                request = Request(call.request, call.caller, self._route.context.stamps.now())
                self.asked(call.lane, server, [request])

    def asked_too_late(self, requests: Sequence[Request]) -> None:
        """Count requests that were on their way from ROS when the offer ended."""
        for request in requests:
            self._flow.asked(len(request.payload))
        self._flow.failures.lost(len(requests), "it is no longer offered")

    def _begin(self, call: CallerCall, payload: bytes, lease: int, stamp: int) -> None:
        """Send a call that has its place in the budget."""
        number = self.pending.begin(call, self._flow.timeout_of(call.lane))
        self.outbox.put(CallFrame(What.CALL, call.lane, number, 0, payload, lease, stamp))

    def _leaves(self, frame: CallFrame) -> bool:
        """Return whether a call that is about to be sent is young enough, or refuse it."""
        check = self._leaving[self._flow.members[frame.lane].limited]
        # One without a stamp has no age.
        if check is not None and frame.stamp and (why := check(frame, self._route.context.now())) is not None:
            if (call := self.pending.end_by(frame)) is not None:
                self._end_refused(call, why)
            return False
        return True  # the outbox forgets calls that have ended

    async def call_by_hand(self, lane: int, request: bytes) -> bytes:
        """Make a call as a caller here would.

        Raises:
            CallError: no response came.
        """
        flow, route = self._flow, self._route
        manual, limited = ManualCall(route.context.loop), flow.members[lane].limited
        flow.asked(len(request))
        lease = route.arming.newest_number if route.arming.required else 0
        made = Request(request, b"", route.context.stamps.now(), lease)
        size, now = frame_size(request), route.context.now()
        check = self._arriving[limited]
        if check is not None and (why := check(made, now)) is not None:
            raise CallError(flow.failures.refused(why))
        stamp = made.stamp if route.age.is_on and limited else 0
        self._begin(CallerCall(lane, size, now, manual, b""), request, lease, stamp)
        number = self.pending.last
        self.outbox.flush()
        try:
            return await manual.answered
        except asyncio.CancelledError:
            if self.pending.end(number) is not None:
                flow.failures.lost(1, "the operator who made it has gone")
            raise

    # --- from the channel to ROS

    def due(self, frame: CallFrame) -> float | None:
        """Return when (s) to answer a caller, or None if that is now.

        An answer that the way has held up keeps its distance from the one before, as if the way took no time.
        """
        if (call := self.pending.get(frame.call)) is None:
            return None
        now, without_way = self._route.context.now(), call.asked_at + frame.took / 1e9
        if (late := now - without_way) < APART:
            return None
        # Else each answer out of turn would add to the time of all.
        self._newest = max(self._newest, without_way)
        return self._spacing.wait(
            int(self._newest * 1e9), now, min(0.5, _CAUGHT_UP_IN * self._flow.call_timeout / late)
        )

    def receive(self, frame: CallFrame, *, readable: bool = True) -> None:
        """Take what the other side says of a call."""
        match frame.what:
            case _ if not readable:
                self._take_unusable(frame, Refused.BYTES_UNDER_WAY)
            case What.ANSWER:
                if (why := self._types.malformed(frame, "_Response")) is not None:
                    self._take_unusable(frame, why)
                elif (call := self.pending.end_by(frame)) is not None:
                    self._answer(call, frame)
                else:
                    self._flow.calls.late += 1
            case What.REFUSED:
                if (call := self.pending.end_by(frame)) is not None:
                    self._end_refused(call, refused_as(frame.content))
            case _:
                raise from_wrong_side(frame)

    def _answer(self, call: CallerCall, frame: CallFrame) -> None:
        """Answer the caller."""
        flow = self._flow
        took, total = frame.took / 1e9, self._route.context.now() - call.asked_at
        self.kind.answered(call, frame)
        try:
            call.server.answer(call.caller, frame.content)
        except RosError as error:
            flow.calls.lost += 1
            flow.failures.say(f"a caller could not be answered: {error}")
            return
        flow.answered(len(frame.content))
        if not flow.members[call.lane].patient:
            flow.calls.timed(took, total)

    # --- calls without an answer

    def _take_unusable(self, frame: CallFrame, why: Refused) -> None:
        """End a call whose answer came, but cannot be passed on."""
        if (call := self.pending.end_by(frame)) is not None:
            self._unanswered(call, self._flow.failures.refused(why))

    def _end_refused(self, call: CallerCall, why: Refused) -> None:
        """Handle that the other side will not answer a call, which has ended."""
        self._unanswered(call, self._flow.failures.refused(why))
        if why is not Refused.LOST:  # else its server may have acted on it
            self.kind.refused(call.lane, call.server, call.caller, call.request)
        elif self.kind.repeats(call) and not isinstance(call.server, ManualCall):
            self.lost.append(call)

    def _unanswered(self, call: CallerCall, reason: str) -> None:
        """Tell an operator that no answer to a call will come. ROS has no way to tell other callers."""
        if isinstance(call.server, ManualCall):
            call.server.fail(reason)
        self.kind.unanswered(call)

    def _expired(self, number: int, call: CallerCall) -> None:
        flow = self._flow
        flow.calls.expired += 1
        flow.failures.say(f"a call had no answer within {flow.call_timeout:g} s")
        self._unanswered(call, f"{flow.calls.last_failure}; {_landed(number, flow.report)}")

    def give_up(self, why: str) -> None:
        """Give up the calls of the present opening, for a reason in words."""
        self._give_up([each for each in self.pending.items() if each[0] > self.pending.before], why)

    def give_up_all(self, why: str) -> None:
        """Give up all calls, for a reason in words."""
        self._give_up(self.pending.items(), why)

    def _give_up(self, calls: Sequence[tuple[int, CallerCall]], why: str) -> None:
        for number, call in calls:
            self.pending.end(number)
            self._unanswered(call, f"no answer: {why}; {_landed(number, self._flow.report)}")
        if not len(self.pending):
            self.pending.clear()  # with the timer
        self._flow.failures.lost(len(calls), why)

    def close(self, reason: str) -> None:
        """End the opening. While the association lasts, calls that may be sent again wait for the next one."""
        peer, pending = self._route.peer, self.pending
        lasts = peer.linked or peer.suspended_since is not None
        self._give_up([each for each in pending.items() if not (lasts and self.kind.repeats(each[1]))], reason)
        pending.before = pending.last
        self.lost.clear()
        self.outbox.clear()
        if len(pending):
            pending.suspend()

    def send_again(self, servers: Mapping[int, ServiceServer]) -> None:
        """Send the calls of earlier openings whose lanes have servers again."""
        pending = self.pending
        waiting = [(number, call) for number, call in pending.items() if number <= pending.before]
        for number, call in waiting:
            if (server := servers.get(call.lane)) is not None:
                pending.resume()
                call.server = server
                new = pending.begin_again(number, self._flow.timeout_of(call.lane))
                self.outbox.put(CallFrame(What.CALL, call.lane, new, 0, call.request))
        self.outbox.flush()
