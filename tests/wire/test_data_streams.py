"""Data streams, and data frames that share the control stream."""

import pytest
from tests.support.connection_keys import connection_keys
from tests.support.frames import StreamedReader, write_chunks, write_frame
from tests.support.wording import says
from tests.wire.links import OTHER_KEY, SUITES, WELCOME, established, make_server, the

from rsb_bridge.wire.connection import DataConnection
from rsb_bridge.wire.events import (
    Accepted,
    Attach,
    DataFrame,
    Failed,
    MessageReceived,
    RefusalCode,
    StreamName,
    StreamRefused,
)
from rsb_bridge.wire.framing import LENGTH, DataReader, DataWriter, pack_frame
from rsb_bridge.wire.messages import Ping
from rsb_bridge.wire.preamble import PreambleKind, preamble_frame
from rsb_bridge.wire.protocol_error import Broken
from rsb_bridge.wire.sealing import CipherSuite, SealError

_NAME = StreamName(5, 4001, large=True)


@SUITES
def test_a_data_stream_is_attached(suite: CipherSuite) -> None:
    _, _, client_keys, server_keys = established(suite)
    data, server = DataConnection(client_keys, _NAME), make_server(suite)
    start = data.start()
    attach = the(Attach, server.receive_data(start))
    assert isinstance(attach, Attach)
    assert (attach.link_id, attach.name) == (WELCOME.link_id, _NAME)
    server_keys.check_attach_proof(attach.header, attach.name.number, attach.proof)

    # The server may send at once: bytes behind the ACCEPT are for the link's routes.
    first = write_frame(DataWriter(server_keys.route_sealer(5, "server"), 5), b"x" * 10_000, 7)
    stream = server.accept_attach() + first
    assert data.receive_data(stream[:20]) == [Accepted()]
    assert data.receive_data(stream[20:30]) == []
    reader = StreamedReader(client_keys.stream_opener(5, "server"))
    assert reader.receive_data(data.leftover()) == []
    assert reader.receive_data(stream[30:]) == [(b"x" * 10_000, 7, 0)]
    assert data.leftover() == b""


@SUITES
def test_a_route_moves_to_another_stream(suite: CipherSuite) -> None:
    """The frame of the move is sealed in order with the route's messages."""
    _, _, client_keys, server_keys = established(suite)
    writer = DataWriter(client_keys.route_sealer(3, "client"), 3)
    reader = DataReader(server_keys.stream_opener(3, "client"))
    first, moved, second = write_frame(writer, b"1", 1), writer.write_moved(), write_frame(writer, b"2", 2)
    read = [memoryview(frame)[LENGTH.size :] for frame in (first, moved, second)]
    assert reader.open_frames(read[:1]) == [(b"1", 1, 0)]
    reader.open_moved(read[1])
    assert reader.open_frames(read[2:]) == [(b"2", 2, 0)]
    with pytest.raises(SealError):
        reader.open_moved(read[1])


def test_bytes_after_data_preamble_are_left_over() -> None:
    _, _, keys, _ = established()
    server = make_server()
    (attach,) = server.receive_data(DataConnection(keys, _NAME).start() + b"beyond")
    assert isinstance(attach, Attach)
    assert server.leftover() == b"beyond"


@pytest.mark.parametrize("suite", [CipherSuite.AESGCM, CipherSuite.CHACHAPOLY])
def test_data_stream_of_another_link_has_no_proof(suite: CipherSuite) -> None:
    _, _, _, server_keys = established(suite)
    stranger = connection_keys(suite, OTHER_KEY, server_keys.link_id)
    server = make_server(suite)
    attach = the(Attach, server.receive_data(DataConnection(stranger, _NAME).start()))
    with pytest.raises(SealError):
        server_keys.check_attach_proof(attach.header, attach.name.number, attach.proof)


def test_a_data_stream_is_turned_away() -> None:
    _, _, keys, _ = established()
    data, server = DataConnection(keys, _NAME), make_server()
    server.receive_data(data.start())
    answer = server.refuse(RefusalCode.NO_SUCH_ROUTE, "route 5 is not open")
    refusal = StreamRefused(RefusalCode.NO_SUCH_ROUTE, "route 5 is not open")
    assert data.receive_data(answer) == [refusal]
    for end in (data, server):
        assert end.receive_data(b"more") == []
        assert end.leftover() == b""


def test_a_data_stream_is_offered_a_retry() -> None:
    _, _, keys, _ = established()
    data = DataConnection(keys, _NAME)
    data.start()
    assert data.receive_data(pack_frame(preamble_frame(PreambleKind.RETRY, b"\x02"))) == [
        Failed(Broken.UNEXPECTED_IN_PREAMBLE(kind="RETRY"))
    ]


# --- data frames on the control stream


@SUITES
def test_a_multiplexed_stream_carries_control_and_data(suite: CipherSuite) -> None:
    client, server, client_keys, server_keys = established(suite, multiplexed=True)
    writer = DataWriter(client_keys.route_sealer(3, "client"), 3)
    reader = StreamedReader(server_keys.stream_opener(3, "client"))
    first, second = write_chunks(writer, b"payload", 9, 0, 4)
    events = server.receive_data(first + client.send(Ping(1, 1)) + second)
    assert [type(event) for event in events] == [DataFrame, MessageReceived, DataFrame]
    frames = [event for event in events if isinstance(event, DataFrame)]
    assert [reader.open_frames((event.frame,)) for event in frames] == [[], [(b"payload", 9, 0)]]


def test_data_frames_are_refused_on_control_stream() -> None:
    _, server, keys, _ = established()
    event = the(Failed, server.receive_data(write_frame(DataWriter(keys.route_sealer(3, "client"), 3), b"x", 0)))
    assert says(event.reason, Broken.UNEXPECTED_ON_CONTROL)
