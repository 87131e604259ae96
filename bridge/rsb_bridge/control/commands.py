"""What a console may ask of a bridge over a control socket. Sans-IO."""

from __future__ import annotations

from typing import TypeAlias

import msgspec

from rsb_bridge.model.benchmark import Order
from rsb_bridge.model.session import Client, Topic


class _Command(msgspec.Struct, frozen=True, tag_field="is", omit_defaults=True):
    """A command, named by its tag."""


class AddTopic(_Command, frozen=True, tag="add"):
    """As the methods of `rsb_bridge.api.EngineApi`, likewise those below."""

    topic: Topic
    link: str = ""


class EditTopic(_Command, frozen=True, tag="edit"):
    """See `AddTopic`."""

    key: str
    topic: Topic
    drop_arm: bool = False


class RemoveTopic(_Command, frozen=True, tag="remove"):
    """See `AddTopic`."""

    key: str
    drop_arm: bool = False


class Pause(_Command, frozen=True, tag="pause"):
    """See `AddTopic`."""

    key: str
    paused: bool


class Acknowledge(_Command, frozen=True, tag="acknowledge"):
    """See `AddTopic`."""

    key: str = ""
    acknowledged: bool = True
    link: str = ""


class ArmTopic(_Command, frozen=True, tag="arm"):
    """As the methods of `rsb_bridge.api.ArmingApi`, likewise those below: for the console that asks."""

    key: str


class DisarmTopic(_Command, frozen=True, tag="disarm"):
    """See `ArmTopic`."""

    key: str


class KeepArmed(_Command, frozen=True, tag="keep_armed"):
    """See `ArmTopic`."""

    pressed: bool


class ReleaseArmed(_Command, frozen=True, tag="release_armed"):
    """See `ArmTopic`."""


class AddClient(_Command, frozen=True, tag="add_client"):
    """See `AddTopic`."""

    client: Client


class ChangeClient(_Command, frozen=True, tag="change_client"):
    """See `AddTopic`."""

    client: Client


class RemoveClient(_Command, frozen=True, tag="remove_client"):
    """See `AddTopic`."""

    name: str


class Retry(_Command, frozen=True, tag="retry"):
    """See `AddTopic`."""

    link: str = ""


class ShutDown(_Command, frozen=True, tag="shut_down"):
    """See `AddTopic`."""


class Restart(_Command, frozen=True, tag="restart"):
    """See `AddTopic`. Its steps come as `Step`."""


class Reload(_Command, frozen=True, tag="reload"):
    """See `AddTopic`."""

    dry_run: bool = False


class Topics(_Command, frozen=True, tag="topics"):
    """See `AddTopic`."""

    link: str | None = None


class Peek(_Command, frozen=True, tag="peek"):
    """See `AddTopic`."""

    key: str
    kept: bool = False


class Describe(_Command, frozen=True, tag="describe"):
    """See `AddTopic`."""

    key: str


class Template(_Command, frozen=True, tag="template"):
    """See `AddTopic`."""

    key: str
    lane: str = ""


class Call(_Command, frozen=True, tag="call"):
    """See `AddTopic`."""

    key: str
    request: str
    lane: str = ""


class History(_Command, frozen=True, tag="history"):
    """See `AddTopic`."""

    seconds: float


class Bench(_Command, frozen=True, tag="bench"):
    """See `AddTopic`."""

    order: Order


class Stop(_Command, frozen=True, tag="stop"):
    """End the bridge's process, as SIGTERM does."""


Command: TypeAlias = (
    AddTopic
    | EditTopic
    | RemoveTopic
    | Pause
    | Acknowledge
    | ArmTopic
    | DisarmTopic
    | KeepArmed
    | ReleaseArmed
    | AddClient
    | ChangeClient
    | RemoveClient
    | Retry
    | ShutDown
    | Restart
    | Reload
    | Topics
    | Peek
    | Describe
    | Template
    | Call
    | History
    | Bench
    | Stop
)

CHANGING = (
    AddTopic, EditTopic, RemoveTopic, Pause, Acknowledge, ArmTopic, DisarmTopic, AddClient, ChangeClient,
    RemoveClient, Call, Retry, ShutDown, Restart, Reload, Stop,
)  # fmt: skip
"""The commands that are refused to those who only watch."""
