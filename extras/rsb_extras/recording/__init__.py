"""Recording: the last seconds of all bridged topics, in memory, and in a file when an operator asks for it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal

import msgspec

from rsb_bridge.feature_api import Feature, SessionKey

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from rsb_bridge.feature_api import Bridge, Command, EnginePart
    from rsb_console.feature_console import Action, AddCommand, Complete


class RecordLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The bounds of what is kept; of two, the tighter one counts. All from `disk` on are of the feature `disk_ring`.

    Attributes:
        seconds: age of the oldest message in memory.
        megabytes: MiB of all messages in memory together.
        disk: GB of the ring on disk, or 0 for none.
        disk_seconds: age of the oldest message there, or 0 for any.
        free: GB of the disk that stay free.
        also: topics of this side's domain that are recorded there though no link carries them; names and patterns.
        before: s before a cause that are kept.
        after: the same after it.
        kept: GB of all stretches that are kept.
        keep_on: causes that keep a stretch without an operator.
    """

    seconds: float = 30.0
    megabytes: float = 32.0
    disk: float = 0.0
    disk_seconds: float = 0.0
    free: float = 1.0
    also: tuple[str, ...] = ()
    before: float = 60.0
    after: float = 30.0
    kept: float = 4.0
    keep_on: tuple[Literal["fault", "link", "disarm"], ...] = ("fault", "link", "disarm")


RECORD: SessionKey[bool | RecordLimits] = SessionKey("record", bool | RecordLimits, False, live=True)
"""Whether the last messages are kept, and within which bounds."""


def record_limits(session: Any) -> RecordLimits | None:
    """Return the bounds that a session sets, or None if it keeps nothing."""
    value = RECORD.of(session)
    return RecordLimits() if value is True else value or None


class RecordingFeature(Feature):
    name = "recording"
    libraries: ClassVar[Mapping[str, str]] = {"record": "mcap"}

    def session_keys(self) -> Iterable[SessionKey[Any]]:
        return (RECORD,)

    def problems(self, session: Any) -> Iterable[tuple[str, str]]:
        from rsb_extras.recording import record_rules  # noqa: PLC0415 -- `Feature` says why, here and below

        return record_rules.problems(session)

    def advice(self, session: Any, file: Path | None) -> Iterable[tuple[str, str]]:
        from rsb_extras.recording import record_rules  # noqa: PLC0415

        return record_rules.advice(session)

    def commands(self) -> Iterable[type[Command[object]]]:
        from rsb_extras.recording.keep_last import KeepLast  # noqa: PLC0415

        return (KeepLast,)

    def parts(self, bridge: Bridge) -> Iterable[EnginePart]:
        from rsb_extras.recording.keeping import Keeping  # noqa: PLC0415

        return (Keeping(bridge),)

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from rsb_console.feature_console import EXIT, bridge_options, subcommand  # noqa: PLC0415

        summary = "write the last seconds of all bridged topics to a file (MCAP)"
        place = "rsb_extras.recording.record_command:record"
        parser = add("record", subcommand(place), summary, EXIT, after="report")
        bridge_options(parser, complete)
        parser.add_argument(
            "--seconds", type=float, default=None, metavar="N", help="how many; without it, all that is kept"
        )
        output = "move the file there, on the bridge's machine (root copies it); without it, the bridge names it"
        complete(parser.add_argument("--output", metavar="FILE", help=output), "files")

    def actions(self) -> Iterable[Action]:
        from rsb_console.feature_console import Action, Group, OnRobot, late  # noqa: PLC0415

        place = "rsb_extras.recording.record_key"
        # On pictures, too, whose line of keys has no room for it.
        on_robot = OnRobot("P", lambda _: False, late(f"{place}:record_beside"))
        return (
            Action(
                "record", "P", "record", "Write the last seconds of all bridged topics to a file", Group.OPERATE,
                changes=True, also="keep, mcap, bag, rosbag, black box", run=late(f"{place}:record_last"),
                on_robot=on_robot,
            ),
        )  # fmt: skip


FEATURE = RecordingFeature()
