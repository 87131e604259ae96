import itertools
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsb_bridge.wire.connection import ClientConnection, Credential, DataConnection, ServerConnection
from rsb_bridge.wire.events import Accepted, Attach, DataFrame, Established, Failed, Received, Refused
from rsb_bridge.wire.framing import CONTROL_LIMIT, DataReader, DataWriter, pack_frame
from rsb_bridge.wire.handshake import NoiseHandshake
from rsb_bridge.wire.messages import Close, Hello, Ping, Pong, Ready, Welcome, encode
from rsb_bridge.wire.opening import Kind, Refusal, RefusalCode, control_header, opening, refuse_frame
from rsb_bridge.wire.sealing import Sealer, SealError, SessionKeys, Suite

KEY = bytes(range(32))
OTHER_KEY = bytes(32)
HELLO = Hello(version="0.1.0", name="robot1", instance="abc", domain_id=2)
WELCOME = Welcome(version="0.1.0", name="pc", link_id=b"linklink", instance="def", domain_id=0)
SUITES = pytest.mark.parametrize("suite", list(Suite))
CONTROL_HEADER = bytes(14)


def key_for(suite):
    return None if suite is Suite.PLAIN else KEY


def make_client(suite=Suite.AESGCM, *, key=KEY, **options):
    return ClientConnection(HELLO, None if suite is Suite.PLAIN else key, suite, **options)


def make_server(suite=Suite.AESGCM, *, key=KEY, aes=True, **options):
    credential = Credential(None if suite is Suite.PLAIN else key)
    return ServerConnection(lambda name: credential, lambda hello: WELCOME, aes, **options)


def shake_hands(client, server):
    """Carry bytes both ways until neither has more to say."""
    client_events, server_events = [], server.receive_data(client.start())
    while to_client := server.data_to_send():
        client_events += client.receive_data(to_client)
        server_events += server.receive_data(client.data_to_send())
    return client_events, server_events


def established(suite=Suite.AESGCM, **options):
    client, server = make_client(suite, **options), make_server(suite, **options)
    (client_event,), (server_event,) = shake_hands(client, server)
    return client, server, client_event.keys, server_event.keys


def ready_to_accept(suite=Suite.AESGCM):
    client, server = make_client(suite), make_server(suite)
    server.receive_data(client.start())
    return client, server


# --- the handshake


@SUITES
@pytest.mark.parametrize("aes", [True, False])
def test_both_sides_establish_and_hold_the_same_keys(suite, aes):
    (client_event,), (server_event,) = shake_hands(make_client(suite), make_server(suite, aes=aes))
    expected = Suite.CHACHAPOLY if suite is Suite.AESGCM and not aes else suite
    for event, peer in ((client_event, WELCOME), (server_event, HELLO)):
        assert event == Established(peer, event.keys)
        assert (event.keys.suite, event.keys.link_id) == (expected, WELCOME.link_id)
    for role, sender, receiver in (("client", client_event, server_event), ("server", server_event, client_event)):
        sealed = sender.keys.route_sealer(1, role).seal(b"content", b"header")
        assert receiver.keys.stream_opener(1, role).open(sealed, b"header") == b"content"


@SUITES
def test_messages_cross_both_ways(suite):
    client, server, _, _ = established(suite)
    for n in range(3):
        assert server.receive_data(client.send(Ping(n, 1))) == [Received(Ping(n, 1))]
        assert client.receive_data(server.send(Pong(n, 1, 2, 3))) == [Received(Pong(n, 1, 2, 3))]


@SUITES
@given(data=st.data())
def test_however_the_streams_are_cut_the_events_are_the_same(suite, data):
    client, server = make_client(suite), make_server(suite, aes=data.draw(st.booleans()))
    client_events, server_events = [], []

    def carry(stream, receiver, events):
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
    assert server_events[1:] == [Received(message) for message in messages]


def test_send_keeps_the_order_of_what_was_not_fetched_yet():
    client, server = ready_to_accept()
    client.receive_data(server.data_to_send())
    events = server.receive_data(client.send(Ready(route=1)))
    assert [type(event) for event in events] == [Established, Received]
    assert client.data_to_send() == b""


# --- keys that do not fit: both sides say so in words


def refused(client, server):
    """The one event on each side of a refusal by the server."""
    client_events, server_events = shake_hands(client, server)
    (ours,), (theirs,) = server_events, client_events
    assert (ours.code, ours.words) == (theirs.code, theirs.words)
    assert not ours.by_peer
    assert theirs.by_peer
    return ours


@pytest.mark.parametrize("suite", [Suite.AESGCM, Suite.CHACHAPOLY])
def test_another_key(suite):
    refusal = refused(make_client(suite), make_server(suite, key=OTHER_KEY))
    assert refusal == Refused(RefusalCode.WRONG_KEY, "the two sides' keys for 'robot1' differ", by_peer=False)


def test_no_key_against_a_key():
    refusal = refused(make_client(Suite.PLAIN), make_server())
    assert refusal.code is RefusalCode.ENCRYPTION_REQUIRED
    assert refusal.words == "the server requires encryption for 'robot1' and the client came without"


def test_a_key_against_none():
    refusal = refused(make_client(), make_server(Suite.PLAIN))
    assert refusal.code is RefusalCode.ENCRYPTION_NOT_POSSIBLE
    assert refusal.words == "the client encrypts and the server has no key for 'robot1'"


def test_an_unknown_name():
    def identity(name):
        raise Refusal(RefusalCode.UNKNOWN_NAME, f"no client {name} is known here")

    refusal = refused(make_client(), ServerConnection(identity, lambda hello: WELCOME, aes=True))
    assert (refusal.code, refusal.words) == (RefusalCode.UNKNOWN_NAME, "no client robot1 is known here")


def test_a_busy_server():
    def make_welcome(hello):
        raise Refusal(RefusalCode.BUSY, f"{hello.name} is linked already")

    server = ServerConnection(lambda name: Credential(KEY), make_welcome, aes=True)
    assert refused(make_client(), server).code is RefusalCode.BUSY


def test_a_server_that_answers_with_another_key():
    client, _ = ready_to_accept()
    answer = pack_frame(opening(Kind.ACCEPT, NoiseHandshake(Suite.AESGCM, OTHER_KEY, b"").write(b"")))
    words = "the server's answer does not open with this side's key"
    assert client.receive_data(answer) == [Refused(RefusalCode.WRONG_KEY, words, by_peer=False)]


def test_a_plain_answer_to_an_encrypting_client_is_not_taken():
    client, _ = ready_to_accept()
    (event,) = client.receive_data(pack_frame(opening(Kind.ACCEPT, encode(WELCOME))))
    assert event.code is RefusalCode.WRONG_KEY


# --- another version


def other_version(frame):
    return pack_frame(b"rsb\x09" + frame[4:])


def test_a_client_of_another_version():
    server = make_server()
    words = "this side speaks version 1, the peer version 9"
    (event,) = server.receive_data(other_version(opening(Kind.CONTROL, b"whatever that means in version 9")))
    assert event == Refused(RefusalCode.WRONG_VERSION, words, by_peer=False)
    assert server.data_to_send() == pack_frame(refuse_frame(RefusalCode.WRONG_VERSION, words))


@pytest.mark.parametrize("kind", [Kind.ACCEPT, Kind.REFUSE])
def test_a_server_of_another_version(kind):
    client = make_client()
    client.start()
    words = "this side speaks version 1, the peer version 9"
    events = client.receive_data(other_version(opening(kind, b"\x01whatever")))
    assert events == [Refused(RefusalCode.WRONG_VERSION, words, by_peer=False)]
    assert client.data_to_send() == b""


# --- RETRY


@pytest.mark.parametrize("body", [b"", b"\x00", b"\x01", b"\x07"])
def test_a_forged_retry_does_not_take_the_encryption_away(body):
    client, _ = ready_to_accept()
    (event,) = client.receive_data(pack_frame(opening(Kind.RETRY, body)))
    assert isinstance(event, Failed)
    assert client.data_to_send() == b""


@pytest.mark.parametrize("suite", [Suite.PLAIN, Suite.CHACHAPOLY])
def test_a_retry_without_cause_is_a_format_error(suite):
    client, _ = ready_to_accept(suite)
    retry = pack_frame(opening(Kind.RETRY, bytes((Suite.CHACHAPOLY,))))
    assert client.receive_data(retry) == [Failed("an opening frame of kind RETRY has no place here")]


def test_a_client_takes_one_retry():
    client, _ = ready_to_accept()
    retry = pack_frame(opening(Kind.RETRY, bytes((Suite.CHACHAPOLY,))))
    assert client.receive_data(retry) == []
    assert client.data_to_send()
    assert [type(event) for event in client.receive_data(retry)] == [Failed]


def test_a_client_that_does_not_follow_a_retry():
    client, server = make_client(), make_server(aes=False)
    assert server.receive_data(client.start()) == []
    (event,) = server.receive_data(client.start())
    assert event == Failed("the client was asked for ChaCha20-Poly1305 and offers AES-GCM again")


# --- a client is proven by its confirmation


@pytest.mark.parametrize("suite", [Suite.AESGCM, Suite.CHACHAPOLY])
def test_a_recorded_first_message_played_again_establishes_nothing(suite):
    client, server = make_client(suite), make_server(suite)
    recording = client.start()
    assert server.receive_data(recording) == []
    client.receive_data(server.data_to_send())
    recording += client.data_to_send()

    (event,) = make_server(suite).receive_data(recording)
    assert isinstance(event, Failed)
    assert "damaged or forged" in event.reason


def test_a_first_frame_with_content_confirms_nothing():
    client, server = ready_to_accept(Suite.PLAIN)
    client.receive_data(server.data_to_send())
    sealed = Sealer(Suite.PLAIN, None).seal(encode(Ping(1, 1)), CONTROL_HEADER)
    (event,) = server.receive_data(pack_frame(CONTROL_HEADER, sealed))
    assert event == Failed("the client did not confirm the handshake")


def test_data_before_the_confirmation_have_no_place():
    client, server = make_client(multiplexed=True), make_server(multiplexed=True)
    server.receive_data(client.start())
    (event,) = server.receive_data(DataWriter(Sealer(Suite.AESGCM, KEY), 1).write(b"x", 0))
    assert "has no place on this control connection" in event.reason


# --- what breaks the format


def control(body):
    return pack_frame(opening(Kind.CONTROL, body))


@pytest.mark.parametrize(
    ("stream", "words"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", "not an rsb-console"),
        (b"\x00\x00\x10\x01", "not an rsb-console"),
        (pack_frame(b""), "not an rsb-console"),
        (pack_frame(b"rsb\x01"), "not an rsb-console"),
        (pack_frame(b"RSB\x01\x01"), "not an rsb-console"),
        (pack_frame(opening(Kind.ACCEPT)), "kind ACCEPT has no place"),
        (pack_frame(b"rsb\x01\x63"), "no opening frame of kind 99"),
        (control(b""), "ends before its name does"),
        (control(b"\x01\x05robo"), "ends before its name does"),
        (control(b"\x01\x02\xff\xfe"), "not UTF-8"),
        (control(b"\x07\x01a"), "cipher suite that does not exist"),
        (control(b"\x01\x06robot1short"), "too short"),
        (pack_frame(opening(Kind.DATA, bytes(11))), "ends before its route does"),
    ],
)
def test_what_is_no_opening_frame_is_refused_in_words(stream, words):
    server = make_server()
    (event,) = server.receive_data(stream)
    assert isinstance(event, Failed)
    assert words in event.reason
    assert server.data_to_send() == pack_frame(refuse_frame(RefusalCode.BAD_FORMAT, event.reason))


@pytest.mark.parametrize("hello", [b"", b"\xc1", encode(Ping(1, 1)), encode(WELCOME)])
def test_a_first_message_that_holds_no_hello(hello):
    (event,) = make_server(Suite.PLAIN).receive_data(pack_frame(control_header(Suite.PLAIN, "robot1"), hello))
    assert "does not read" in event.reason


def test_a_client_with_two_names():
    (event,) = make_server(Suite.PLAIN).receive_data(pack_frame(control_header(Suite.PLAIN, "robot2"), encode(HELLO)))
    assert event == Failed("the client calls itself 'robot2' first and 'robot1' then")


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (opening(Kind.DATA), "kind DATA has no place"),
        (opening(Kind.REFUSE), "a reason that does not exist"),
        (opening(Kind.REFUSE, b"\x63words"), "a reason that does not exist"),
        (opening(Kind.ACCEPT, b"short"), "too short"),
        (b"SSH-2.0-OpenSSH", "not an rsb-console"),
    ],
)
def test_a_client_hears_nonsense(frame, words):
    client, _ = ready_to_accept()
    (event,) = client.receive_data(pack_frame(frame))
    assert words in event.reason
    assert client.data_to_send() == b""


def test_a_refusal_s_words_are_bounded_and_printable():
    client, _ = ready_to_accept()
    words = "\x1b[2J" + "ü" * 400
    assert len(refuse_frame(RefusalCode.BUSY, words)) == 6 + 512
    (event,) = client.receive_data(pack_frame(refuse_frame(RefusalCode.BUSY, words)))
    assert (event.code, event.by_peer) == (RefusalCode.BUSY, True)
    assert event.words.startswith("\N{REPLACEMENT CHARACTER}[2Jü")
    assert len(event.words.encode()) <= 512 + 4


@SUITES
def test_damage_to_a_sealed_frame_ends_the_connection(suite):
    client, server, _, _ = established(suite)
    frame = bytearray(client.send(Ping(1, 1)))
    frame[-1] ^= 1
    (event,) = server.receive_data(frame)
    assert "damaged or forged" in event.reason
    assert server.data_to_send() == b""
    assert server.receive_data(client.send(Ping(2, 2))) == []


@SUITES
def test_a_sealed_frame_played_again_ends_the_connection(suite):
    client, server, _, _ = established(suite)
    frame = client.send(Ping(1, 1))
    events = server.receive_data(frame + frame)
    assert [type(event) for event in events] == [Received, Failed]


@pytest.mark.parametrize("frame", [b"", b"\x00", bytes(13), b"\x02" + bytes(30), bytes((0, 1)) + bytes(30)])
@pytest.mark.parametrize("multiplexed", [True, False])
def test_a_sealed_frame_that_is_neither_control_nor_data(frame, multiplexed):
    _, server, _, _ = established(multiplexed=multiplexed)
    (event,) = server.receive_data(pack_frame(frame))
    assert "has no place on this control connection" in event.reason


def test_a_control_frame_too_long_is_refused_before_it_comes():
    _, server, _, _ = established()
    (event,) = server.receive_data(struct.pack(">I", CONTROL_LIMIT + 1))
    assert event == Failed(f"a frame of {CONTROL_LIMIT + 1} bytes, where {CONTROL_LIMIT} are the most")


def test_an_empty_control_frame_later_is_no_message():
    _, server, _, _ = established(Suite.PLAIN)
    sealer = Sealer(Suite.PLAIN, None)
    sealer.sequence = 1
    (event,) = server.receive_data(pack_frame(CONTROL_HEADER, sealer.seal(b"", CONTROL_HEADER)))
    assert "does not read" in event.reason


@st.composite
def any_end(draw):
    """Either end of any stream, in any state it may be met in."""
    suite = draw(st.sampled_from(Suite))
    client, server = ready_to_accept(suite)
    data = DataConnection(SessionKeys(suite, key_for(suite) and KEY, b"linklink"), 1)
    live_client, live_server, _, _ = established(suite, multiplexed=draw(st.booleans()))
    return draw(st.sampled_from([make_server(suite), client, server, data, live_client, live_server]))


@given(end=any_end(), garbage=st.lists(st.binary(max_size=200), max_size=5), framed=st.booleans())
def test_garbage_gives_events_not_exceptions(end, garbage, framed):
    events = []
    for piece in garbage:
        events += end.receive_data(pack_frame(piece) if framed else piece)
    assert all(isinstance(event, Failed | Refused | DataFrame) for event in events)
    assert sum(isinstance(event, Failed | Refused) for event in events) <= 1


# --- sending


def test_a_name_too_long_is_refused_with_the_remedy():
    client = ClientConnection(Hello("0.1.0", "ü" * 128, "abc", 0), KEY, Suite.AESGCM)
    with pytest.raises(ValueError, match="256 bytes long in UTF-8; 255 are the most: choose a shorter one"):
        client.start()


def test_nothing_is_sent_before_the_connection_is_established():
    with pytest.raises(RuntimeError, match="before the connection is established"):
        make_client().send(Ping(1, 1))


@SUITES
def test_a_message_may_fill_a_control_frame_and_no_more(suite):
    client, server, _, _ = established(suite)
    room = CONTROL_LIMIT - 14 - 16 - len(encode(Close(route=1, reason="x" * 70_000))) + 70_000
    message = Close(route=1, reason="x" * room)
    assert server.receive_data(client.send(message)) == [Received(message)]
    with pytest.raises(ValueError, match="a Close of"):
        client.send(Close(route=1, reason="x" * (room + 1)))
    assert server.receive_data(client.send(Ping(1, 1))) == [Received(Ping(1, 1))]


# --- data streams


@SUITES
def test_a_data_stream_is_attached(suite):
    _, _, client_keys, server_keys = established(suite)
    data, server = DataConnection(client_keys, 5), make_server(suite)
    start = data.start()
    (attach,) = server.receive_data(start)
    assert isinstance(attach, Attach)
    assert (attach.link_id, attach.route) == (WELCOME.link_id, 5)
    server_keys.check_attach_proof(attach.header, attach.route, attach.proof)

    # The server may send at once: what comes with the ACCEPT is the route's.
    first = DataWriter(server_keys.route_sealer(5, "server"), 5).write(b"x" * 10_000, 7)
    stream = server.accept_attach() + first
    assert data.receive_data(stream[:20]) == [Accepted()]
    assert data.receive_data(stream[20:30]) == []
    reader = DataReader(client_keys.stream_opener(5, "server"), 5)
    assert reader.receive_data(data.leftover()) == []
    assert reader.receive_data(stream[30:]) == [(b"x" * 10_000, 7, 0)]
    assert data.leftover() == b""


def test_what_a_client_sends_behind_its_data_opening_is_left_over():
    _, _, keys, _ = established()
    server = make_server()
    (attach,) = server.receive_data(DataConnection(keys, 5).start() + b"beyond")
    assert isinstance(attach, Attach)
    assert server.leftover() == b"beyond"


@pytest.mark.parametrize("suite", [Suite.AESGCM, Suite.CHACHAPOLY])
def test_a_data_stream_of_another_link_has_no_proof(suite):
    _, _, _, server_keys = established(suite)
    stranger = SessionKeys(suite, OTHER_KEY, server_keys.link_id)
    server = make_server(suite)
    (attach,) = server.receive_data(DataConnection(stranger, 5).start())
    with pytest.raises(SealError):
        server_keys.check_attach_proof(attach.header, attach.route, attach.proof)


def test_a_data_stream_is_turned_away():
    _, _, keys, _ = established()
    data, server = DataConnection(keys, 5), make_server()
    server.receive_data(data.start())
    answer = server.refuse(RefusalCode.NO_SUCH_ROUTE, "route 5 is not open")
    refusal = Refused(RefusalCode.NO_SUCH_ROUTE, "route 5 is not open", by_peer=True)
    assert data.receive_data(answer) == [refusal]
    for end in (data, server):
        assert end.receive_data(b"more") == []
        assert end.leftover() == b""


def test_a_data_stream_is_offered_a_retry():
    _, _, keys, _ = established()
    data = DataConnection(keys, 5)
    data.start()
    assert data.receive_data(pack_frame(opening(Kind.RETRY, b"\x02"))) == [
        Failed("an opening frame of kind RETRY has no place here")
    ]


# --- data frames on the control stream


@SUITES
def test_a_multiplexed_stream_carries_control_and_data(suite):
    client, server, client_keys, server_keys = established(suite, multiplexed=True)
    writer = DataWriter(client_keys.route_sealer(3, "client"), 3)
    reader = DataReader(server_keys.stream_opener(3, "client"), 3)
    first, second = writer.write_chunks(b"payload", 9, 0, 4)
    events = server.receive_data(first + client.send(Ping(1, 1)) + second)
    assert [type(event) for event in events] == [DataFrame, Received, DataFrame]
    assert [event.route for event in events[::2]] == [3, 3]
    assert [reader.open_frame(event.frame) for event in events[::2]] == [None, (b"payload", 9, 0)]


def test_elsewhere_data_frames_have_no_place_on_the_control_stream():
    _, server, keys, _ = established()
    (event,) = server.receive_data(DataWriter(keys.route_sealer(3, "client"), 3).write(b"x", 0))
    assert "has no place on this control connection" in event.reason
