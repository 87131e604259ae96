"""The common part of `Caller` and `Provider`.

A route of calls consists of members (`rsb_bridge.model.calls`): services, and topics that go from the providing side to
the callers'. The frames of all members (`rsb_bridge.wire.headers`) go over one channel, which sends both ways. A frame
names its member by a number, the *lane*.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec

from rsb_bridge.model.codes import EventCode
from rsb_bridge.route.calls.call_frames import CallFrames
from rsb_bridge.route.calls.calls_verdict import OF_CALLS, CallsFacts, malformed_in
from rsb_bridge.route.combined_verdict import lasting, node_names, record_of
from rsb_bridge.wire.records import CallsReport

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.ros.ros_interface import EndPlace
    from rsb_bridge.route.calls.asked_calls import AskedCalls, CallerKind
    from rsb_bridge.route.calls.call_frames import TakesFrames
    from rsb_bridge.route.calls.calls_end import CallsEnd
    from rsb_bridge.route.calls.calls_flow import CallsFlow
    from rsb_bridge.route.calls.lane_types import LaneTypes
    from rsb_bridge.route.calls.provided_calls import ProvidedCalls, ProviderKind
    from rsb_bridge.route.crossing import Crossing
    from rsb_bridge.route.half import Rules
    from rsb_bridge.route.idling import Signs


class CallsHalf:
    """The verbs of a half that do the same for callers and providers, with the parts of either.

    Attributes:
        flow: the counts of its calls.
        types: of its members.
        under_way: its calls.
        kind: what they do besides, by the route's kind.
    """

    peer_report: ClassVar[Any] = CallsReport
    rules: ClassVar[Rules[Any]] = OF_CALLS
    duplex: ClassVar[bool] = True
    rests: ClassVar[bool] = False

    under_way: AskedCalls | ProvidedCalls
    kind: CallerKind | ProviderKind
    _last_report: CallsReport | None = None  # of the present opening

    def __init__(
        self,
        flow: CallsFlow,
        types: LaneTypes,
        under_way: AskedCalls | ProvidedCalls,
        end: CallsEnd,
        messages: TakesFrames,
    ) -> None:
        """Join the parts.

        Args:
            messages: takes those of lanes that are topics.
        """
        self.route, self.flow, self.carried, self.types = flow.route, flow, flow.carried, types
        self.under_way, self.kind, self._end = under_way, under_way.kind, end
        self._frames = CallFrames(flow, under_way.outbox, under_way, messages)
        self.deliver, self.flush = self._frames.deliver, under_way.outbox.flush
        self.facts = CallsFacts(flow, types, end, self.kind)

    def proceed(self) -> None:
        """Open the channel; offer what can be called, or find it and tell the other side."""
        if not self.route.life.accepted:
            return
        if self.carried.channel is None:
            self.route.peer.open_channel(self.route)
        self._end.proceed()

    @property
    def places(self) -> Sequence[EndPlace]:
        return ()

    def move(self) -> bool:
        return True

    def open(self) -> None:
        self._last_report = self.types.last_malformed = None
        self.flow.open()

    def close(self, reason: str) -> None:
        """End the opening, and with it the calls that cannot be sent again."""
        self._end.close()
        self.under_way.close(reason)
        self._frames.clear()

    def suspend(self) -> None:
        """Let no call expire, as nobody can answer."""
        self.under_way.pending.suspend()

    def resume(self) -> None:
        """Let calls expire again, in the time that was left for each."""
        self._last_report = None
        self.under_way.pending.resume()

    def lapse(self) -> None:
        """Calls that were under way go on."""

    def configure(self) -> None:
        """Take over whether messages are checked."""
        self.types.set_check()

    def restart_measuring(self) -> None:
        """Forget earlier failures."""
        self.flow.failures.forget()

    def measure(self, now: float, crossing: Crossing, *, learns: bool) -> None:
        calls = self.flow.calls
        if not self.facts.end.offered:
            calls.forget_lately()
        calls.tick()
        self.flow.failures.tick()

    @property
    def passed(self) -> int:
        calls = self.flow.calls
        return calls.asked + calls.answered + calls.expired + calls.refused.total() + calls.lost + calls.late

    def signs(self) -> Signs:
        end = self.facts.end
        malformed = self.facts.last_malformed()
        return self.flow.report, end.unavailable(), end.warning, end.offered, malformed, end.nodes()

    def goes_on(self, _: float) -> bool:
        return False

    def is_calm(self, now: float) -> bool:
        return False

    def is_well(self, now: float) -> bool:
        return False  # each call may be the last for long, and nothing measures calls

    def next_change(self, now: float, crossing: Crossing) -> float:
        return math.inf if self.kind.goals is None else now  # goals have times of their own, and a robot few actions

    def reported(self, report: CallsReport) -> None:
        """Take the peer's verdict, and how far its calls are."""
        route, found = self.route, malformed_in(report)
        if found is not None and found != malformed_in(self.flow.report):
            text = f"malformed {found.type_name} to {route.peer.name}: {found.field}: see the node here that sent it"
            self.flow.failures.say(text, EventCode.ROUTE_MALFORMED)
        self.flow.report = report
        route.wake()
        route.judged.receive(report.verdict, route.context.now())

    def news(self) -> Sequence[CallsReport]:
        route, malformed, verdict = self.route, self.types.last_malformed, self.route.verdict(for_peer=True)
        given, waiting = (0, 0) if route.outgoing else self.facts.end.at_node()
        report = CallsReport(
            route=route.id,
            given=given,
            waiting=waiting,
            malformed_type="" if malformed is None else malformed.type_name,
            malformed="" if malformed is None else malformed.field,
            offered=self.facts.end.offered,
            verdict=record_of(verdict),
            nodes=node_names(self.carried.endpoints),
        )
        # Without the verdict's duration, which is another one each second.
        if report == self._last_report:
            return ()
        self._last_report = report
        return (msgspec.structs.replace(report, verdict=lasting(report.verdict, verdict, route.context.now())),)
