"""The keys that publish by hand and drive."""

from __future__ import annotations

from rsb_console.feature_console import Action, Group, KeyChapter, OnRobot, late

_PLACE = "rsb_extras.driving"
_DRIVE_SCREEN = KeyChapter(
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
PUBLISH = Action(
    "publish", "S", "publish", "Publish a message by hand, on any topic of this side", Group.OPERATE,
    changes=True, also="pub, send, template, goal pose", after="call",
    run=late(f"{_PLACE}.publish_screen:publish_selected"),
    with_message=late(f"{_PLACE}.publish_screen:publish_message"),
)  # fmt: skip
DRIVE = Action(
    "drive", "D", "drive", "Drive a robot by keys, on a topic that has to be armed", Group.OPERATE,
    changes=True, needs_topic=True, also="teleop, cmd_vel, twist, joystick", after="publish",
    run=late(f"{_PLACE}.drive_screen:drive_selected"),
    on_robot=OnRobot("d", late(f"{_PLACE}.drive_screen:suits"), late(f"{_PLACE}.drive_screen:drive_one")),
    chapters=(_DRIVE_SCREEN,),
)  # fmt: skip
