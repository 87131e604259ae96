"""An operator's command acts on the topic as it is once a robot has come to rest."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest
from tests.support.wording import says

from rsb_bridge.engine.topic_commands import CommandLog, TopicCommands
from rsb_bridge.link.extension import Denied, LinkError
from rsb_bridge.model.commands import PauseTopics
from rsb_bridge.telemetry.event_log import EventLog

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.link.link import Link

KEY = "robot1 → topic /cmd_vel"


class Role:
    """A role with one link and one route.

    Attributes:
        paused: the routes that were paused, by name.
    """

    def __init__(self) -> None:
        self.paused: list[str] = []
        self.link = SimpleNamespace(
            name="robot1",
            routes={KEY: route("old")},
            patterns=SimpleNamespace(find=lambda _: None),
            table=SimpleNamespace(pause=lambda each, **_: self.paused.append(each.local_topic)),
        )

    def links(self) -> list[Link]:
        return [cast("Link", self.link)]


def route(name: str) -> Any:
    async def wait() -> None:
        """Return at once."""

    pausing, settling = SimpleNamespace(paused=False), SimpleNamespace(wait=wait)
    return SimpleNamespace(local_topic=name, spec=None, pausing=pausing, settling=settling)


def pause(role: Role, context: Context, meanwhile: Callable[[], None]) -> None:
    """Pause the route, and do something while its robot comes to rest."""

    async def end_motions(_: set[str]) -> bool:
        await asyncio.sleep(0.2)
        meanwhile()
        return True

    log = CommandLog(EventLog(context.clock))
    bridge = SimpleNamespace(context=context, log=log, role=role, end_motions=end_motions)
    commands = TopicCommands(cast("Any", bridge))
    cast("VirtualLoop", context.loop).run_until_complete(commands.pause(PauseTopics(KEY, True)))


def test_what_took_its_place_meanwhile_is_paused(make_context: Callable[..., Context]) -> None:
    role = Role()
    pause(role, make_context(), lambda: role.link.routes.update({KEY: route("new")}))
    assert role.paused == ["new"]


def test_what_is_gone_meanwhile_is_not_paused(make_context: Callable[..., Context]) -> None:
    role = Role()
    with pytest.raises(LinkError) as refused:
        pause(role, make_context(), role.link.routes.clear)
    assert says(str(refused.value), Denied.NO_ROUTE, key=KEY)
    assert role.paused == []
