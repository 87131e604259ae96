"""The control connection: the handshake, who is let in, what is sent."""

import itertools

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.connection_keys import propose
from tests.support.frames import write_frame
from tests.support.wording import pattern, says
from tests.wire.links import (
    CONTROL_HEADER,
    HELLO,
    KEY,
    OTHER_KEY,
    SUITES,
    WELCOME,
    established,
    make_client,
    make_server,
    ready_to_accept,
    shake_hands,
    the,
)

from rsb_bridge.model.fingerprints import fingerprint_of, format_fingerprint
from rsb_bridge.wire.codec import encode
from rsb_bridge.wire.connection import ClientConnection, ServerConnection
from rsb_bridge.wire.events import Established, Event, Failed, MessageReceived, RefusalCode, StreamRefused
from rsb_bridge.wire.framing import CONTROL_LIMIT, LENGTH, DataWriter, pack_frame
from rsb_bridge.wire.messages import Hello, Ping, Pong, Ready, TopicList, Welcome
from rsb_bridge.wire.preamble import PreambleKind, Refusal, RefusalText, preamble_frame, refuse_frame
from rsb_bridge.wire.protocol_error import Broken, Misuse
from rsb_bridge.wire.sealed_stream import Credential, NoiseHandshake, ReplayCache
from rsb_bridge.wire.sealing import CipherSuite, InvalidSeal, Role, Sealer

ROLES: tuple[Role, ...] = ("client", "server")


@SUITES
@pytest.mark.parametrize("aes", [True, False])
def test_both_sides_establish_and_hold_the_same_keys(suite: CipherSuite, aes: bool) -> None:
    connection = make_client(suite)
    assert connection.suite is suite
    client_events, server_events = shake_hands(connection, make_server(suite, aes=aes))
    client, server = the(Established, client_events), the(Established, server_events)
    expected = CipherSuite.CHACHAPOLY if suite is CipherSuite.AESGCM and not aes else suite
    assert connection.suite is expected
    assert (client.peer, server.peer) == (WELCOME, HELLO)
    for event in (client, server):
        assert (event.keys.suite, event.keys.link_id) == (expected, WELCOME.link_id)
        propose(event.keys, (1,))
    for role, sender, receiver in zip(ROLES, (client, server), (server, client), strict=True):
        sealed = sender.keys.route_sealer(1, role).seal(b"content", b"header")
        assert receiver.keys.stream_opener(1, role).open(sealed, b"header") == b"content"


@SUITES
def test_messages_cross_both_ways(suite: CipherSuite) -> None:
    client, server, _, _ = established(suite)
    for n in range(3):
        assert server.receive_data(client.send(Ping(n, 1))) == [MessageReceived(encode(Ping(n, 1)))]
        assert client.receive_data(server.send(Pong(n, 1, 2, 3))) == [MessageReceived(encode(Pong(n, 1, 2, 3)))]


@SUITES
@given(data=st.data())
def test_however_streams_are_cut_events_are_same(suite: CipherSuite, data: st.DataObject) -> None:
    client, server = make_client(suite), make_server(suite, aes=data.draw(st.booleans()))
    client_events: list[Event] = []
    server_events: list[Event] = []

    def carry(stream: bytes, receiver: ClientConnection | ServerConnection, events: list[Event]) -> None:
        cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
        for start, stop in itertools.pairwise([0, *cuts, len(stream)]):
            events += receiver.receive_data(stream[start:stop])

    carry(client.start(), server, server_events)
    while to_client := server.data_to_send():
        carry(to_client, client, client_events)
        carry(client.data_to_send(), server, server_events)
    messages = [Ping(n, n) for n in range(data.draw(st.integers(0, 4)))]
    carry(b"".join(client.send(message) for message in messages), server, server_events)
    assert [type(event) for event in client_events] == [Established]
    assert [type(event) for event in server_events[:1]] == [Established]
    assert server_events[1:] == [MessageReceived(encode(message)) for message in messages]


def test_send_keeps_order_of_unfetched() -> None:
    client, server = ready_to_accept()
    client.receive_data(server.data_to_send())
    events = server.receive_data(client.send(Ready(route=1, sources=1)))
    assert [type(event) for event in events] == [Established, MessageReceived]
    assert client.data_to_send() == b""


# --- keys that do not fit: both sides explain it


def refused(client: ClientConnection, server: ServerConnection) -> StreamRefused:
    """The one event on each side of a refusal by the server."""
    client_events, server_events = shake_hands(client, server)
    ours, theirs = the(StreamRefused, server_events), the(StreamRefused, client_events)
    assert (ours.code, ours.message) == (theirs.code, theirs.message)
    return ours


def test_another_key_or_key_on_one_side_only() -> None:
    ours, theirs = (format_fingerprint(fingerprint_of(key)) for key in (KEY, OTHER_KEY))
    differ = RefusalText.KEYS_DIFFER(name="robot1", theirs=ours, there="client", ours=theirs, here="server")
    for suite in (CipherSuite.AESGCM, CipherSuite.CHACHAPOLY):
        refusal = refused(make_client(suite), make_server(suite, keys=(OTHER_KEY,)))
        assert refusal == StreamRefused(RefusalCode.WRONG_KEY, differ)
    required = RefusalText.ENCRYPTION_REQUIRED(name="robot1")
    refusal = refused(make_client(CipherSuite.PLAIN), make_server())
    assert refusal == StreamRefused(RefusalCode.ENCRYPTION_REQUIRED, required)
    impossible = RefusalText.ENCRYPTION_NOT_POSSIBLE(name="robot1")
    refusal = refused(make_client(), make_server(CipherSuite.PLAIN))
    assert refusal == StreamRefused(RefusalCode.ENCRYPTION_NOT_POSSIBLE, impossible)


@pytest.mark.parametrize("suite", [CipherSuite.AESGCM, CipherSuite.CHACHAPOLY])
@pytest.mark.parametrize("aes", [True, False])
@pytest.mark.parametrize("key", [KEY, OTHER_KEY])
def test_a_client_may_have_either_of_two_keys(suite: CipherSuite, aes: bool, key: bytes) -> None:
    client, server = make_client(suite, key=key), make_server(suite, keys=(KEY, OTHER_KEY), aes=aes)
    assert server.fingerprint == b""
    client_events, server_events = shake_hands(client, server)
    the(Established, client_events)
    the(Established, server_events)
    assert server.fingerprint == fingerprint_of(key)


def test_a_key_that_is_neither_of_two() -> None:
    third = bytes(range(1, 33))
    refusal = refused(make_client(key=third), make_server(keys=(KEY, OTHER_KEY)))
    current, following, theirs = (format_fingerprint(fingerprint_of(key)) for key in (KEY, OTHER_KEY, third))
    assert refusal.code is RefusalCode.WRONG_KEY
    assert says(refusal.message, RefusalText.KEYS_DIFFER, name="robot1", theirs=theirs, there="client")
    assert current in refusal.message
    assert following in refusal.message


def test_first_message_needs_more_than_claimed_key() -> None:
    """The server takes the key that the client claims to have; only the handshake proves it.

    That the keys differ would be untrue where it was forged or damaged.
    """
    frame = make_client().start()
    for changed, words in (
        (frame.replace(fingerprint_of(KEY), fingerprint_of(OTHER_KEY)), RefusalText.FIRST_MESSAGE_FORGED),
        (frame[:-1] + bytes((frame[-1] ^ 1,)), RefusalText.FIRST_MESSAGE_FORGED),
        (frame.replace(fingerprint_of(KEY), bytes(8)), RefusalText.KEY_NOT_NAMED),
    ):
        refusal = the(StreamRefused, make_server(keys=(KEY, OTHER_KEY)).receive_data(changed))
        assert refusal.code is RefusalCode.WRONG_KEY
        assert says(refusal.message, words, name="robot1")
    server = make_server(CipherSuite.PLAIN)
    assert server.receive_data(make_client(CipherSuite.PLAIN).start().replace(bytes(8), fingerprint_of(KEY), 1)) == []
    assert (server.accepted, server.fingerprint) == (True, b"")


def test_an_unknown_name_and_a_busy_server() -> None:
    def identity(name: str) -> Credential:
        raise Refusal(RefusalCode.UNKNOWN_NAME, f"no client {name} is known here")

    def make_welcome(hello: Hello) -> Welcome:
        raise Refusal(RefusalCode.BUSY, f"{hello.name} is linked already")

    refusal = refused(make_client(), ServerConnection(identity, lambda hello: WELCOME, aes=True))
    assert (refusal.code, refusal.message) == (RefusalCode.UNKNOWN_NAME, "no client robot1 is known here")
    busy = ServerConnection(lambda name: Credential((KEY,), ReplayCache()), make_welcome, aes=True)
    assert refused(make_client(), busy).code is RefusalCode.BUSY


def test_a_server_that_answers_with_another_key() -> None:
    client, _ = ready_to_accept()
    answer = pack_frame(
        preamble_frame(PreambleKind.ACCEPT, NoiseHandshake(CipherSuite.AESGCM, OTHER_KEY, b"").write(b""))
    )
    text = RefusalText.ANSWER_SEALED_WITH_ANOTHER_KEY()
    assert client.receive_data(answer) == [StreamRefused(RefusalCode.WRONG_KEY, text)]


def test_plain_answer_to_encrypting_client_is_not_taken() -> None:
    client, _ = ready_to_accept()
    event = the(StreamRefused, client.receive_data(pack_frame(preamble_frame(PreambleKind.ACCEPT, encode(WELCOME)))))
    assert event.code is RefusalCode.WRONG_KEY


# --- another version


def other_version(frame: bytes, version: int = 9) -> bytes:
    return pack_frame(b"rsb" + bytes((version,)) + frame[4:])


@pytest.mark.parametrize(("version", "text"), [(0, RefusalText.PEER_OLDER), (9, RefusalText.THIS_SIDE_OLDER)])
def test_a_client_of_another_version(version: int, text: RefusalText) -> None:
    server, words = make_server(), text(ours=1, theirs=version)
    (event,) = server.receive_data(other_version(preamble_frame(PreambleKind.CONTROL, b"whatever it means"), version))
    assert event == StreamRefused(RefusalCode.WRONG_VERSION, words)
    assert server.data_to_send() == pack_frame(refuse_frame(RefusalCode.WRONG_VERSION, words))


@pytest.mark.parametrize("kind", [PreambleKind.ACCEPT, PreambleKind.REFUSE])
def test_a_server_of_another_version(kind: PreambleKind) -> None:
    client = make_client()
    client.start()
    words = RefusalText.THIS_SIDE_OLDER(ours=1, theirs=9)
    events = client.receive_data(other_version(preamble_frame(kind, b"\x01whatever")))
    assert events == [StreamRefused(RefusalCode.WRONG_VERSION, words)]
    assert client.data_to_send() == b""


# --- RETRY


@pytest.mark.parametrize("body", [b"", b"\x00", b"\x01", b"\x07"])
def test_forged_retry_does_not_take_encryption_away(body: bytes) -> None:
    client, _ = ready_to_accept()
    (event,) = client.receive_data(pack_frame(preamble_frame(PreambleKind.RETRY, body)))
    assert isinstance(event, Failed)
    assert client.data_to_send() == b""


@pytest.mark.parametrize("suite", [CipherSuite.PLAIN, CipherSuite.CHACHAPOLY])
def test_a_retry_without_cause_is_a_format_error(suite: CipherSuite) -> None:
    client, _ = ready_to_accept(suite)
    retry = pack_frame(preamble_frame(PreambleKind.RETRY, bytes((CipherSuite.CHACHAPOLY,))))
    assert client.receive_data(retry) == [Failed(Broken.UNEXPECTED_IN_PREAMBLE(kind="RETRY"))]


def test_a_client_takes_one_retry() -> None:
    client, _ = ready_to_accept()
    retry = pack_frame(preamble_frame(PreambleKind.RETRY, bytes((CipherSuite.CHACHAPOLY,))))
    assert client.receive_data(retry) == []
    assert client.data_to_send()
    assert [type(event) for event in client.receive_data(retry)] == [Failed]


def test_a_client_that_does_not_follow_a_retry() -> None:
    client, server = make_client(), make_server(aes=False)
    assert server.receive_data(client.start()) == []
    (event,) = server.receive_data(client.start())
    assert event == Failed(Broken.RETRY_IGNORED())


# --- a client is proven by its confirmation


@pytest.mark.parametrize("suite", [CipherSuite.AESGCM, CipherSuite.CHACHAPOLY])
def test_a_recorded_first_message_played_again_establishes_nothing(suite: CipherSuite) -> None:
    client, server = make_client(suite), make_server(suite)
    recording = client.start()
    assert server.receive_data(recording) == []
    client.receive_data(server.data_to_send())
    recording += client.data_to_send()

    event = the(Failed, make_server(suite).receive_data(recording))
    assert event.reason == InvalidSeal.FORGED(sequence=0)


def test_a_first_message_is_answered_once() -> None:
    """It costs a Diffie-Hellman exchange, and a place in the queue of handshakes."""
    before = ReplayCache()

    def server() -> ServerConnection:
        return ServerConnection(lambda name: Credential((KEY, OTHER_KEY), before), lambda hello: WELCOME, aes=True)

    for key in (OTHER_KEY, KEY):
        recording = make_client(key=key).start()
        assert server().receive_data(recording) == []
        (event,) = server().receive_data(recording)
        assert event == Failed(Broken.HANDSHAKE_REPLAYED(name="robot1"))
    for _ in range(512):
        assert server().receive_data(make_client().start()) == []
    assert server().receive_data(recording) == []  # so many are remembered


def test_client_of_shut_down_link_proves_key_first() -> None:
    shut_down = msgspec.structs.replace(WELCOME, shut_down="shut down by anna on pts/3")
    client = make_client()
    server = ServerConnection(lambda name: Credential((KEY,), ReplayCache()), lambda hello: shut_down, aes=True)
    client_events, server_events = shake_hands(client, server)
    assert the(StreamRefused, client_events) == StreamRefused(RefusalCode.SHUT_DOWN, "shut down by anna on pts/3")
    assert the(StreamRefused, server_events).code is RefusalCode.SHUT_DOWN
    assert the(StreamRefused, server_events).peer == HELLO


def test_clear_refuse_cannot_claim_shut_down() -> None:
    """Anybody can forge one, and the client would wait long before its next attempt."""
    client = make_client()
    client.start()
    (event,) = client.receive_data(pack_frame(refuse_frame(RefusalCode.SHUT_DOWN, "for ever")))
    assert isinstance(event, Failed)


def test_client_of_taken_name_proves_key_first() -> None:
    """Thus the server distinguishes a second client that has the key from a replayed first message."""
    client = make_client()
    taken = msgspec.structs.replace(WELCOME, taken="'robot1' is linked already")
    server = ServerConnection(lambda name: Credential((KEY,), ReplayCache()), lambda hello: taken, aes=True)
    assert server.receive_data(client.start()) == []
    assert client.receive_data(server.data_to_send()) == [
        StreamRefused(RefusalCode.NAME_TAKEN, "'robot1' is linked already")
    ]
    confirmation = client.data_to_send()
    assert server.receive_data(confirmation) == [
        StreamRefused(RefusalCode.NAME_TAKEN, "'robot1' is linked already", HELLO)
    ]
    assert server.receive_data(confirmation) == []


def test_a_first_frame_with_content_confirms_nothing() -> None:
    client, server = ready_to_accept(CipherSuite.PLAIN)
    client.receive_data(server.data_to_send())
    sealed = Sealer(CipherSuite.PLAIN, None).seal(encode(Ping(1, 1)), CONTROL_HEADER)
    (event,) = server.receive_data(pack_frame(CONTROL_HEADER, sealed))
    assert event == Failed(Broken.NOT_CONFIRMED(peer="client"))


def test_data_before_the_confirmation_have_no_place() -> None:
    client, server = make_client(multiplexed=True), make_server(multiplexed=True)
    server.receive_data(client.start())
    event = the(Failed, server.receive_data(write_frame(DataWriter(Sealer(CipherSuite.AESGCM, KEY), 1), b"x", 0)))
    assert event == Failed(Broken.NOT_CONFIRMED(peer="client"))


def test_who_has_not_confirmed_gets_room_of_handshake() -> None:
    """A replayed first message does not make the server hold a control frame of 1 MiB."""
    _, server = ready_to_accept()
    assert server.accepted
    assert server.receive_data(LENGTH.pack(4096) + bytes(4095)) == []
    event = the(Failed, ready_to_accept()[1].receive_data(LENGTH.pack(4097)))
    assert event.foreign is None  # its first message was an rsb-console's


def test_what_follows_confirmation_at_once_may_be_long() -> None:
    client, server = ready_to_accept(CipherSuite.AESGCM)
    client.receive_data(server.data_to_send())
    long = TopicList(1, bytes(30_000))
    confirmed, received = server.receive_data(client.send(long))
    assert isinstance(confirmed, Established)
    assert received == MessageReceived(encode(long))


# --- sending


def test_name_too_long_is_refused_with_remedy() -> None:
    client = ClientConnection(Hello("0.1.0", "ü" * 128, "abc", 0), KEY, CipherSuite.AESGCM)
    with pytest.raises(ValueError, match=pattern(Misuse.NAME_TOO_LONG, length=256, limit=255)):
        client.start()


def test_nothing_is_sent_before_the_connection_is_established() -> None:
    with pytest.raises(RuntimeError, match=pattern(Misuse.NOT_ESTABLISHED)):
        make_client().send(Ping(1, 1))


@SUITES
def test_message_may_fill_control_frame_and_no_more(suite: CipherSuite) -> None:
    client, server, _, _ = established(suite)
    others = 14 + 16 + len(encode(TopicList(1, bytes(1 << 16)))) - (1 << 16)
    message = TopicList(1, bytes(CONTROL_LIMIT - others))
    assert server.receive_data(client.send(message)) == [MessageReceived(encode(message))]
    with pytest.raises(ValueError, match=pattern(Misuse.CONTROL_MESSAGE_TOO_LONG)):
        client.send(TopicList(1, bytes(CONTROL_LIMIT - others + 1)))
    assert server.receive_data(client.send(Ping(1, 1))) == [MessageReceived(encode(Ping(1, 1)))]


def test_server_without_confirmation_is_understood() -> None:
    """The client has been accepted, and its confirmation takes too long."""
    client, server = make_client(), make_server()
    server.receive_data(client.start())
    the(Established, client.receive_data(server.data_to_send()))
    refusal = server.refuse(RefusalCode.BUSY, "too slow")
    assert client.receive_data(refusal) == [StreamRefused(RefusalCode.BUSY, "too slow")]
    assert client.receive_data(refusal) == []


@pytest.mark.parametrize(
    "frame", [preamble_frame(PreambleKind.ACCEPT), b"rsb", bytes(20)], ids=["ACCEPT", "cut off", "other"]
)
def test_any_other_frame_in_clear_breaks_format(frame: bytes) -> None:
    client, *_ = established()
    the(Failed, client.receive_data(pack_frame(frame)))


def test_refusal_after_sealed_frame_breaks_format() -> None:
    client, server, *_ = established()
    client.receive_data(server.send(Ping(n=1, sent=1)))
    refusal = pack_frame(refuse_frame(RefusalCode.BUSY, "forged"))
    the(Failed, client.receive_data(refusal))
