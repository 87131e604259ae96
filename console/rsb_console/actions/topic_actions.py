"""The keys that change topics and calls."""

from __future__ import annotations

from rsb_console.actions.action import Action, Group, late

_PLACE = "rsb_console.operations.topic_operations"
ACTIONS = (
    Action("add_topic", "a", "add", "Add a topic, service, action or parameters from either side", Group.OPERATE,
           changes=True, in_footer=True, run=late(f"{_PLACE}:add_topic")),
    Action("edit_topic", "e", "edit", "Edit the topic or the service", Group.OPERATE,
           changes=True, needs_topic=True, in_footer=True, run=late(f"{_PLACE}:edit_topic"),
           also="limit the rate, bandwidth, throttle, type, QoS, protocol, port, compression"),
    Action("remove_topic", "d", "remove", "Remove the topic or the service", Group.OPERATE,
           changes=True, needs_topic=True, in_footer=True, run=late(f"{_PLACE}:remove_topic")),
    Action("pause", "p", "pause", "Pause or resume the topic or the service", Group.OPERATE,
           changes=True, needs_topic=True, in_footer=True, run=late(f"{_PLACE}:pause")),
    Action("acknowledge", "i", "acknowledge", "Acknowledge the fault until it changes, or take that back",
           Group.OPERATE, changes=True, needs_topic=True, run=late(f"{_PLACE}:acknowledge"),
           also="known, silence, mute, ack, ignore"),
    Action("undo", "u", "undo", "Undo the last change of this console, after a question", Group.OPERATE,
           changes=True, in_footer=True, run=late(f"{_PLACE}:undo"), footer=late(f"{_PLACE}:undo_in_footer"),
           also="revert, put back, restore a removed topic"),
    Action("call", "C", "call", "Call the service or action by hand; of a node: set a parameter", Group.OPERATE,
           changes=True, needs_topic=True, in_footer=True, run=late(f"{_PLACE}:call"),
           possible=late(f"{_PLACE}:has_calls"), also="request, send a goal, param get list"),
)  # fmt: skip
