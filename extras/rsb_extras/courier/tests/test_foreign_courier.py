"""Peers that hold the key and lie in what they ask for, and in each answer: nothing leaves, and nothing false stays."""

from __future__ import annotations

import asyncio
import threading
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
import zstandard
from tests.link.foreign_proposals_helpers import link, rogue
from tests.support.bridge import happened
from tests.support.inside import inside
from tests.support.waiting import eventually
from tests.wire.document_helpers import documented_fields

from rsb_bridge.api import EngineError
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import State
from rsb_bridge.wire.messages import Accept, Propose, Refuse
from rsb_bridge.wire.protocol_error import Broken
from rsb_extras import courier
from rsb_extras.courier.courier_messages import (
    PIECES,
    AskRecordings,
    BeginPieces,
    PiecesEnded,
    PiecesTaken,
    RecordingsAnswer,
)
from rsb_extras.courier.courier_records import Cursor, ListedRecording, Wanted
from rsb_extras.courier.courier_requests import FetchState, ListRecordings
from rsb_extras.courier.fetch_spool import PieceRow
from rsb_extras.courier.link_courier import LinkCourier
from rsb_extras.courier.pieces import Piece, PieceContent, encode_piece
from rsb_extras.courier.tests.bags import BEGAN, messages, write_bag
from rsb_extras.courier.tests.courier_bed import done, fetch, report, robot_features, two_sides
from rsb_extras.courier.tests.courier_places import ENCODED_PIECE, LEFT_FREE, LIST_PAGE

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.bridge import Bridge
    from tests.support.rogue import Rogue

    from rsb_bridge.engine import Engine

KEY = "0123456789abcdef"
WANTED = Wanted(KEY, KEY, ("/scan",))


def server(bridge: Bridge, bags: Path, *, may: bool = True) -> Engine:
    """A server whose recordings a client may get, if it may."""
    return bridge.server(features=robot_features(bags, may=may))


def asks(peer: Rogue, request: int = 1) -> RecordingsAnswer:
    peer.say(AskRecordings(request))
    return peer.wait_for(RecordingsAnswer)


def proposed(peer: Rogue, name: str = "pieces/1", *, sends: bool = False) -> tuple[int, Accept | Refuse]:
    number = peer.new_route()
    peer.say(
        Propose(
            route=number, topic=name, remote_topic=name, from_client=sends, transport="tcp", purpose=PIECES.name,
            type=PIECES.type_name,
        )
    )  # fmt: skip
    answer = peer.wait_for(Accept, Refuse)
    assert isinstance(answer, Accept | Refuse)
    return number, answer


def ended(peer: Rogue, order: BeginPieces) -> PiecesEnded:
    peer.say(order)
    return peer.wait_for(PiecesEnded)


def test_the_page_documents_each_field() -> None:
    page = (Path(courier.__file__).with_name("docs") / "courier-protocol.md").read_text(encoding="utf-8")
    kinds = (
        AskRecordings, RecordingsAnswer, BeginPieces, PiecesTaken, PiecesEnded, ListedRecording, Wanted,
    )  # fmt: skip
    assert documented_fields(page) == {
        each.__name__: {field.name for field in msgspec.structs.fields(each)} for each in kinds
    }


def test_without_the_right_nothing_is_told(bridge: Bridge, bags: Path) -> None:
    write_bag(bags / "drive.mcap", messages(1))
    server(bridge, bags, may=False)
    with rogue(bridge, "courier", "recording") as peer:
        answer = asks(peer)
        assert (answer.recordings, "does not let robot1 get recordings" in answer.problem) == ((), True)
        _, refused = proposed(peer)
        assert isinstance(refused, Refuse)
        assert "does not let robot1 get recordings" in refused.reason
        assert ended(peer, BeginPieces(1, 1, WANTED)).problem


def test_heads_are_of_topics_that_it_may_read(bridge: Bridge, bags: Path) -> None:
    """And others' names come back whether or not the recording has them."""
    write_bag(bags / "drive.mcap", messages(1, topics=("/scan", "/secret")))
    pc, _ = two_sides(bridge, bags, deny=("/secret", "/nowhere"))
    (group,) = pc.do(ListRecordings("robot1")).result(60)
    listed = group.recordings[0]
    wanted = Wanted(listed.id, listed.stamp, ("/scan", "/secret", "/nowhere"), heads=True)
    row = PieceRow(bags.parent, wanted, listed.size, threading.RLock())
    (here,) = inside(pc).role.links()
    courier = here.extensions.find(LinkCourier)
    asyncio.run_coroutine_threadsafe(courier.receive(row), here.context.loop).result(60)
    assert row.denied == ("/nowhere", "/secret")
    assert {each.channel.topic for each in row.messages()} == {"/scan"}


def test_nobody_sends_pieces_unasked(bridge: Bridge, bags: Path) -> None:
    server(bridge, bags)
    with rogue(bridge, "courier", "recording") as peer:
        _, refused = proposed(peer, sends=True)
        assert isinstance(refused, Refuse)


def test_one_route_and_few_orders(bridge: Bridge, bags: Path) -> None:
    server(bridge, bags)
    with rogue(bridge, "courier", "recording") as peer:
        _, accepted = proposed(peer)
        assert isinstance(accepted, Accept)
        _, refused = proposed(peer, "pieces/2")
        assert isinstance(refused, Refuse)
        problems = [ended(peer, BeginPieces(run, 999, WANTED)).problem for run in range(25)]
    assert sum("one request more is taken each 3 s" in each for each in problems) >= 4


@pytest.mark.parametrize(
    "broken",
    [
        {"run": -1}, {"route": 0}, {"at": [-1, 0, 0]}, {"known": [b"short"]},
        {"known": [b"x" * 8] * 1025},
        {"wanted": {"recording": "../../etc/passwd", "stamp": KEY, "topics": ["/scan"]}},
        {"wanted": {"recording": KEY, "stamp": KEY, "topics": []}},
        {"wanted": {"recording": KEY, "stamp": KEY, "topics": ["/scan"] * 257}},
        {"wanted": {"recording": KEY, "stamp": KEY, "topics": ["\x1b[2J"]}},
        {"wanted": {"recording": KEY, "stamp": KEY, "topics": ["/scan"], "end": 2**63}},
        {"wanted": {"recording": KEY, "stamp": KEY, "topics": ["/scan"], "spans": [[256, 0]]}},
        {"wanted": {"recording": KEY, "stamp": KEY, "topics": ["/scan"], "spans": [[0, -1]]}},
        {"wanted": {"recording": KEY, "stamp": KEY, "topics": ["/scan"], "spans": [[0, 0]] * 4097}},
    ],
)  # fmt: skip
def test_orders_out_of_bounds_end_the_link(bridge: Bridge, bags: Path, broken: dict[str, Any]) -> None:
    _breaks(server(bridge, bags), bridge, msgspec.to_builtins(BeginPieces(1, 2, WANTED)) | broken)


@pytest.mark.parametrize(
    "broken",
    [
        {"recordings": [{"id": "a/b", "name": "x", "stamp": KEY}]},
        {"recordings": [{"id": KEY, "name": "x" * 256, "stamp": KEY}]},
        {"recordings": [{"id": KEY, "name": "\x1b[2J", "stamp": KEY}]},
        {"recordings": [{"id": KEY, "name": "", "stamp": KEY}] * 17},
        {"recordings": [{"id": KEY, "name": "", "stamp": KEY, "size": -1}]}, {"problem": "x" * 501},
    ],
)  # fmt: skip
def test_answers_out_of_bounds_end_the_link(bridge: Bridge, bags: Path, broken: dict[str, Any]) -> None:
    _breaks(server(bridge, bags), bridge, msgspec.to_builtins(RecordingsAnswer(1)) | broken)


def _breaks(engine: Engine, bridge: Bridge, said: dict[str, Any]) -> None:
    with rogue(bridge, "courier", "recording") as peer:
        eventually(lambda: engine.snapshot().links[0].state is State.OK, what="a link")
        peer.say_raw(msgspec.msgpack.encode(said))
        eventually(lambda: engine.snapshot().links[0].state is not State.OK, what="the end of the link")
        assert happened(engine, EventCode.LINK_LOST, Broken.INVALID_CONTROL_MESSAGE)


def test_answers_that_nobody_waits_for_change_nothing(bridge: Bridge, bags: Path) -> None:
    engine = server(bridge, bags)
    with rogue(bridge, "courier", "recording") as peer:
        eventually(lambda: engine.snapshot().links[0].state is State.OK, what="a link")
        peer.say(RecordingsAnswer(7, more=True), PiecesTaken(3, 2**53, 2**53), PiecesEnded(1, "no", is_final=True))
        assert asks(peer).problem == ""
        assert link(engine).linked


def test_a_list_without_end_is_noticed(bridge: Bridge, bags: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def page(_: object, ask: AskRecordings) -> RecordingsAnswer:
        return RecordingsAnswer(ask.request, (ListedRecording(KEY, "drive", KEY),), more=True)

    LIST_PAGE.set(monkeypatch, page)
    pc, _ = two_sides(bridge, bags)
    with pytest.raises(EngineError, match="a page without end"):
        fetch(pc, "drive")


def repacked(piece: Piece, change: Callable[[PieceContent], PieceContent]) -> Piece:
    packed = zstandard.compress(msgspec.msgpack.encode(change(piece.content())))
    return msgspec.structs.replace(piece, packed=packed)


def _elsewhere(piece: Piece) -> bytes:
    return encode_piece(msgspec.structs.replace(piece, begin=Cursor(5)))


def _endless(piece: Piece) -> bytes:
    return encode_piece(msgspec.structs.replace(piece, end=piece.begin, is_last=False))


def _damaged(piece: Piece) -> bytes:
    return bytes(32) + encode_piece(piece)[32:]


def _bomb(piece: Piece) -> bytes:
    return encode_piece(msgspec.structs.replace(piece, packed=zstandard.compress(bytes(50 << 20))))


def _other_topic(piece: Piece) -> bytes:
    def change(content: PieceContent) -> PieceContent:
        secret = {key: _as_secret(each) for key, each in content.channels.items()}
        return msgspec.structs.replace(content, channels=secret)

    return encode_piece(repacked(piece, change))


def _as_secret(channel: Any) -> Any:
    return msgspec.structs.replace(channel, topic="/secret")


def _no_channel(piece: Piece) -> bytes:
    return encode_piece(repacked(piece, partial(msgspec.structs.replace, channels={})))


def _out_of_order(piece: Piece) -> bytes:
    return encode_piece(
        repacked(piece, lambda each: msgspec.structs.replace(each, messages=bytes(8) + each.messages[8:]))
    )


def _cut_off(piece: Piece) -> bytes:
    return encode_piece(repacked(piece, lambda each: msgspec.structs.replace(each, messages=each.messages[:-1])))


@pytest.mark.parametrize(
    ("lie", "text"),
    [
        (_damaged, "sent what it was not asked for: a piece is damaged"),
        (_bomb, "sent what it was not asked for: a piece is damaged"),
        (_elsewhere, "a piece begins elsewhere than the last one ended"),
        (_endless, "a piece has nothing"),
        (_other_topic, "a message of /secret was not asked for"),
        (_no_channel, "a message has no channel"),
        (_out_of_order, "messages are not in order"),
        (_cut_off, "the last message is cut off"),
        (lambda _: b"x", "a piece is damaged"),
        (lambda _: bytes(2 << 20), "a piece is damaged"),
    ],
)
def test_a_piece_that_lies_ends_the_fetch(
    lie: Callable[[Piece], bytes], text: str, bridge: Bridge, bags: Path, fetched: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_bag(bags / "drive.mcap", list(messages(1))[:9])
    ENCODED_PIECE.set(monkeypatch, lie)
    pc, _ = two_sides(bridge, bags)
    name = fetch(pc, "drive.mcap", begin=BEGAN)
    eventually(lambda: report(pc, name).state is FetchState.FAILED, what="the fetch ends")
    assert text in report(pc, name).reason
    assert not [*fetched.iterdir()], "nothing false stays"


def test_a_gap_begins_anew(bridge: Bridge, bags: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As if a piece were lost on the way."""
    write_bag(bags / "drive.mcap", messages(3))
    gaps = iter([3])

    def encoded(piece: Piece) -> bytes:
        skipped = piece.number == 2 and next(gaps, 0)
        return encode_piece(msgspec.structs.replace(piece, number=skipped) if skipped else piece)

    ENCODED_PIECE.set(monkeypatch, encoded)
    pc, _ = two_sides(bridge, bags)
    done(pc, fetch(pc, "drive.mcap"))
    assert next(gaps, None) is None, "there was a gap"


def test_a_full_disk_has_it_wait(bridge: Bridge, bags: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_bag(bags / "drive.mcap", messages(1))
    LEFT_FREE.set(monkeypatch, 1 << 60)
    pc, _ = two_sides(bridge, bags)
    name = fetch(pc, "drive.mcap")
    eventually(lambda: "GB of free space: make room there" in report(pc, name).reason, what="it says so")
    assert report(pc, name).state is FetchState.WAITING
