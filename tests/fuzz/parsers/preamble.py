"""The beginnings of streams: bytes of strangers before authentication, to either side."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from tests.fuzz.editing import behind, edit_bytes
from tests.fuzz.parser import Parser
from tests.support.connection_keys import connection_keys
from tests.wire.links import WELCOME, key_for, make_client, make_server

from rsb_bridge.model.text import is_clean
from rsb_bridge.wire.codec import encode
from rsb_bridge.wire.connection import ClientConnection, DataConnection, ServerConnection
from rsb_bridge.wire.events import (
    Accepted,
    Attach,
    DataFrame,
    Established,
    Event,
    Failed,
    MessageReceived,
    RefusalCode,
    StreamName,
    StreamRefused,
)
from rsb_bridge.wire.framing import PREAMBLE_LIMIT, pack_frame
from rsb_bridge.wire.preamble import MESSAGE_LIMIT, PreambleKind, data_header, preamble_frame, refuse_frame
from rsb_bridge.wire.sealing import CipherSuite

End = ClientConnection | ServerConnection | DataConnection

_ANSWER = 3 * PREAMBLE_LIMIT
"""Bytes that a stranger can have this side send at most: a RETRY or an ACCEPT, and a REFUSE."""


def _pieces(content: bytes, size: int) -> Iterator[bytes]:
    size = size or len(content) or 1
    for at in range(0, len(content), size):
        yield content[at : at + size]


def _check(events: list[Event], answer: bytes) -> None:
    assert len(answer) <= _ANSWER
    ended = [event for event in events if isinstance(event, Failed | StreamRefused)]
    assert len(ended) <= 1
    assert not ended or events[-1] is ended[0]
    for event in events:
        match event:
            case Failed(reason):
                assert is_clean(reason)
                assert len(reason) <= MESSAGE_LIMIT
            case StreamRefused(_, message, _):
                assert is_clean(message)
                assert len(message) <= 2 * MESSAGE_LIMIT
            case Attach(link_id, _, _, _):
                assert len(link_id) == 8
            case Established() | MessageReceived() | DataFrame() | Accepted():
                pass


def _read(start: Callable[[CipherSuite, bool], End], data: bytes) -> None:
    """Read a beginning. Its first byte gives the suite, whether the stream is multiplexed, and its pieces."""
    choice = data[0] if data else 0
    end = start(CipherSuite(choice % 3), bool(choice & 4))
    events: list[Event] = []
    answer = b""
    for piece in _pieces(data[1:], choice >> 3):
        events += end.receive_data(piece)
        answer += end.data_to_send()
    _check(events, answer)


def _server(suite: CipherSuite, multiplexed: bool) -> End:
    return make_server(suite, aes=multiplexed, multiplexed=multiplexed)


def _client(suite: CipherSuite, multiplexed: bool) -> End:
    client = make_client(suite, multiplexed=multiplexed)
    client.start()
    return client


def _data_client(suite: CipherSuite, _: bool) -> End:
    connection = DataConnection(connection_keys(suite, key_for(suite)), StreamName(1))
    connection.start()
    return connection


def _seed(suite: CipherSuite, *frames: bytes, multiplexed: bool = True) -> bytes:
    return bytes((suite + _choice(suite, multiplexed),)) + b"".join(map(pack_frame, frames))


def _choice(suite: CipherSuite, multiplexed: bool) -> int:
    """Return a summand that keeps a suite's number the rest of a division by 3."""
    return next(each for each in range(0, 8, 3) if bool((suite + each) & 4) is multiplexed)


def _confirmed() -> bytes:
    """All that a client without encryption sends until the link is up."""
    client, server = make_client(CipherSuite.PLAIN), make_server(CipherSuite.PLAIN)
    first = client.start()
    server.receive_data(first)
    client.receive_data(server.data_to_send())
    return first + client.data_to_send()


def _answered() -> bytes:
    """All that a server without encryption sends until then."""
    client, server = make_client(CipherSuite.PLAIN), make_server(CipherSuite.PLAIN)
    server.receive_data(client.start())
    return server.data_to_send()


_REFUSED = refuse_frame(RefusalCode.WRONG_KEY, "the keys of 'robot1' differ")
_ATTACH = data_header(b"linklink", StreamName(1)) + bytes(16)

PARSERS = (
    Parser(
        "server_preamble",
        partial(_read, _server),
        (
            bytes(1) + _confirmed(),
            bytes((9,)) + _confirmed()[:40],
            _seed(CipherSuite.AESGCM, make_client(CipherSuite.AESGCM).start()[4:]),
            _seed(CipherSuite.AESGCM, make_client(CipherSuite.AESGCM).start()[4:], multiplexed=False),
            _seed(CipherSuite.CHACHAPOLY, make_client(CipherSuite.CHACHAPOLY).start()[4:]),
            _seed(CipherSuite.AESGCM, _ATTACH),
            _seed(CipherSuite.AESGCM, b"rsb\x01\x01" + bytes(20)),
        ),
        behind(1, edit_bytes),
    ),
    Parser(
        "client_preamble",
        partial(_read, _client),
        (
            bytes(1) + _answered(),
            _seed(CipherSuite.PLAIN, _REFUSED),
            _seed(CipherSuite.AESGCM, preamble_frame(PreambleKind.RETRY, bytes((CipherSuite.CHACHAPOLY,))), _REFUSED),
            _seed(CipherSuite.AESGCM, preamble_frame(PreambleKind.ACCEPT, bytes(32) + encode(WELCOME) + bytes(16))),
            _seed(CipherSuite.PLAIN, preamble_frame(PreambleKind.ACCEPT, encode(WELCOME)), _REFUSED),
        ),
        behind(1, edit_bytes),
    ),
    Parser(
        "data_preamble",
        partial(_read, _data_client),
        (
            _seed(CipherSuite.AESGCM, preamble_frame(PreambleKind.ACCEPT), b"sealed"),
            _seed(CipherSuite.CHACHAPOLY, _REFUSED),
        ),
        behind(1, edit_bytes),
    ),
)
