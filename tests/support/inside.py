"""Functions that reach into private parts of the program. A part has one here, and no test names it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from tests.support import replaced

from rsb_bridge.link.link_session import LinkSession

if TYPE_CHECKING:
    import asyncio
    import socket

    import pytest

    from rsb_bridge.control.attached_console import AttachedConsole
    from rsb_bridge.control.control_server import ControlServer
    from rsb_bridge.engine import Engine
    from rsb_bridge.engine.bridge import Bridge
    from rsb_bridge.link.link import Link
    from rsb_bridge.model.calls import Refused
    from rsb_bridge.ros.node import RosNode
    from rsb_bridge.ros.participant import Participant
    from rsb_bridge.ros.publication_numbers import PublicationNumbers
    from rsb_bridge.route.calls.calls_route import CallsRoute
    from rsb_bridge.route.calls.kept_calls import KeptResult, KeptResults
    from rsb_bridge.route.calls.paced_client import PacedClient
    from rsb_bridge.route.calls.pending_calls import PendingCalls
    from rsb_bridge.route.calls.providing import ProvidingRoute
    from rsb_bridge.route.incoming import IncomingRoute
    from rsb_bridge.route.ledger import RouteLedger
    from rsb_bridge.route.outgoing import OutgoingRoute
    from rsb_bridge.route.source_publishers import SourcePublishers
    from rsb_bridge.transport.streams import Stream
    from rsb_bridge.wire.headers import CallFrame
    from rsb_bridge.wire.messages import Provide


def inside(engine: Engine) -> Bridge:
    """Return the parts of a running engine, which belong to its loop."""
    bridge = _bridge_of(engine)
    assert bridge is not None
    return bridge


def _bridge_of(engine: Engine) -> Bridge | None:
    return engine._bridge


def pretend_linked(link: Link, control: Any) -> None:
    """Let a link have a connection of which there is only a stand-in of its control channel."""
    channels: Any = SimpleNamespace(control=control, is_silent=False, away=lambda _: None, close=lambda: None)
    link._channels, link.session = channels, LinkSession(bytes(8), "", channels)
    link.outlives = link.own_outlive  # as if the peer's session were this one's


def renew_snapshot(engine: Engine) -> None:
    """Have a running engine renew its snapshot soon, as it does after each command."""
    bridge = _bridge_of(engine)
    if bridge is None:
        return

    def renew() -> None:
        if not bridge._stopping.is_set():  # the last snapshot shows the end, and stays
            bridge._snapshots.refresh_now(role_of(engine))

    bridge.context.call(renew)


def is_running(engine: Engine) -> bool:
    return _bridge_of(engine) is not None


def role_of(engine: Engine) -> Any:
    return inside(engine).role


def participant_of(node: RosNode) -> Participant:
    participant = node._participant
    assert participant is not None
    return participant


def break_waiting(node: RosNode, patch: pytest.MonkeyPatch) -> None:
    """Let a node's thread fail when it next waits for DDS."""

    def broken(*_: object) -> None:
        raise RuntimeError("the wait set is broken")

    replaced.PARTICIPANT_WAIT.set(patch, broken)
    participant_of(node).wake()


def socket_of(stream: Stream) -> socket.socket:
    transport = stream._transport
    assert transport is not None
    found: socket.socket = transport.get_extra_info("socket")
    return found


def ledger_of(route: OutgoingRoute) -> RouteLedger:
    """Return a route's own counts, which a snapshot has up to a second later."""
    return route._ledger


def publication_numbers_of(route: OutgoingRoute) -> PublicationNumbers:
    return route._subscription.numbers


def outputs_of(route: IncomingRoute) -> SourcePublishers:
    return route.outputs


def pending_calls(route: CallsRoute) -> Any:
    """Return the table of a half's calls in flight."""
    return route._pending


def waiting_frames(route: CallsRoute) -> list[Any]:
    """Return the frames of a half that wait for its channel."""
    return list(route._outbox._frames.values())


def timer_of(calls: PendingCalls[Any]) -> asyncio.TimerHandle | None:
    return calls._timer


def kept_results(results: KeptResults) -> dict[bytes, KeptResult]:
    return results.kept


def numbers_of(thing: ProvidingRoute | KeptResults) -> dict[Any, Any]:
    """Return the entries by the number of a call."""
    return thing._by_number


def refusal_of(route: ProvidingRoute, frame: CallFrame) -> Refused | None:
    """Return why a half refuses a call that comes, or None."""
    return route._refusal(frame)


def provide(route: ProvidingRoute, message: Provide) -> None:
    """Let a half have told the other one what is provided."""
    route._last_sent = message


def offers_of(route: CallsRoute) -> Any:
    """Return the open lanes of the callers' half."""
    return route._offers  # type: ignore[attr-defined]


def clients_of(route: CallsRoute) -> Any:
    """Return the open lanes of the provider's half."""
    return route._clients  # type: ignore[attr-defined]


def paced(client: PacedClient) -> Any:
    """Return the client that sends what its turn has come for."""
    return client._client


def attached_to(server: ControlServer) -> set[AttachedConsole]:
    return server._consoles


def bytes_for(console: AttachedConsole) -> int:
    """Return how many bytes wait until a console takes them."""
    return console._connection.buffered


def is_sending(console: AttachedConsole) -> bool:
    return console._sending.locked()
