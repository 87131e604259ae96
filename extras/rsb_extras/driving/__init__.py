"""Driving: a robot by the keys of a console, on a topic that has to be armed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature import Feature

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_console.actions import Action


class Driving(Feature):
    name = "driving"

    def actions(self) -> Iterable[Action]:
        from rsb_console.actions import Action, Group, KeyChapter, OnRobot, late  # noqa: PLC0415 -- `Feature` says why

        place = "rsb_extras.driving.drive_screen"
        keys = KeyChapter(
            "Drive (D, or d on a picture)",
            "DriveScreen",
            (
                ("← → ↑ ↓", "Drive while a key is held"),
                ("uiojlm,.", "The same, and diagonally, as with teleop_twist_keyboard"),
                ("space k", "Stop"),
                ("+ -", "Faster, slower"),
                ("A", "Arm the topic, disarm it, or ask its holder for it"),
                ("y n", "Give it to the operator who asks for it, or keep it"),
                ("esc q", "Leave"),
            ),
        )
        return (
            Action(
                "drive", "D", "drive", "Drive a robot by keys, on a topic that has to be armed", Group.OPERATE,
                changes=True, needs_topic=True, also="teleop, cmd_vel, twist, joystick", after="publish",
                run=late(f"{place}:drive_selected"),
                on_robot=OnRobot("d", late(f"{place}:suits"), late(f"{place}:drive_one")), chapters=(keys,),
            ),
        )  # fmt: skip


FEATURE = Driving()
