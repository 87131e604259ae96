"""The callers' half of a route of calls, put together of its parts.

`ServiceOffer` offers here what the other side provides. `AskedCalls` takes callers' requests, and answers them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import EndPlace
from rsb_bridge.route.calls.action_goals import CallerGoals
from rsb_bridge.route.calls.asked_calls import AskedCalls, CallerKind
from rsb_bridge.route.calls.calls_flow import CallsFlow
from rsb_bridge.route.calls.calls_half import CallsHalf
from rsb_bridge.route.calls.lane_types import LaneTypes
from rsb_bridge.route.calls.manual_call import CallError
from rsb_bridge.route.calls.node_parameters import CallerParameters
from rsb_bridge.route.calls.service_offer import ServiceOffer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.route.crossing import Crossing
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import Provide
    from rsb_bridge.wire.records import CallsReport, LaneEntry

_KINDS = {"service": CallerKind, "action": CallerGoals, "parameters": CallerParameters}


class Caller(CallsHalf):
    """Offers services and publishes topics here, as long as the other side can answer.

    Attributes:
        under_way: the calls of callers here.
        offer: what is offered here.
    """

    outgoing: ClassVar[bool] = True
    under_way: AskedCalls
    kind: CallerKind

    def __init__(self, route: Route) -> None:
        flow = CallsFlow(route)
        types = LaneTypes(flow)
        calls = AskedCalls(flow, types, _KINDS[route.proposal.kind])
        self.offer = ServiceOffer(flow, types, calls)
        super().__init__(flow, types, calls, self.offer, messages=self.offer)

    @property
    def places(self) -> Sequence[EndPlace]:
        """Return those of all lanes but topics that several nodes publish."""
        route = self.route
        return [
            EndPlace("publisher" if each.is_topic else "service", name, route.peer.name)
            for each in self.flow.members
            if not each.absolute and (name := each.name_on(route.local_topic))
        ]

    def move(self) -> bool:
        return self.offer.move()

    def provided(self, provide: Provide) -> None:
        """Take the providing side's list of what can be called."""
        if why := self.offer.take(provide):
            self.route.request_reopen(EventCode.ROUTE_CALLS_BROKEN, why, Level.ERROR)
        else:
            self.route.advance()

    def destroy(self) -> None:
        """Close what is open in ROS, and give up the calls that wait for another opening."""
        self.offer.withdraw()
        self.under_way.give_up_all("it was removed")

    def disarm(self) -> None:
        """Let nothing more cross in this opening, not even the answers to pending calls."""
        self.offer.withdraw()
        self.under_way.close("it was disarmed")

    def act(self, now: float, crossing: Crossing) -> None:
        self.kind.act(now)
        self.offer.act()

    def reported(self, report: CallsReport) -> None:
        super().reported(report)
        peer = self.route.judged.peer
        self.route.notices.set_loop(peer.text if peer.cause == Cause.LOOP else "")

    # --- by hand

    async def call_by_hand(self, lane: int, request: bytes) -> bytes:
        """Make an operator's call over the link.

        Args:
            lane: its place among the route's members.

        Returns:
            The serialized response.

        Raises:
            CallError: no response came.
        """
        self.entry(lane)  # for its error, which says why nothing can be called
        return await self.under_way.call_by_hand(lane, request)

    def entry(self, lane: int) -> LaneEntry:
        """Return the type of a lane, as the other side has it.

        Raises:
            CallError: nothing can be called now.
        """
        if lane in self.offer.reach:
            return self.offer.provided.lanes[lane]
        verdict, _ = self.route.judged.shown(self.route.verdict())
        known = verdict.cause != Cause.NO_CALL
        why = verdict.text if known else f"no server of {self.route.remote_topic} on the other side"
        raise CallError(f"{self.route.local_topic} cannot be called now: {why}")
