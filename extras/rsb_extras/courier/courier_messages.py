"""What crosses for recordings: questions for lists, and orders for pieces (docs/courier-protocol.md)."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from rsb_bridge.feature_api import ControlMessageBase, Count, Purpose, Reason, RouteId
from rsb_extras.courier.courier_records import PAGE, Cursor, ListedRecording, RecordingId, Wanted
from rsb_extras.courier.pieces import MOST_CHANNELS, ChannelId

PIECES = Purpose("pieces", is_shown=False, type_name="rsb_bridge/msg/Piece", type_hash="RIHS01_" + "2" * 64)
"""Pieces of recordings, for the side that proposes the route."""
WINDOW = 4
"""Pieces that may be on their way: 1 MiB, which fills 10 Mbit/s with 0.8 s there and back. A round figure."""


class AskRecordings(ControlMessageBase, frozen=True):
    """Asks for the recordings of the other side. Answered by a `RecordingsAnswer` of the same number.

    Attributes:
        after: the last id of the page before, or empty for the first page.
    """

    request: Count
    after: RecordingId | None = None


class RecordingsAnswer(ControlMessageBase, frozen=True, omit_defaults=True):
    """A page of a side's recordings, by their ids.

    Attributes:
        more: whether another page follows.
        problem: why there is none, or empty.
    """

    request: Count
    recordings: Annotated[tuple[ListedRecording, ...], Meta(max_length=PAGE)] = ()
    more: bool = False
    problem: Reason = ""


class BeginPieces(ControlMessageBase, frozen=True, omit_defaults=True):
    """Asks for pieces of a recording, in place of those asked for before. Answered by pieces on the route.

    Attributes:
        run: its number, which the pieces have, too.
        route: id of the route that carries the pieces.
        at: where to begin.
        known: the channels that the asker has already.
    """

    run: Count
    route: RouteId
    wanted: Wanted
    at: Cursor = Cursor()
    known: Annotated[tuple[ChannelId, ...], Meta(max_length=MOST_CHANNELS)] = ()


class PiecesTaken(ControlMessageBase, frozen=True):
    """Says what has come of a run: sent for each slice and each piece.

    Attributes:
        slices: those that have come.
        taken: pieces that are kept; `WINDOW` more may be on their way.
    """

    run: Count
    slices: Count
    taken: Count


class PiecesEnded(ControlMessageBase, frozen=True):
    """No more pieces of a run come.

    Attributes:
        problem: the reason, for an operator.
        is_final: whether it is of no use to ask again.
    """

    run: Count
    problem: Reason
    is_final: bool = False
