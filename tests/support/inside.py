"""Functions that reach into private parts of the program. A part has one here, and no test names it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from tests.support import replaced

from rsb_bridge.link.association import Association

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
    from rsb_bridge.route.calls.calls_half import CallsHalf
    from rsb_bridge.route.calls.paced_client import PacedClient
    from rsb_bridge.route.calls.pending_calls import PendingCalls
    from rsb_bridge.route.calls.provider import Provider
    from rsb_bridge.route.receiver import Receiver
    from rsb_bridge.route.source_publishers import SourcePublishers
    from rsb_bridge.transport.streams import Stream
    from rsb_bridge.wire.headers import CallFrame


def inside(engine: Engine) -> Bridge:
    """Return the parts of a running engine, which belong to its loop."""
    bridge = _bridge_of(engine)
    assert bridge is not None
    return bridge


def _bridge_of(engine: Engine) -> Bridge | None:
    return engine._bridge


def pretend_linked(link: Link, control: Any) -> None:
    """Let a link have a connection of which there is only a stand-in of its control channel."""
    channels: Any = SimpleNamespace(control=control, is_silent=False, suspend=lambda _: None, close=lambda: None)
    link.present, link.association = channels, Association(bytes(8), "", channels)
    link.outlive = link.own_outlive  # as if the peer's association were this one's


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


def outputs_of(receiver: Receiver) -> SourcePublishers:
    return receiver.outputs


def pending_calls(half: CallsHalf) -> PendingCalls[Any]:
    """Return the table of a half's calls in flight."""
    return half.under_way.pending


def waiting_frames(half: CallsHalf) -> list[Any]:
    """Return the frames of a half that wait for its channel."""
    return list(half.under_way.outbox._frames.values())


def timer_of(calls: PendingCalls[Any]) -> asyncio.TimerHandle | None:
    return calls._timer


def numbers_of(half: Provider) -> dict[Any, Any]:
    """Return the other side's calls by the number of a call here."""
    return half.under_way._by_number


def refusal_of(half: Provider, frame: CallFrame) -> Refused | None:
    """Return why a half refuses a call that comes, or None."""
    return half.under_way._refusal(frame)


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
