"""Tags of samples of Zenoh streams, and the secrets that both sides of a handshake derive for them."""

from __future__ import annotations

import msgspec
import pytest
from tests.wire.links import HELLO, KEY, WELCOME, ready_to_accept

from rsb_bridge.wire.connection import ClientConnection, OperatorConsole, OperatorEngine, ServerConnection
from rsb_bridge.wire.sealed_stream import Credential, ReplayCache
from rsb_bridge.wire.sealing import TAG_LENGTH, CipherSuite, SampleTags

SECRET, STREAM = bytes(range(32)), "5" * 16


def both() -> tuple[SampleTags, SampleTags]:
    return SampleTags(SECRET, STREAM, opener=True), SampleTags(SECRET, STREAM, opener=False)


@pytest.mark.parametrize("payload", [b"", b"x", bytes(1 << 20)], ids=len)
def test_tag_proves_sample_to_other_side_only(payload: bytes) -> None:
    near, far = both()
    tag = near.tag(1, 7, payload)
    assert len(tag) == TAG_LENGTH
    assert far.proves(1, 7, memoryview(payload), tag)
    assert not near.proves(1, 7, payload, tag)


def test_tag_depends_on_all_its_inputs() -> None:
    near, far = both()
    tag = near.tag(1, 7, b"payload")
    forged = [(2, 7, b"payload", tag), (1, 8, b"payload", tag), (1, 7, b"another", tag), (1, 7, b"payload", b""),
              (1, 7, b"payload", tag[:-1]), (1, 7, b"payload", bytes(TAG_LENGTH))]  # fmt: skip
    assert not any(far.proves(*each) for each in forged)
    assert not SampleTags(SECRET, "6" * 16, opener=False).proves(1, 7, b"payload", tag)
    assert not SampleTags(bytes(32), STREAM, opener=False).proves(1, 7, b"payload", tag)


def test_both_sides_of_a_link_have_one_secret() -> None:
    welcome = msgspec.structs.replace(WELCOME, at="a" * 16)
    client = ClientConnection(HELLO, KEY, CipherSuite.AESGCM)
    server = ServerConnection(lambda _: Credential((KEY,), ReplayCache()), lambda _: welcome, aes=True)
    server.receive_data(client.start())
    client.receive_data(server.data_to_send())
    assert client.sample_secret is not None
    assert client.sample_secret == server.sample_secret
    assert (client.proven, client.at) == (True, "a" * 16)


def test_fork_takes_answer_and_leaves_first_untouched() -> None:
    client, server = ready_to_accept()
    answer = server.data_to_send()
    for forged in (b"forged", answer[:-1] + bytes([answer[-1] ^ 1]), b"\0\0\0\5rsb\2\7", b"", answer + b"\0\0\0\1?"):
        fork = client.fork()
        fork.receive_data(forged)
        assert not fork.proven
    fork = client.fork()
    fork.receive_data(answer)
    assert fork.proven
    assert not client.proven
    server.receive_data(fork.data_to_send())
    assert server.accepted


def test_operator_and_engine_share_zenoh_secret() -> None:
    at = "a" * 16
    console = OperatorConsole("anna", KEY, "robot1", version=7)
    engine = OperatorEngine("robot1", lambda _: Credential((KEY,), ReplayCache()), at)
    first = console.start()
    engine.receive_data(first)
    answer = engine.data_to_send()
    for forged in (b"forged", answer + b"\0\0\0\1?"):
        fork = console.fork()
        fork.receive_data(forged)
        assert not fork.proven
    console.receive_data(answer)
    assert console.proven
    assert console.at == at
    assert console.sample_secret is not None
    assert console.sample_secret == engine.sample_secret
