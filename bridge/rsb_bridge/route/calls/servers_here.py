"""The servers here that the other side may call. They get clients, and the other side hears of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.model.snapshot import Stage
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.call_servers import CallLoopGuard, Provision, provision
from rsb_bridge.route.calls.calls_end import Trouble
from rsb_bridge.route.combined_verdict import node_names
from rsb_bridge.wire.messages import Provide

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Sequence

    from rsb_bridge.route.calls.calls_flow import CallsFlow
    from rsb_bridge.route.calls.lane_types import LaneTypes
    from rsb_bridge.route.calls.provided_calls import ProvidedCalls
    from rsb_bridge.wire.records import LaneEntry

_MATCHED_AGAIN, _LONGEST_MATCHED_AGAIN = 0.05, 1.0
"""s until the next look whether DDS has matched a client with its server. A look asks the graph of all lanes, and DDS
shows a killed server for up to 40 s."""
_WAITED_PART = 0.1
"""Part of the wait so far that a look may come later than the match. A round figure."""
_EXPLAINED_AGAIN = 0.5
"""s until the next look whether a bridge has announced where its answers come from. A round figure."""


class ServersHere:
    """The servers here that can be called.

    Attributes:
        found: what the last look has found.
        warning: the trouble that does not keep it from being called, or None.
    """

    def __init__(self, flow: CallsFlow, types: LaneTypes, calls: ProvidedCalls) -> None:
        self._flow, self._route, self._carried, self._types, self._calls = flow, flow.route, flow.carried, types, calls
        self.found = Provision()
        self.warning: Trouble | None = None
        self._trouble: Trouble | None = None  # that keeps it from being called
        self._loop_guard = CallLoopGuard(flow.route.context, flow.route.peer)
        self._served_in = 0  # the last connection in which a server was there, or 0
        self._told: Provide | None = None  # to the other side, in the present opening
        self._again: asyncio.TimerHandle | None = None
        self._unmatched_since = 0.0

    def proceed(self) -> None:
        """Find the servers, have clients for them, and tell the other side."""
        calls, route, retry = self._calls, self._route, self._calls.clients.retry
        had_server = bool(self.found.entries)
        self._look()
        entries = self.found.entries
        if had_server and not entries:
            calls.kind.server_gone()
        # Nothing ever holds up the lanes that are not limited, as a cancel.
        if not entries or (route.crossing.is_held_back and all(member.limited for member in self._flow.members)):
            retry.clear()
            if calls.clients.services:
                calls.close_clients()
                stopped = "it was paused" if route.pausing.paused else "it is not armed" if entries else ""
                calls.give_up_all(stopped or "its server has gone")
        elif self._types.load(entries) and not retry.waits(entries):
            self._have_clients(entries)
        calls.give_up_orphans()
        self._tell()
        calls.outbox.flush()

    def _look(self) -> None:
        """Find the servers that may be called, and what is wrong with them."""
        route, carried = self._route, self._carried
        self.found = found = self.find()
        carried.endpoints = found.servers
        if self._calls.see({each.gid for each in found.servers}):
            self._unmatched_since = route.context.now()
        trouble, self.warning = found.unavailable, found.warning
        loop = trouble is not None and trouble.cause is Cause.LOOP
        route.notices.set_loop(trouble.text if loop and trouble else "")
        has_gone = self._served_in == route.peer.connections and not self._loop_guard.waits
        if has_gone and trouble is not None and trouble.cause is Cause.NO_SERVER:
            trouble = Trouble(Cause.SERVER_GONE, f"{trouble.text} any more: start its node again")
        self._trouble = None if loop else trouble
        if found.entries:
            # Also while it is paused or not armed: the first call afterwards would wait for them.
            self._types.load(found.entries)
            carried.type_name, carried.type_hash = self._types.know(found.entries)
            self._served_in = route.peer.connections

    def find(self) -> Provision:
        """Return what can be called here, even if the link is down."""
        route, guard = self._route, self._loop_guard
        guard.begin()
        found = provision(route.context, self._flow.members, route.local_topic, route.topic, route.proposal.type, guard)
        if guard.waits:
            self._advance_after(_EXPLAINED_AGAIN)
        return self._calls.kind.explained(found)

    def _have_clients(self, entries: Sequence[LaneEntry]) -> None:
        try:
            if self._calls.open_clients(entries):
                self._unmatched_since = self._route.context.now()
        except RosError as error:
            self._calls.failed(error)
        else:
            self._calls.clients.retry.clear()

    def _tell(self) -> None:
        """Tell the other side what it can call, once a call would reach a server."""
        route, services = self._route, self._calls.clients.services
        is_ready = bool(services) and all(each.client.ready for each in services.values())
        entries = self.found.entries if is_ready else ()
        provide = Provide(route=route.id, pause_revision=route.pausing.revision)
        if entries:
            nodes = node_names(self._carried.endpoints)
            provide = msgspec.structs.replace(provide, lanes=entries, nodes=nodes, via=self._loop_guard.via)
        if services and not is_ready:
            waited = route.context.now() - self._unmatched_since
            self._advance_after(min(max(_MATCHED_AGAIN, _WAITED_PART * waited), _LONGEST_MATCHED_AGAIN))
        if provide != self._told:
            self._told, self._calls.entries = provide, entries
            route.peer.send(provide)
            self._calls.kind.told()

    def _advance_after(self, seconds: float) -> None:
        """Advance again soon: no event announces what is waited for."""
        due = self._route.context.now() + seconds
        if self._again is not None and self._again.when() > due:
            self._again.cancel()
            self._again = None
        if self._again is None:
            self._again = self._route.context.loop.call_at(due, self._advance_again)

    def _advance_again(self) -> None:
        self._again = None
        self._route.advance()

    def withdraw(self) -> None:
        """Close the clients, unless goals still need them, and stop looking."""
        self._calls.close_clients()
        if self._again is not None:
            self._again.cancel()
            self._again = None

    def close(self) -> None:
        """End the opening: the other side has been told nothing."""
        self.withdraw()
        self._trouble = self.warning = self._told = None
        self._calls.clients.retry.clear()

    # --- facts

    @property
    def offered(self) -> bool:
        report = self._flow.report
        return report is not None and report.offered

    def nodes(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        report = self._flow.report
        return report.nodes if report is not None else (), node_names(self._carried.endpoints)

    @property
    def nodes_there(self) -> tuple[str, ...]:
        return self.nodes()[0]

    def at_node(self) -> tuple[int, int]:
        return self._calls.at_node()

    def unavailable(self) -> Trouble | None:
        """Return the reason why nothing can be called, or None; of an absent server, with a name that may be meant."""
        trouble = self._trouble or self._calls.clients.retry.trouble
        if trouble is None or trouble.cause is not Cause.NO_SERVER or self._served_in or self._carried.endpoints:
            return trouble
        route = self._route
        hint = route.context.suggester.of((route.spec.kind, route.local_topic), route.judge_again)
        return Trouble(trouble.cause, f"{trouble.text}; {hint}") if hint else trouble

    def stages(self) -> tuple[Stage, Stage, Stage]:
        servers, offered, failure = self._carried.endpoints, self.offered, self._calls.clients.retry.trouble
        why = self._trouble.text if self._trouble is not None else ""
        if self.found.entries:
            known = Stage("type known", True, self._carried.type_name)
        else:
            known = Stage("type known", False, why) if servers else Stage("type known", None)
        why_not = "" if offered else failure.text if failure else self._route.judged.peer.text
        return (
            Stage("server seen", bool(servers), ", ".join(node_names(servers)) if servers else why),
            known,
            Stage("offered", False if failure else offered or None, why_not),
        )
