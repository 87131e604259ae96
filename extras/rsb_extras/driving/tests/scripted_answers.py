"""Answers to the commands of the documents."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rsb_bridge.model.audience import Audience
from rsb_extras.driving.publish_requests import Draft, DraftMessage, Publish, Published

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.commands import Command

ANSWERS: dict[type[Command[Any]], Callable[[Any], object]] = {
    DraftMessage: lambda _: Draft("geometry_msgs/msg/PoseStamped", "pose: {}\n"),
    Publish: lambda _: Published(is_done=True, audience=Audience(1)),
}
