"""Messages cut into pieces and joined again, from any piece on."""

from __future__ import annotations

import os
import threading
from collections import deque
from typing import TYPE_CHECKING

import msgspec
import pytest
import zstandard
from tests.support.wording import pattern

from rsb_extras.courier.courier_records import LATEST, Cursor, ListedRecording, Wanted
from rsb_extras.courier.fetch_spool import AskedFetch, FetchSpool, PieceRow, load_asked
from rsb_extras.courier.kept_recordings import FetchError, KeptProblem
from rsb_extras.courier.pieces import (
    PIECE,
    Cutter,
    Joiner,
    Piece,
    PieceContent,
    PieceError,
    PieceProblem,
    check_follows,
    decode_piece,
    encode_piece,
)
from rsb_extras.courier.tests.bags import BEGAN, SECOND, channel, messages
from rsb_extras.courier.tests.courier_places import FOLLOWS, LEFT_FREE
from rsb_extras.recording.mcap_file import new_recording
from rsb_extras.recording.reading.stored_message import StoredMessage

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

START = Cursor()
TOPICS = ("/scan", "/tf")


def cut(content: Iterable[StoredMessage], at: Cursor = START, known: Iterable[bytes] = ()) -> list[Piece]:
    cutter = Cutter(1, (each for each in content if each.time >= at.time), at, [*known])
    found = [cutter.next()]
    while not found[-1].is_last:
        found.append(cutter.next())
    return found


def joined(pieces: Iterable[Piece], topics: Iterable[str] = TOPICS) -> list[StoredMessage]:
    joiner = Joiner({*topics}, 0, LATEST)
    found = [message for piece in pieces for message in joiner.add(piece.content())]
    joiner.finish()
    return found


def test_joined_pieces_are_the_messages() -> None:
    content = [*messages(3)]
    pieces = cut(content)
    assert len(pieces) > 4
    assert joined(pieces) == content
    assert all(len(piece.content().messages) == PIECE for piece in pieces[:-1])


def spooled(folder: Path, content: list[StoredMessage]) -> FetchSpool:
    """Return a fetch whose pieces have all come."""
    wanted = Wanted("0" * 16, "0" * 16, TOPICS)
    asked = AskedFetch("robot1-drive", "server pc", "robot1", ListedRecording("0" * 16, "drive", "0" * 16), wanted)
    spool = FetchSpool(folder / ".robot1-drive.fetch", asked).make()
    for piece in cut(content):
        spool.row.add(piece, encode_piece(piece))
    return spool


def test_a_bridge_killed_behind_the_file_is_done(tmp_path: Path) -> None:
    """It had no time to remove the pieces."""
    content = [*messages(1)]
    spool = spooled(tmp_path, content)
    with new_recording(spool.path) as recording:
        for message in content:
            recording.copy(message)
    assert spool.write(lambda: False) == len(content)
    assert [*tmp_path.iterdir()] == [spool.path]
    other = spooled(tmp_path, content[:-1])
    assert other.write(lambda: False) == len(content) - 1
    assert [each.name for each in sorted(tmp_path.iterdir())] == ["robot1-drive-2.mcap", "robot1-drive.mcap"]
    assert other.path.name == "robot1-drive-2.mcap", "the file of that name is another one"


def test_a_fetch_is_loaded_up_to_what_is_missing(tmp_path: Path) -> None:
    folder = spooled(tmp_path, [*messages(3)]).folder
    assert _loaded(folder).is_whole
    assert not _loaded(folder, stop=True).is_whole
    second = sorted(folder.glob("*.piece"))[1]
    second.unlink()
    second.mkdir()  # cannot be read
    part = _loaded(folder)
    assert (part.is_whole, part.at > Cursor()) == (False, True)


def _loaded(folder: Path, *, stop: bool = False) -> PieceRow:
    asked = load_asked(folder)
    assert asked is not None
    row = FetchSpool(folder, asked).row
    row.load(lambda: stop)
    return row


def test_nothing_is_left_of_a_fetch_that_is_removed_at_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = [*messages(1)]
    spool = spooled(tmp_path, content)
    free, is_there = threading.Event(), threading.Event()

    def held(*_: object) -> None:
        is_there.set()
        free.wait(60)

    FOLLOWS.set(monkeypatch, held)
    piece = cut(content)[0]
    adding = threading.Thread(target=spool.row.add, args=(piece, encode_piece(piece)))
    removing = threading.Thread(target=spool.remove)
    adding.start()
    is_there.wait(60)
    removing.start()
    removing.join(0.2)
    free.set()
    for each in (adding, removing):
        each.join(60)
    assert not spool.folder.exists()
    with pytest.raises(InterruptedError):
        spool.write(lambda: True)
    assert not [*tmp_path.iterdir()]


def test_the_file_leaves_room_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spool = spooled(tmp_path, [*messages(1)])
    free = os.statvfs(tmp_path)
    LEFT_FREE.set(monkeypatch, free.f_bavail * free.f_frsize - spool.taken // 2)
    with pytest.raises(OSError, match="make room there"):
        spool.write(lambda: False)
    assert spool.folder.exists()
    assert not spool.path.exists()


def test_cutting_goes_on_at_any_piece() -> None:
    """Of several messages of one time, and within one that is longer than a piece."""
    content = [*messages(3)]
    pieces = cut(content)
    assert any(piece.begin.offset for piece in pieces)
    for number, piece in enumerate(pieces):
        known = {key for each in pieces[:number] for key in each.content().channels}
        rest = cut(content, piece.begin, known)
        assert joined([*pieces[:number], *rest]) == content


def test_a_recording_without_messages_is_one_piece() -> None:
    (piece,) = cut([])
    check_follows(piece, Cursor())
    assert (piece.is_last, joined([piece])) == (True, [])


def test_many_definitions_are_shared_out() -> None:
    kinds = [channel(f"/topic{number}")._replace(definition=("ros2msg", bytes(200_000))) for number in range(5)]
    content = [StoredMessage(each, BEGAN, BEGAN, 1, memoryview(b"\0\1\0\0")) for each in kinds]
    pieces = cut(content)
    assert len(pieces) == 5
    assert joined(pieces, [each.topic for each in kinds]) == content


def test_a_definition_that_is_too_long_is_left_out() -> None:
    huge = channel("/scan")._replace(definition=("ros2msg", bytes(300_000)))
    (message,) = joined(cut([StoredMessage(huge, BEGAN, BEGAN, 1, memoryview(b"\0\1\0\0"))]))
    assert message.channel == huge._replace(definition=("", b""))


@pytest.mark.parametrize("at", [0, 40, 1000])
def test_a_damaged_piece_is_noticed(at: int) -> None:
    data = bytearray(encode_piece(cut(messages(1))[0]))
    assert decode_piece(bytes(data))
    data[at] ^= 1
    with pytest.raises(PieceError, match=pattern(PieceProblem.INVALID)):
        decode_piece(bytes(data))


def test_a_piece_cannot_unpack_to_more_than_its_bound() -> None:
    bomb = zstandard.compress(bytes(100 << 20))
    with pytest.raises(PieceError, match=pattern(PieceProblem.INVALID)):
        Piece(1, 1, Cursor(), Cursor(1), True, bomb).content()


@pytest.mark.parametrize(
    ("begin", "end", "is_last", "problem"),
    [
        (Cursor(4), Cursor(9), False, PieceProblem.WRONG_PLACE),
        (Cursor(5), Cursor(5), False, PieceProblem.NO_PROGRESS),
        (Cursor(5), Cursor(4), True, PieceProblem.NO_PROGRESS),
    ],
)
def test_pieces_follow_each_other(begin: Cursor, end: Cursor, is_last: bool, problem: PieceProblem) -> None:
    with pytest.raises(PieceError, match=pattern(problem)):
        check_follows(Piece(1, 1, begin, end, is_last, b""), Cursor(5))


def lying(*content: StoredMessage, **changes: object) -> PieceContent:
    return msgspec.structs.replace(cut(content)[0].content(), **changes)


def test_what_was_not_asked_for_is_refused() -> None:
    first, second = (StoredMessage(channel("/scan"), BEGAN + n * SECOND, 0, 1, memoryview(b"0123")) for n in (1, 2))
    other = first._replace(channel=channel("/secret"))
    cases = [
        ([lying(other)], PieceProblem.NOT_ASKED),
        ([lying(first, channels={})], PieceProblem.UNKNOWN_CHANNEL),
        ([lying(second), lying(first)], PieceProblem.OUT_OF_ORDER),
        ([lying(first, messages=lying(first).messages[:-1])], PieceProblem.CUT),
    ]
    for contents, problem in cases:
        with pytest.raises(PieceError, match=pattern(problem)):
            _join(contents)


def _join(contents: Iterable[PieceContent]) -> None:
    joiner = Joiner({"/scan"}, 0, LATEST)
    for each in contents:
        deque(joiner.add(each))
    joiner.finish()


def test_other_rights_in_a_later_run_end_it_with_words(tmp_path: Path) -> None:
    """A place among fewer topics is another place."""
    content = [*messages(3)]
    wanted = Wanted("0" * 16, "0" * 16, TOPICS, heads=True)
    asked = AskedFetch("robot1-drive", "server pc", "robot1", ListedRecording("0" * 16, "drive", "0" * 16), wanted)
    row = FetchSpool(tmp_path / ".robot1-drive.fetch", asked).make().row
    first = Cutter(1, iter(content), row.at, ()).next()
    row.add(first, encode_piece(first))
    assert not row.is_whole
    left = iter([each for each in content if each.channel.topic == "/scan" and each.time >= row.at.time])
    second = Cutter(2, left, row.at, row.known, ("/tf",)).next()
    with pytest.raises(FetchError, match=pattern(KeptProblem.RIGHTS)):
        row.add(second, encode_piece(second))
