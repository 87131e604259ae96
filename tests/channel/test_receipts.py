"""The times at which the receiver of datagrams sends receipts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

from tests.support.session_keys import session_keys

from rsb_bridge.channel.datagram_channel import WINDOW, DatagramReceiver
from rsb_bridge.wire.datagram import DatagramReader, DatagramWriter
from rsb_bridge.wire.sealing import Suite

if TYPE_CHECKING:
    from rsb_bridge.channel.channel import RouteSink
    from rsb_bridge.channel.udp_channel import UdpChannel
    from rsb_bridge.wire.datagram import Receipt

_SMALL, _RAISED = 200_000, 4_000_000


def test_a_sender_hears_soon_of_a_buffer_that_has_become_larger() -> None:
    """Before it has sent as much as it may without a receipt, which is a part of the smaller one."""
    keys = session_keys(Suite.PLAIN, None, bytes(8))
    writer = DatagramWriter(keys.route_sealer(1, "client"), keys.link_id, 1)
    receipts: list[Receipt] = []
    carrier = SimpleNamespace(
        socket=SimpleNamespace(receive_buffer=_SMALL),
        add_receiver=lambda *_: None,
        acknowledge=receipts.append,
        shortages={},
    )
    route = SimpleNamespace(id=1, deliver=lambda _: None)
    reader = DatagramReader(session_keys(Suite.PLAIN, None, bytes(8)).datagram_opener(1, "client"), 1)
    receiver = DatagramReceiver(cast("UdpChannel", carrier), cast("RouteSink", route), reader)

    def come(size: int) -> None:
        receiver.received(writer.write(bytes(size), 0, 0, 1400), 0.0)

    come(1000)
    assert [receipt.buffer for receipt in receipts] == [_SMALL]
    carrier.socket.receive_buffer = _RAISED
    receiver.expire(1.0)
    come(_SMALL // WINDOW // 2)
    assert [receipt.buffer for receipt in receipts] == [_SMALL, _RAISED]
    receiver.expire(2.0)
    come(1000)
    assert len(receipts) == 2
