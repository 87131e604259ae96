"""Datagrams: fragments and probes, of a peer or of anybody who can send to the port."""

from __future__ import annotations

import random
import struct

from tests.fuzz.editing import behind, edit_bytes
from tests.fuzz.parser import Parser

from rsb_bridge.wire.datagram import (
    MAGIC,
    Arrived,
    DatagramReader,
    DatagramWriter,
    Probe,
    Receipt,
    by_addressee,
    unpack_probe,
)
from rsb_bridge.wire.framing import Budget
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_bridge.wire.sealing import CipherSuite, DatagramOpener, Sealer, SealError

_BUDGET = 5000
_LONGEST = 600
_LINK = b"linklink"
_ROUTE = 7
_HEADER = struct.Struct(">BBHHI8sQIQ")
_PIECE = struct.Struct(">BBHHIIB")


def _read(data: bytes) -> None:
    """Datagrams of a peer that has the key. The header's figures are as the input says, and the seal is right."""
    budget = Budget(_BUDGET)
    reader = DatagramReader(DatagramOpener(CipherSuite.PLAIN, None), _ROUTE, _LONGEST, budget)
    now, sent = 0.0, 0
    while len(data) >= _PIECE.size:
        flags, wait, index, count, sequence, number, size = _PIECE.unpack_from(data)
        content, data = data[_PIECE.size : _PIECE.size + size], data[_PIECE.size + size :]
        header = _HEADER.pack(MAGIC, flags, index, count, _ROUTE, _LINK, sequence, number, 5)
        datagram = header + _seal(sequence, content, header)
        assert by_addressee([(datagram, None)]) == {(_ROUTE, _LINK, None): [datagram]}
        now += wait / 100
        sent += len(content)
        message = reader.receive(datagram, now)
        assert message is None or len(message[0]) <= min(sent, max(_LONGEST, len(content)))
        reader.expire(now)
        assert 0 <= budget.held <= _BUDGET
        assert reader.expired >= 0
    reader.close()
    assert budget.held == 0
    assert reader.pending == 0


def _seal(sequence: int, content: bytes, header: bytes) -> bytes:
    sealer = Sealer(CipherSuite.PLAIN, None)
    sealer.sequence = sequence
    try:
        return sealer.seal(content, header)
    except SealError:  # no sender gets so far, so it has no seal for it
        return bytes(4)


def _read_unsealed(data: bytes) -> None:
    """Read a datagram of a stranger: it has no message unless its seal is right."""
    for suite in (CipherSuite.PLAIN, CipherSuite.AESGCM):
        reader = DatagramReader(DatagramOpener(suite, bytes(32)), _ROUTE)
        by_addressee([(data, None)])
        message = reader.receive(data, 0.0)
        assert message is None or suite is CipherSuite.PLAIN
        assert reader.receive(data, 0.0) is None, "a datagram is read twice"


def _read_probe(data: bytes) -> None:
    try:
        probe = unpack_probe(data)
    except ProtocolError:
        return
    assert unpack_probe(probe.pack()) == probe


def _round_trip(data: bytes) -> None:
    """Check that one side reads what the other writes, for any order of the datagrams."""
    choice = data[0] if data else 0
    payload = data[1:]
    writer = DatagramWriter(Sealer(CipherSuite.AESGCM, bytes(32)), _LINK, _ROUTE)
    reader = DatagramReader(DatagramOpener(CipherSuite.AESGCM, bytes(32)), _ROUTE)
    datagrams = writer.write(payload, 5, choice & 1, 70 + choice)
    assert len(datagrams) == writer.datagrams(len(payload), 70 + choice)
    random.Random(choice).shuffle(datagrams)
    messages = [message for each in datagrams if (message := reader.receive(each, 0.0)) is not None]
    assert messages == [(payload, 5, choice & 1)]


def _piece(index: int, count: int, sequence: int, number: int, content: bytes, wait: int = 0) -> bytes:
    return _PIECE.pack(0, wait, index, count, sequence, number, len(content)) + content


PARSERS = (
    Parser(
        "datagrams",
        _read,
        (
            _piece(0, 2, 0, 1, b"a mess") + _piece(1, 2, 1, 1, b"age"),
            _piece(0, 1, 0, 1, b"whole") + _piece(2, 3, 1, 2, b"x", 200) + _piece(0, 3, 2, 2**32 - 1, b"y", 200),
        ),
    ),
    Parser(
        "unsealed_datagrams",
        _read_unsealed,
        tuple(
            DatagramWriter(Sealer(suite, bytes(32)), _LINK, _ROUTE).write(b"a message", 5, 0, 1000)[0]
            for suite in (CipherSuite.PLAIN, CipherSuite.CHACHAPOLY)
        ),
    ),
    Parser(
        "probe",
        _read_probe,
        (Probe(pong=True, opaque=2**64 - 1).pack(), Receipt(1 << 23, 2**33, (Arrived(7, 2**40, 2**33),)).pack()),
    ),
    Parser("datagram_round_trip", _round_trip, (b"\3any content", bytes(400)), behind(1, edit_bytes)),
)
