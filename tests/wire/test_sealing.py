import hmac
import struct
import zlib
from collections.abc import Iterable

import pytest
from cryptography.hazmat.primitives.ciphers.aead import AESGCM, ChaCha20Poly1305
from hypothesis import given
from hypothesis import strategies as st
from tests.support.connection_keys import connection_keys as proposed
from tests.support.held import held_by
from tests.support.wording import pattern
from tests.wire.links import KEY, SUITES, key_for

from rsb_bridge.wire.protocol_error import Misuse
from rsb_bridge.wire.sealing import (
    EPOCH_BITS,
    EPOCHS_AHEAD,
    CipherSuite,
    ConnectionKeys,
    DatagramOpener,
    InvalidSeal,
    Role,
    Sealer,
    SealError,
    StreamOpener,
)

EPOCH = 1 << EPOCH_BITS
ENCRYPTED = pytest.mark.parametrize("suite", [CipherSuite.AESGCM, CipherSuite.CHACHAPOLY])


def sealed_at(suite: CipherSuite, sequence: int, content: bytes = b"content", associated: bytes = b"header") -> bytes:
    sealer = Sealer(suite, key_for(suite))
    sealer.sequence = sequence
    return sealer.seal(content, associated)


def by_the_book(suite: CipherSuite, key: bytes, sequence: int, content: bytes, associated: bytes) -> bytes:
    """PROTOCOL.md 1.4, written out again."""
    if suite is CipherSuite.AESGCM:
        return AESGCM(key).encrypt(bytes(4) + struct.pack(">Q", sequence), content, associated)
    if suite is CipherSuite.CHACHAPOLY:
        return ChaCha20Poly1305(key).encrypt(bytes(4) + struct.pack("<Q", sequence), content, associated)
    return content + struct.pack(">I", zlib.crc32(struct.pack(">Q", sequence) + associated + content))


@SUITES
@given(messages=st.lists(st.tuples(st.binary(), st.binary()), max_size=5))
def test_what_is_sealed_opens_in_order(suite: CipherSuite, messages: list[tuple[bytes, bytes]]) -> None:
    sealer, opener = Sealer(suite, key_for(suite)), StreamOpener(suite, key_for(suite))
    for n, (content, associated) in enumerate(messages):
        sealed = sealer.seal(content, associated)
        assert sealed == by_the_book(suite, KEY, n, content, associated)
        assert len(sealed) == len(content) + suite.tag_length
        assert opener.open(memoryview(sealed), memoryview(associated)) == content
    assert sealer.sequence == opener.sequence == len(messages)


@SUITES
def test_every_byte_counts(suite: CipherSuite) -> None:
    sealed = Sealer(suite, key_for(suite)).seal(b"content", b"header")
    for at in range(len(sealed)):
        damaged = bytearray(sealed)
        damaged[at] ^= 0x10
        with pytest.raises(SealError, match=pattern(InvalidSeal.FORGED)):
            StreamOpener(suite, key_for(suite)).open(damaged, b"header")
    with pytest.raises(SealError):
        StreamOpener(suite, key_for(suite)).open(sealed, b"Header")


@SUITES
@given(garbage=st.binary(max_size=64))
def test_garbage_does_not_open(suite: CipherSuite, garbage: bytes) -> None:
    with pytest.raises(SealError):
        StreamOpener(suite, key_for(suite)).open(garbage, b"header")


@SUITES
def test_stream_refuses_wrong_order_and_goes_on(suite: CipherSuite) -> None:
    sealer, opener = Sealer(suite, key_for(suite)), StreamOpener(suite, key_for(suite))
    first, second = sealer.seal(b"1", b""), sealer.seal(b"2", b"")
    with pytest.raises(SealError):
        opener.open(second, b"")
    assert opener.open(first, b"") == b"1"
    with pytest.raises(SealError):
        opener.open(first, b"")
    assert opener.open(second, b"") == b"2"


@pytest.mark.parametrize("key", [None, b"", KEY[1:]])
@ENCRYPTED
def test_a_cipher_takes_a_whole_key(suite: CipherSuite, key: bytes | None) -> None:
    with pytest.raises(ValueError, match=pattern(Misuse.KEY_LENGTH, expected=32)):
        Sealer(suite, key)


def rekeyed(suite: CipherSuite, key: bytes) -> bytes:
    """REKEY of the Noise specification, 4.2."""
    return by_the_book(suite, key, 2**64 - 1, bytes(32), b"")[:32]


@SUITES
def test_each_epoch_has_the_key_that_rekey_gives(suite: CipherSuite) -> None:
    keys = [KEY]
    while len(keys) < 4:
        keys.append(rekeyed(suite, keys[-1]))
    sealer, stream = Sealer(suite, key_for(suite)), StreamOpener(suite, key_for(suite))
    for epoch in range(3):
        sealer.sequence = stream.sequence = (epoch + 1) * EPOCH - 1
        for sequence in (sealer.sequence, sealer.sequence + 1):
            sealed = sealer.seal(b"content", b"header")
            assert sealed == by_the_book(suite, keys[sequence >> EPOCH_BITS], sequence, b"content", b"header")
            assert stream.open(sealed, b"header") == b"content"


@SUITES
def test_lent_memory_seals_across_epochs(suite: CipherSuite) -> None:
    sealer, opener = Sealer(suite, key_for(suite)), StreamOpener(suite, key_for(suite))
    sealer.sequence = opener.sequence = EPOCH - 1
    for sequence in range(EPOCH - 1, EPOCH + 1):
        sealed, content = bytearray(7 + suite.tag_length), bytearray(7)
        sealer.seal_into(b"content", b"header", memoryview(sealed))
        assert sealed == sealed_at(suite, sequence)
        opener.open_into(bytes(sealed), b"header", memoryview(content))
        assert content == b"content"


@ENCRYPTED
def test_the_keys_of_past_epochs_are_forgotten(suite: CipherSuite) -> None:
    opener = DatagramOpener(suite, KEY)
    opener.open(0, sealed_at(suite, 0), b"header")
    opener.open(5 * EPOCH, sealed_at(suite, 5 * EPOCH), b"header")
    assert opener.open(5 * EPOCH - 1, sealed_at(suite, 5 * EPOCH - 1), b"header") == b"content"
    assert held_by(opener) == 2
    sealer = Sealer(suite, KEY)
    sealer.sequence = 5 * EPOCH
    sealer.seal(b"", b"")
    assert held_by(sealer) == 1


@SUITES
def test_datagrams_open_across_an_epoch_in_any_order(suite: CipherSuite) -> None:
    opener = DatagramOpener(suite, key_for(suite))
    for sequence in (EPOCH - 3, EPOCH + 1, EPOCH - 1, EPOCH, EPOCH - 2, 3 * EPOCH, 3 * EPOCH - 1):
        assert opener.open(sequence, sealed_at(suite, sequence), b"header") == b"content"


@SUITES
def test_datagram_too_many_epochs_ahead_is_refused_unopened(suite: CipherSuite) -> None:
    opener = DatagramOpener(suite, key_for(suite))
    for sequence in ((EPOCHS_AHEAD + 1) * EPOCH, 2**64 - 1):
        with pytest.raises(SealError, match=pattern(InvalidSeal.EPOCH_TOO_FAR_AHEAD)):
            opener.open(sequence, b"", b"header")
    far = EPOCHS_AHEAD * EPOCH
    assert opener.open(far, sealed_at(suite, far), b"header") == b"content"


@SUITES
def test_a_forged_datagram_moves_nothing(suite: CipherSuite) -> None:
    opener = DatagramOpener(suite, key_for(suite))
    opener.open(7, sealed_at(suite, 7), b"header")
    for sequence in (9, 2000, 3 * EPOCH, 6):
        with pytest.raises(SealError, match=pattern(InvalidSeal.FORGED)):
            opener.open(sequence, b"forged, and long enough", b"header")
    for sequence in (6, 8, 9):
        assert opener.open(sequence, sealed_at(suite, sequence), b"header") == b"content"


@SUITES
@given(
    window=st.integers(1, 12),
    arrivals=st.lists(st.integers(0, 30), max_size=60),
    leap=st.sampled_from([0, EPOCH - 15, 5 * EPOCH]),
)
def test_each_sequence_opens_once_and_only_within_window(
    suite: CipherSuite, window: int, arrivals: list[int], leap: int
) -> None:
    opener = DatagramOpener(suite, key_for(suite), window)
    opened, newest = set(), None
    for sequence in (leap + arrival for arrival in arrivals):
        fresh = sequence not in opened and (newest is None or sequence > newest - window)
        sealed = sealed_at(suite, sequence)
        if fresh:
            assert opener.open(sequence, sealed, b"header") == b"content"
            opened.add(sequence)
            newest = sequence if newest is None else max(newest, sequence)
        else:
            late = newest is not None and sequence <= newest - window
            why = InvalidSeal.TOO_LATE if late else InvalidSeal.REPLAYED
            with pytest.raises(SealError, match=pattern(why, sequence=sequence)):
                opener.open(sequence, sealed, b"header")


def connection_keys(
    suite: CipherSuite = CipherSuite.AESGCM, export: bytes = KEY, routes: Iterable[int] = (1, 2, 3, 5)
) -> ConnectionKeys:
    return proposed(suite, None if suite is CipherSuite.PLAIN else export, routes=routes)


def expand(secret: bytes, label: bytes, info: bytes = b"") -> bytes:
    """HKDF-Expand of RFC 5869 for one block: PROTOCOL.md 1.3, written out again."""
    return hmac.digest(secret, label + info + b"\x01", "sha256")


def chain(proposer: int, proposals: int) -> bytes:
    """The chain of a side after so many of its proposals."""
    secret = expand(KEY, b"rsb chain", bytes((proposer,)))
    for _ in range(proposals):
        secret = expand(secret, b"rsb next")
    return secret


@ENCRYPTED
@pytest.mark.parametrize(("role", "direction"), [("client", 0), ("server", 1)])
@pytest.mark.parametrize(("route", "secret"), [(0, KEY), (1, chain(0, 0)), (5, chain(0, 2)), (2, chain(1, 0))])
def test_data_keys_are_those_of_the_document(
    suite: CipherSuite, role: Role, direction: int, route: int, secret: bytes
) -> None:
    sealed = connection_keys(suite).route_sealer(route, role).seal(b"content", b"header")
    key = expand(secret, b"rsb data", struct.pack(">IB", route, direction))
    assert sealed == by_the_book(suite, key, 0, b"content", b"header")


@ENCRYPTED
@pytest.mark.parametrize(("role", "direction"), [("client", 0), ("server", 1)])
def test_keys_of_resumed_routes_are_those_of_the_document(suite: CipherSuite, role: Role, direction: int) -> None:
    """They are derived once, for routes that were proposed on an earlier connection."""
    keys = connection_keys(suite, routes=())
    keys.resumed((1, 8))
    sealed = keys.route_sealer(8, role).seal(b"content", b"header")
    key = expand(expand(KEY, b"rsb resumed"), b"rsb data", struct.pack(">IB", 8, direction))
    assert sealed == by_the_book(suite, key, 0, b"content", b"header")
    with pytest.raises(AttributeError):
        keys.resumed((3,))


@ENCRYPTED
def test_attach_proof_is_that_of_the_document(suite: CipherSuite) -> None:
    proof = connection_keys(suite).attach_proof(b"header", 5)
    key = expand(expand(KEY, b"rsb attach"), b"rsb stream", struct.pack(">I", 5))
    assert proof == by_the_book(suite, key, 0, b"", b"header")


@given(st.permutations([1, 2, 3, 4, 5, 6]), st.sets(st.sampled_from([1, 2, 3, 4, 5, 6])))
def test_both_sides_keep_in_step_whatever_crosses(taken: list[int], refused: set[int]) -> None:
    """Proposals of both sides cross on the way, routes are refused and removed, and others use their keys later."""
    ours, theirs = connection_keys(routes=(1, 3, 5, 2, 4, 6)), connection_keys(routes=(2, 1, 4, 6, 3, 5))
    for route in refused:
        ours.closed(route)
    for route in taken:
        if route not in refused:
            sealed = ours.route_sealer(route, "client").seal(b"content", b"header")
            assert theirs.datagram_opener(route, "client").open(0, sealed, b"header") == b"content"


@ENCRYPTED
def test_no_other_route_direction_or_link_opens_it(suite: CipherSuite) -> None:
    sealed = connection_keys(suite).route_sealer(1, "client").seal(b"content", b"header")
    others: tuple[tuple[ConnectionKeys, int, Role], ...] = (
        (connection_keys(suite), 3, "client"),
        (connection_keys(suite), 1, "server"),
        (connection_keys(suite, bytes(32)), 1, "client"),
    )
    for keys, route, role in others:
        with pytest.raises(SealError):
            keys.stream_opener(route, role).open(sealed, b"header")


def held(thing: object) -> set[bytes]:
    """All bytes in an object's attributes and their containers."""
    if isinstance(thing, bytes):
        return {thing}
    inside = thing.values() if isinstance(thing, dict) else thing if isinstance(thing, list | tuple | set) else ()
    return set().union(*map(held, inside))


@ENCRYPTED
def test_who_takes_over_a_process_opens_nothing_earlier(suite: CipherSuite) -> None:
    """Neither what crossed before the epoch of an open route, nor what crossed on a closed one."""
    keys = connection_keys(suite)
    early = [keys.route_sealer(route, "client").seal(b"content", b"header") for route in (0, 1, 3)]
    keys.closed(3)
    secrets = held(vars(keys))
    assert secrets
    for _ in range(4):
        infos = [struct.pack(">IB", route, 0) for route in (0, 1, 3)]
        candidates = {expand(each, b"rsb data", info) for each in secrets for info in infos}
        for key in {each for each in candidates | secrets if len(each) == 32}:
            for sealed in early:
                with pytest.raises(SealError):
                    StreamOpener(suite, key).open(sealed, b"header")
        secrets = {expand(each, b"rsb next") for each in secrets}


def test_each_key_is_handed_out_once() -> None:
    keys = connection_keys()
    keys.route_sealer(1, "client")
    keys.stream_opener(1, "server")
    keys.closed(2)
    for route, role in (1, "client"), (1, "server"), (2, "client"), (9, "client"):
        with pytest.raises(ValueError, match=pattern(Misuse.NO_KEY_LEFT, route=route)):
            keys.route_sealer(route, role)  # type: ignore[arg-type]
    keys.closed(2)
    with pytest.raises(SealError):
        keys.check_attach_proof(b"header", 2, b"")


@SUITES
def test_attach_proof_holds_for_header_and_route(suite: CipherSuite) -> None:
    keys = connection_keys(suite)
    proof = keys.attach_proof(b"header of 5", 5)
    connection_keys(suite).check_attach_proof(b"header of 5", 5, proof)
    wrong = [(b"header of 7", 5, proof), (b"header of 5", 5, b"")]
    if suite is not CipherSuite.PLAIN:
        wrong.append((b"header of 5", 3, proof))
    for each in wrong:
        with pytest.raises(SealError):
            keys.check_attach_proof(*each)
