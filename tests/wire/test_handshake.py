"""Noise NNpsk0 against published vectors: cacophony's, as snow's tests/vectors/cacophony.txt has them.

Their `handshake_hash` is left out: in that file it is the hash before the last message, and nothing here uses the last.
The second ciphertext depends on that hash, and the third and fourth on the final chaining key.
"""

import pytest
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey
from tests.support.wording import pattern

from rsb_bridge.wire.protocol_error import Broken, Misuse, ProtocolError
from rsb_bridge.wire.sealed_stream import NoiseHandshake, PlainHandshake, _hkdf
from rsb_bridge.wire.sealing import CipherSuite, Sealer, SealError, StreamOpener

PSK = bytes.fromhex("54686973206973206d7920417573747269616e20706572737065637469766521")
PROLOGUE = bytes.fromhex("4a6f686e2047616c74")
CLIENT_EPHEMERAL = bytes.fromhex("893e28b9dc6ca8d611ab664754b8ceb7bac5117349a4439a6b0569da977c464a")
SERVER_EPHEMERAL = bytes.fromhex("bbdb4cdbd309f1a1f2e1456967fe288cadd6f712d65dc7b7793d5e63da6b375b")
PAYLOADS = [
    bytes.fromhex(payload)
    for payload in (
        "4c756477696720766f6e204d69736573",
        "4d757272617920526f746862617264",
        "462e20412e20486179656b",
        "4361726c204d656e676572",
        "4a65616e2d426170746973746520536179",
        "457567656e2042f6686d20766f6e2042617765726b",
    )
]
CIPHERTEXTS = {
    CipherSuite.AESGCM: [
        (
            "ca35def5ae56cec33dc2036731ab14896bc4c75dbb07a61f879f8e3afa4c7944"
            "7c37a89fc17813788d30df2d59501d6066f5f8aecc3406bbd9829f2d24a531b1"
        ),
        (
            "95ebc60d2b1fa672c1f46a8aa265ef51bfe38e7ccb39ec5be34069f144808843"
            "2f29d79368ef9de4e1ae7a362fb05bf0ad668e026bf5714554497b3a720461"
        ),
        "7c01e898a6201f36aecee532e29cd0b7f8ffa29d3366ad0dce39a6",
        "a9ff535aace3db6a1da1a7fb00fe2de2622bb373abad9fb42c00e0",
        "6cfc49a3e65472edc2d0152abe5ce950170a8a47c959f30bd48b5f0aacf29adbfd",
        "9bc86e6d974ed21ba04604a94aa68de21677eb409ead070c0cd569b069ee19ba142aa4c1a9",
    ],
    CipherSuite.CHACHAPOLY: [
        (
            "ca35def5ae56cec33dc2036731ab14896bc4c75dbb07a61f879f8e3afa4c7944"
            "79b962b8aff8485742ac32f905ba45369e2465fb59e138a93d67a0d1266b6a54"
        ),
        (
            "95ebc60d2b1fa672c1f46a8aa265ef51bfe38e7ccb39ec5be34069f144808843"
            "d6062704d5a9c422a8e834423f8c1feada7e8d0d910a1a2cd030fb584221e3"
        ),
        "e632c3763d7669067383433197a3baddf146e9e70ad4b4e9e59e0f",
        "64c6bee32ea91c8474bb4c21d7a700109ad45af77b29764ba5eb1e",
        "e2fa0bed0603b62d3ccac2ecabbf3fe33f3e86514909b323361626266cb2471cc8",
        "0c01dc9cec1fe4ddd692e8dd32188aa351088dc91183639a53b57aa4692b5ebdef8b8ca111",
    ],
}
ENCRYPTED = [CipherSuite.AESGCM, CipherSuite.CHACHAPOLY]


def ends(suite: CipherSuite) -> tuple[NoiseHandshake, NoiseHandshake]:
    return (
        NoiseHandshake(suite, PSK, PROLOGUE, X25519PrivateKey.from_private_bytes(CLIENT_EPHEMERAL)),
        NoiseHandshake(suite, PSK, PROLOGUE, X25519PrivateKey.from_private_bytes(SERVER_EPHEMERAL)),
    )


@pytest.mark.parametrize("suite", ENCRYPTED)
def test_published_vector(suite: CipherSuite) -> None:
    client, server = ends(suite)
    expected = [bytes.fromhex(ciphertext) for ciphertext in CIPHERTEXTS[suite]]

    first = client.write(PAYLOADS[0])
    assert first == expected[0]
    assert server.read(first) == PAYLOADS[0]
    second = server.write(PAYLOADS[1])
    assert second == expected[1]
    assert client.read(second) == PAYLOADS[1]

    keys = client.split()
    assert keys == server.split()
    sealers = [Sealer(suite, keys.client), Sealer(suite, keys.server)]
    openers = [StreamOpener(suite, keys.client), StreamOpener(suite, keys.server)]
    for n in range(2, 6):
        sealed = sealers[n % 2].seal(PAYLOADS[n], b"")
        assert sealed == expected[n]
        assert openers[n % 2].open(sealed, b"") == PAYLOADS[n]


@pytest.mark.parametrize("suite", ENCRYPTED)
def test_keys_are_new_each_time(suite: CipherSuite) -> None:
    links = set()
    for _ in range(3):
        client, server = NoiseHandshake(suite, PSK, b""), NoiseHandshake(suite, PSK, b"")
        server.read(client.write(b""))
        client.read(server.write(b""))
        keys = client.split()
        assert keys == server.split()
        assert len(set(keys)) == 3
        links.add(keys)
    assert len(links) == 3


@pytest.mark.parametrize("suite", ENCRYPTED)
def test_a_handshake_that_is_over_holds_no_secret(suite: CipherSuite) -> None:
    client, server = NoiseHandshake(suite, PSK, b""), NoiseHandshake(suite, PSK, b"")
    server.read(client.write(b""))
    client.read(server.write(b""))
    secrets = {*client.split(), *server.split()}
    for end in (client, server):
        left = [value for value in vars(end).values() if isinstance(value, bytes)]
        assert not any(isinstance(value, X25519PrivateKey) for value in vars(end).values())
        assert not secrets & {each for value in left for each in _hkdf(value, b"")}


@pytest.mark.parametrize("suite", ENCRYPTED)
def test_another_key_or_another_prologue_does_not_open(suite: CipherSuite) -> None:
    message = NoiseHandshake(suite, PSK, PROLOGUE).write(b"hello")
    with pytest.raises(SealError):
        NoiseHandshake(suite, bytes(32), PROLOGUE).read(message)
    with pytest.raises(SealError):
        NoiseHandshake(suite, PSK, b"another").read(message)


@pytest.mark.parametrize("suite", ENCRYPTED)
def test_every_byte_of_a_message_counts(suite: CipherSuite) -> None:
    message = NoiseHandshake(suite, PSK, PROLOGUE).write(b"hello")
    for at in range(len(message)):
        damaged = bytearray(message)
        damaged[at] ^= 1
        with pytest.raises(SealError):
            NoiseHandshake(suite, PSK, PROLOGUE).read(bytes(damaged))


def test_a_message_too_short_is_a_format_error() -> None:
    for length in range(48):
        with pytest.raises(ProtocolError, match=pattern(Broken.HANDSHAKE_TOO_SHORT, length=length)):
            NoiseHandshake(CipherSuite.AESGCM, PSK, b"").read(bytes(length))


def test_a_low_order_ephemeral_is_refused() -> None:
    client = NoiseHandshake(CipherSuite.AESGCM, PSK, b"")
    client.write(b"")
    with pytest.raises(ProtocolError, match=pattern(Broken.EPHEMERAL_KEY_INVALID)):
        client.read(bytes(48))


def test_a_key_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match=pattern(Misuse.SESSION_KEY_LENGTH, expected=32, length=0)):
        NoiseHandshake(CipherSuite.AESGCM, b"", b"")


def test_plain_passes_payloads_through_and_has_no_keys() -> None:
    end = PlainHandshake()
    assert end.read(end.write(b"hello")) == b"hello"
    assert end.split() == (None, None, None)
