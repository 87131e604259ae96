"""Courier: recordings of the other side of a link, brought here over it in pieces, over cuts, restarts and days."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from rsb_bridge.feature_api import Feature, PeerRight, SessionKey

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from rsb_bridge.feature_api import Bridge, Command, ControlMessageBase, EnginePart, Extension, Link, Purpose
    from rsb_console.feature_console import Action, Complete, TileLines


class RecordingFolders(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where recordings are.

    Attributes:
        folders: their absolute paths, beside the bridge's own.
        fetched: GB of what was got from the other side of a link.
    """

    folders: tuple[str, ...] = ()
    fetched: float = 10.0


RECORDINGS_KEY: SessionKey[RecordingFolders] = SessionKey(
    "recordings", RecordingFolders, RecordingFolders(), live=True, hidden_as="folders"
)
"""The folders of this machine from which operators list recordings, and peers with the right get them."""
MAY_FETCH: PeerRight[bool] = PeerRight("recordings", bool, False)
"""Whether the other side may list and get this side's recordings, of the topics that it may read."""


class Courier(Feature):
    name = "courier"
    needs = ("history", "recording")

    def session_keys(self) -> Iterable[SessionKey[Any]]:
        return (RECORDINGS_KEY,)

    def rights(self) -> Iterable[PeerRight[Any]]:
        return (MAY_FETCH,)

    def problems(self, session: Any) -> Iterable[tuple[str, str]]:
        from rsb_extras.courier import courier_rules  # noqa: PLC0415 -- `Feature` says why, here and below

        return courier_rules.problems(session)

    def advice(self, session: Any, file: Path | None) -> Iterable[tuple[str, str]]:
        from rsb_extras.courier import courier_rules  # noqa: PLC0415

        return courier_rules.advice(session, file)

    def effects(self, session: Any) -> Iterable[str]:
        from rsb_extras.courier import courier_rules  # noqa: PLC0415

        return courier_rules.effects(session)

    def messages(self) -> Iterable[type[ControlMessageBase]]:
        from rsb_extras.courier.courier_messages import (  # noqa: PLC0415
            AskRecordings,
            BeginPieces,
            PiecesEnded,
            PiecesTaken,
            RecordingsAnswer,
        )

        return AskRecordings, RecordingsAnswer, BeginPieces, PiecesTaken, PiecesEnded

    def purposes(self) -> Iterable[Purpose]:
        from rsb_extras.courier.courier_messages import PIECES  # noqa: PLC0415

        return (PIECES,)

    def extensions(self, link: Link) -> Iterable[Extension]:
        from rsb_extras.courier.link_courier import LinkCourier  # noqa: PLC0415

        return (LinkCourier(link),)

    def commands(self) -> Iterable[type[Command[Any]]]:
        from rsb_extras.courier.courier_requests import (  # noqa: PLC0415
            CancelFetch,
            FetchRecording,
            ListFetches,
            ListRecordings,
            NewestRecordings,
            ReadCompleted,
        )

        return ListRecordings, NewestRecordings, FetchRecording, ListFetches, ReadCompleted, CancelFetch

    def parts(self, bridge: Bridge) -> Iterable[EnginePart]:
        from rsb_extras.courier.courier_part import CourierPart  # noqa: PLC0415

        return (CourierPart(bridge),)

    def options(self, commands: Mapping[str, Any], complete: Complete) -> None:
        from rsb_extras.courier.courier_arguments import add_to_record  # noqa: PLC0415

        add_to_record(commands["record"], complete)

    def tiles(self) -> Iterable[type[TileLines]]:
        from rsb_extras.courier.recordings_tile import RecordingsLines  # noqa: PLC0415

        return (RecordingsLines,)

    def actions(self) -> Iterable[Action]:
        from rsb_console.feature_console import Action, Group, late  # noqa: PLC0415
        from rsb_extras.courier.courier_arguments import CHAPTER  # noqa: PLC0415

        return (
            Action(
                "recordings", "F", "recordings", "Show the recordings of both sides; get one from there",
                Group.OPERATE, also="fetch, download, mcap, bag, rosbag, courier",
                run=late("rsb_extras.courier.courier_screen:show_recordings"), chapters=(CHAPTER,), after="record",
            ),
        )  # fmt: skip


FEATURE = Courier()
