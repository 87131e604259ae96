"""Errors in a stream's format are explained, on either side."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.connection_keys import connection_keys
from tests.support.wording import says
from tests.wire.links import (
    HELLO,
    KEY,
    SUITES,
    WELCOME,
    established,
    key_for,
    make_server,
    ready_to_accept,
    the,
)

from rsb_bridge.model.fingerprints import fingerprint_of
from rsb_bridge.wire.codec import encode
from rsb_bridge.wire.connection import ClientConnection, DataConnection, ServerConnection
from rsb_bridge.wire.events import DataFrame, Event, Failed, MessageReceived, RefusalCode, StreamName, StreamRefused
from rsb_bridge.wire.framing import CONTROL_LIMIT, pack_frame
from rsb_bridge.wire.messages import Ping
from rsb_bridge.wire.preamble import PreambleKind, control_header, preamble_frame, refuse_frame
from rsb_bridge.wire.protocol_error import Broken
from rsb_bridge.wire.sealing import CipherSuite, InvalidSeal

End = ClientConnection | ServerConnection | DataConnection


def control(body: bytes) -> bytes:
    return pack_frame(preamble_frame(PreambleKind.CONTROL, body))


@pytest.mark.parametrize(
    ("stream", "broken", "parameters"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", Broken.FOREIGN_KNOWN, {"protocol": "HTTP"}),
        (b"\x00\x00\x10\x01", Broken.FOREIGN, {}),
        (pack_frame(b""), Broken.FOREIGN, {}),
        (pack_frame(b"rsb\x01"), Broken.FOREIGN, {}),
        (pack_frame(b"RSB\x01\x01"), Broken.FOREIGN, {}),
        (pack_frame(preamble_frame(PreambleKind.ACCEPT)), Broken.UNEXPECTED_IN_PREAMBLE, {"kind": "ACCEPT"}),
        (pack_frame(b"rsb\x01\x63"), Broken.UNKNOWN_PREAMBLE, {"kind": 99}),
        (control(b""), Broken.CONTROL_TOO_SHORT, {}),
        (control(b"\x01\x05robo"), Broken.CONTROL_TOO_SHORT, {}),
        (control(b"\x01\x06robot1" + bytes(7)), Broken.CONTROL_TOO_SHORT, {}),
        (control(b"\x01\x02\xff\xfe" + bytes(8)), Broken.NAME_NOT_UTF8, {"frame": "CONTROL"}),
        (control(b"\x01\x03\xe2\x80\xae" + bytes(8)), Broken.NAME_UNPRINTABLE, {"frame": "CONTROL"}),
        (control(b"\x07\x01a" + bytes(8)), Broken.UNKNOWN_SUITE, {}),
        (control(b"\x01\x06robot1" + fingerprint_of(KEY) + b"short"), Broken.HANDSHAKE_TOO_SHORT, {"length": 5}),
        *((pack_frame(preamble_frame(PreambleKind.DATA, bytes(n))), Broken.DATA_TOO_SHORT, {}) for n in (11, 14)),
    ],
)
def test_what_is_no_preamble_is_refused_in_words(stream: bytes, broken: Broken, parameters: dict[str, object]) -> None:
    server = make_server()
    event = the(Failed, server.receive_data(stream))
    assert event.reason == broken(**parameters)
    assert server.data_to_send() == pack_frame(refuse_frame(RefusalCode.BAD_FORMAT, event.reason))


@pytest.mark.parametrize("hello", [b"", b"\xc1", encode(Ping(1, 1)), encode(WELCOME)])
def test_a_first_message_that_holds_no_hello(hello: bytes) -> None:
    event = the(
        Failed,
        make_server(CipherSuite.PLAIN).receive_data(pack_frame(control_header(CipherSuite.PLAIN, "robot1"), hello)),
    )
    assert says(event.reason, Broken.INVALID_CONTROL_MESSAGE)


def test_a_client_with_two_names() -> None:
    (event,) = make_server(CipherSuite.PLAIN).receive_data(
        pack_frame(control_header(CipherSuite.PLAIN, "robot2"), encode(HELLO))
    )
    assert event == Failed(Broken.NAMES_DIFFER(preamble="robot2", hello="robot1"))


@pytest.mark.parametrize(
    ("frame", "broken", "parameters"),
    [
        (preamble_frame(PreambleKind.DATA), Broken.UNEXPECTED_IN_PREAMBLE, {"kind": "DATA"}),
        (preamble_frame(PreambleKind.REFUSE), Broken.UNKNOWN_REFUSAL, {}),
        (preamble_frame(PreambleKind.REFUSE, b"\x63words"), Broken.UNKNOWN_REFUSAL, {}),
        (preamble_frame(PreambleKind.ACCEPT, b"short"), Broken.HANDSHAKE_TOO_SHORT, {"length": 5}),
        (b"SSH-2.0-OpenSSH", Broken.FOREIGN, {}),
    ],
)
def test_a_client_hears_nonsense(frame: bytes, broken: Broken, parameters: dict[str, object]) -> None:
    client, _ = ready_to_accept()
    event = the(Failed, client.receive_data(pack_frame(frame)))
    assert event.reason == broken(**parameters)
    assert client.data_to_send() == b""


def test_a_refusal_s_message_is_bounded_and_printable() -> None:
    client, _ = ready_to_accept()
    words = "\x1b[2J" + "ü" * 400
    assert len(refuse_frame(RefusalCode.BUSY, words)) == 6 + 512
    event = the(StreamRefused, client.receive_data(pack_frame(refuse_frame(RefusalCode.BUSY, words))))
    assert event.code is RefusalCode.BUSY
    assert event.message.startswith("\N{REPLACEMENT CHARACTER}[2Jü")
    assert len(event.message.encode()) <= 512 + 4


@SUITES
def test_damage_to_a_sealed_frame_ends_the_connection(suite: CipherSuite) -> None:
    client, server, _, _ = established(suite)
    frame = bytearray(client.send(Ping(1, 1)))
    frame[-1] ^= 1
    event = the(Failed, server.receive_data(frame))
    assert event.reason == InvalidSeal.FORGED(sequence=1)
    assert server.data_to_send() == b""
    assert server.receive_data(client.send(Ping(2, 2))) == []


@SUITES
def test_a_sealed_frame_played_again_ends_the_connection(suite: CipherSuite) -> None:
    client, server, _, _ = established(suite)
    frame = client.send(Ping(1, 1))
    events = server.receive_data(frame + frame)
    assert [type(event) for event in events] == [MessageReceived, Failed]


@pytest.mark.parametrize("frame", [b"", b"\x00", bytes(13), b"\x02" + bytes(30), bytes((0, 1)) + bytes(30)])
@pytest.mark.parametrize("multiplexed", [True, False])
def test_sealed_frame_that_is_neither_control_nor_data(frame: bytes, multiplexed: bool) -> None:
    _, server, _, _ = established(multiplexed=multiplexed)
    event = the(Failed, server.receive_data(pack_frame(frame)))
    assert event.reason == Broken.UNEXPECTED_ON_CONTROL(header=frame[:14].hex(" "))


def test_long_control_frame_is_refused_early() -> None:
    _, server, _, _ = established()
    (event,) = server.receive_data(struct.pack(">I", CONTROL_LIMIT + 1))
    assert event == Failed(Broken.FRAME_TOO_LONG(length=CONTROL_LIMIT + 1, limit=CONTROL_LIMIT))


@st.composite
def any_end(draw: st.DrawFn) -> End:
    suite = draw(st.sampled_from(CipherSuite))
    client, server = ready_to_accept(suite)
    data = DataConnection(connection_keys(suite, key_for(suite)), StreamName(1))
    live_client, live_server, _, _ = established(suite, multiplexed=draw(st.booleans()))
    ends: list[End] = [make_server(suite), client, server, data, live_client, live_server]
    return draw(st.sampled_from(ends))


@given(end=any_end(), garbage=st.lists(st.binary(max_size=200), max_size=5), framed=st.booleans())
def test_garbage_gives_events_not_exceptions(end: End, garbage: list[bytes], framed: bool) -> None:
    events: list[Event] = []
    for piece in garbage:
        events += end.receive_data(pack_frame(piece) if framed else piece)
    assert all(isinstance(event, Failed | StreamRefused | DataFrame) for event in events)
    assert sum(isinstance(event, Failed | StreamRefused) for event in events) <= 1
