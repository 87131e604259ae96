"""The key that arms and disarms."""

from __future__ import annotations

from rsb_console.actions.action import Action, Group, late

_PLACE = "rsb_console.operations.arming_operations"
ACTIONS = (
    Action("arm", "A", "arm", "Arm the topic or the service, or disarm it", Group.OPERATE,
           changes=True, needs_topic=True, in_footer=True, run=late(f"{_PLACE}:arm"),
           possible=late(f"{_PLACE}:arms_or_disarms"), footer=late(f"{_PLACE}:arm_in_footer"),
           stops=late(f"{_PLACE}:disarms"), also="deadman, safety, enable", after="undo"),
)  # fmt: skip
