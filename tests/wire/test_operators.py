"""An operator's connection: the handshake, the records, and what somebody on the way can do."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.wording import pattern
from tests.wire.links import KEY, OTHER_KEY, make_client, make_server, the
from tests.wire.operators_helpers import VERSION, attached, make_console, make_engine

from rsb_bridge.model.fingerprints import fingerprint_of
from rsb_bridge.wire.connection import (
    HOST_BYTES,
    OPERATOR_SUITE,
    RECORD_CONTENT,
    RECORD_LIMIT,
    OperatorConsole,
    OperatorEngine,
)
from rsb_bridge.wire.events import Admitted, Event, Failed, OperatorOpened, RefusalCode, StreamRefused
from rsb_bridge.wire.framing import LENGTH, PREAMBLE_LIMIT, pack_frame
from rsb_bridge.wire.preamble import (
    PreambleKind,
    operator_header,
    parse_control,
    parse_operator,
    parse_preamble,
    preamble_frame,
)
from rsb_bridge.wire.protocol_error import Broken, Misuse, ProtocolError
from rsb_bridge.wire.sealed_stream import Credential, NoiseHandshake, ReplayCache
from rsb_bridge.wire.sealing import Sealer

TAG = OPERATOR_SUITE.tag_length


def contents(events: list[Event]) -> bytes:
    assert all(isinstance(event, OperatorOpened) for event in events)
    return b"".join(event.content for event in events if isinstance(event, OperatorOpened))


def first_message(*, header: bytes | None = None, host: bytes = b"") -> bytes:
    header = header or operator_header(VERSION, "anna", "robot1", fingerprint_of(KEY))
    return pack_frame(header, NoiseHandshake(OPERATOR_SUITE, KEY, header).write(host))


# --- the handshake


def test_both_know_each_other_after_the_confirmation() -> None:
    console, engine = make_console(), make_engine()
    assert not engine.accepted
    assert engine.receive_data(console.start()) == []
    assert engine.accepted
    assert console.receive_data(engine.data_to_send()) == [Admitted()]
    (admitted,) = engine.receive_data(console.data_to_send())
    assert admitted == Admitted("pc", KEY)
    assert KEY.hex() not in repr(admitted)
    assert repr(KEY) not in repr(admitted)


@pytest.mark.parametrize(("host", "told"), [("p" * 100, "p" * HOST_BYTES), ("\x1b[2J", "\N{REPLACEMENT CHARACTER}[2J")])
def test_host_name_is_cut_and_harmless(host: str, told: str) -> None:
    console, engine = make_console(host=host), make_engine()
    engine.receive_data(console.start())
    console.receive_data(engine.data_to_send())
    assert the(Admitted, engine.receive_data(console.data_to_send())).host == told


@pytest.mark.parametrize("size", [1, 3, 50])
def test_in_whatever_pieces_it_comes(size: int) -> None:
    console, engine = make_console(), make_engine()
    events: list[Event] = []
    for at in range(0, len(first := console.start()), size):
        events += engine.receive_data(first[at : at + size])
    console.receive_data(engine.data_to_send())
    rest = console.data_to_send() + console.send(b"look")
    for at in range(0, len(rest), size):
        events += engine.receive_data(rest[at : at + size])
    assert events == [Admitted("pc", KEY), OperatorOpened(b"look")]


def test_host_name_that_is_too_long_is_refused() -> None:
    the(Failed, make_engine().receive_data(first_message(host=b"p" * (HOST_BYTES + 1))))


@pytest.mark.parametrize("names", [("a" * 256, "robot1"), ("anna", "r" * 256)])
def test_a_name_that_is_too_long(names: tuple[str, str]) -> None:
    with pytest.raises(ValueError, match=pattern(Misuse.NAME_TOO_LONG, length=256)):
        operator_header(VERSION, *names, fingerprint_of(KEY))


# --- who does not get in


def refusal(console: OperatorConsole, engine: OperatorEngine) -> tuple[StreamRefused, StreamRefused]:
    """Return the reason of a refusal, after checking that both sides give the same."""
    here = the(StreamRefused, engine.receive_data(console.start()))
    there = the(StreamRefused, console.receive_data(engine.data_to_send()))
    assert (here.code, here.message) == (there.code, there.message)
    return here, there


def test_another_key_is_refused_with_both_fingerprints() -> None:
    here, _ = refusal(make_console(key=OTHER_KEY), make_engine())
    assert here.code is RefusalCode.WRONG_KEY
    for key in (KEY, OTHER_KEY):
        assert fingerprint_of(key).hex()[:4] in here.message


@pytest.mark.parametrize(("operator", "engine"), [("carl", "robot1"), ("anna", "robot2")])
def test_stranger_is_not_told_which_engine(operator: str, engine: str) -> None:
    here, _ = refusal(make_console(operator=operator, engine=engine), make_engine())
    assert here.code is RefusalCode.UNKNOWN_NAME
    assert "robot1" not in here.message


def test_key_that_only_claims_its_fingerprint_opens_nothing() -> None:
    header = operator_header(VERSION, "anna", "robot1", fingerprint_of(KEY))
    forged = pack_frame(header, NoiseHandshake(OPERATOR_SUITE, OTHER_KEY, header).write(b""))
    assert the(StreamRefused, make_engine().receive_data(forged)).code is RefusalCode.WRONG_KEY


@pytest.mark.parametrize(
    "header",
    [
        operator_header(VERSION + 1, "anna", "robot1", fingerprint_of(KEY)),
        operator_header(VERSION, "anna", "robot2", fingerprint_of(KEY)),
    ],
)
def test_what_is_in_the_clear_is_bound(header: bytes) -> None:
    """Somebody on the way gives the engine another header with the same handshake message."""
    said = first_message(header=header)[LENGTH.size :]
    mine = operator_header(VERSION, "anna", "robot1", fingerprint_of(KEY))
    changed = pack_frame(mine, parse_operator(said).message)
    assert the(StreamRefused, make_engine().receive_data(changed)).code is RefusalCode.WRONG_KEY


def test_engine_with_same_key_cannot_answer_for_another() -> None:
    """Somebody on the way makes the first message fit another engine, which has the key, too: it does not open."""
    console = make_console(engine="robot1")
    offer = parse_operator(console.start()[LENGTH.size :])
    header = operator_header(VERSION, "anna", "robot2", fingerprint_of(KEY))
    forwarded = pack_frame(header, offer.message)
    assert the(StreamRefused, make_engine(name="robot2").receive_data(forwarded)).code is RefusalCode.WRONG_KEY
    other = make_console(engine="robot2")
    answering = make_engine(name="robot2")
    answering.receive_data(other.start())
    refused = the(StreamRefused, console.receive_data(answering.data_to_send()))
    assert refused.code is RefusalCode.WRONG_KEY
    assert console.data_to_send() == b""


def test_a_replayed_first_message_is_not_answered() -> None:
    replays = ReplayCache()
    engines = [OperatorEngine("robot1", lambda _: Credential((KEY,), replays)) for _ in range(2)]
    first = make_console().start()
    assert engines[0].receive_data(first) == []
    the(Failed, engines[1].receive_data(first))
    kind, _ = parse_preamble(engines[1].data_to_send()[LENGTH.size :])
    assert kind is PreambleKind.REFUSE


def test_a_replay_that_is_answered_confirms_nothing() -> None:
    """After a restart, an engine has forgotten the first messages; the confirmation of then is of no use now."""
    console, engine = make_console(), make_engine()
    first = console.start()
    engine.receive_data(first)
    console.receive_data(engine.data_to_send())
    confirmation = console.data_to_send()
    restarted = make_engine()
    assert restarted.receive_data(first) == []
    the(Failed, restarted.receive_data(confirmation))


def sealer_of(console: OperatorConsole) -> Sealer:
    """Return what seals records, for a console that keeps to no rule."""
    sealer = console._sealer
    assert sealer is not None
    return sealer


def test_a_confirmation_with_content_is_none() -> None:
    console, engine = make_console(), make_engine()
    engine.receive_data(console.start())
    console.receive_data(engine.data_to_send())
    console.data_to_send()
    sealer_of(console).sequence = 0
    the(Failed, engine.receive_data(console.send(b"not empty")))


def test_long_record_ends_wait_for_confirmation() -> None:
    engine = make_engine()
    engine.receive_data(make_console().start())
    the(Failed, engine.receive_data(LENGTH.pack(PREAMBLE_LIMIT + 1)))


# --- links and operators


def test_link_is_no_operator_with_same_key() -> None:
    link, engine = make_client(), make_engine()
    the(Failed, engine.receive_data(link.start()))
    assert isinstance(link.receive_data(engine.data_to_send())[0], StreamRefused)


def test_operator_has_no_link_even_with_same_key() -> None:
    console, server = make_console(), make_server()
    the(Failed, server.receive_data(console.start()))
    the(StreamRefused, console.receive_data(server.data_to_send()))


def test_links_first_message_opens_for_no_operator() -> None:
    offer = parse_control(make_client(OPERATOR_SUITE).start()[LENGTH.size :])
    header = operator_header(VERSION, "anna", "robot1", offer.fingerprint)
    assert (
        the(StreamRefused, make_engine().receive_data(pack_frame(header, offer.message))).code is RefusalCode.WRONG_KEY
    )


@pytest.mark.parametrize("kind", [PreambleKind.CONTROL, PreambleKind.DATA, PreambleKind.RETRY, PreambleKind.OPERATOR])
def test_an_engine_answers_with_accept_or_refuse(kind: PreambleKind) -> None:
    console = make_console()
    console.start()
    the(Failed, console.receive_data(pack_frame(preamble_frame(kind, bytes(20)))))


def test_another_version_is_said() -> None:
    frame = bytearray(make_console().start())
    frame[LENGTH.size + 3] += 1
    assert the(StreamRefused, make_engine().receive_data(bytes(frame))).code is RefusalCode.WRONG_VERSION


def test_a_refusal_in_words() -> None:
    console, engine = make_console(), make_engine()
    console.start()
    refused = the(StreamRefused, console.receive_data(engine.refuse(RefusalCode.BUSY, "too many")))
    assert (refused.code, refused.message) == (RefusalCode.BUSY, "too many")
    assert console.receive_data(b"more") == []
    assert engine.receive_data(console.start()) == []


# --- frames that are broken

GOOD = operator_header(VERSION, "anna", "robot1", fingerprint_of(KEY))


def test_a_preamble_reads_as_it_was_written() -> None:
    offer = parse_operator(GOOD + b"message")
    assert offer[:4] == (VERSION, "anna", "robot1", fingerprint_of(KEY))
    assert (offer.header, offer.message) == (GOOD, b"message")


@pytest.mark.parametrize("length", range(5, len(GOOD)))
def test_a_preamble_that_ends_early(length: int) -> None:
    with pytest.raises(ProtocolError, match=pattern(Broken.OPERATOR_TOO_SHORT)):
        parse_operator(GOOD[:length])


@pytest.mark.parametrize("name", [b"\xff", b"\x1b[2J"])
def test_a_name_that_is_none(name: bytes) -> None:
    body = struct.pack(">H", VERSION) + bytes((len(name),)) + name + b"\6robot1" + bytes(8)
    with pytest.raises(ProtocolError):
        parse_operator(preamble_frame(PreambleKind.OPERATOR, body))


# --- records


def test_nothing_is_sent_before_the_handshake() -> None:
    with pytest.raises(RuntimeError):
        make_console().send(b"early")


@given(st.lists(st.binary(min_size=0, max_size=3 * RECORD_CONTENT), max_size=4), st.integers(1, 40_000))
def test_what_is_sent_arrives_in_order(pieces: list[bytes], size: int) -> None:
    console, engine = attached()
    for one, other in ((console, engine), (engine, console)):
        stream = b"".join(map(one.send, pieces))
        events = [event for at in range(0, len(stream), size) for event in other.receive_data(stream[at : at + size])]
        assert contents(events) == b"".join(pieces)


def test_records_are_no_longer_than_they_may_be() -> None:
    console, _ = attached()
    stream, lengths = console.send(bytes(2 * RECORD_CONTENT + 1)), []
    while stream:
        (length,) = LENGTH.unpack_from(stream)
        lengths.append(length)
        stream = stream[LENGTH.size + length :]
    assert lengths == [RECORD_LIMIT, RECORD_LIMIT, 1 + TAG]


@pytest.mark.parametrize(
    "change",
    [
        lambda one, two: two + one,
        lambda one, two: one + one,
        lambda one, two: one + two[: LENGTH.size] + bytes(len(two) - LENGTH.size),
        lambda one, two: one + LENGTH.pack(len(two) - LENGTH.size - 1) + two[LENGTH.size : -1],
        lambda one, two: one + LENGTH.pack(RECORD_LIMIT + 1),
        lambda one, two: one + LENGTH.pack(TAG - 1) + bytes(TAG - 1),
        lambda one, two: LENGTH.pack(0) + one,
    ],
    ids=["reordered", "repeated", "forged", "truncated", "oversized", "without a tag", "empty"],
)
@pytest.mark.parametrize("from_console", [True, False])
def test_what_was_changed_on_the_way_ends_it(change: object, from_console: bool) -> None:
    console, engine = attached()
    one, other = (console, engine) if from_console else (engine, console)
    assert callable(change)
    events = other.receive_data(change(one.send(b"first"), one.send(b"second")))
    assert isinstance(events[-1], Failed)
    assert contents(events[:-1]) in (b"", b"first")
    assert other.data_to_send() == b""
    assert other.receive_data(one.send(b"third")) == []


def test_a_sealed_record_without_content_is_refused() -> None:
    console, engine = attached()
    the(Failed, engine.receive_data(pack_frame(sealer_of(console).seal(b"", b""))))


def test_sealed_bytes_belong_to_their_side() -> None:
    console, _ = attached()
    the(Failed, console.receive_data(console.send(b"mine")))
