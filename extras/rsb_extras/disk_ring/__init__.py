"""The ring on disk: what passed lately, and stretches of it that are kept when something happens."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from rsb_bridge.feature_api import Feature

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from rsb_bridge.feature_api import Bridge, Command, EnginePart
    from rsb_console.feature_console import Action, Complete


class DiskRingFeature(Feature):
    name = "disk_ring"
    needs = ("history", "recording")
    libraries: ClassVar[Mapping[str, str]] = {"record": "mcap"}

    def problems(self, session: Any) -> Iterable[tuple[str, str]]:
        from rsb_extras.disk_ring import ring_rules  # noqa: PLC0415 -- `Feature` says why, here and below

        return ring_rules.problems(session)

    def advice(self, session: Any, file: Path | None) -> Iterable[tuple[str, str]]:
        from rsb_extras.disk_ring import ring_rules  # noqa: PLC0415

        return ring_rules.advice(session)

    def effects(self, session: Any) -> Iterable[str]:
        from rsb_extras.disk_ring import ring_rules  # noqa: PLC0415

        return ring_rules.effects(session)

    def commands(self) -> Iterable[type[Command[object]]]:
        from rsb_extras.disk_ring.keep_stretch import KeepStretch  # noqa: PLC0415

        return (KeepStretch,)

    def parts(self, bridge: Bridge) -> Iterable[EnginePart]:
        from rsb_extras.disk_ring.disk_ring import DiskRing  # noqa: PLC0415

        return (DiskRing(bridge),)

    def options(self, commands: Mapping[str, argparse.ArgumentParser], complete: Complete) -> None:
        if (record := commands.get("record")) is not None:
            from rsb_extras.disk_ring.keep_arguments import add_keep  # noqa: PLC0415

            add_keep(record)

    def actions(self) -> Iterable[Action]:
        from rsb_console.feature_console import Action, Group, OnRobot, late  # noqa: PLC0415

        place = "rsb_extras.disk_ring.keep_key"
        on_robot = OnRobot("E", lambda _: False, late(f"{place}:keep_beside"))
        return (
            Action(
                "keep_event", "E", "keep event", "Keep what was on disk before and comes after now, with a note",
                Group.OPERATE, changes=True, also="record, ring, stretch, mark, note, bag, black box",
                run=late(f"{place}:keep_event"), on_robot=on_robot,
            ),
        )  # fmt: skip


FEATURE = DiskRingFeature()
