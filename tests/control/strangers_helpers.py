"""Helpers of `test_strangers` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model import commands
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.snapshot import State

if TYPE_CHECKING:
    from rsb_bridge.control.protocol import (
        AnyCommand,
    )


TOPIC = Topic("/scan", "transmit")


CHANGES: tuple[AnyCommand, ...] = (
    commands.AddTopic(TOPIC),
    commands.EditTopic("key", TOPIC, seen=TOPIC),
    commands.RemoveTopic("key"),
    commands.PauseTopics("key", paused=True),
    commands.Acknowledge("key", seen=(State.DOWN, "no_link")),
    commands.ArmTopic("key"),
    commands.AskHolder("key"),
    commands.TakeArming("key"),
    commands.AnswerAsker("key", gives=True),
    commands.DisarmTopic("key"),
    commands.AddClient(Client("robot2")),
    commands.ChangeClient(Client("robot2")),
    commands.RemoveClient("robot2"),
    commands.Call("key", "{}"),
    commands.CallWhole("key", "{}"),
    commands.Retry(),
    commands.ShutDownLinks(),
    commands.Restart(),
    commands.Reload(),
    commands.Save(),
    commands.Stop(),
)
