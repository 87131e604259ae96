"""The providing half of a route of calls, put together of its parts.

`ServersHere` finds what can be called here, and tells the other side. `ProvidedCalls` takes that side's calls to them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from rsb_bridge.model.calls import Refused
from rsb_bridge.route.calls.action_goals import ProviderGoals
from rsb_bridge.route.calls.calls_flow import CallsFlow
from rsb_bridge.route.calls.calls_half import CallsHalf
from rsb_bridge.route.calls.calls_ledger import REMEDIES
from rsb_bridge.route.calls.lane_types import LaneTypes
from rsb_bridge.route.calls.manual_call import CallError, call_directly
from rsb_bridge.route.calls.node_parameters import ProviderParameters
from rsb_bridge.route.calls.provided_calls import ProvidedCalls, ProviderKind
from rsb_bridge.route.calls.servers_here import ServersHere
from rsb_bridge.route.gates import why_not_by_hand

if TYPE_CHECKING:
    from rsb_bridge.route.crossing import Crossing
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.records import LaneEntry

_KINDS = {"service": ProviderKind, "action": ProviderGoals, "parameters": ProviderParameters}


class Provider(CallsHalf):
    """Tells the peer what is provided here, and passes its calls on.

    Attributes:
        under_way: the calls of the other side.
        servers: what can be called here.
    """

    outgoing: ClassVar[bool] = False
    under_way: ProvidedCalls
    kind: ProviderKind

    def __init__(self, route: Route) -> None:
        flow = CallsFlow(route)
        types = LaneTypes(flow)
        calls = ProvidedCalls(flow, types, _KINDS[route.proposal.kind])
        self.servers = ServersHere(flow, types, calls)
        super().__init__(flow, types, calls, self.servers, messages=calls)

    def destroy(self) -> None:
        """Close what is open in ROS."""
        self.under_way.clients.close()

    def disarm(self) -> None:
        """Let nothing more cross in this opening, not even the answers to pending calls."""
        self.kind.disarm()
        self.servers.withdraw()
        self.under_way.give_up_all("it was disarmed")
        self.under_way.outbox.clear()

    def act(self, now: float, crossing: Crossing) -> None:
        self.kind.act(now)

    # --- by hand

    async def call_by_hand(self, lane: int, request: bytes) -> bytes:
        """Make an operator's call to the node itself. Arming applies, but neither a pause nor counts do.

        Args:
            lane: its place among the route's members.

        Returns:
            The serialized response.

        Raises:
            CallError: no response came.
        """
        route, member, opening = self.route, self.flow.members[lane], self.route.id

        def may() -> None:
            if not member.limited:
                return
            why = why_not_by_hand(route, route.context.now())
            # In another opening, somebody else may have armed it.
            if why is None and route.arming.required and route.id != opening:
                why = Refused.DISARMED
            if why is not None:
                raise CallError(f"{route.local_topic} cannot be called now: {REMEDIES[why]}")

        may()
        name, within = member.name_on(route.local_topic), self.flow.timeout_of(lane)
        return await call_directly(route.context, name, self.entry(lane), request, within, may)

    def entry(self, lane: int) -> LaneEntry:
        """Return the type of a lane that can be called here, even if the link is down.

        Raises:
            CallError: nothing can be called now.
        """
        found = self.servers.find()
        if found.unavailable is not None:
            raise CallError(found.unavailable.text)
        return found.entries[lane]
